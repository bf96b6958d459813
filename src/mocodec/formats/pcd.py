"""PCD of the Point Cloud Library: frames of coloured points, one file per frame, in a folder, a glob or a single file.

    header ─► Header ─► the columns of the fields that are kept ─► points with finite coordinates ─► Frame

The data are text, rows of bytes, or columns of bytes behind LZF (`binary_compressed`). PCD stores neither rate nor
unit.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from itertools import accumulate
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ..errors import BadInput, Truncated
from ..pointcloud import PointClouds
from . import cloud_frames, lzf
from .cloud_frames import COLOURS, NORMAL, POSITION, Frame

PACKED_COLOURS = ("rgb", "rgba")
"""Fields of 32 bits, integer or float, whose bits are 0xAARRGGBB."""
NAMES = {
    **{name: name for name in (*POSITION, *PACKED_COLOURS)},
    **dict(zip(("normal_x", "normal_y", "normal_z"), NORMAL, strict=True)),
    **{name: name for name in COLOURS[-1]},
}
"""The fields that are kept, and their names in a Frame."""
PADDING = "_"
TYPES = {"I": "i", "U": "u", "F": "f"}
SIZES = {"I": (1, 2, 4, 8), "U": (1, 2, 4, 8), "F": (4, 8)}
"""Bytes that a value of a type can have."""
ENCODINGS = ("ascii", "binary", "binary_compressed")
MAX_HEADER_BYTES = 1 << 16
MAX_COUNT = 1 << 20
MAX_POINTS = 1 << 40
AT_ORIGIN = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
"""The VIEWPOINT of a sensor at the origin: translation, quaternion (w first)."""

WITHOUT_POSITION = "points without coordinates (NaN or infinite) are left out"
NOT_APPLIED = "frames with a VIEWPOINT, which is not applied to their points"
AS_NUMBERS = "frames whose rgb floats are taken as numbers 0xRRGGBB, not as bits"
LOST_COLOURS = "colours that are NaN in the text and become black"

Value = TypeVar("Value", int, float)
Column = np.ndarray[Any, np.dtype[Any]]


class Field(NamedTuple):
    """kind: NumPy type. values: how many each point has."""

    name: str
    kind: str
    values: int

    @property
    def bytes(self) -> int:
        """Bytes in each point."""
        return np.dtype(self.kind).itemsize * self.values


class Header(NamedTuple):
    """size: bytes of the header. has_viewpoint: whether the sensor is anywhere but at the origin."""

    encoding: str
    fields: list[Field]
    points: int
    size: int
    has_viewpoint: bool


def read(
    path: str | PathLike[str],
    *,
    fps: float | None = None,
    rate: float | None = None,
    unit: str | float | None = None,
    up: str | None = None,
    salvage: bool = False,
) -> PointClouds:
    """Frames of points from a folder of .pcd files, a glob of them, or one file; frames in natural order of names.

    fps or rate: hertz. unit: of the coordinates, by default "m". up: the vertical axis, by default "y". Points without
    finite coordinates are left out and noted; fields other than position, colour and normal are listed in
    `source["ignored"]`. salvage: leave out frames at the end that cannot be read. Raises BadInput, Truncated.
    """
    hertz = fps if fps is not None else rate
    return cloud_frames.recording(path, ".pcd", read_frame, hertz=hertz, unit=unit, up=up, salvage=salvage)


def read_frame(path: Path) -> Frame:
    """The points of one file that have coordinates. Raises BadInput, Truncated."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}") from None
    header = parse_header(data, path)
    kept = [i for i, field in enumerate(header.fields) if _is_kept(field)]
    if not set(POSITION) <= {header.fields[i].name for i in kept}:
        raise BadInput(f"{path}: has no fields x, y and z")
    given = columns_of(header, data[header.size :], kept, path)
    columns = {NAMES[header.fields[i].name]: column for i, column in given.items()}
    has_position = np.logical_and.reduce([np.isfinite(columns[axis]) for axis in POSITION])
    columns = {name: column[has_position] for name, column in columns.items()}
    remarks = {NOT_APPLIED: int(header.has_viewpoint), WITHOUT_POSITION: int(np.count_nonzero(~has_position))}
    for name in set(PACKED_COLOURS) & set(columns):
        bits, noted = colour_bits(columns.pop(name), header.encoding == "ascii")
        remarks |= noted
        columns |= {c: (bits >> shift).astype(np.uint8) for c, shift in zip(COLOURS[0], (16, 8, 0), strict=True)}
    values = np.empty(len(columns["x"]), [(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        values[name] = column
    ignored = [field.name for i, field in enumerate(header.fields) if i not in given and field.name != PADDING]
    return Frame(values, ignored=ignored, remarks={text: count for text, count in remarks.items() if count})


def _is_kept(field: Field) -> bool:
    return field.name in NAMES and field.values == 1 and (field.name not in PACKED_COLOURS or field.bytes == 4)


def colour_bits(column: Column, is_text: bool) -> tuple[np.ndarray[Any, np.dtype[np.uint32]], dict[str, int]]:
    """Packed colours as uint32 0xAARRGGBB, and remarks for the notes.

    The bits of a float are the colour. In text they are small (below 1e-37) or, with alpha, beyond ±1e37 or NaN, so
    floats from 1 to 0xFFFFFF are taken as numbers.
    """
    if column.dtype.kind != "f":
        return column.astype(np.uint32), {}
    bits = np.ascontiguousarray(column).view(np.uint32)
    if not is_text:
        return bits, {}
    lost = np.isnan(column)
    known = column[~lost]
    if ((known == 0) | ((known >= 1) & (known <= 0xFFFFFF))).all() and known.any():
        return np.where(lost, 0, column).astype(np.uint32), {AS_NUMBERS: 1, LOST_COLOURS: int(lost.sum())}
    return np.where(lost, np.uint32(0), bits), {LOST_COLOURS: int(lost.sum())}


def columns_of(header: Header, body: bytes, kept: list[int], path: Path) -> dict[int, Column]:
    """The values (points,) of the fields with these indices, which have one value in a point.

    Raises BadInput, Truncated.
    """
    if not header.points:
        return {index: np.zeros(0, header.fields[index].kind) for index in kept}
    if header.encoding == "ascii":
        return _of_text(header, body, kept, path)
    if header.encoding == "binary":
        return _of_rows(header, body, kept, path)
    return _of_compressed(header, body, kept, path)


def _of_text(header: Header, body: bytes, kept: list[int], path: Path) -> dict[int, Column]:
    starts = _starts([field.values for field in header.fields])
    if header.points * starts[-1] * 2 > len(body) + 1:
        raise Truncated(f"{path}: ends before its {header.points} points")
    lines = [line for line in body.split(b"\n") if line and not line.isspace()][: header.points]
    numbers = cloud_frames.numbers_of_lines(lines, (header.points, starts[-1]), "points", path)
    fields = header.fields
    return {i: cloud_frames.of_type(numbers[:, starts[i]], fields[i].kind, fields[i].name, path) for i in kept}


def _of_rows(header: Header, body: bytes, kept: list[int], path: Path) -> dict[int, Column]:
    starts = _starts([field.bytes for field in header.fields])
    if header.points * starts[-1] > len(body):
        raise Truncated(f"{path}: ends before its {header.points} points")
    rows = np.frombuffer(body, np.uint8, header.points * starts[-1]).reshape(header.points, starts[-1])
    columns = dict[int, Column]()
    for index in kept:
        of_field = np.ascontiguousarray(rows[:, starts[index] : starts[index + 1]])
        columns[index] = of_field.view(header.fields[index].kind)[:, 0]
    return columns


def _of_compressed(header: Header, body: bytes, kept: list[int], path: Path) -> dict[int, Column]:
    """Fields one after the other behind LZF. Writers leave out padding that the header may name."""
    compressed, size = (int.from_bytes(body[start : start + 4], "little") for start in (0, 4))
    if len(body) < 8 + compressed:
        raise Truncated(f"{path}: ends before its {header.points} points")
    all_bytes = [field.bytes for field in header.fields]
    without_padding = [0 if field.name == PADDING else field.bytes for field in header.fields]
    widths = next((w for w in (all_bytes, without_padding) if sum(w) * header.points == size), None)
    if widths is None:
        expected = sum(without_padding) * header.points
        raise BadInput(f"{path}: its {header.points} points take {expected} bytes, not {size} as it says")
    try:
        data = lzf.decompress(body[8 : 8 + compressed], size)
    except ValueError as error:
        raise BadInput(f"{path}: its compressed points are damaged ({error})") from None
    starts = _starts(widths)
    columns = dict[int, Column]()
    for index in kept:
        of_field = data[starts[index] * header.points : starts[index + 1] * header.points]
        columns[index] = np.frombuffer(of_field, header.fields[index].kind)
    return columns


def _starts(widths: list[int]) -> list[int]:
    """Where each of parts that follow each other starts, and where the last ends."""
    return [0, *accumulate(widths)]


def parse_header(data: bytes, path: Path) -> Header:
    """The header up to and with the line DATA. Raises BadInput, Truncated."""
    if not data:
        raise Truncated(f"{path}: is empty")
    if not re.match(rb"\s*(#|VERSION|FIELDS|COLUMNS)", data):
        raise BadInput(f"{path}: not a PCD file")
    end = re.search(rb"(?:^|\n)DATA[ \t]+(\S+)[ \t]*\r?\n", data[:MAX_HEADER_BYTES])
    if not end:
        raise Truncated(f"{path}: the file is cut off: its header does not end")
    encoding = end[1].decode("latin-1")
    if encoding not in ENCODINGS:
        raise BadInput(f"{path}: unknown PCD encoding {encoding!r:.40}")
    entries = dict[str, list[str]]()
    for line in data[: end.start()].decode("latin-1").split("\n"):
        words = line.split()
        if words and not words[0].startswith("#"):
            entries["FIELDS" if words[0] == "COLUMNS" else words[0]] = words[1:]
    viewpoint = _entry(entries, "VIEWPOINT", float, path) or AT_ORIGIN
    return Header(encoding, _fields(entries, path), _points(entries, path), end.end(), viewpoint != AT_ORIGIN)


def _entry(entries: dict[str, list[str]], name: str, type_: Callable[[str], Value], path: Path) -> list[Value]:
    """The values of a line of the header; [] without the line. Raises BadInput."""
    try:
        return [type_(word) for word in entries.get(name, [])]
    except ValueError:
        raise BadInput(f"{path}: bad header line {' '.join((name, *entries[name]))!r:.80}") from None


def _fields(entries: dict[str, list[str]], path: Path) -> list[Field]:
    """The fields of a point; sizes, types and counts are 4, F and 1 in old files without them. Raises BadInput."""
    names = [name.lower() if name.lower() in NAMES else name for name in entries.get("FIELDS", [])]
    sizes = _entry(entries, "SIZE", int, path) or [4] * len(names)
    types = entries.get("TYPE") or ["F"] * len(names)
    counts = _entry(entries, "COUNT", int, path) or [1] * len(names)
    if not len(names) == len(sizes) == len(types) == len(counts):
        raise BadInput(f"{path}: FIELDS, SIZE, TYPE and COUNT of its header have different numbers of entries")
    repeated = [name for name, count in Counter(names).items() if count > 1 and name != PADDING]
    if repeated:
        raise BadInput(f"{path}: has several fields {repeated[0]!r:.40}")
    for name, size, type_, count in zip(names, sizes, types, counts, strict=True):
        if size not in SIZES.get(type_, ()):
            raise BadInput(f"{path}: field {name!r:.40} has an unknown type {type_!r:.10} of {size} bytes")
        if not 1 <= count <= MAX_COUNT:
            raise BadInput(f"{path}: field {name!r:.40} has a count of {count}")
    kinds = [f"<{TYPES[type_]}{size}" for size, type_ in zip(sizes, types, strict=True)]
    return [Field(*field) for field in zip(names, kinds, counts, strict=True)]


def _points(entries: dict[str, list[str]], path: Path) -> int:
    """The number of points: POINTS, or WIDTH × HEIGHT in files without it. Raises BadInput where they differ."""
    points, width, height = (_entry(entries, name, int, path)[:1] for name in ("POINTS", "WIDTH", "HEIGHT"))
    product = [w * h for w, h in zip(width, height or [1], strict=False)]
    if not points and not product:
        raise BadInput(f"{path}: its header says no number of points")
    if points and product and points != product and product != [0]:
        raise BadInput(f"{path}: its header says {points[0]} points, but WIDTH × HEIGHT are {product[0]}")
    count = (points or product)[0]
    if not 0 <= count <= MAX_POINTS:
        raise BadInput(f"{path}: its header says {count} points")
    return count
