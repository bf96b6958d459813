"""Which lattice points stand for the points of a frame: a rate–distortion choice within the bound. Encoder only.

    points ─► lattice points within the bound, as candidates
    samples of the surface ─► distance of each candidate from it ─► bits of a lattice point there
    lattice points chosen so far ─► where smoothing moves each candidate ─► squared error
    Σ squared errors + λ Σ bits of the lattice points that are used ─► smaller, point by point and cell by cell

Points that share a lattice point take its bits once. A lattice finer than the bound asks for gives points more
candidates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ... import native
from ...typing import Booleans, Integers
from . import octree, point_octree, point_smoothing
from .lattice_frames import LatticeFrame, LatticeGrid
from .point_smoothing import FINE_BITS, Candidates
from .surface_hints import NORMAL_BITS, SUBUNIT_BITS, SurfaceHints

FREEDOM = 1.06  # bound over the largest distance of any place from the lattice
LAMBDA = 0.15  # squared lattice units for a bit
SHARED_BITS = 1.6  # of a lattice point, besides those of its place on the surface
STAY_BITS = 4  # of a point that smoothing would move beyond the bound, more than of others
ROUNDS = 3  # over all points and cells in a choice
NEAR_SPACINGS = 2  # distance of a point from its sample, in spacings of samples, at most
UNIT = 1 << FINE_BITS
STAY_COST = round(LAMBDA * UNIT**2 * STAY_BITS)
SUBUNIT = UNIT >> SUBUNIT_BITS
CLASSES, CLASSES_PER_DEVIATION = 64, 8  # of distances from the surface, up to eight mean deviations
SMOOTHED_CLASSES = 2  # on either side, over which frequencies are averaged
FAR = CLASSES  # class of a candidate without a sample
SAMPLE_SHARE = 1.0  # of the squared spacing: the area of a sample
PRIOR_COUNT = 2  # points that an offset of zero counts for
CORNERS = np.array([[corner >> axis & 1 for axis in range(3)] for corner in range(8)])
BEYOND = 1 << 40  # squared error of a candidate beyond the bound


class _Choices(NamedTuple):
    """The candidates of all points of a frame.

    starts (n + 1,): of the candidates of each point. point (k,): of each candidate. cells (k, 3): lattice coordinates.
    squares (k,): squared distances from the point, in 2^-2 FINE_BITS units. cell_of (k,): number of the cell among the
    distinct ones. first (c,): the first candidate of each cell. nearest (n,): the candidate nearest to each point.
    """

    starts: Integers
    point: Integers
    cells: Integers
    squares: Integers
    cell_of: Integers
    first: Integers
    nearest: Integers


def chosen_cells(frame: LatticeFrame, grid: LatticeGrid, hints: SurfaceHints, bound_m: float) -> LatticeFrame:
    """The frame with other cells for its points, all within the bound."""
    reach = int(bound_m / grid.step_m * UNIT) - 1  # rounding of points takes less than a unit
    if (kernel := native.kernel("PointChoice")) is not None:
        places = frame.originals, grid.step_m, grid.corner, frame.codes.astype(np.uint64), frame.rows
        choice = kernel(hints.compiled, *places, reach, NEAR_SPACINGS * hints.spacing)
        costs = _costs_of_classes(np.asarray(choice.frequencies()), _bits_of_area(choice.width, hints))
        spacing = min(hints.spacing, point_smoothing.MAX_SPACING)
        return frame.with_codes(*map(np.asarray, choice.choose(costs, spacing, STAY_COST, ROUNDS)))
    points = np.rint((frame.originals / grid.step_m - grid.corner) * UNIT).astype(np.int64)
    choices = _candidates(points, reach, grid.depth)
    samples = _near_samples(frame, hints)
    classes, width = _classes(points, samples, choices, hints)
    is_used = np.zeros(len(choices.first), bool)
    is_used[choices.cell_of[choices.nearest]] = True
    frequencies = np.bincount(classes[is_used], minlength=CLASSES + 1)[:CLASSES]
    costs = _costs_of_classes(frequencies, _bits_of_area(width, hints))[classes]
    errors = _errors(points, choices, samples, hints, is_used, reach)
    chosen = _PointsAndCells(choices.starts, choices.cell_of, errors, costs, choices.nearest).choose()
    return frame.with_cells(choices.cells[chosen], np.zeros(3, np.int64))


def _candidates(points: Integers, reach: int, depth: int) -> _Choices:
    """The lattice points within reach of points (n, 3), both in 2^-FINE_BITS units, and within the octree; at least the
    nearest.
    """
    squares, bases, sides = list[Integers](), list[Integers](), list[Integers]()
    for parity in (0, 1):
        base = 2 * ((points - parity * UNIT + UNIT) >> FINE_BITS + 1) + parity
        away = points - base * UNIT  # at most a unit: the next point along an axis lies on this side
        per_axis = np.stack([away**2, (2 * UNIT - np.abs(away)) ** 2])
        x, y, z = (per_axis[CORNERS[:, axis], :, axis] for axis in range(3))
        squares.append(x + y + z)
        bases.append(base)
        sides.append(np.where(away < 0, -2, 2))
    cells = np.concatenate(
        [base[:, None] + CORNERS * side[:, None] for base, side in zip(bases, sides, strict=True)], axis=1
    )
    square = np.concatenate(squares).T  # (n, 16)
    is_inside = ((cells >= 0) & (cells < 1 << depth)).all(axis=2)
    nearest = np.where(is_inside, square, BEYOND).min(axis=1, keepdims=True)
    point, number = np.nonzero(is_inside & (square <= np.maximum(reach**2, nearest)))
    cells = cells[point, number]
    _, first, cell_of = np.unique(octree.morton_codes(cells), return_index=True, return_inverse=True)
    starts = np.searchsorted(point, np.arange(len(points) + 1))
    squares = square[point, number]
    nearest = np.lexsort((squares, point))[starts[:-1]]
    return _Choices(starts, point, cells, squares, cell_of.reshape(-1), first, nearest)


def _near_samples(frame: LatticeFrame, hints: SurfaceHints) -> Integers:
    """(n,): the sample near the lattice point of each point, −1 without one."""
    reach = NEAR_SPACINGS * hints.spacing
    nearest = point_octree.samples_of_points(frame.codes, hints)[frame.rows]
    own = np.maximum(nearest, 0)
    apart = octree.cells_of_codes(frame.codes)[frame.rows] * (1 << SUBUNIT_BITS) - hints.points[own]
    return np.where(_squares(apart) <= reach**2, nearest, -1)


def _squares(vectors: Integers) -> Integers:
    """(n,): squared lengths of vectors (n, 3)."""
    x, y, z = vectors.T
    return x * x + y * y + z * z


def _distances(places: Integers, samples: Integers, hints: SurfaceHints) -> Integers:
    """(n,): the distances of places (n, 3) from the tangent planes of samples (n,), 2^-FINE_BITS units."""
    apart, normals = places - hints.points[samples] * SUBUNIT, hints.normals[samples]
    return apart[:, 0] * normals[:, 0] + apart[:, 1] * normals[:, 1] + apart[:, 2] * normals[:, 2] >> NORMAL_BITS


def _classes(points: Integers, samples: Integers, choices: _Choices, hints: SurfaceHints) -> tuple[Integers, int]:
    """(c,): the class of each cell's distance from the surface that the points around it show; and the width of a
    class, 2^-FINE_BITS units, 0 if no point has a sample.
    """
    known = np.flatnonzero(samples >= 0)
    if not len(known):
        return np.full(len(choices.first), FAR), 0
    distance, rows = _distances(points[known], samples[known], hints), samples[known]
    offsets = hints.mean_around(distance, rows, 0, PRIOR_COUNT)
    width = max(int(np.abs(distance - offsets[rows]).mean()) // CLASSES_PER_DEVIATION, 1)
    of_cells = samples[choices.point[choices.first]]
    away = np.abs(_distances(choices.cells[choices.first] * UNIT, of_cells, hints) - offsets[of_cells])
    return np.where(of_cells >= 0, np.minimum(away // width, CLASSES - 1), FAR), width


def _bits_of_area(width: int, hints: SurfaceHints) -> float:
    """The bits that tell which class-wide part of the surface's area a lattice point lies in. width: of `_classes`."""
    if not width:
        return 0.0
    area = SAMPLE_SHARE * len(hints.points) * (hints.spacing / (1 << SUBUNIT_BITS)) ** 2
    return float(np.log2(area * 2 * width / UNIT / 4))  # a lattice point has four cubic units


