"""Distances of points from bodies made of capsules, and of any place from points; for many bodies at once."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import native
from ..typing import Booleans, Floats, Integers
from . import neighbours, single_view

HIDDEN_M = 0.04
"""Distance from the points at which a hidden place counts, at most, metres: a limb is rather seen than hidden."""
MAX_HIDDEN_CELLS = 4_000_000
"""Cells of a grid, above which none counts as hidden: more than a person takes."""


def surface_distances(points: Floats, ends: Floats, radii: Floats, signed: bool = False) -> Floats:
    """(k, n): the distance of each of points (n, 3) from the surface of the nearest capsule of each of k bodies,
    metres.

    ends (k, c, 2, 3), radii (k, c, 2): of the bodies' c capsules. signed: negative inside, where the deepest capsule
    counts. Compiled in single precision: accurate to 0.1 mm within ten metres.
    """
    if not signed and (kernel := native.kernel("capsule_surfaces")) is not None:
        return np.asarray(kernel(points, ends, radii))
    distance, _ = capsule_distances(points, ends.reshape(-1, 2, 3), radii.reshape(-1, 2))
    return (distance if signed else np.abs(distance)).reshape(*ends.shape[:2], -1).min(axis=1)


def capsule_distances(points: Floats, ends: Floats, radii: Floats) -> tuple[Floats, Floats]:
    """(c, n) each: the distance of each of points (n, 3) from the surface of each of c capsules, metres, negative
    inside, and the share of the capsule's axis that is nearest. ends (c, 2, 3), radii (c, 2).
    """
    centre = points.mean(axis=0)
    x, p, along = points - centre, ends[:, 0] - centre, ends[:, 1] - ends[:, 0]
    square = np.sum(x**2, axis=1)[None, :] - 2 * p @ x.T + np.sum(p**2, axis=1)[:, None]
    projection = along @ x.T - np.sum(p * along, axis=1)[:, None]
    length = np.maximum(np.sum(along**2, axis=1)[:, None], 1e-6)  # squared
    share = np.clip(projection / length, 0, 1)
    square += share * (share * length - 2 * projection)
    return np.sqrt(np.maximum(square, 0)) - (radii[:, :1] + share * (radii[:, 1:] - radii[:, :1])), share


class DistanceField:
    """Distances of places from the nearest of points (n, 3), metres: a grid of `cell` metres without interpolation.

    Where a single camera has seen the points, the places behind them may be filled as well, and have distance 0.
    """

    def __init__(self, points: Floats, cell: float = 0.03, margin: float = 0.25) -> None:
        self.cell, self.low = cell, points.min(axis=0) - margin
        self.shape = np.ceil((points.max(axis=0) + margin - self.low) / cell).astype(np.int64) + 1
        filled = np.zeros(self.shape, bool)
        filled[tuple(((points - self.low) / cell).astype(np.int64).T)] = True
        values = neighbours.cell_distances(filled).astype(np.float32) * cell
        self.hidden = self._hidden_places(points)
        if self.hidden is not None:
            filled |= self.hidden.reshape(self.shape)
            from_hidden = neighbours.cell_distances(filled).astype(np.float32) * cell
            values = np.minimum(values, from_hidden + np.float32(HIDDEN_M))
        self.values = values.ravel()

    def __call__(self, places: Floats) -> Floats:
        """(…,): distances of places (…, 3), metres; places outside the grid count as at its edge."""
        return np.asarray(self.values[self._rows(places)], np.float64)

    def is_hidden(self, places: Floats) -> Booleans:
        """(…,): whether places (…, 3), metres, are behind the points that a single camera has seen."""
        return np.zeros(places.shape[:-1], bool) if self.hidden is None else self.hidden[self._rows(places)]

    def compiled_distances(self) -> Any:
        """The distances as the compiled module takes them, None without it."""
        grid = native.kernel("CellDistances")
        return None if grid is None else grid(self.values, self.low, self.shape, self.cell)

    def compiled_hidden(self) -> Any:
        """The hidden cells as the compiled module takes them, None if there are none."""
        flags = native.kernel("CellFlags")
        if flags is None or self.hidden is None:
            return None
        return flags(self.hidden.view(np.uint8), self.low, self.shape, self.cell)

    def _hidden_places(self, points: Floats) -> Booleans | None:
        """(cells of the grid,): as `is_hidden`; None if more than one camera has seen the points."""
        camera = single_view.camera_place(points)
        if camera is None or self.shape.prod() > MAX_HIDDEN_CELLS:
            return None
        cells = np.stack(np.unravel_index(np.arange(int(self.shape.prod())), self.shape), axis=1)
        return single_view.is_hidden(self.low + (cells + 0.5) * self.cell, points, camera)

    def _rows(self, places: Floats) -> Integers:
        """(…,): the cell of each place (…, 3)."""
        cell = np.clip(((places - self.low) / self.cell).astype(np.int64), 0, self.shape - 1)
        return (cell[..., 0] * self.shape[1] + cell[..., 1]) * self.shape[2] + cell[..., 2]
