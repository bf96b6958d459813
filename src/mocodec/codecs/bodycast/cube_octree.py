"""Occupancy octree of lattice points, coded cube by cube: each cube from what the cubes around it show of the surface.

    cubes of a level, in order ─► nearest samples ─► centres of the cubes around ─► where the surface passes a cube
                                                              ▲                               │
                                     centres of its children ─┘   points expected in each child of it
                                                ▲                                             │
                                                └── occupancy bits ◄──────── contexts ◄───────┘

Cubes that are coded already tell where the surface is by their children, those that follow by their own centres.
Levels, samples near cubes and contexts are as in `point_octree`, which codes octant by octant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...entropy.adaptive_bits import MIXERS
from ...entropy.bit_arrays import BitCoder
from ...typing import Booleans, Integers
from . import octree, point_octree
from .point_octree import DISTANCE_STEPS, FAR, NO_HINT, POSTERIORS, LevelOfCubes
from .surface_hints import NORMAL_BITS, SUBUNIT_BITS, SurfaceHints

CUBES_OF_SAMPLE = 4  # of each sample that tell where the surface is
HALF_UNIT = 1 << SUBUNIT_BITS - 1  # lattice points lie at the corners of unit cubes
LARGEST_SPACING = 1 << 16  # subunits
LARGEST_DISTANCE = 1 << 25  # of a cube from its sample, subunits
LARGEST_DEVIATION = 1 << 20  # subunits
SAMPLE_WEIGHT = 5120  # of the sample itself, against the cubes around; a near cube weighs some thousands
USUAL_WEIGHT = 1024  # of the usual deviation of the level
LEAST_VARIANCE = 16  # of the surface, squared subunits
DENSITY = 1634  # 4096 / sqrt(2 π): of a normal density's largest value, with DENSITY_BITS
DENSITY_BITS = 16  # an expected number of points is in 2^-16
LARGEST_DENSITY, MOST_EXPECTED = 1 << 24, 1 << 19
LEAST_ODDS = 16  # binary digits of the odds of the lowest class; odds of 1 have 24


def code_octree(
    coder: BitCoder, codes: Integers | None, depth: int, points: int, surface: SurfaceHints | None
) -> tuple[Integers, Integers]:
    """As `point_octree.code_octree`. Raises Corrupt in the decoder."""
    return point_octree.code_levels("cube_octree", _code_cubes, coder, codes, depth, points, surface)


def _code_cubes(coder: BitCoder, own: LevelOfCubes, occupied: Booleans | None) -> Integers:
    return _Level(own).code(coder, occupied)


class _Level:
    """The cubes of a level while they are coded."""

    def __init__(self, own: LevelOfCubes) -> None:
        self.height, self.count, self.octants = own.depth - own.level, len(own.cubes), own.octants
        self.known = [0] * (self.count + 1)  # masks of the occupied octants; one cube more, which stays empty
        neighbours = octree.neighbour_rows(own.cubes, own.level)
        self.filled = np.minimum((neighbours < self.count).sum(axis=0) // 2, 3).tolist()
        self.neighbours = neighbours.T.tolist()
        self.nearest = own.nearest.tolist()
        self.passage = None if own.surface is None else _Passage(own, own.surface)

    def code(self, coder: BitCoder, occupied: Booleans | None) -> Integers:
        """(n, 8): which children are occupied."""
        for i in range(self.count):
            passage = self.passage if self.nearest[i] >= 0 else None
            if passage is not None:
                passage.expect(i, self.octants)
            for place, octant in enumerate(self.octants):
                if place == len(self.octants) - 1 and not self.known[i]:
                    self.known[i] = 1 << octant
                    continue
                contexts, weights = self._contexts(i, self.octants[place:], passage)
                wanted = None if occupied is None else occupied[i, octant : octant + 1]
                bit = coder.code(np.array([contexts]), np.array([weights]), wanted)[0]
                self.known[i] |= int(bit) << octant
            if passage is not None:
                passage.learn(i, [octant for octant in self.octants if self.known[i] >> octant & 1])
        return np.array(self.known[:-1])[:, None] >> np.arange(8) & 1

    def _contexts(self, i: int, remaining: Sequence[int], passage: _Passage | None) -> tuple[list[int], int]:
        """The contexts of the first of the `remaining` octants of cube i, and their weight set."""
        octant, known = remaining[0], self.known[i]
        few, tall = min(known.bit_count(), 3), min(self.height, 15)
        beside = nearby = 0
        for axis in range(3):
            is_upper = octant >> axis & 1
            row = self.neighbours[i][2 * axis + is_upper]
            inner = (known if is_upper else self.known[row]) >> (octant ^ 1 << axis) & 1
            outer = int(row < self.count)
            beside, nearby = beside * 4 + 2 * inner + outer, nearby + inner + outer
        narrow, wide, distance, samples, hint = NO_HINT, NO_HINT, FAR, 0, 0
        if self.passage is not None:
            samples, hint = self.passage.samples[i][octant], 1
        if passage is not None:
            narrow, wide = (_odds_class(expected, remaining, few) for expected in (passage.narrow, passage.wide))
            distance, hint = passage.distance_class(octant), 2
        contexts = [
            ((octant * 4 + few) * 64 + beside) * 4 + self.filled[i],
            narrow * 4 + few,
            (wide * 4 + few) * 16 + tall,
            ((distance * 5 + samples) * 4 + few) * 16 + tall,
            ((narrow * 7 + nearby) * 4 + few) * 8 + len(remaining) - 1,
        ]
        return contexts, ((min(self.height, 20) * 4 + few) * 3 + hint) % MIXERS


class _Passage:
    """Where the surface passes the cubes of a level. Lengths are in subunits.

    narrow, wide (8): points that are expected in each child of the last cube, 2^-DENSITY_BITS, for two standard
    deviations of the surface. samples (n, 8): classes of how many samples each child holds.
    """

    def __init__(self, own: LevelOfCubes, surface: SurfaceHints) -> None:
        cubes, level, nearest = own.cubes, own.level, own.nearest
        cells = octree.cells_of_codes(cubes)
        self.side, self.cells, self.bell = surface.child_size(level), cells.tolist(), point_octree.bell().tolist()
        self.size = 2 * self.side
        self.points, self.normals = surface.points.tolist(), surface.normals.tolist()
        self.around = surface.neighbours.tolist()
        centres = cells * self.size + self.side - HALF_UNIT
        self.centres, self.nearest = centres.tolist(), nearest.tolist()
        self.places, self.noise = centres.tolist(), [self.size**2] * len(cubes)
        self.spacing = min(surface.spacing, LARGEST_SPACING)
        known = np.flatnonzero(nearest >= 0)
        far = np.zeros(len(cubes), np.int64)
        far[known] = surface.distance(centres[known], nearest[known])
        self.far = np.clip(far, -LARGEST_DISTANCE, LARGEST_DISTANCE).tolist()
        self.usual = sum(map(abs, self.far)) // max(len(known), 1)
        self.cubes_of = _thinned(known.tolist(), self.nearest)
        across = self.side * 256 // self.spacing
        density = own.points * DENSITY * across**2 // (len(self.points) * 16) if len(known) else 0
        self.density = min(density, LARGEST_DENSITY)
        held = np.zeros((len(cubes), 8), np.int64)
        if self.size > surface.spacing:
            held = surface.samples_inside(cubes, level)
        self.samples = np.searchsorted([1, 2, 3, 5], held, side="right").tolist()
        self.distances, self.narrow, self.wide = [0] * 8, [0] * 8, [0] * 8

    def expect(self, i: int, octants: Sequence[int]) -> None:
        """Set the expected occupancy of the children of cube i, which has a sample."""
        offset, variance = self._surface(i)
        own, cut = self.nearest[i], self.size**2 // 48  # variance of the places within a child
        first = [
            v * self.size + self.side // 2 - HALF_UNIT - p for v, p in zip(self.cells[i], self.points[own], strict=True)
        ]
        distance = (sum(a * m for a, m in zip(first, self.normals[own], strict=True)) >> NORMAL_BITS) - offset
        steps = [m * self.side >> NORMAL_BITS for m in self.normals[own]]
        for octant in octants:
            self.distances[octant] = distance + sum(steps[axis] for axis in range(3) if octant >> axis & 1)
        for expected, deviation in ((self.narrow, variance + cut), (self.wide, 3 * variance + cut)):
            sigma = math.isqrt(deviation)
            most = min(self.density * self.side // (sigma * 256), MOST_EXPECTED)
            for octant in octants:
                weight = self.bell[min(abs(self.distances[octant]) * 16 // sigma, 64)]
                expected[octant] = (most * weight >> 12) + 1

    def _surface(self, i: int) -> tuple[int, int]:
        """The distance of the surface from that of the sample of cube i, and its variance. The constants are those that
        took the fewest bytes on recordings of several people, at several bounds.
        """
        own, (x, y, z), square = self.nearest[i], self.centres[i], self.spacing**2
        far, (p, q, r) = self.far[i], self.normals[own]
        weights, distances = list[int](), list[int]()
        for sample in [own, *(s for s in self.around[own] if s != own)]:
            m, n, o = self.normals[sample]
            for j in self.cubes_of.get(sample, ()):
                a, b, c = self.places[j]
                a, b, c = a - x, b - y, c - z
                away = 13 * (a * a + b * b + c * c) + 10 * square + 64 * self.noise[j] + 1
                weights.append((square << 16) // away)
                distances.append(far + (a * (p + m) + b * (q + n) + c * (r + o) >> NORMAL_BITS + 1))
        total = sum(weights)
        offset = sum(w * d for w, d in zip(weights, distances, strict=True)) // (total + SAMPLE_WEIGHT)
        spread = sum(w * abs(d - offset) for w, d in zip(weights, distances, strict=True)) + USUAL_WEIGHT * self.usual
        deviation = min(spread // (total + USUAL_WEIGHT), LARGEST_DEVIATION)
        return offset, max((166 * deviation**2 >> 8) - self.size**2 // 20, LEAST_VARIANCE)

    def learn(self, i: int, octants: Sequence[int]) -> None:
        """The occupied children of cube i are known."""
        for axis in range(3):
            upper = sum(octant >> axis & 1 for octant in octants)
            corner = self.cells[i][axis] * self.size + self.side // 2 - HALF_UNIT
            self.places[i][axis] = corner + upper * self.side // len(octants)
        self.noise[i] = self.size**2 // (6 * len(octants))

    def distance_class(self, octant: int) -> int:
        """The class of the distance of a child of the last cube."""
        distance = self.distances[octant]
        steps = sum(step * self.side <= 4 * abs(distance) for step in DISTANCE_STEPS)
        return len(DISTANCE_STEPS) + (-steps if distance < 0 else steps)


def _thinned(rows: Sequence[int], nearest: Sequence[int]) -> dict[int, list[int]]:
    """The cubes of each sample, at most CUBES_OF_SAMPLE of them. rows: of the cubes with a sample."""
    result = dict[int, list[int]]()
    for i in rows:
        result.setdefault(nearest[i], []).append(i)
    most = CUBES_OF_SAMPLE
    return {
        s: own if len(own) <= most else [own[k * len(own) // most] for k in range(most)] for s, own in result.items()
    }


def _odds_class(expected: Sequence[int], remaining: Sequence[int], few: int) -> int:
    """The class of the odds that the first of the remaining octants is occupied, in quarters of a binary order.

    With λ points expected in it and r in the others the odds are e^λ − 1, and if no octant is occupied so far, but one
    must be, (e^λ − 1) / (1 − e^−r). λ (1 + λ / 2) and r / (1 + r / 2), at most 1, are near enough.
    """
    own, others = expected[remaining[0]], sum(expected[octant] for octant in remaining[1:])
    odds = own * ((2 << DENSITY_BITS) + own) >> DENSITY_BITS + 1
    if few or others >= 2 << DENSITY_BITS:
        odds <<= 8
    else:
        odds = odds * 128 * ((2 << DENSITY_BITS) + others) // others
    order = odds.bit_length() - 1
    if order < LEAST_ODDS:
        return 0
    return min(4 * (order - LEAST_ODDS) + (odds >> order - 2 & 3), POSTERIORS - 1)
