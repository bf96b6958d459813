"""Normals of surface points: the direction of least variance among each point's neighbours, oriented outwards."""

from __future__ import annotations

import numpy as np

from .. import native
from ..typing import Floats
from .neighbours import nearest

VOTING_ROUNDS = 8
"""Rounds in which neighbours vote on a normal's orientation."""
BLUR = 1.5
"""Standard deviation of the Gaussian that the density grid is blurred with, cells."""
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
    spread = among[nearest(points, among, min(neighbours, len(among)))[1]] - points[:, None]
    spread -= spread.mean(axis=1, keepdims=True)
    return smallest_eigenvectors(spread.transpose(0, 2, 1) @ spread)


def outward(points: Floats, neighbours: int = 8, cell: float = 0.05) -> Floats:
    """(n, 3): unit normals that point away from the local centre of mass, which is inside a body.

    The centre is a Gaussian-weighted mean of the points within about 15 cm, computed on a grid with cells of `cell`
    metres. Neighbours with similar normals then vote on the orientation.
    """
    if len(points) < 3:
        return estimate(points)
    _, index = nearest(points, points, min(neighbours, len(points)))
    spread = points[index] - points[:, None]
    spread -= spread.mean(axis=1, keepdims=True)
    normals = smallest_eigenvectors(spread.transpose(0, 2, 1) @ spread)
    low = np.percentile(points, 1, axis=0) - 0.5
    place = np.clip((points - low) / cell, 0, MAX_CELLS).astype(np.int64)
    shape = place.max(axis=0) + 1
    flat = np.asarray((place[:, 0] * shape[1] + place[:, 1]) * shape[2] + place[:, 2])
    weights = (np.ones(len(flat)), *(points - low).T)
    sums = np.stack([np.bincount(flat, weight, int(shape.prod())) for weight in weights]).astype(np.float64)
    wide = _blurred(sums.reshape(-1, *shape))
    count, *moments = wide.reshape(len(sums), -1)[:, flat]
    vote = np.sum((points - low - np.stack(moments, 1) / count[:, None]) * normals, axis=1)
    similarity = np.einsum("nki,ni->nk", normals[index], normals)
    similarity *= np.abs(similarity) / len(index[0])
    for _ in range(VOTING_ROUNDS):
        vote = np.einsum("nk,nk->n", similarity, vote[index])
    return np.where(vote[:, None] < 0, -normals, normals)


def _blurred(values: Floats) -> Floats:
    """(…, x, y, z): grids of values convolved with a Gaussian of BLUR cells, cut off at 2 standard deviations; 0 beyond
    the edges.
    """
    reach = round(2 * BLUR)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / BLUR) ** 2)
    kernel /= kernel.sum()
    for axis in (-3, -2, -1):
        lines = np.moveaxis(values, axis, 0)
        result = kernel[reach] * lines
        for shift in range(1, min(reach, len(lines) - 1) + 1):
            result[shift:] += kernel[reach + shift] * lines[:-shift]
            result[:-shift] += kernel[reach + shift] * lines[shift:]
        values = np.moveaxis(result, 0, axis)
    return values


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
    if len(points) < 2:
        return 0.0
    return float(np.median(nearest(points, points, 2)[0][:, 1]))
