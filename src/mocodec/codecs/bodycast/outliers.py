"""Outlier points, which no body explains: skirts, props, people who are not tracked. Stored as centimetre cells.

frame − bodies ─► dense clusters ─► octree of cells, coded by context; colours relative to the cell before
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry import body_matching
from ...typing import Booleans, Floats, Integers
from ..clouds.raw_frames import MAX_RAW_POINTS, Cloud, no_points
from . import octree
from .binary_coder import BinaryDecoder, BinaryEncoder

CELL_M = 0.01
DEPTH = 13  # octree levels: 82 m
ORIGIN = 1 << DEPTH - 1  # the cell of coordinate 0
COLOUR_STEP = 12  # levels of 256
MIN_DISTANCE_M = 0.07  # of an outlier from the nearest body
CUBE_M = 0.04  # in which density is measured
MIN_DENSITY = 0.5  # of the median density at the bodies' surface, of a cube of outliers
MIN_CLUSTER_SHARE, MIN_CLUSTER_POINTS = (
    0.004,
    8.0,
)  # of the frame's points, of a cluster; flying pixels form smaller ones
TOUCHING = 1.8  # distance between cubes, in cubes: a shared face, edge or corner
POINTS_PER_BYTE = 8 * 16384  # most points that a byte of coded data can stand for


def find_outliers(frame: Cloud, bodies: Floats) -> Cloud:
    """The points of a frame that lie away from the bodies' surface (m, 3) and form dense clusters."""
    points, colours = frame
    distance, _ = body_matching.FramePoints.build(bodies, None, None).nearest(points, None, MIN_DISTANCE_M)
    is_far = ~np.isfinite(distance)
    rows = np.flatnonzero(is_far)
    if len(rows):
        cube = np.clip(np.floor(points / CUBE_M).astype(np.int64) + ORIGIN, 0, 2 * ORIGIN - 1)
        code, cube_of, count = np.unique(octree.morton_codes(cube), return_inverse=True, return_counts=True)
        cube_of = cube_of.reshape(-1)
        at_body = count[cube_of[~is_far]]
        usual = float(np.median(at_body)) if len(at_body) else 1.0
        outliers = np.bincount(cube_of[rows], minlength=len(code))
        rows = rows[outliers[cube_of[rows]] >= max(MIN_DENSITY * usual, 1.0)]
        least = max(MIN_CLUSTER_SHARE * len(points), MIN_CLUSTER_POINTS)
        rows = rows[_is_in_cluster(octree.cells_of_codes(code), cube_of[rows], least)]
    return points[rows], None if colours is None else colours[rows]


def _is_in_cluster(cubes: Integers, cube_of: Integers, least: float) -> Booleans:
    """(n,): True for points whose cluster of touching cubes holds at least `least` of them.

    cubes (m, 3): coordinates of cubes. cube_of (n,): the cube of each point.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    occupied, own = np.unique(cube_of, return_inverse=True)
    if not len(occupied):
        return np.zeros(0, bool)
    pairs = KDTree(cubes[occupied]).query_pairs(TOUCHING, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), bool), tuple(pairs.T)), shape=(len(occupied),) * 2)
    _, cluster = connected_components(graph, directed=False)
    label = np.asarray(cluster)[own.reshape(-1)]
    return np.bincount(label)[label] >= least


def pack_outliers(frames: Sequence[Cloud], coloured: bool) -> bytes:
    """The outliers of frames; b"" where no frame has any. Points of one cell become one."""
    encoder, contexts = BinaryEncoder(), octree.OctreeContexts.new()
    counts, colour_differences = list[int](), list[Integers]()
    for points, colours in frames:
        grid = np.clip(np.round(points / CELL_M) + ORIGIN, 0, 2 * ORIGIN - 1).astype(np.int64)
        code, first = np.unique(octree.morton_codes(grid), return_index=True)
        if len(code):
            octree.encode_octree(encoder, contexts, code, DEPTH, DEPTH)
        if coloured and colours is not None and len(code):
            colour_differences.append(np.diff(colours[first].astype(np.int64) // COLOUR_STEP, axis=0, prepend=0))
        counts.append(len(code))
    if not sum(counts):
        return b""
    octrees = encoder.finish()
    coded_counts = coder.pack(np.array(counts)[:, None])
    colour = coder.pack(np.concatenate(colour_differences)) if colour_differences else b""
    return varint.write([len(coded_counts), len(octrees)]) + coded_counts + octrees + colour


def unpack_outliers(data: bytes, frames: int, coloured: bool) -> list[Cloud]:
    """The inverse of `pack_outliers`, with points at the centres of their cells. Raises Corrupt."""
    if not data:
        return [no_points(coloured)] * frames
    (count_bytes, octree_bytes), at = varint.read(data, 2)
    counts = coder.unpack(data[at : at + count_bytes], (frames, 1))[:, 0]
    at += count_bytes
    if at + octree_bytes > len(data) or (counts < 0).any() or counts.max() > MAX_RAW_POINTS:
        raise Corrupt("bodycast: outlier points are damaged: cut off, or a count is out of range")
    if counts.sum() > min(MAX_RAW_POINTS, POINTS_PER_BYTE * len(data)):
        raise Corrupt(f"bodycast: {counts.sum()} outlier points in {len(data)} bytes")
    decoder, contexts = BinaryDecoder(data[at : at + octree_bytes]), octree.OctreeContexts.new()
    codes = [octree.decode_octree(decoder, contexts, int(n), DEPTH) if n else np.zeros(0, np.int64) for n in counts]
    decoder.finish()
    ends = np.cumsum([0, *counts.tolist()])
    differences = np.zeros((0, 3), np.int64)
    if coloured:
        differences = coder.unpack(data[at + octree_bytes :], (int(ends[-1]), 3))
    result = list[Cloud]()
    for code, i, j in zip(codes, ends[:-1], ends[1:], strict=True):
        points = (octree.cells_of_codes(code).astype(np.float64) - ORIGIN) * CELL_M
        levels = np.cumsum(differences[i:j], axis=0) * COLOUR_STEP + COLOUR_STEP // 2
        result.append((points, np.clip(levels, 0, 255).astype(np.uint8) if coloured else None))
    return result
