"""PLY: frames of coloured points, one file per frame, in a folder, a glob or a single file.

    folder | glob | file.ply ──read──► PointClouds ──write──► folder of frame_000000.ply | one file.ply

PLY stores neither rate nor unit: they are options of the reader, or comments that `write` adds (`comment rate 15`,
`comment units m`).
"""

from __future__ import annotations

import glob
import os
import re
import shutil
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import BadInput, Truncated
from ..motion import UP_AXES
from ..pointcloud import PointClouds
from ..selection import counted
from ..typing import Bytes, Floats
from .conventions import unit_option

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
POSITION, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
KNOWN = {*POSITION, *NORMAL, *(name for names in COLOURS for name in names)}
MAX_HEADER_BYTES = 1 << 16
MAX_ELEMENTS = 1 << 40
MAX_UNIT_COLOUR = 1.01
"""The largest float colour of files whose colours are 0 … 1; rounding may exceed 1."""
BLOCK_LINES = 1 << 15
"""Lines of an ASCII file that are parsed at a time: their numbers as texts take ten times their bytes."""
USUAL_EXTENT_M = 100.0
"""Frames of people that are larger are rarely in metres."""


class Element(NamedTuple):
    """One element of a PLY header. fields: (name, NumPy type); lists: (name, type of the count, type of the items)."""

    name: str
    size: int
    fields: list[tuple[str, str]]
    lists: list[tuple[str, str, str]]


class Header(NamedTuple):
    """A PLY header; size: its bytes."""

    encoding: str
    elements: list[Element]
    comments: dict[str, str]
    size: int


def read(
    path: str | PathLike[str],
    *,
    fps: float | None = None,
    rate: float | None = None,
    unit: str | float | None = None,
    up: str | None = None,
    salvage: bool = False,
) -> PointClouds:
    """Frames of points from a folder of .ply files, a glob of them, or one file; frames in natural order of names.

    fps or rate: hertz. unit: of the coordinates, such as "m" or "mm". up: the vertical axis, by default "y". All
    three may be comments of the files instead. Points with NaN coordinates are kept; properties other than position,
    colour and normal are listed in `source["ignored"]`; `source["missing_numbers"]` counts missing file numbers, whose
    frames are skipped. salvage: leave out frames at the end that cannot be read. Raises BadInput, Truncated.
    """
    notes: list[str] = []
    files = frame_files(path)
    frames = _read_frames(files, salvage, notes)
    files = files[: len(frames)]
    comments = frames[0][1].comments
    hertz = next((given for given in (fps, rate, comments.get("rate")) if given is not None), None)
    if hertz is None:
        raise BadInput(f"{path}: PLY files store no frame rate; give it, for instance fps=15 (--fps 15)")
    try:
        units, unit_m = unit_option(unit or comments.get("units", "m"))
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None
    first = frames[0][0].dtype
    names = first.names or ()
    if not (unit or "units" in comments):
        notes += _unit_notes(frames)
    colour = next((c for c in COLOURS if set(c) <= set(names)), None)
    normal = NORMAL if set(NORMAL) <= set(names) else None
    coloured = sum(any(set(c) <= set(values.dtype.names or ()) for c in COLOURS) for values, _ in frames)
    if colour is None and coloured:
        notes.append(f"the colours of {counted(coloured, 'frame')} are left out, since {files[0].name} has none")
    for file, (values, _) in zip(files, frames, strict=True):
        _require_properties(file, values, colour, normal)
    positions = [columns(values, POSITION) * unit_m for values, _ in frames]
    normals = [columns(values, normal) for values, _ in frames] if normal else None
    colours = _colours([values for values, _ in frames], colour, notes) if colour else None
    for name, frames_of_vectors in (("points", positions), ("normals", normals or [])):
        if missing := sum(int((~np.isfinite(vectors)).any(axis=1).sum()) for vectors in frames_of_vectors):
            notes.append(f"{missing} {name} are NaN or infinite; codecs of point clouds may leave them out")
    used = {*POSITION, *(colour or ()), *(normal or ())}
    source: dict[str, Any] = {
        "format": "ply", "encoding": frames[0][1].encoding, "units": units, "unit_m": unit_m,
        "double": bool(first["x"].itemsize == 8),
    }  # fmt: skip
    if missing := missing_numbers(files):
        source["missing_numbers"] = missing
    if ignored := [n for n in names if n not in used]:
        source["ignored"] = ignored
    if notes:
        source["notes"] = notes
    try:
        return PointClouds(
            positions=positions,
            rate=float(hertz),
            colours=colours,
            normals=normals,
            up=up or (comments["up"] if comments.get("up") in UP_AXES else "y"),
            source=source,
        )
    except ValueError as error:
        raise BadInput(f"{path}: {error}") from None


