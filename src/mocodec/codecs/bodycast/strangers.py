"""Points that no part of the body explains: skirts, props, a second person. As cells of a centimetre, in order of an
octree.

    frame − body ─► crowded cells ─► Morton order ─► differences of the codes ─► entropy coder
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry.articulation import Floats
from .. import body_stream

Integers = NDArray[np.int64]
Cloud = tuple[Floats, NDArray[np.uint8] | None]
CELL = 0.01  # metres
AWAY = 0.07  # metres from the body that a point must be
CROWD = 4  # points within 4 cm that a point must be among, so that flying pixels are not coded
BITS = 13  # of a coordinate: 80 m
COLOUR_STEP = 12


def strangers(frame: Cloud, share: float, body: Floats) -> Cloud:
    """The points of a frame that are away from the body's (m, 3), where there is a crowd of them.

    share: of the points that the tracker could not explain; below a hundredth nothing is looked for.
    """
    from scipy.spatial import KDTree

    points, colours = frame
    if share >= 0.01:
        away, _ = KDTree(body).query(points, distance_upper_bound=AWAY)
        far = np.flatnonzero(~np.isfinite(away))
        if len(far):
            cell = np.floor(points[far] / 0.04).astype(np.int64)
            _, which, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
            far = far[count[which.reshape(-1)] >= CROWD]
        return points[far], None if colours is None else colours[far]
    return np.zeros((0, 3)), None if colours is None else np.zeros((0, 3), np.uint8)


def pack_strangers(frames: Sequence[Cloud], coloured: bool) -> bytes:
    """Frames of such points; nothing where no frame has any."""
    parts, counts = list[Integers](), list[int]()
    for points, colours in frames:
        grid = np.clip(np.round(points / CELL) + (1 << BITS - 1), 0, (1 << BITS) - 1).astype(np.int64)
        code, first = np.unique(_interleave(grid), return_index=True)
        lanes = [np.diff(code, prepend=0)[:, None]]
        if coloured:
            assert colours is not None
            lanes.append(np.diff(colours[first].astype(np.int64) // COLOUR_STEP, axis=0, prepend=0))
        parts.append(np.concatenate(lanes, axis=1))
        counts.append(len(code))
    if not sum(counts):
        return b""
    return varint.write(counts) + coder.pack(np.concatenate(parts))


def unpack_strangers(data: bytes, frames: int, coloured: bool) -> list[Cloud]:
    """The inverse of `pack_strangers`, points at the middle of their cells. Raises Corrupt."""
    empty = np.zeros((0, 3)), np.zeros((0, 3), np.uint8) if coloured else None
    if not data:
        return [empty] * frames
    counts, at = varint.read(data, frames)
    if sum(counts) > body_stream.MAX_RAW:
        raise Corrupt("bodycast: too many points beside the body")
    values = coder.unpack(data[at:], (sum(counts), 4 if coloured else 1))
    result, at = list[Cloud](), 0
    for count in counts:
        run = np.cumsum(values[at : at + count], axis=0)
        points = (_separate(run[:, 0]).astype(np.float64) - (1 << BITS - 1)) * CELL
        colours = np.clip(run[:, 1:] * COLOUR_STEP + COLOUR_STEP // 2, 0, 255).astype(np.uint8) if coloured else None
        result.append((points, colours))
        at += count
    return result


def _interleave(grid: Integers) -> Integers:
    """Morton codes (n,) of (n, 3)."""
    code = np.zeros(len(grid), np.int64)
    for bit in range(BITS):
        for axis in range(3):
            code |= ((grid[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def _separate(code: Integers) -> Integers:
    """(n, 3) of Morton codes (n,)."""
    grid = np.zeros((len(code), 3), np.int64)
    for bit in range(BITS):
        for axis in range(3):
            grid[:, axis] |= ((code >> (3 * bit + axis)) & 1) << bit
    return grid