def _costs_of_classes(frequencies: Integers, bits_of_area: float) -> Integers:
    """(CLASSES + 1,): λ · bits of a lattice point of each class, in squared 2^-FINE_BITS units. frequencies
    (CLASSES,): how many of those that are used each class has.
    """
    width = 2 * SMOOTHED_CLASSES + 1
    count = frequencies[np.clip(np.arange(-SMOOTHED_CLASSES, CLASSES + SMOOTHED_CLASSES), 0, CLASSES - 1)] + 1.0
    smooth = np.convolve(count, np.ones(width) / width, "valid")
    bits = np.maximum(SHARED_BITS + bits_of_area - np.log2(smooth), 1.0)
    return np.rint(LAMBDA * UNIT**2 * np.append(bits, bits.max())).astype(np.int64)


def _errors(
    points: Integers,
    choices: _Choices,
    samples: Integers,
    hints: SurfaceHints,
    is_used: Booleans,
    reach: int,
) -> Integers:
    """(k,): squared distances of points (n, 3) from their candidates as they are decoded while cells are used: moved to
    the surface where that keeps the bound; with STAY_COST where it does not. samples (n,): near points. Points with
    one candidate have no choice: their errors stay 0.
    """
    own = (np.cumsum(is_used) - 1)[choices.cell_of[choices.nearest]]  # among the cells that are used
    used = choices.cells[choices.first[is_used]]
    sample_of_used = np.zeros(len(used), np.int64)
    sample_of_used[own] = samples
    some = np.flatnonzero(np.diff(choices.starts)[choices.point] > 1)
    point, cells = choices.point[some], choices.cells[some]
    candidates = Candidates(cells, samples[point], own[point])
    moves = point_smoothing.candidate_moves(candidates, used, sample_of_used, hints)
    shifts = point_smoothing.shifts_of_moves(moves, samples[point], hints)
    moved = _squares(cells * UNIT + shifts - points[point])
    stays = choices.squares[some] + STAY_COST * (moves != 0)
    errors = np.zeros(len(choices.point), np.int64)
    errors[some] = np.where(moved <= reach**2, moved, stays)
    return errors


