"""An NPZ that is cut off: the arrays before its end, and the complete frames of the one that the end cuts.

    local headers from the start ─► complete arrays ──────────────────────┐
                                 └► an array that is cut: complete rows ──┴─► an NPZ in memory
The directory of a zip file is at its end, so a cut archive has none.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from .numpy_files import MAX_DEFLATE_RATIO, array_of, bytes_of, header_of

LOCAL = b"PK\x03\x04"
SIZES_FOLLOW = 0x08
"""Flag of members whose sizes stand behind their bytes."""
NOT_BY_FRAME = ("parents", "offsets", "betas", "names", "labels", "joint_names", "marker_names")
"""Arrays that have no row for each frame, whatever their length."""


class _Member(NamedTuple):
    """A member of the archive; data: its inflated bytes that are there, of `size`."""

    name: str
    data: bytes
    size: int


def archive_of(path: str | Path, salvage: bool, notes: list[str]) -> zipfile.ZipFile:
    """The archive at a path; of a cut one, with salvage, what is there, which is noted. Raises BadInput."""
    try:
        return zipfile.ZipFile(path)
    except zipfile.BadZipFile:
        data = Path(path).read_bytes()
        if not data.startswith(LOCAL):
            raise
        if not salvage:
            raise BadInput(
                f"{path}: cut off: the directory at its end is missing; --salvage reads what is there"
            ) from None
    return _salvaged(str(path), data, notes)


def _salvaged(path: str, data: bytes, notes: list[str]) -> zipfile.ZipFile:
    members = [member for member in _members(data) if member.name.endswith(".npy")]
    arrays = {m.name: array_of(m.data, m.name) for m in members if len(m.data) == m.size}
    rows = 0
    for member in members:
        if len(member.data) < member.size and member.name.removesuffix(".npy") not in NOT_BY_FRAME:
            cut, rows = _complete_rows(member)
            if not len(cut):
                continue
            arrays = {name: _first_rows(name, array, rows, len(cut)) for name, array in arrays.items()}
            arrays[member.name] = cut
            name = member.name.removesuffix(".npy")
            notes.append(f"cut off: {len(cut)} of {rows} rows of {name!r} are read; arrays behind it are lost")
    if not arrays:
        raise BadInput(f"{path}: cut off: no array is complete")
    if not rows:
        notes.append(f"cut off: its complete arrays are read, {len(arrays)} of them")
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, array in arrays.items():
            archive.writestr(name, bytes_of(array))
    return zipfile.ZipFile(out)


def _members(data: bytes) -> list[_Member]:
    """The members from the start on, up to the end of the bytes or to one that says nothing of its size."""
    members: list[_Member] = []
    at = 0
    while data.startswith(LOCAL, at) and at + 30 <= len(data):
        flags, method = struct.unpack_from("<HH", data, at + 6)
        packed, size, name_length, extra_length = struct.unpack_from("<IIHH", data, at + 18)
        name = data[at + 30 : at + 30 + name_length].decode("utf-8", "replace")
        start = at + 30 + name_length + extra_length
        if 0xFFFFFFFF in (packed, size):
            packed, size = _long_sizes(data[at + 30 + name_length : start])
        if flags & SIZES_FOLLOW or method not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            break
        body = data[start : start + packed]
        limit = min(size, MAX_DEFLATE_RATIO * len(body) + 4096)
        if method == zipfile.ZIP_DEFLATED and limit:
            body = zlib.decompressobj(-zlib.MAX_WBITS).decompress(body, limit)
        members.append(_Member(name, body, size))
        at = start + packed
    return members


def _long_sizes(extra: bytes) -> tuple[int, int]:
    """Packed and inflated size of a member whose 32-bit sizes are saturated; 0, 0 without them."""
    at = 0
    while at + 4 <= len(extra):
        tag, length = struct.unpack_from("<HH", extra, at)
        if tag == 1 and length >= 16 and at + 20 <= len(extra):
            size, packed = struct.unpack_from("<QQ", extra, at + 4)
            return packed, size
        at += 4 + length
    return 0, 0


def _complete_rows(member: _Member) -> tuple[NDArray[Any], int]:
    """The complete rows of an array that is cut, and how many it declares."""
    try:
        header = header_of(member.data)
    except ValueError:
        return np.empty(0), 0
    if header.dtype.hasobject or not header.shape or not header.dtype.itemsize:
        return np.empty(0), 0
    row = header.dtype.itemsize * int(np.prod(header.shape[1:], dtype=object))
    rows = min(header.shape[0], (len(member.data) - header.size) // row) if row else 0
    values = np.frombuffer(member.data, header.dtype, rows * row // header.dtype.itemsize, header.size)
    return values.reshape(rows, *header.shape[1:]), header.shape[0]


def _first_rows(name: str, array: NDArray[Any], rows: int, count: int) -> NDArray[Any]:
    """The first rows of an array that has one for each frame; others as they are."""
    by_frame = array.ndim > 0 and len(array) == rows and name.removesuffix(".npy") not in NOT_BY_FRAME
    return array[:count] if by_frame else array
