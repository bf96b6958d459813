"""Points of a noisy surface put onto it: moving least squares, a quadric over each point's neighbours."""

from __future__ import annotations

import numpy as np

from .normals import Floats, least

NEIGHBOURS, ROUNDS = 24, 3
STRAY = 0.01  # metres from the quadric at which a neighbour counts half
RIDGE = 1e-3  # of the neighbours' weight, which holds slopes and curvatures back where they say little


def smoothed(points: Floats, among: Floats) -> Floats:
    """(n, 3): points moved along their normals onto the surface that `among` (m, 3) shows around them, metres.

    A quadric, not a plane, which would sink into what is round. Robust, so that the other side of a thin limb does not
    draw.
    """
    from scipy.spatial import KDTree

    if len(among) < NEIGHBOURS:
        return points
    away, rows = KDTree(among, leafsize=16, compact_nodes=False, balanced_tree=False).query(points, k=NEIGHBOURS)
    offset = among[rows] - points[:, None]
    spread = offset - offset.mean(axis=1, keepdims=True)
    normal = least(spread.transpose(0, 2, 1) @ spread)
    side = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    size = np.maximum(away[:, -1:], 1e-9)
    x, y = (np.einsum("nki,ni->nk", offset, axis) / size for axis in (side, np.cross(normal, side)))
    height = np.einsum("nki,ni->nk", offset, normal)
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)
    near = 1 - (away / size) ** 2 / 1.01
    weight, ridge = near, np.diag([0.0, *[RIDGE] * 5])
    surface = np.zeros((len(points), 6))
    for _ in range(ROUNDS):
        weighted = terms * weight[..., None]
        across = weighted.transpose(0, 2, 1)
        surface = np.linalg.solve(across @ terms + ridge, across @ height[..., None])[..., 0]
        weight = near / (1 + ((terms @ surface[..., None])[..., 0] - height) ** 2 / STRAY**2)
    return points + normal * surface[:, :1]
