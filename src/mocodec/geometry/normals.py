"""Normals of points of a surface: the direction of least spread among each point's neighbours, turned outwards."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
ROUNDS = 8  # of asking the neighbours which way is out


def estimate(points: Floats, among: Floats | None = None, neighbours: int = 10) -> Floats:
    """(n, 3) unit normals of (n, 3) points, of either sign; +y where there are fewer than three points.

    among (m, 3): all the points of the surface, where `points` are some of them.
    """
    from scipy.spatial import KDTree

    if len(points) < 3:
        return np.tile([0.0, 1.0, 0.0], (len(points), 1))
    among = points if among is None else among
    tree = KDTree(among, leafsize=16, compact_nodes=False, balanced_tree=False)
    spread = among[tree.query(points, k=min(neighbours, len(among)))[1]] - points[:, None]
    spread -= spread.mean(axis=1, keepdims=True)
    return least(spread.transpose(0, 2, 1) @ spread)


def outward(points: Floats, neighbours: int = 8, cell: float = 0.05) -> Floats:
    """(n, 3) unit normals that point away from where the other points around are, which is inside a body.

    The middle of what is within some 15 cm, weighted by a bell, comes from sums over cells of `cell` metres; then what
    neighbours say counts too.
    """
    from scipy.ndimage import gaussian_filter
    from scipy.spatial import KDTree

    if len(points) < 3:
        return estimate(points)
    tree = KDTree(points, leafsize=16, compact_nodes=False, balanced_tree=False)
    index = np.asarray(tree.query(points, k=min(neighbours, len(points)))[1], np.int64)
    spread = points[index] - points[:, None]
    spread -= spread.mean(axis=1, keepdims=True)
    normals = least(spread.transpose(0, 2, 1) @ spread)
    low = np.percentile(points, 1, axis=0) - 0.5
    place = np.clip((points - low) / cell, 0, 99).astype(np.int64)  # five metres: what flies beyond is no matter
    shape = place.max(axis=0) + 1
    flat = np.asarray((place[:, 0] * shape[1] + place[:, 1]) * shape[2] + place[:, 2])
    sums = [np.bincount(flat, weight, int(shape.prod())) for weight in (None, *(points - low).T)]
    wide = [gaussian_filter(s.reshape(shape).astype(np.float32), 1.5, mode="constant", truncate=2.0) for s in sums]
    count, *middle = (np.asarray(w, np.float64).ravel()[flat] for w in wide)
    vote = np.sum((points - low - np.stack(middle, 1) / count[:, None]) * normals, axis=1)
    alike = np.einsum("nki,ni->nk", normals[index], normals)
    alike *= np.abs(alike) / len(index[0])
    for _ in range(ROUNDS):
        vote = np.einsum("nk,nk->n", alike, vote[index])
    return np.where(vote[:, None] < 0, -normals, normals)


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
