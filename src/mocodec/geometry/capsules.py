"""How far points are from bodies made of capsules, and how far any place is from points: many bodies at once."""

from __future__ import annotations

import numpy as np

from .articulation import Floats


def gaps(points: Floats, ends: Floats, radii: Floats, signed: bool = False) -> Floats:
    """(k, n): how far each of points (n, 3) is from the nearest capsule's surface; ends (k, c, 2, 3), radii (k, c, 2).

    signed: negative inside, and the deepest counts. Single precision: a tenth of a millimetre within ten metres.
    """
    middle = points.mean(axis=0)
    x = (points - middle).astype(np.float32)
    p = (ends[:, :, 0] - middle).astype(np.float32)
    along = (ends[:, :, 1] - ends[:, :, 0]).astype(np.float32)
    k, c = p.shape[:2]
    away = np.sum(x**2, axis=1)[None, :] - 2 * p.reshape(-1, 3) @ x.T + np.sum(p**2, axis=2).reshape(-1, 1)
    forth = along.reshape(-1, 3) @ x.T - np.sum(p * along, axis=2).reshape(-1, 1)
    square = np.maximum(np.sum(along**2, axis=2).reshape(-1, 1), 1e-6)
    share = np.clip(forth / square, 0, 1)
    away += share * (share * square - 2 * forth)
    near, far = radii[..., 0].reshape(-1, 1), radii[..., 1].reshape(-1, 1)
    gap = np.sqrt(np.maximum(away, 0)) - (near + share * (far - near)).astype(np.float32)
    return (gap if signed else np.abs(gap)).reshape(k, c, -1).min(axis=1)


class Field:
    """How far any place is from the nearest of points (n, 3): a grid of `cell` metres, read without interpolation."""

    def __init__(self, points: Floats, cell: float = 0.03, margin: float = 0.25) -> None:
        from scipy.ndimage import distance_transform_edt

        self.cell, self.low = cell, points.min(axis=0) - margin
        self.shape = np.ceil((points.max(axis=0) + margin - self.low) / cell).astype(np.int64) + 1
        empty = np.ones(self.shape, bool)
        empty[tuple(((points - self.low) / cell).astype(np.int64).T)] = False
        self.values = np.asarray(distance_transform_edt(empty), np.float32).ravel() * cell

    def __call__(self, places: Floats) -> Floats:
        """(…,) metres from places (…, 3), those outside the grid from its edge."""
        cell = np.clip(((places - self.low) / self.cell).astype(np.int64), 0, self.shape - 1)
        row = (cell[..., 0] * self.shape[1] + cell[..., 1]) * self.shape[2] + cell[..., 2]
        return np.asarray(self.values[row], np.float64)