def _unit_notes(frames: Sequence[tuple[np.ndarray[Any, np.dtype[Any]], Header]]) -> list[str]:
    """A note on frames without a unit that are too large for metres."""
    values = next((values for values, _ in frames if len(values)), None)
    if values is None:
        return []
    points = columns(values, POSITION)
    points = points[np.isfinite(points).all(axis=1)]
    extent = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    if extent <= USUAL_EXTENT_M:
        return []
    return [f"its points extend over {extent:,.0f} m: if its unit is not the metre, give it, such as --unit mm (unit=)"]


def _read_frames(
    files: list[Path], salvage: bool, notes: list[str]
) -> list[tuple[np.ndarray[Any, np.dtype[Any]], Header]]:
    """All frames; with salvage, those before the first of the broken ones at the end, which are noted."""
    frames: list[tuple[np.ndarray[Any, np.dtype[Any]], Header]] = []
    broken: list[BadInput | Truncated] = []
    for file in files:
        try:
            frame = read_frame(file)
        except (BadInput, Truncated) as error:
            if not salvage:
                raise
            broken.append(error)
            continue
        if broken:
            raise broken[0]  # not at the end: leaving it out would shift the frames behind it
        frames.append(frame)
    if broken and not frames:
        raise broken[0]
    if broken:
        notes.append(f"cut off: {len(broken)} frames at the end cannot be read and are left out ({broken[0]})")
    return frames


def _require_properties(
    file: Path, values: np.ndarray[Any, np.dtype[Any]], colour: tuple[str, ...] | None, normal: tuple[str, ...] | None
) -> None:
    """Raises BadInput for a frame without properties of the first frame, and for colours that are not finite."""
    for properties in filter(None, (POSITION, colour, normal)):
        if not set(properties) <= set(values.dtype.names or ()):
            raise BadInput(f"{file}: has no {', '.join(properties)}, which the first frame has")
    if not all(np.isfinite(values[name]).all() for name in colour or ()):
        raise BadInput(f"{file}: has colours that are not finite")


def _colours(frames: list[np.ndarray[Any, np.dtype[Any]]], names: tuple[str, ...], notes: list[str]) -> list[Bytes]:
    """Colours of all frames as bytes.

    Floats are 0 … 1 by custom; if any is larger, all are taken as 0 … 255. So are 16-bit integers if none is larger.
    """
    floats = (frame[name] for frame in frames for name in names if frame.dtype[name].kind == "f")
    largest = max((float(values.max(initial=0)) for values in floats), default=0.0)
    full_scale = 255.0
    if largest > MAX_UNIT_COLOUR:
        full_scale = 1.0
        notes.append(f"its colours are floats up to {largest:g}: they are taken as 0 to 255, not as 0 to 1")
    shorts = [frame[name] for frame in frames for name in names if frame.dtype[name].str[1:] == "u2"]
    short_step = 257.0
    if shorts and 0 < max(int(values.max(initial=0)) for values in shorts) <= 255:
        short_step = 1.0
        notes.append("its colours are 16-bit numbers up to 255: they are taken as 0 to 255, not as 0 to 65535")
    return [as_bytes(columns(frame, names, full_scale, short_step)) for frame in frames]


