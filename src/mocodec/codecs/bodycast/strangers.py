"""Points that no body explains: skirts, props, people beyond those who are followed. As cells of a centimetre.

frame − bodies ─► crowded cells ─► octree ─► adaptive bits; colours against the cell before ─► entropy coder
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry import body_matching
from ...geometry.articulation import Floats
from .. import body_stream
from . import bits, octree

Integers = NDArray[np.int64]
Cloud = tuple[Floats, NDArray[np.uint8] | None]
CELL = 0.01  # metres
AWAY = 0.07  # metres from the body that a point must be
WIDE = 0.04  # metres: a cube of a crowd
CROWD = 0.5  # of the points that a cube at the body usually holds, which one of a crowd holds at least
COMPANY = 0.004  # of a frame's points that a crowd is at least, in cubes that touch: flying pixels are in smaller ones
DEPTH = 13  # levels: 80 m
COLOUR_STEP = 12


def unexplained(frame: Cloud, bodies: Floats) -> Cloud:
    """The points of a frame that are away from the bodies' (m, 3), where there is a crowd of them."""
    points, colours = frame
    away, _ = body_matching.FramePoints.build(bodies, None, None).nearest(points, None, AWAY)
    is_far = ~np.isfinite(away)
    far = np.flatnonzero(is_far)
    if len(far):
        cube = np.clip(np.floor(points / WIDE).astype(np.int64) + (1 << DEPTH - 1), 0, (1 << DEPTH) - 1)
        code, which, count = np.unique(octree.codes(cube), return_inverse=True, return_counts=True)
        which = which.reshape(-1)
        near = count[which[~is_far]]
        usual = float(np.median(near)) if len(near) else 1.0
        outside = np.bincount(which[far], minlength=len(code))
        far = far[outside[which[far]] >= max(CROWD * usual, 1.0)]
        far = far[_in_company(octree.cells_of(code), which[far], max(COMPANY * len(points), 8.0))]
    return points[far], None if colours is None else colours[far]


def _in_company(cube: Integers, which: Integers, least: float) -> NDArray[np.bool_]:
    """(n,): which points, of these cubes, are among so many in cubes that touch one another."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    kinds, own = np.unique(which, return_inverse=True)
    if not len(kinds):
        return np.zeros(0, bool)
    pairs = KDTree(cube[kinds]).query_pairs(1.8, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), bool), tuple(pairs.T)), shape=(len(kinds),) * 2)
    _, group = connected_components(links, directed=False)
    label = np.asarray(group)[own.reshape(-1)]
    return np.bincount(label)[label] >= least


def pack_strangers(frames: Sequence[Cloud], coloured: bool) -> bytes:
    """Frames of such points; nothing where no frame has any."""
    writer, state, counts, shades = bits.Writer(), octree.State.new(), list[int](), list[Integers]()
    for points, colours in frames:
        grid = np.clip(np.round(points / CELL) + (1 << DEPTH - 1), 0, (1 << DEPTH) - 1).astype(np.int64)
        code, first = np.unique(octree.codes(grid), return_index=True)
        if len(code):
            octree.write(writer, state, code, DEPTH, DEPTH)
        if coloured and colours is not None and len(code):
            shades.append(np.diff(colours[first].astype(np.int64) // COLOUR_STEP, axis=0, prepend=0))
        counts.append(len(code))
    if not sum(counts):
        return b""
    cells = writer.finish()
    numbers = coder.pack(np.array(counts)[:, None])
    colour = coder.pack(np.concatenate(shades)) if shades else b""
    return varint.write([len(numbers), len(cells)]) + numbers + cells + colour


def unpack_strangers(data: bytes, frames: int, coloured: bool) -> list[Cloud]:
    """The inverse of `pack_strangers`, points at the middle of their cells. Raises Corrupt."""
    empty = np.zeros((0, 3)), np.zeros((0, 3), np.uint8) if coloured else None
    if not data:
        return [empty] * frames
    (numbers, cells), at = varint.read(data, 2)
    counts = coder.unpack(data[at : at + numbers], (frames, 1))[:, 0]
    at += numbers
    if at + cells > len(data) or (counts < 0).any() or counts.max() > body_stream.MAX_RAW:
        raise Corrupt("bodycast: points beside the body are damaged")
    if counts.sum() > min(body_stream.MAX_RAW, 8 * 16384 * len(data)):
        raise Corrupt("bodycast: too many points beside the body")
    reader, state = bits.Reader(data[at : at + cells]), octree.State.new()
    codes = [octree.read(reader, state, int(n), DEPTH) if n else np.zeros(0, np.int64) for n in counts]
    reader.finish()
    ends = np.cumsum([0, *counts.tolist()])
    values = coder.unpack(data[at + cells :], (int(ends[-1]), 3)) if coloured else np.zeros((0, 3), np.int64)
    result = list[Cloud]()
    for code, i, j in zip(codes, ends[:-1], ends[1:], strict=True):
        points = (octree.cells_of(code).astype(np.float64) - (1 << DEPTH - 1)) * CELL
        shade = np.cumsum(values[i:j], axis=0) * COLOUR_STEP + COLOUR_STEP // 2
        result.append((points, np.clip(shade, 0, 255).astype(np.uint8) if coloured else None))
    return result
