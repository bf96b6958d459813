"""The posed surface of the bodies as the octree of a frame sees it: how far a cube lies from it. Integers only.

    surface of the frame ─► samples in units of the octree, normals, neighbours
    cubes of a level ──attach──► nearest sample of each ──correct──► how far the points lie from the surface around it
                                                          └────────► distance of each child from the corrected surface

The points of the levels above correct the surface: samples whose cubes lie in front of it move it forward.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ... import native
from ...typing import Integers
from . import octree

SUBUNIT_BITS = 4  # lengths are in 1/16 of the octree's unit
NORMAL_BITS = 10  # of a unit normal's components
NEIGHBOURS = 12  # samples around each sample
PRIOR_COUNT = 2  # cubes that a correction of zero counts for
NOWHERE = -1
SEARCHED = 3  # samples of a cube that are candidates for the nearest
COARSEST_SPACINGS = 4  # side of the largest cubes that have a nearest sample, in spacings
UNLIMITED = 1 << 62
AROUND = np.array([[x, y, z] for x in (0, -1, 1) for y in (0, -1, 1) for z in (0, -1, 1)], np.int64)


@dataclass(frozen=True, eq=False)
class SurfaceHints:
    """Samples of the surface of a frame.

    points (m, 3): in subunits, from the octree's corner. normals (m, 3): of length 2^NORMAL_BITS. neighbours
    (m, NEIGHBOURS): rows of the samples around each, itself where there are fewer. spacing: between samples, subunits.
    depth: levels of the octree. largest_corrected: side of the largest cubes that correct the surface, subunits.
    """

    points: Integers
    normals: Integers
    neighbours: Integers
    spacing: int
    depth: int
    largest_corrected: int = UNLIMITED

    @cached_property
    def compiled(self) -> Any:
        """The same for the compiled octree, which must be available."""
        kernel = native.kernel("OctreeSurface")
        assert kernel is not None
        return kernel(self.points, self.normals, self.neighbours, self.spacing, self.depth, self.largest_corrected)

    def child_size(self, level: int) -> int:
        """The side of the children of a level's cubes, subunits."""
        return 1 << SUBUNIT_BITS + self.depth - level - 1

    def attach(self, cubes: Integers, level: int, nearest: Integers) -> Integers:
        """(n,): a sample near the centre of each cube, NOWHERE without one; nearest (n,): that of each cube's parent.

        Large cubes look for samples in the cubes around them, small ones among the neighbours of their parent's sample.
        """
        size = 2 * self.child_size(level)
        if not len(self.points) or size > COARSEST_SPACINGS * self.spacing:
            return np.full(len(cubes), NOWHERE)
        places = octree.cells_of_codes(cubes)
        centres = places * size + size // 2 - self._half_unit
        result = self._descend(centres, nearest)
        if 2 * size > self.spacing:
            result = self._nearest_around(places, centres, level, size, result)
        return result

    @property
    def _half_unit(self) -> int:
        """Lattice points lie at the corners of unit cubes: their mean is half a unit before the centre of a cube."""
        return 1 << SUBUNIT_BITS - 1

    def _nearest_around(
        self, places: Integers, centres: Integers, level: int, size: int, nearest: Integers
    ) -> Integers:
        """The nearest sample in the cubes around each cube, or `nearest` where none is nearer. Of the samples in one
        cube, the first SEARCHED count.
        """
        side = 1 << level
        cell = np.floor_divide(self.points + self._half_unit, size)
        inside = np.flatnonzero(((cell >= 0) & (cell < side)).all(axis=1))
        code = octree.morton_codes(cell[inside])
        order = np.argsort(code, kind="stable")
        code, inside = np.append(code[order], NOWHERE), np.append(inside[order], 0)
        best, result = self._square(centres, nearest), nearest.copy()
        for offset in AROUND:
            other = places + offset
            wanted = octree.morton_codes(np.clip(other, 0, side - 1))
            wanted[((other < 0) | (other >= side)).any(axis=1)] = NOWHERE - 1
            first = np.searchsorted(code[:-1], wanted)
            for at in (np.minimum(first + rank, len(code) - 1) for rank in range(SEARCHED)):
                rows = np.flatnonzero(code[at] == wanted)
                square = self._square(centres[rows], inside[at[rows]])
                nearer = square < best[rows]
                best[rows[nearer]], result[rows[nearer]] = square[nearer], inside[at[rows[nearer]]]
        return result

    def _square(self, centres: Integers, rows: Integers) -> Integers:
        """(n,): squared distances from centres to samples; the largest number for NOWHERE."""
        square = ((centres - self.points[rows]) ** 2).sum(axis=1)
        return np.where(rows < 0, np.iinfo(np.int64).max, square)

    def _descend(self, centres: Integers, nearest: Integers) -> Integers:
        """The nearest among each sample and its neighbours, the first where several are; NOWHERE stays."""
        candidates = np.concatenate([nearest[:, None], self.neighbours[nearest]], axis=1)
        square = ((self.points[candidates] - centres[:, None]) ** 2).sum(axis=2)
        chosen = np.take_along_axis(candidates, square.argmin(axis=1)[:, None], axis=1)[:, 0]
        return np.where(nearest < 0, NOWHERE, chosen)

    def offsets(self, cubes: Integers, level: int, nearest: Integers) -> tuple[Integers, Integers]:
        """(n,) each: the mean distance of the cubes around each cube from the surface, and the mean deviation from it,
        subunits.
        """
        size = 2 * self.child_size(level)
        rows = np.flatnonzero(nearest >= 0)
        result, spread = np.zeros(len(cubes), np.int64), np.full(len(cubes), size)
        if not len(rows):
            return result, spread
        centres = octree.cells_of_codes(cubes[rows]) * size + size // 2 - self._half_unit
        distance = self.distance(centres, nearest[rows])
        own = nearest[rows]
        if size <= self.largest_corrected:
            result[rows] = self.mean_around(distance, own, 0, PRIOR_COUNT)[own]
        deviation = np.abs(distance - result[rows])
        usual = int(deviation.sum()) // len(rows)
        spread[rows] = self.mean_around(deviation, own, usual * PRIOR_COUNT, PRIOR_COUNT)[own]
        return result, spread

    def mean_around(self, values: Integers, rows: Integers, prior: int, prior_count: int) -> Integers:
        """(m,): the mean of the values (n,) at samples `rows` (n,) over each sample and its neighbours."""
        total = np.bincount(rows, values, len(self.points)).astype(np.int64)
        count = np.bincount(rows, minlength=len(self.points))
        around = total + total[self.neighbours].sum(axis=1) + prior
        return around // (count + count[self.neighbours].sum(axis=1) + prior_count)

    def distance(self, places: Integers, rows: Integers) -> Integers:
        """(n,): the distance of places (n, 3) from the tangent planes of samples, subunits, positive outside."""
        return ((places - self.points[rows]) * self.normals[rows]).sum(axis=1) >> NORMAL_BITS

    def child_distances(self, cubes: Integers, level: int, nearest: Integers, offset: Integers) -> Integers:
        """(n, 8): the distances of the children's centres from the corrected surface."""
        size = self.child_size(level)
        base = octree.cells_of_codes(cubes) * (2 * size) + size // 2 - self._half_unit
        first = self.distance(base, nearest) - offset
        step = self.normals[nearest] * size >> NORMAL_BITS
        octants = np.arange(8)
        return first[:, None] + sum((octants >> axis & 1) * step[:, axis, None] for axis in range(3))

    def samples_inside(self, cubes: Integers, level: int) -> Integers:
        """(n, 8): how many samples each child holds."""
        side, size = 1 << level + 1, self.child_size(level)
        cell = np.floor_divide(self.points + self._half_unit, size)
        code = np.sort(octree.morton_codes(cell[((cell >= 0) & (cell < side)).all(axis=1)]))
        children = (cubes[:, None] << 3) + np.arange(8)
        return np.searchsorted(code, children, side="right") - np.searchsorted(code, children)
