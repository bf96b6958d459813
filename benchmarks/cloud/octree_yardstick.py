"""Yardstick for clouds without a body: an octree of occupied cubes for each frame alone, like G-PCC's geometry.

    points ─► cells of a cubic grid ─► occupancy of the eight children of each cube, bit by bit ─► adaptive bits

As in G-PCC (ISO/IEC 23090-9, octree geometry), the context of a child's bit is the occupancy of the six cubes beside
its cube, of the coded children of this cube, and of coded children beside it in earlier cubes. Probabilities are mixed
as in `entropy.bit_arrays`, which takes fewer bits than G-PCC's single contexts. Every frame starts without statistics,
like an intra frame.
"""

from __future__ import annotations

import numpy as np

from mocodec.codecs.bodycast import octree
from mocodec.entropy.bit_arrays import BitEncoder
from mocodec.typing import Floats, Integers

HEADER_BYTES = 24  # header of a frame: corner, step, depth and number of points
POPULATION = np.array([bin(mask).count("1") for mask in range(256)])


def frame_bytes(points: Floats, step_m: float) -> int:
    """Bytes of a frame (n, 3) on a cubic grid, with errors of at most √3/2 steps."""
    if not len(points):
        return 1
    cells = np.round(points / step_m).astype(np.int64)
    cells -= cells.min(axis=0)
    codes = np.unique(octree.morton_codes(cells))
    depth, encoder = int(cells.max()).bit_length(), BitEncoder()
    for level in range(depth):
        cubes = np.unique(codes >> 3 * (depth - level))
        children = np.unique(codes >> 3 * (depth - level - 1))
        masks = np.zeros(len(cubes) + 1, np.int64)
        np.bitwise_or.at(masks, np.searchsorted(cubes, children >> 3), 1 << (children & 7))
        _code_level(encoder, masks, octree.neighbour_rows(cubes, level), depth - level)
    return len(encoder.finish()) + HEADER_BYTES


def decoded(points: Floats, step_m: float) -> Floats:
    """Centres (n, 3) of the distinct cells of a frame."""
    return np.unique(np.round(points / step_m), axis=0) * step_m


def _code_level(encoder: BitEncoder, masks: Integers, neighbours: Integers, height: int) -> None:
    """masks (n + 1,): occupied children of each cube; the last is empty. neighbours (6, n): rows; n: empty."""
    own, octants = masks[:-1, None], np.arange(8)
    occupied = neighbours < neighbours.shape[1]
    pattern = (occupied.T << np.arange(6)).sum(axis=1)[:, None]
    coded = own & (1 << octants) - 1
    few = np.minimum(POPULATION[coded], 3)
    beside = np.zeros((len(own), 8), np.int64)
    for axis in range(3):
        opposite = octants ^ 1 << axis
        inside = own >> opposite & 1
        before = masks[neighbours[2 * axis]][:, None] >> opposite & 1  # already coded: cubes are sorted by code
        behind = occupied[2 * axis + 1].astype(np.int64)[:, None]
        beside = beside * 4 + np.where(octants >> axis & 1, 2 * inside + behind, before)
    filled = occupied.sum(axis=0)[:, None]
    prefix = octants * 256 + coded
    contexts = np.stack(
        [
            pattern * 2048 + prefix,
            ((octants * 4 + few) * 64 + beside) * 4 + np.minimum(filled // 2, 3),
            filled * 2048 + prefix,
            (octants * 4 + few) * 16 + np.broadcast_to(min(height, 15), few.shape),
            ((octants * 4 + few) * 7 + filled) * 16 + min(height, 15),
        ],
        axis=2,
    )
    is_known = (octants == 7) & (coded == 0)  # at least one child is occupied
    sets = np.broadcast_to(min(height, 15) * 8, few.shape) + octants
    bits = (own >> octants & 1).astype(bool)
    encoder.code(contexts[~is_known], sets[~is_known], bits[~is_known])
