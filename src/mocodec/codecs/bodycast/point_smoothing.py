"""Moves the points of a lattice towards the surface that the points around them lie on. Integers only.

    cells, sample of each point ─► points of the samples around it ─► mean distance from their tangent planes ─► shift

Rounding to the lattice moves points off a smooth surface. The points around a point tell where the surface passes, so
a decoder takes most of the error along the normal back: a coarser lattice gives the same distances.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ... import native
from ...entropy.bit_arrays import CUT_OFF, BitCoder
from ...errors import Corrupt
from ...typing import Booleans, Integers
from .surface_hints import NORMAL_BITS, SUBUNIT_BITS, SurfaceHints

FINE_BITS = 8  # shifts are in 2^-8 of the lattice's unit
PER_SAMPLE = 4  # points of a sample that others are compared with
MAX_SPACING = 1 << 16  # of samples, subunits, so that products of damaged values fit into 64 bits
WEIGHT_BITS = 10  # weight of a point at no distance: 2^12
LEAST_COSINE = 315  # of the angle between normals of compared points, 2^-10
GAIN_AT_UNIT, GAIN_LOSS = 48_000, 90  # gain in 2^-8: the first over the mean deviation, minus the second
LARGEST_MOVE = 1 << FINE_BITS - 1  # along the normal
BATCH_POINTS = 4096  # whose candidates are in memory together
STAY_CONTEXTS, STAY_WEIGHTS = 1 << 20, 1024  # first context and weight set, beyond those of octrees
DEVIATIONS = 16  # classes


class SmoothedPoints(NamedTuple):
    """shifts (n, 3), 2^-FINE_BITS units: from lattice points to the surface. moves (n,): along the normals. deviations
    (n,): the mean distance of the points around from their mean; 0 where nothing moves.
    """

    shifts: Integers
    moves: Integers
    deviations: Integers


def smooth(cells: Integers, samples: Integers, hints: SurfaceHints | None) -> SmoothedPoints:
    """cells (n, 3): lattice coordinates. samples (n,): the row in `hints` near each, −1 without one."""
    count = len(cells)
    if hints is None or not len(hints.points):
        return SmoothedPoints(np.zeros((count, 3), np.int64), np.zeros(count, np.int64), np.zeros(count, np.int64))
    if (kernel := native.kernel("smooth_points")) is not None:
        spacing = min(hints.spacing, MAX_SPACING)
        return SmoothedPoints(*map(np.asarray, kernel(hints.compiled, cells, samples, spacing)))
    moves, deviations = _moves(Candidates(cells, samples, np.arange(count)), cells, samples, hints)
    return SmoothedPoints(shifts_of_moves(moves, samples, hints), moves, deviations)


def shifts_of_moves(moves: Integers, samples: Integers, hints: SurfaceHints) -> Integers:
    """(n, 3): moves (n,) along the normals of samples (n,), 2^-FINE_BITS units; 0 without a sample."""
    normals = np.where((samples >= 0)[:, None], hints.normals[samples], 0)
    return normals * moves[:, None] + (1 << NORMAL_BITS - 1) >> NORMAL_BITS


class Candidates(NamedTuple):
    """Where points might lie. places (k, 3): lattice coordinates. samples (k,): near each, −1 without one. skipped
    (k,): the row of a point that a candidate is not compared with, −1 for none.
    """

    places: Integers
    samples: Integers
    skipped: Integers


def candidate_moves(candidates: Candidates, cells: Integers, samples: Integers, hints: SurfaceHints) -> Integers:
    """(k,): the moves of candidates among points at cells (n, 3). samples (n,): as in `smooth`."""
    return _moves(candidates, cells, samples, hints)[0]


def _references(samples: Integers, count: int) -> Integers:
    """(count, PER_SAMPLE): points of each sample, evenly among those that it has in order; −1 for fewer."""
    order = np.argsort(samples, kind="stable")
    own = samples[order]
    first, last = (np.searchsorted(own, np.arange(count), side=side) for side in ("left", "right"))
    size = (last - first)[:, None]
    rank = np.arange(PER_SAMPLE)
    rank = np.where(size > PER_SAMPLE, rank * size // PER_SAMPLE, rank)
    table = order[np.minimum(first[:, None] + rank, len(order) - 1)]
    return np.where(rank < size, table, -1)


def _moves(
    candidates: Candidates, cells: Integers, samples: Integers, hints: SurfaceHints
) -> tuple[Integers, Integers]:
    """(k,) each: the moves of candidates along their normals, and the deviations. A point at the very place of a
    candidate does not count.
    """
    table = _references(samples, len(hints.points))
    around = np.concatenate([np.arange(len(hints.points))[:, None], hints.neighbours], axis=1)
    moves, deviations = np.zeros(len(candidates.places), np.int64), np.zeros(len(candidates.places), np.int64)
    known = np.flatnonzero(candidates.samples >= 0)
    for start in range(0, len(known), BATCH_POINTS):
        rows = known[start : start + BATCH_POINTS]
        batch = Candidates(*(values[rows] for values in candidates))
        moves[rows], deviations[rows] = _moves_of_batch(batch, cells, samples, hints, around, table)
    return moves, deviations


def _moves_of_batch(
    candidates: Candidates, cells: Integers, samples: Integers, hints: SurfaceHints, around: Integers, table: Integers
) -> tuple[Integers, Integers]:
    spacing, normals = min(hints.spacing, MAX_SPACING), hints.normals
    own = normals[candidates.samples][:, None]
    others = table[around[candidates.samples]].reshape(len(candidates.places), -1)
    other = normals[samples[others]]
    faces_alike = (own * other).sum(axis=2) >= LEAST_COSINE << NORMAL_BITS
    apart = cells[others] - candidates.places[:, None]
    square = (apart**2).sum(axis=2) << 2 * SUBUNIT_BITS
    valid = (others >= 0) & (others != candidates.skipped[:, None]) & (square > 0) & faces_alike
    weight = np.where(valid, (spacing * spacing << WEIGHT_BITS) // (square + spacing * spacing // 4 + 1), 0)
    distance = (apart * (own + other)).sum(axis=2) << FINE_BITS >> NORMAL_BITS + 1
    total, largest = weight.sum(axis=1), weight.max(axis=1)
    mean = (weight * distance).sum(axis=1) // np.maximum(total + largest, 1)
    deviation = (weight * np.abs(distance - mean[:, None])).sum(axis=1) // np.maximum(total, 1)
    gain = np.clip(GAIN_AT_UNIT // np.maximum(deviation, 1) - GAIN_LOSS, 0, 256)
    return np.clip(mean * gain >> 8, -LARGEST_MOVE, LARGEST_MOVE), deviation


def code_stays(coder: BitCoder, smoothed: SmoothedPoints, stays: Booleans | None) -> Booleans:
    """Code which points (n,) stay on the lattice, since they would move beyond the bound. stays: None in the decoder.

    Points that do not move have no bit, and stay. Raises Corrupt in the decoder.
    """
    if (kernel := native.kernel("code_stays")) is not None and coder.compiled is not None:
        wanted = np.zeros(0, np.uint8) if stays is None else stays.view(np.uint8)
        found = kernel(coder.compiled, smoothed.moves, smoothed.deviations, wanted)
        if found is None:
            raise Corrupt(CUT_OFF)
        return np.asarray(found).view(bool)
    rows = np.flatnonzero(smoothed.moves)
    length = np.abs(smoothed.moves[rows])
    coarse, around = length >> 3, np.minimum(smoothed.deviations[rows] >> 4, DEVIATIONS - 1)
    columns = coarse, 32 + around, 64 + coarse * DEVIATIONS + around, 1024 + (length >> 1), np.full(len(rows), 2048)
    sets = np.full(len(rows), STAY_WEIGHTS)
    result = np.ones(len(smoothed.moves), bool)
    result[rows] = coder.code(STAY_CONTEXTS + np.stack(columns, axis=1), sets, None if stays is None else stays[rows])
    return result