class _PointsAndCells:
    """Which candidate each point has, so that all points together cost less.

    In a round each point takes the candidate that costs least while the others stay; then each cell takes all points
    that gain by it, if together they gain more than it costs.
    """

    def __init__(
        self, starts: Integers, cell_of: Integers, errors: Integers, costs: Integers, chosen: Integers
    ) -> None:
        """starts, cell_of: as in `_Choices`. errors (k,): of candidates. costs (c,): of cells. chosen (n,): candidates
        before the first round.
        """
        self._starts, self._cell_of, self._errors = starts.tolist(), cell_of.tolist(), errors.tolist()
        self._costs, self._chosen = costs.tolist(), chosen.tolist()
        self._users = np.bincount(cell_of[chosen], minlength=len(costs)).tolist()
        self._point_of = np.repeat(np.arange(len(chosen)), np.diff(starts)).tolist()
        members = np.argsort(cell_of, kind="stable")
        self._members = [part.tolist() for part in np.split(members, np.cumsum(np.bincount(cell_of))[:-1])]

    def choose(self) -> Integers:
        """(n,): the candidates of all points after ROUNDS."""
        for _ in range(ROUNDS):
            has_moved = self._change_points()
            if not self._open_cells() and not has_moved:
                break
        return np.array(self._chosen, np.int64)

    def _change_points(self) -> bool:
        changed = False
        for i, own in enumerate(self._chosen):
            cell, best = self._cell_of[own], own
            least = self._errors[own] + (self._costs[cell] if self._users[cell] == 1 else 0)
            for k in range(self._starts[i], self._starts[i + 1]):
                other = self._cell_of[k]
                total = self._errors[k] + (0 if self._users[other] else self._costs[other])
                if other != cell and total < least:
                    least, best = total, k
            if best != own:
                self._move(i, best)
                changed = True
        return changed

    def _open_cells(self) -> bool:
        changed = False
        for cell, members in enumerate(self._members):
            if len(members) < 2:
                continue
            gain, taken = 0 if self._users[cell] else -self._costs[cell], list[int]()
            for k in members:
                own = self._chosen[self._point_of[k]]
                if own == k:
                    continue
                left = self._cell_of[own]
                saved = self._errors[own] - self._errors[k] + (self._costs[left] if self._users[left] == 1 else 0)
                if saved > 0:
                    gain += saved
                    self._users[left] -= 1  # so that the last point that leaves a cell closes it
                    taken.append(k)
            for k in taken:
                self._users[self._cell_of[self._chosen[self._point_of[k]]]] += 1
            if gain > 0 and taken:
                for k in taken:
                    self._move(self._point_of[k], k)
                changed = True
        return changed

    def _move(self, point: int, candidate: int) -> None:
        self._users[self._cell_of[self._chosen[point]]] -= 1
        self._chosen[point] = candidate
        self._users[self._cell_of[candidate]] += 1
