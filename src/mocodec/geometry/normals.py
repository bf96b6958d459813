"""Normals of points of a surface: the direction of least spread among each point's neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def estimate(points: Floats, neighbours: int = 10) -> Floats:
    """(n, 3) unit normals of (n, 3) points, of either sign; +y where there are fewer than three points."""
    from scipy.spatial import KDTree

    count = len(points)
    if count < 3:
        return np.tile([0.0, 1.0, 0.0], (count, 1))
    tree = KDTree(points, leafsize=16, compact_nodes=False, balanced_tree=False)
    _, index = tree.query(points, k=min(neighbours, count))
    spread = points[index] - points[:, None]
    spread -= spread.mean(axis=1, keepdims=True)
    return least(np.einsum("nki,nkj->nij", spread, spread))


def least(covariance: Floats) -> Floats:
    """(n, 3) unit eigenvectors of the smallest eigenvalues of symmetric matrices (n, 3, 3), in closed form.

    Two steps of inverse iteration on the adjugate, which needs no eigensolver: the adjugate's own largest eigenvalue
    belongs to the smallest of the matrix.
    """
    scale = np.trace(covariance, axis1=1, axis2=2)[:, None, None]
    m = covariance / np.maximum(scale, 1e-30) + 1e-6 * np.eye(3)
    adjugate = np.stack([np.cross(m[:, 1], m[:, 2]), np.cross(m[:, 2], m[:, 0]), np.cross(m[:, 0], m[:, 1])], axis=1)
    for _ in range(4):
        adjugate = adjugate @ adjugate
        adjugate /= np.maximum(np.abs(adjugate).max(axis=(1, 2), keepdims=True), 1e-300)
    column = np.argmax(np.linalg.norm(adjugate, axis=1), axis=1)
    normal = np.take_along_axis(adjugate, column[:, None, None], axis=2)[:, :, 0]
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
