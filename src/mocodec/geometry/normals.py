"""Normals of surface points: the direction of least variance among each point's neighbours, oriented outwards."""

from __future__ import annotations

import numpy as np

from .. import native
from ..typing import Floats

VOTING_ROUNDS = 8
"""Rounds in which neighbours vote on a normal's orientation."""
MAX_CELLS = 99
"""Cells of a side of the density grid, at most: five metres; points beyond count as in the last cell."""


def estimate(points: Floats, among: Floats | None = None, neighbours: int = 10) -> Floats:
    """(n, 3): unit normals of points (n, 3), of either orientation; +y for fewer than three points.

    among (m, 3): all the points of the surface, if `points` are a subset.
    """
    if len(points) < 3:
        return np.tile([0.0, 1.0, 0.0], (len(points), 1))
    among = points if among is None else among
    if (kernel := native.kernel("surface_normals")) is not None:
        return np.asarray(kernel(points, among, neighbours))
    from scipy.spatial import KDTree

    tree = KDTree(among, leafsize=16, compact_nodes=False, balanced_tree=False)
    spread = among[tree.query(points, k=min(neighbours, len(among)))[1]] - points[:, None]
    spread -= spread.mean(axis=1, keepdims=True)
    return smallest_eigenvectors(spread.transpose(0, 2, 1) @ spread)


def outward(points: Floats, neighbours: int = 8, cell: float = 0.05) -> Floats:
    """(n, 3): unit normals that point away from the local centre of mass, which is inside a body.

    The centre is a Gaussian-weighted mean of the points within about 15 cm, computed on a grid with cells of `cell`
    metres. Neighbours with similar normals then vote on the orientation.
    """
    from scipy.ndimage import gaussian_filter
    from scipy.spatial import KDTree

    if len(points) < 3:
        return estimate(points)
    tree = KDTree(points, leafsize=16, compact_nodes=False, balanced_tree=False)
    index = np.asarray(tree.query(points, k=min(neighbours, len(points)))[1], np.int64)
    spread = points[index] - points[:, None]
    spread -= spread.mean(axis=1, keepdims=True)
    normals = smallest_eigenvectors(spread.transpose(0, 2, 1) @ spread)
    low = np.percentile(points, 1, axis=0) - 0.5
    place = np.clip((points - low) / cell, 0, MAX_CELLS).astype(np.int64)
    shape = place.max(axis=0) + 1
    flat = np.asarray((place[:, 0] * shape[1] + place[:, 1]) * shape[2] + place[:, 2])
    sums = [np.bincount(flat, weight, int(shape.prod())) for weight in (None, *(points - low).T)]
    wide = [gaussian_filter(s.reshape(shape).astype(np.float32), 1.5, mode="constant", truncate=2.0) for s in sums]
    count, *moments = (np.asarray(w, np.float64).ravel()[flat] for w in wide)
    vote = np.sum((points - low - np.stack(moments, 1) / count[:, None]) * normals, axis=1)
    similarity = np.einsum("nki,ni->nk", normals[index], normals)
    similarity *= np.abs(similarity) / len(index[0])
    for _ in range(VOTING_ROUNDS):
        vote = np.einsum("nk,nk->n", similarity, vote[index])
    return np.where(vote[:, None] < 0, -normals, normals)


def smallest_eigenvectors(covariance: Floats) -> Floats:
    """(n, 3): unit eigenvectors of the smallest eigenvalues of symmetric positive matrices (n, 3, 3).

    By repeated squaring of the adjugate, which needs no eigensolver: the adjugate has the same eigenvectors, and its
    largest eigenvalue belongs to the smallest of the matrix.
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


def spacing(points: Floats) -> float:
    """The median distance of one of points (n, 3) from its nearest neighbour, metres."""
    from scipy.spatial import KDTree

    if len(points) < 2:
        return 0.0
    return float(np.median(KDTree(points).query(points, k=2)[0][:, 1]))
