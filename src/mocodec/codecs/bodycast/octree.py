"""Occupancy octree of points on a grid.

    cells ─► Morton codes, sorted ─► level by level, octant by octant ─► occupancy bits, coded by context
                                     └─ below the last coded level, the rest of each code as raw bits

All first octants of a level are coded before all second ones. So the context of an octant includes the octants beside
it that are coded already, in its own cube and in the next.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ... import native
from ...errors import Corrupt
from ...typing import AnyInteger, Integers
from .binary_coder import BinaryDecoder, BinaryEncoder, ContextCounts

MAX_DEPTH = 20  # levels
MAX_POINTS = 1 << 24
SINGLE_SHARE = 0.9  # once this share of the distinct points have a cube of their own, the rest of the codes is raw
MAX_MULTIPLICITY_CONTEXT = 3
AXIS_BITS = tuple(sum(1 << 3 * bit + axis for bit in range(MAX_DEPTH)) for axis in range(3))
SPREAD_STEPS = (
    (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)  # fmt: skip
"""Shifts and masks that move the bits of a number three places apart."""


class OctreeContexts(NamedTuple):
    """Counts that carry over from frame to frame.

    occupancy: of octants. multiplicity: "does this cube hold another point?"
    """

    occupancy: ContextCounts
    multiplicity: ContextCounts

    @staticmethod
    def new() -> OctreeContexts:
        return OctreeContexts(ContextCounts(8 * 64 * 3 * 7), ContextCounts(MAX_MULTIPLICITY_CONTEXT + 1))


def morton_codes(cells: Integers) -> Integers:
    """Morton codes (n,) of cells (n, 3), coordinates 0 to 2^20 − 1; x is the lowest bit of each three."""
    if (kernel := native.kernel("morton_codes")) is not None:
        return np.asarray(kernel(cells))
    result = np.zeros(len(cells), np.int64)
    for axis in range(3):
        v = cells[:, axis].astype(np.int64)
        for shift, mask in SPREAD_STEPS:
            v = (v | v << shift) & mask
        result |= v << axis
    return result


def cells_of_codes(code: Integers) -> Integers:
    """The inverse of `morton_codes`."""
    if (kernel := native.kernel("cells_of_codes")) is not None:
        return np.asarray(kernel(code))
    result = np.empty((len(code), 3), np.int64)
    for axis in range(3):
        v = code >> axis & SPREAD_STEPS[-1][1]
        for (shift, _), (_, mask) in zip(SPREAD_STEPS[::-1], (*SPREAD_STEPS[-2::-1], (0, (1 << 21) - 1)), strict=True):
            v = (v | v >> shift) & mask
        result[:, axis] = v
    return result


def last_coded_level(code: Integers, depth: int) -> int:
    """The level of sorted codes (n,) below which the rest of each code is stored as raw bits."""
    distinct = len(np.unique(code))
    for level in range(depth):
        if len(np.unique(code >> 3 * (depth - level))) >= SINGLE_SHARE * distinct:
            return level
    return depth


def encode_octree(encoder: BinaryEncoder, contexts: OctreeContexts, code: Integers, depth: int, stop: int) -> Integers:
    """Code sorted codes (n,), n ≥ 1, of `depth` levels down to level `stop`. Returns the rest (n,) of each code."""
    for level in range(stop):
        cubes, children = np.unique(code >> 3 * (depth - level)), np.unique(code >> 3 * (depth - level - 1))
        occupied = np.zeros((len(cubes) + 1, 8), np.int64)
        occupied[np.searchsorted(cubes, children >> 3), children & 7] = 1
        known = np.zeros_like(occupied)
        neighbours = neighbour_rows(cubes, level)
        for octant in range(8):
            context = _occupancy_contexts(known, neighbours, octant)
            encoder.encode(contexts.occupancy, context, occupied[:-1, octant])
            known[:, octant] = occupied[:, octant]
    _, count = np.unique(code >> 3 * (depth - stop), return_counts=True)
    for points in range(int(count.max())):
        context = np.full(len(count), min(points, MAX_MULTIPLICITY_CONTEXT))
        encoder.encode(contexts.multiplicity, context, (count > 1).astype(np.int64))
        count = count[count > 1] - 1
    return code & (1 << 3 * (depth - stop)) - 1


def decode_octree(decoder: BinaryDecoder, contexts: OctreeContexts, points: int, stop: int) -> Integers:
    """The cubes (points,) of level `stop` that hold the points, in order. Raises Corrupt."""
    cubes = np.zeros(1, np.int64)
    for level in range(stop):
        known = np.zeros((len(cubes) + 1, 8), np.int64)
        neighbours = neighbour_rows(cubes, level)
        for octant in range(8):
            known[:-1, octant] = decoder.decode(contexts.occupancy, _occupancy_contexts(known, neighbours, octant))
        parent, octant = np.nonzero(known[:-1])
        if not 0 < len(parent) <= points:
            raise Corrupt(f"bodycast: an octree of {points} points has {len(parent)} cubes in level {level + 1}")
        cubes = cubes[parent] << 3 | octant
    count, multiple, rounds = np.ones(len(cubes), np.int64), np.arange(len(cubes)), 0
    while len(multiple):
        context = np.full(len(multiple), min(rounds, MAX_MULTIPLICITY_CONTEXT))
        multiple = multiple[decoder.decode(contexts.multiplicity, context) > 0]
        count[multiple] += 1
        rounds += 1
        if rounds > points:
            break
    if int(count.sum()) != points:
        raise Corrupt(f"bodycast: the cubes of an octree hold {int(count.sum())} points instead of {points}")
    return np.repeat(cubes, count)


def neighbour_rows(cubes: Integers, level: int) -> Integers:
    """(6, n): the row in `cubes` of each cube's neighbours, before and behind along every axis; n where it is empty."""
    result = np.full((6, len(cubes)), len(cubes))
    inside = (1 << 3 * level) - 1
    for axis, axis_bits in enumerate(AXIS_BITS):
        mask = axis_bits & inside
        own, rest = cubes & mask, cubes & ~mask
        for side, at_edge, neighbour in (
            (0, own == 0, (own - 1) & mask | rest),
            (1, own == mask, ((own | ~mask) + 1) & mask | rest),
        ):
            row = np.minimum(np.searchsorted(cubes, neighbour), len(cubes) - 1)
            occupied = (cubes[row] == neighbour) & ~at_edge
            result[2 * axis + side][occupied] = row[occupied]
    return result


def _occupancy_contexts(known: Integers, neighbours: Integers, octant: int) -> AnyInteger:
    """(n,): the context of this octant in each cube.

    In mixed radix: the octant (8); along each axis (4) either the two octants beside it that are coded already, or
    whether the neighbour cube on its side is occupied; octants of its cube occupied so far (3: 0, 1, more); occupied
    neighbour cubes (7).
    """
    count = neighbours.shape[1]
    context = np.full(count, octant)
    for axis in range(3):
        if octant >> axis & 1:
            opposite = octant ^ 1 << axis
            context = context * 4 + 2 * known[:-1, opposite] + known[neighbours[2 * axis + 1], opposite]
        else:
            context = context * 4 + (neighbours[2 * axis] < count)
    context = context * 3 + np.minimum(known[:-1].sum(axis=1), 2)
    return context * 7 + (neighbours < count).sum(axis=0)
