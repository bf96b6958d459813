"""Distances of points from bodies made of capsules, and of any place from points; for many bodies at once."""

from __future__ import annotations

import numpy as np

from ..typing import Floats


def surface_distances(points: Floats, ends: Floats, radii: Floats, signed: bool = False) -> Floats:
    """(k, n): the distance of each of points (n, 3) from the surface of the nearest capsule of each of k bodies,
    metres.

    ends (k, c, 2, 3), radii (k, c, 2): of the bodies' c capsules. signed: negative inside, where the deepest capsule
    counts. In single precision: accurate to 0.1 mm within ten metres.
    """
    distance, _ = capsule_distances(points, ends.reshape(-1, 2, 3), radii.reshape(-1, 2))
    return (distance if signed else np.abs(distance)).reshape(*ends.shape[:2], -1).min(axis=1)


def capsule_distances(points: Floats, ends: Floats, radii: Floats) -> tuple[Floats, Floats]:
    """(c, n) each: the distance of each of points (n, 3) from the surface of each of c capsules, metres, negative
    inside, and the share of the capsule's axis that is nearest. ends (c, 2, 3), radii (c, 2). In single precision.
    """
    centre = points.mean(axis=0)
    x, (p, q) = (points - centre).astype(np.float32), (ends - centre).astype(np.float32).transpose(1, 0, 2)
    along = q - p
    square = np.sum(x**2, axis=1)[None, :] - 2 * p @ x.T + np.sum(p**2, axis=1)[:, None]
    projection = along @ x.T - np.sum(p * along, axis=1)[:, None]
    length = np.maximum(np.sum(along**2, axis=1)[:, None], np.float32(1e-6))  # squared
    share = np.clip(projection / length, 0, 1)
    square += share * (share * length - 2 * projection)
    near, far = radii[:, :1].astype(np.float32), radii[:, 1:].astype(np.float32)
    return np.sqrt(np.maximum(square, 0)) - (near + share * (far - near)), share


class DistanceField:
    """Distances of places from the nearest of points (n, 3), metres: a grid of `cell` metres without interpolation."""

    def __init__(self, points: Floats, cell: float = 0.03, margin: float = 0.25) -> None:
        from scipy.ndimage import distance_transform_edt

        self.cell, self.low = cell, points.min(axis=0) - margin
        self.shape = np.ceil((points.max(axis=0) + margin - self.low) / cell).astype(np.int64) + 1
        empty = np.ones(self.shape, bool)
        empty[tuple(((points - self.low) / cell).astype(np.int64).T)] = False
        self.values = np.asarray(distance_transform_edt(empty), np.float32).ravel() * cell

    def __call__(self, places: Floats) -> Floats:
        """(…,): distances of places (…, 3), metres; places outside the grid count as at its edge."""
        cell = np.clip(((places - self.low) / self.cell).astype(np.int64), 0, self.shape - 1)
        row = (cell[..., 0] * self.shape[1] + cell[..., 1]) * self.shape[2] + cell[..., 2]
        return np.asarray(self.values[row], np.float64)