def write(
    path: str | PathLike[str], clouds: PointClouds, *, encoding: str | None = None, overwrite: bool = False
) -> None:
    """Write frames as `frame_000000.ply` … into a folder, or a single frame as one .ply file.

    encoding: "ascii", "binary_little_endian" or "binary_big_endian"; by default the source's. Coordinates are in the
    source's unit. overwrite: remove .ply files that are in the folder; otherwise they raise BadInput.
    """
    from . import replace_whole

    encoding = encoding or str(clouds.source.get("encoding", "binary_little_endian"))
    if encoding not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise BadInput(f"unknown PLY encoding {encoding!r}")
    target = Path(path)
    if target.suffix.lower() == ".ply":
        if len(clouds) != 1:
            raise BadInput(f"{target}: {len(clouds)} frames do not fit one .ply file; name a folder")
        replace_whole(target, frame_bytes(clouds, 0, encoding))
        return
    if target.is_file():
        raise BadInput(f"{target}: is a file, not a folder")
    old = sorted(target.glob("*.ply"))
    if old and not overwrite:
        raise BadInput(f"{target}: already has {len(old)} .ply files; name a new folder (overwrite=True replaces them)")
    with _frames_together(Path(os.path.realpath(target)), old) as folder:
        for frame in range(len(clouds)):
            (folder / f"frame_{frame:06d}.ply").write_bytes(frame_bytes(clouds, frame, encoding))


