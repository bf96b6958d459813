"""Frames of point clouds: which points can be coded, and frames stored point by point.

PointClouds ──usable_points──► points and colours of a frame
frames that show no body ──pack_raw_frames──► bytes ──unpack_raw_frames──► the same frames
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np

from ...entropy import varint
from ...errors import Corrupt
from ...pointcloud import PointClouds
from ...typing import Booleans, Bytes, Floats
from .inflate import inflate

Cloud = tuple[Floats, Bytes | None]
"""Points (n, 3) in metres and their colours (n, 3), None without colours."""
MAX_COORDINATE_M = 1e4
MAX_RAW_POINTS = 1 << 24  # of a chunk
POSITION_BYTES, COLOUR_BYTES = 12, 3


def is_usable(points: Floats, limit_m: float = MAX_COORDINATE_M) -> Booleans:
    """(n,): True for points without NaN whose coordinates are all smaller than `limit_m`."""
    return np.asarray((np.abs(points) < limit_m).all(axis=1))


def usable_points(clouds: PointClouds, frame: int, limit_m: float = MAX_COORDINATE_M) -> Cloud:
    """The points and colours of a frame that `is_usable` accepts."""
    points = np.asarray(clouds.positions[frame], np.float64)
    colours = None if clouds.colours is None else clouds.colours[frame]
    if points.size and -limit_m < points.min() and points.max() < limit_m:  # False with any NaN
        return points, colours
    usable = is_usable(points, limit_m)
    return points[usable], None if colours is None else colours[usable]


def no_points(coloured: bool) -> Cloud:
    """A frame without points."""
    return np.zeros((0, 3)), np.zeros((0, 3), np.uint8) if coloured else None


def pack_raw_frames(frames: Sequence[Cloud]) -> bytes:
    """Frames of few points as 32-bit floats and bytes of colour; b"" for no frames."""
    if not frames:
        return b""
    content = b"".join(
        points.astype("<f4").tobytes() + (b"" if colours is None else colours.tobytes()) for points, colours in frames
    )
    counts = varint.write(len(points) for points, _ in frames)
    return counts + zlib.compress(content, 9)


def unpack_raw_frames(data: bytes, frames: int, coloured: bool) -> list[Cloud]:
    """The inverse of `pack_raw_frames`. Raises Corrupt."""
    if not frames:
        return []
    counts, at = varint.read(data, frames)
    if sum(counts) > MAX_RAW_POINTS:
        raise Corrupt(f"raw frames with more than {MAX_RAW_POINTS} points in a chunk")
    size = sum(counts) * (POSITION_BYTES + COLOUR_BYTES * coloured)
    content = inflate(data[at:], size)
    if len(content) != size:
        raise Corrupt(f"raw frames hold {len(content)} bytes of points instead of {size}")
    result, at = list[Cloud](), 0
    for count in counts:
        points = np.frombuffer(content, "<f4", count * 3, at).reshape(count, 3).astype(np.float64)
        at += count * POSITION_BYTES
        colours = np.frombuffer(content, np.uint8, count * 3, at).reshape(count, 3) if coloured else None
        at += count * COLOUR_BYTES * coloured
        result.append((points, colours))
    return result
