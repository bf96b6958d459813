"""Frames of points on a lattice: integers, sorted by their Morton codes.

Points of one cell of the lattice become one, with their mean colour. So every original point has a decoded one within
the bound, and every decoded point an original one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ... import native
from ...errors import CannotEncode
from ...typing import Bytes, Floats, Integers
from ..clouds.raw_frames import Cloud
from . import lattice, octree, point_octree
from .integer_surface import MAX_PLACE_M, PLACE_BITS

MIN_STEP_M, MAX_STEP_M = 1e-7, 10.0
MAX_CORNER = 1 << 40
ROUNDING_CELLS = 8  # by which rounding to the lattice may extend a frame, at most


class LatticeFrame(NamedTuple):
    """A frame on the lattice.

    codes (n,): sorted distinct Morton codes. colours (n, 3): mean colours, or None. originals (m, 3): the points of the
    frame, metres. rows (m,): which of the codes is that of each. own_colours (m, 3): of the originals, or None.
    """

    codes: Integers
    colours: Bytes | None
    originals: Floats
    rows: Integers
    own_colours: Bytes | None = None

    def own_distances(self, decoded: Floats) -> Floats:
        """(m,): the distance of each original from its own decoded point, metres. decoded (n, 3): of the codes."""
        if (kernel := native.kernel("own_distances")) is not None:
            return np.asarray(kernel(self.originals, decoded, self.rows))
        return np.sqrt(lattice.squares(self.originals - decoded[self.rows]))

    def with_cells(self, cells: Integers, corner: Integers) -> LatticeFrame:
        """The same points in cells (m, 3), with codes from a corner (3,)."""
        return self.with_codes(*_distinct_codes(cells, corner))

    def with_codes(self, codes: Integers, rows: Integers) -> LatticeFrame:
        """The same points with other `codes` and `rows`."""
        colours = None if self.own_colours is None else _mean_colours(self.own_colours, rows, len(codes))
        return LatticeFrame(codes, colours, self.originals, rows, self.own_colours)


@dataclass(frozen=True)
class LatticeGrid:
    """Where the points of a chunk lie. step_m: unit of the lattice. corner (3,), even: in that unit. depth: levels."""

    step_m: float
    corner: Integers
    depth: int

    def positions(self, cells: Integers) -> Floats:
        """The places (n, 3) of cells (n, 3), metres."""
        return lattice.positions(cells + self.corner, self.step_m)

    def shifted_positions(self, cells: Integers, shifts: Integers, shift_bits: int) -> Floats:
        """The places (n, 3) of cells after shifts (n, 3) of 2^-shift_bits units, metres."""
        step_m = self.step_m / (1 << shift_bits)
        if (kernel := native.kernel("shifted_positions")) is not None:
            return np.asarray(kernel(cells, self.corner, shifts, shift_bits, step_m))
        return lattice.positions((cells + self.corner << shift_bits) + shifts, step_m)

    def places(self, cells: Integers) -> Integers:
        """Cells (n, 3) as places in 2^-PLACE_BITS metres, rounded down, at most MAX_PLACE_M from the origin."""
        limit = float(MAX_PLACE_M << PLACE_BITS)
        scale = self.step_m * (1 << PLACE_BITS)
        if (kernel := native.kernel("places_of_cells")) is not None:
            return np.asarray(kernel(cells, self.corner, scale, limit))
        return np.floor(np.clip((cells + self.corner) * scale, -limit, limit)).astype(np.int64)


def to_lattice(frames: Sequence[Cloud], bound_m: float, coloured: bool) -> tuple[LatticeGrid, list[LatticeFrame]]:
    """The frames of a chunk on the lattice of this bound. Raises CannotEncode for points too far apart."""
    step = _step_of_bound(bound_m)
    places = [lattice.nearest(points, step) for points, _ in frames]
    grid = _grid([p for p in places if len(p)], step, bound_m)
    pairs = zip(places, frames, strict=True)
    nothing = np.zeros(0, np.int64)
    return grid, [
        LatticeFrame(nothing, None, points, nothing, colours if coloured else None).with_cells(place, grid.corner)
        for place, (points, colours) in pairs
    ]


def require_range(frames: Sequence[Cloud], bound_m: float) -> None:
    """Raises CannotEncode for a chunk that `to_lattice` cannot hold with this bound; takes little time if it can."""
    step = _step_of_bound(bound_m)
    filled = [points for points, _ in frames if len(points)]
    if not filled:
        return
    low, high = (np.array([of(points, axis=0) for points in filled]) for of in (np.min, np.max))
    size = (1 << point_octree.MAX_DEPTH) - ROUNDING_CELLS
    is_near = np.abs([low, high]).max() < step * MAX_CORNER / 2
    if not is_near or (high.max(axis=0) - low.min(axis=0)).max() >= step * size:
        _grid([lattice.nearest(points, step) for points in filled], step, bound_m)


def _step_of_bound(bound_m: float) -> float:
    """The unit of the lattice of a bound, metres. Raises CannotEncode."""
    step = lattice.step_of_bound(bound_m)
    if not MIN_STEP_M <= step <= MAX_STEP_M:
        raise CannotEncode(
            f"bodycast cannot bound the error of points by {bound_m * 1000:g} mm; "
            "ask for 0.001 mm to 10 m, or keep every point with residual exact"
        )
    return step


def _grid(filled: Sequence[Integers], step: float, bound_m: float) -> LatticeGrid:
    """The grid of lattice points (n, 3) of frames with points. Raises CannotEncode for points too far apart."""
    corner, depth = np.zeros(3, np.int64), 0
    if filled:
        boxes = np.stack([_box(p) for p in filled])
        corner = boxes[:, 0].min(axis=0) // 2 * 2
        depth = int((boxes[:, 1] - corner).max()).bit_length()
    if depth > point_octree.MAX_DEPTH or np.abs(corner).max() >= MAX_CORNER:
        limit_m = 2**point_octree.MAX_DEPTH * step
        raise CannotEncode(
            f"points lie more than {limit_m:.3g} m apart, too far for an error of {bound_m * 1000:g} mm; "
            "ask for a larger error, or keep every point with residual exact"
        )
    return LatticeGrid(step, corner, depth)


def _box(cells: Integers) -> Integers:
    """(2, 3): the least and the largest coordinates of cells (n, 3), n > 0."""
    if (kernel := native.kernel("box_of_cells")) is not None:
        return np.asarray(kernel(cells))
    return np.stack([cells.min(axis=0), cells.max(axis=0)])


def _distinct_codes(cells: Integers, corner: Integers) -> tuple[Integers, Integers]:
    """The `codes` and `rows` of a frame with points in cells (m, 3), from a corner (3,)."""
    if (kernel := native.kernel("distinct_codes")) is not None:
        codes, rows = kernel(cells, corner)
        return np.asarray(codes), np.asarray(rows)
    codes, rows = np.unique(octree.morton_codes(cells - corner), return_inverse=True)
    return codes, rows.reshape(-1)


def _mean_colours(colours: Bytes, rows: Integers, count: int) -> Bytes:
    """(count, 3): the mean of the colours (m, 3) at each of the rows (m,), halves rounded to even."""
    if (kernel := native.kernel("mean_colours")) is not None:
        return np.asarray(kernel(colours, rows, count))
    sums = np.stack([np.bincount(rows, column, count) for column in colours.T], axis=1)
    return np.round(sums / np.bincount(rows, minlength=count)[:, None]).astype(np.uint8)