@contextmanager
def _frames_together(target: Path, old: Sequence[Path]) -> Generator[Path, None, None]:
    """A temporary folder whose files become those of `target`, in place of `old`, at the end of the context, unless it
    raises.
    """
    is_new = not target.is_dir()
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = (target.parent if is_new else target) / f".mocodec-{os.urandom(6).hex()}-part"
    temporary.mkdir()
    try:
        yield temporary
        if is_new:
            os.replace(temporary, target)
            return
        for file in old:
            file.unlink()
        for file in sorted(temporary.iterdir()):
            os.replace(file, target / file.name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def frame_files(path: str | PathLike[str]) -> list[Path]:
    """The .ply files of a folder, glob or single path, in natural order: frame_2 before frame_10."""
    text = os.fspath(path)
    if Path(text).is_dir():
        files = [p for p in Path(text).iterdir() if p.suffix.lower() == ".ply" and p.is_file()]
    elif Path(text).is_file():
        files = [Path(text)]
    else:
        files = [Path(p) for p in glob.glob(text) if p.lower().endswith(".ply") and Path(p).is_file()]
    if not files:
        raise BadInput(f"{text}: no .ply file there")
    return sorted(files, key=lambda p: [int(s) if i % 2 else s for i, s in enumerate(re.split(r"([0-9]+)", p.name))])


def missing_numbers(files: list[Path]) -> int:
    """How many numbers are missing between the first and the last file of a sequence whose numbers have a usual step;
    0 for numbers without one, such as times."""
    numbers = [re.findall(r"[0-9]+", file.stem)[-1:] for file in files]
    if len(files) < 3 or not all(numbers):
        return 0
    values = [int(number[0]) for number in numbers]
    steps = [after - before for before, after in pairwise(values)]
    usual = sorted(steps)[len(steps) // 2]
    if usual <= 0 or any(step <= 0 or step % usual for step in steps):
        return 0
    return sum(step // usual - 1 for step in steps)


def read_frame(path: Path) -> tuple[np.ndarray[Any, np.dtype[Any]], Header]:
    """The vertices of one file as a structured array, and its header. Raises BadInput, Truncated."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}") from None
    header = parse_header(data, path)
    body = data[header.size :]
    names = [element.name for element in header.elements]
    if "vertex" not in names:
        raise BadInput(f"{path}: has no vertices")
    before, vertex = header.elements[: names.index("vertex")], header.elements[names.index("vertex")]
    if vertex.lists:
        raise BadInput(f"{path}: vertices with list properties ({vertex.lists[0][0]}) are not supported")
    if not set(POSITION) <= {name for name, _ in vertex.fields}:
        raise BadInput(f"{path}: vertices without x, y and z")
    if header.encoding == "ascii":
        return ascii_vertices(body, sum(e.size for e in before), vertex, path), header
    order = "<" if header.encoding == "binary_little_endian" else ">"
    skip = 0
    for element in before:
        skip += bytes_of(element, body[skip:], order, path)
    dtype = record(vertex, order)
    if skip + vertex.size * dtype.itemsize > len(body):
        raise Truncated(f"{path}: ends before its {vertex.size} vertices")
    return np.frombuffer(body, dtype, vertex.size, skip), header


def bytes_of(element: Element, body: bytes, order: str, path: Path) -> int:
    """Bytes of an element at the start of `body`; lists must all have one length (triangles, or quads)."""
    if not element.lists or not element.size:
        return element.size * record(element, order).itemsize
    if element.fields or len(element.lists) > 1:
        raise BadInput(f"{path}: {element.name} with lists comes before the vertices; save vertices first")
    _, count, kind = element.lists[0]
    width = np.dtype(count).itemsize
    items = int(np.frombuffer(body, order + count, 1)[0]) if len(body) >= width else 0
    row = width + max(items, 0) * np.dtype(kind).itemsize
    if element.size * row > len(body):
        raise Truncated(f"{path}: ends before its {element.size} {element.name} elements")
    counts = np.frombuffer(body, np.dtype([("count", order + count), ("rest", f"V{row - width}")]), element.size)
    if (counts["count"] != items).any():
        raise BadInput(f"{path}: {element.name} of different sizes come before the vertices; save vertices first")
    return element.size * row


def ascii_vertices(body: bytes, skip_lines: int, vertex: Element, path: Path) -> np.ndarray[Any, np.dtype[Any]]:
    """Vertices of an ASCII file, the numbers of BLOCK_LINES lines parsed in one call."""
    width = len(vertex.fields)
    if vertex.size * width * 2 > len(body) + 1:
        raise Truncated(f"{path}: ends before its {vertex.size} vertices")
    lines = body.split(b"\n", skip_lines + vertex.size)[skip_lines : skip_lines + vertex.size]
    try:
        blocks = [lines[start : start + BLOCK_LINES] for start in range(0, len(lines), BLOCK_LINES)]
        parsed = [np.array(b" ".join(block).split(), dtype=np.float64) for block in blocks]
        flat = np.concatenate(parsed) if parsed else np.zeros(0)
    except ValueError:
        wrong = next(token for token in b" ".join(lines).split() if not _is_number(token))
        raise BadInput(f"{path}: {wrong.decode('latin-1')!r:.40} among its vertices is not a number") from None
    if flat.size < vertex.size * width:
        raise Truncated(f"{path}: ends before its {vertex.size} vertices")
    if flat.size != vertex.size * width:
        raise BadInput(f"{path}: its {vertex.size} vertices have {flat.size} numbers, not {width} each")
    values = np.empty(vertex.size, record(vertex, "<"))
    for (name, kind), column in zip(vertex.fields, flat.reshape(vertex.size, width).T, strict=True):
        if kind[0] in "iu":
            limits = np.iinfo(kind)
            if not ((column >= limits.min) & (column <= limits.max)).all():
                raise BadInput(f"{path}: {name} is outside the range of its type")
        values[name] = column.astype(kind)
    return values


def _is_number(token: bytes) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return True


def parse_header(data: bytes, path: Path) -> Header:
    """The header up to and with `end_header`. Raises BadInput, Truncated."""
    if not data:
        raise Truncated(f"{path}: is empty")
    if data[:3] != b"ply":
        raise BadInput(f"{path}: not a PLY file")
    end = re.search(rb"(?:^|\n)end_header[ \t]*\r?\n", data[:MAX_HEADER_BYTES])
    if not end:
        raise Truncated(f"{path}: the file is cut off: its header does not end")
    encoding, elements, comments = "", list[Element](), dict[str, str]()
    for line in data[: end.end()].decode("latin-1").splitlines()[1:]:
        words = line.split()
        try:
            match words:
                case ["format", kind, _]:
                    encoding = kind
                case ["comment" | "obj_info", key, value]:
                    comments.setdefault(key, value)
                case ["element", name, count]:
                    elements.append(Element(name, int(count), [], []))
                    if not 0 <= int(count) <= MAX_ELEMENTS:
                        raise ValueError
                case ["property", "list", count, kind, name]:
                    if TYPES[count][0] == "f":
                        raise ValueError
                    elements[-1].lists.append((name, TYPES[count], TYPES[kind]))
                case ["property", kind, name]:
                    name = name.lower() if name.lower() in KNOWN else name
                    if name in dict(elements[-1].fields):
                        raise ValueError
                    elements[-1].fields.append((name, TYPES[kind]))
                case _:
                    pass
        except (KeyError, IndexError, ValueError):
            raise BadInput(f"{path}: bad header line {line!r}") from None
    if encoding not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise BadInput(f"{path}: unknown PLY encoding {encoding!r}")
    return Header(encoding, elements, comments, end.end())


def record(element: Element, order: str) -> np.dtype[Any]:
    """The dtype of one item of an element; order: "<" or ">"."""
    return np.dtype([(name, order + kind) for name, kind in element.fields])


def columns(
    values: np.ndarray[Any, np.dtype[Any]], names: tuple[str, ...], full_scale: float = 255.0, short_step: float = 257.0
) -> Floats:
    """(n, 3) float64 of three named fields; colours are scaled from the range of their type to 0 … 255.

    full_scale: what a colour of 1.0 becomes. short_step: what becomes 1 of a colour of 16 bits.
    """
    result = np.empty((len(values), len(names)))
    for i, name in enumerate(names):
        with np.errstate(invalid="ignore"):  # of signalling NaNs
            result[:, i] = values[name]
        if values.dtype[name].kind == "f" and name not in POSITION + NORMAL:
            result[:, i] *= full_scale
        elif values.dtype[name].kind == "u" and values.dtype[name].itemsize == 2:
            result[:, i] /= short_step
    return result


def as_bytes(colours: Floats) -> Bytes:
    """Colours 0 to 255 as uint8; NaN becomes black."""
    return np.clip(np.rint(np.nan_to_num(colours)), 0, 255).astype(np.uint8)


def frame_bytes(clouds: PointClouds, frame: int, encoding: str) -> bytes:
    """One frame as a PLY file."""
    order = ">" if encoding == "binary_big_endian" else "<"
    kind = "f8" if clouds.source.get("double") else "f4"
    unit = float(clouds.source.get("unit_m", 1.0))
    fields = [(name, order + kind) for name in POSITION]
    parts = [np.asarray(clouds.positions[frame], np.float64) / unit]
    if clouds.normals is not None:
        fields += [(name, order + "f4") for name in NORMAL]
        parts.append(np.asarray(clouds.normals[frame], np.float64))
    if clouds.colours is not None:
        fields += [(name, "u1") for name in COLOURS[0]]
        parts.append(np.asarray(clouds.colours[frame], np.float64))
    names = {"f4": "float", "f8": "double", "u1": "uchar"}
    head = ["ply", f"format {encoding} 1.0", f"comment rate {clouds.rate:.17g}"]
    head += [f"comment units {clouds.source.get('units', 'm')}", f"comment up {clouds.up}"]
    head += [f"element vertex {len(clouds.positions[frame])}"]
    head += [f"property {names[kind.lstrip('<>')]} {name}" for name, kind in fields] + ["end_header", ""]
    values = np.empty(len(clouds.positions[frame]), fields)
    for name, column in zip(values.dtype.names or (), np.concatenate(parts, axis=1).T, strict=True):
        values[name] = column
    if encoding != "ascii":
        return "\n".join(head).encode() + values.tobytes()
    rows = (" ".join(map(str, row)) for row in values.tolist())
    if kind == "f4":
        digits = " ".join("%d" if k == "u1" else "%.9g" for _, k in fields)
        rows = (digits % row for row in values.tolist())
    return ("\n".join(head) + "\n".join(rows) + ("\n" if len(values) else "")).encode()
