"""PLY: frames of coloured points, one file per frame, in a folder, a glob or a single file.

    folder | glob | file.ply ──read──► PointClouds ──write──► folder of frame_000000.ply | one file.ply

PLY stores neither rate nor unit: they are options of the reader, or comments that `write` adds (`comment rate 15`,
`comment units m`).
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import BadInput, Truncated
from ..pointcloud import PointClouds
from . import cloud_frames
from .cloud_frames import COLOURS, NORMAL, POSITION, Frame

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
KNOWN = {*POSITION, *NORMAL, *(name for names in COLOURS for name in names)}
MAX_HEADER_BYTES = 1 << 16
MAX_ELEMENTS = 1 << 40


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
    hertz = fps if fps is not None else rate
    return cloud_frames.recording(path, ".ply", read_frame, hertz=hertz, unit=unit, up=up, salvage=salvage)


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


def read_frame(path: Path) -> Frame:
    """The vertices of one file. Raises BadInput, Truncated."""
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
    source = {"encoding": header.encoding}
    if header.encoding == "ascii":
        return Frame(ascii_vertices(body, sum(e.size for e in before), vertex, path), source, header.comments)
    order = "<" if header.encoding == "binary_little_endian" else ">"
    skip = 0
    for element in before:
        skip += bytes_of(element, body[skip:], order, path)
    dtype = record(vertex, order)
    if skip + vertex.size * dtype.itemsize > len(body):
        raise Truncated(f"{path}: ends before its {vertex.size} vertices")
    return Frame(np.frombuffer(body, dtype, vertex.size, skip), source, header.comments)


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
    """Vertices of an ASCII file."""
    width = len(vertex.fields)
    if vertex.size * width * 2 > len(body) + 1:
        raise Truncated(f"{path}: ends before its {vertex.size} vertices")
    lines = body.split(b"\n", skip_lines + vertex.size)[skip_lines : skip_lines + vertex.size]
    numbers = cloud_frames.numbers_of_lines(lines, (vertex.size, width), "vertices", path)
    values = np.empty(vertex.size, record(vertex, "<"))
    for (name, kind), column in zip(vertex.fields, numbers.T, strict=True):
        values[name] = cloud_frames.of_type(column, kind, name, path)
    return values


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
