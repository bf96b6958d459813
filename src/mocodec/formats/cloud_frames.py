"""Recordings of point clouds with a file for each frame, as PLY and PCD have them: files to frames to PointClouds.

    folder | glob | file ──frame_files──► files ──read_frame of the format──► Frames ──recording──► PointClouds

A format has a suffix and a `read_frame`.
"""

from __future__ import annotations

import glob
import os
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
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

POSITION, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
MAX_UNIT_COLOUR = 1.01
"""The largest float colour of files whose colours are 0 … 1; rounding may exceed 1."""
BLOCK_LINES = 1 << 15
"""Lines of a text file that are parsed at a time: their numbers as texts take ten times their bytes."""
USUAL_EXTENT_M = 100.0
"""Frames of people that are larger are rarely in metres."""


class Frame(NamedTuple):
    """One file.

    values: structured array (points,) with POSITION, and if it has them NORMAL and one of COLOURS. source: what the
    format adds to the source of the recording. comments: of the file: rate, units, up. ignored: names of properties
    that are not in `values`. remarks: sentences for the notes, each with a count that is summed over frames.
    """

    values: np.ndarray[Any, np.dtype[Any]]
    source: Mapping[str, Any] = {}
    comments: Mapping[str, str] = {}
    ignored: Sequence[str] = ()
    remarks: Mapping[str, int] = {}


def frame_files(path: str | PathLike[str], suffix: str) -> list[Path]:
    """The files with this suffix of a folder, glob or single path, in natural order: frame_2 before frame_10."""
    text = os.fspath(path)
    if Path(text).is_dir():
        files = [p for p in Path(text).iterdir() if p.suffix.lower() == suffix and p.is_file()]
    elif Path(text).is_file():
        files = [Path(text)]
    else:
        files = [Path(p) for p in glob.glob(text) if p.lower().endswith(suffix) and Path(p).is_file()]
    if not files:
        raise BadInput(f"{text}: no {suffix} file there")
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


def read_frames(
    files: Sequence[Path], read_frame: Callable[[Path], Frame], salvage: bool, notes: list[str]
) -> list[Frame]:
    """All frames; with salvage, those before the first of the broken ones at the end, which are noted."""
    frames: list[Frame] = []
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


def recording(
    path: str | PathLike[str],
    suffix: str,
    read_frame: Callable[[Path], Frame],
    *,
    hertz: float | None = None,
    unit: str | float | None = None,
    up: str | None = None,
    salvage: bool = False,
) -> PointClouds:
    """The frames of a folder, a glob or a file whose format has this suffix. Raises BadInput, Truncated.

    hertz, unit, up: in place of the comments of the first file. salvage: as `read_frames`.
    """
    notes: list[str] = []
    files = frame_files(path, suffix)
    frames = read_frames(files, read_frame, salvage, notes)
    files = files[: len(frames)]
    first, comments = frames[0].values.dtype, frames[0].comments
    hertz = hertz if hertz is not None else comments.get("rate")  # type: ignore[assignment]
    if hertz is None:
        name = suffix[1:].upper()
        raise BadInput(f"{path}: {name} files store no frame rate; give it, for instance fps=15 (--fps 15)")
    try:
        units, unit_m = unit_option(unit or comments.get("units", "m"))
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None
    names = first.names or ()
    if not (unit or "units" in comments):
        notes += _unit_notes(frames)
    colour = next((c for c in COLOURS if set(c) <= set(names)), None)
    normal = NORMAL if set(NORMAL) <= set(names) else None
    coloured = sum(any(set(c) <= set(frame.values.dtype.names or ()) for c in COLOURS) for frame in frames)
    if colour is None and coloured:
        notes.append(f"the colours of {counted(coloured, 'frame')} are left out, since {files[0].name} has none")
    for file, frame in zip(files, frames, strict=True):
        _require_properties(file, frame.values, colour, normal)
    positions = [columns(frame.values, POSITION) * unit_m for frame in frames]
    normals = [columns(frame.values, normal) for frame in frames] if normal else None
    colours = _colours([frame.values for frame in frames], colour, notes) if colour else None
    for name, frames_of_vectors in (("points", positions), ("normals", normals or [])):
        if missing := sum(int((~np.isfinite(vectors)).any(axis=1).sum()) for vectors in frames_of_vectors):
            notes.append(f"{missing} {name} are NaN or infinite; codecs of point clouds may leave them out")
    remarks = sum((Counter(frame.remarks) for frame in frames), Counter[str]())
    notes += [f"{remark}: {count:,}" for remark, count in remarks.items()]
    used = {*POSITION, *(colour or ()), *(normal or ())}
    source: dict[str, Any] = {
        "format": suffix[1:], **frames[0].source, "units": units, "unit_m": unit_m,
        "double": bool(first["x"].itemsize == 8),
    }  # fmt: skip
    if missing := missing_numbers(files):
        source["missing_numbers"] = missing
    if ignored := [n for n in names if n not in used] + list(frames[0].ignored):
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


def _unit_notes(frames: Sequence[Frame]) -> list[str]:
    """A note on frames without a unit that are too large for metres."""
    values = next((frame.values for frame in frames if len(frame.values)), None)
    if values is None:
        return []
    points = columns(values, POSITION)
    points = points[np.isfinite(points).all(axis=1)]
    extent = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    if extent <= USUAL_EXTENT_M:
        return []
    return [f"its points extend over {extent:,.0f} m: if its unit is not the metre, give it, such as --unit mm (unit=)"]


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


def numbers_of_lines(lines: Sequence[bytes], shape: tuple[int, int], what: str, path: Path) -> Floats:
    """The numbers in lines of text, in rows of this shape; those of BLOCK_LINES lines are parsed in one call.

    what: the rows in words, such as "vertices". Raises BadInput, Truncated.
    """
    rows, width = shape
    try:
        blocks = [lines[start : start + BLOCK_LINES] for start in range(0, len(lines), BLOCK_LINES)]
        parsed = [np.array(b" ".join(block).split(), dtype=np.float64) for block in blocks]
        flat = np.concatenate(parsed) if parsed else np.zeros(0)
    except ValueError:
        wrong = next(token for token in b" ".join(lines).split() if not _is_number(token))
        raise BadInput(f"{path}: {wrong.decode('latin-1')!r:.40} among its {what} is not a number") from None
    if flat.size < rows * width:
        raise Truncated(f"{path}: ends before its {rows} {what}")
    if flat.size != rows * width:
        raise BadInput(f"{path}: its {rows} {what} have {flat.size} numbers, not {width} each")
    return flat.reshape(rows, width)


def of_type(numbers: Floats, kind: str, name: str, path: Path) -> np.ndarray[Any, np.dtype[Any]]:
    """Numbers that were text as the type of their property. Raises BadInput for integers outside its range."""
    if kind[0] in "iu":
        limits = np.iinfo(kind)
        if not ((numbers >= limits.min) & (numbers <= limits.max)).all():
            raise BadInput(f"{path}: {name} is outside the range of its type")
    return numbers.astype(kind)


def _is_number(token: bytes) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return True
