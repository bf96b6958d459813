"""Noise reduction of surface points by moving least squares: a quadric fitted to each point's neighbours."""

from __future__ import annotations

import numpy as np

from ..typing import Floats
from . import neighbours
from .normals import smallest_eigenvectors

NEIGHBOURS = 24
REWEIGHTINGS = 3
OUTLIER_M = 0.01
"""Distance from the quadric at which a neighbour counts half, metres."""
RIDGE = 1e-3
"""Regularisation of slopes and curvatures, relative to the neighbours' weight."""


def project_to_surface(points: Floats, among: Floats) -> Floats:
    """(n, 3): points moved along their normals onto the local surface of `among` (m, 3), metres.

    A quadric, because a plane would flatten round surfaces. Robust, so that the other side of a thin limb has little
    influence. Fewer than 24 points in `among` leave the points as they are.
    """
    if len(among) < NEIGHBOURS:
        return points
    distance, rows = neighbours.nearest(points, among, NEIGHBOURS)
    offset = among[rows] - points[:, None]
    spread = offset - offset.mean(axis=1, keepdims=True)
    normal = smallest_eigenvectors(spread.transpose(0, 2, 1) @ spread)
    side = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    size = np.maximum(distance[:, -1:], 1e-9)
    x, y = (np.einsum("nki,ni->nk", offset, axis) / size for axis in (side, np.cross(normal, side)))
    height = np.einsum("nki,ni->nk", offset, normal)
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)
    near = 1 - (distance / size) ** 2 / 1.01
    weight, ridge = near, np.diag([0.0, *[RIDGE] * 5])
    surface = np.zeros((len(points), 6))
    for _ in range(REWEIGHTINGS):
        weighted = terms * weight[..., None]
        across = weighted.transpose(0, 2, 1)
        surface = np.linalg.solve(across @ terms + ridge, across @ height[..., None])[..., 0]
        weight = near / (1 + ((terms @ surface[..., None])[..., 0] - height) ** 2 / OUTLIER_M**2)
    return points + normal * surface[:, :1]
