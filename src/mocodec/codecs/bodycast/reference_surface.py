"""The surface that points of earlier frames lie on, as samples for the octree of a frame. Integers only.

points ─► the nearest points of each ─► their plane ─► places moved onto it, normals, neighbours: samples as of a body
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ... import native
from ...typing import Integers
from .surface_hints import NEIGHBOURS, NORMAL_BITS, SUBUNIT_BITS

SPREAD_BITS = 9  # of the differences from a point that its plane is fitted to
COLUMN_BITS = 20  # of a normal before it is scaled
TIES = 8  # points at the same distance that a search may end with


class Samples(NamedTuple):
    """Samples of a surface as the octree sees them.

    places (m, 3): subunits from the octree's corner. normals (m, 3): of length 2^NORMAL_BITS. neighbours
    (m, NEIGHBOURS): rows of those around each that face the same way, nearest first, then itself.
    """

    places: Integers
    normals: Integers
    neighbours: Integers


def surface_of_points(cells: Integers) -> Samples:
    """A sample for each of the distinct lattice points (m, 3), m > NEIGHBOURS; coordinates from 0 to 2^20 − 1."""
    points = cells << SUBUNIT_BITS
    if (kernel := native.kernel("surface_of_points")) is not None:
        return Samples(*map(np.asarray, kernel(points)))
    around = _nearest_others(points)
    apart = points[around] - points[:, None]
    normals = _plane_normals(apart)
    centre = points.sum(axis=0) // len(points)
    normals[((points - centre) * normals).sum(axis=1) < 0] *= -1
    offset = ((apart.sum(axis=1) * normals).sum(axis=1) >> NORMAL_BITS) // (NEIGHBOURS + 1)
    places = points + (offset[:, None] * normals >> NORMAL_BITS)
    faces_alike = (normals[around] * normals[:, None]).sum(axis=2) > 0
    order = np.argsort(~faces_alike, axis=1, kind="stable")
    own = np.arange(len(points))[:, None]
    return Samples(places, normals, np.take_along_axis(np.where(faces_alike, around, own), order, axis=1))


def _nearest_others(points: Integers) -> Integers:
    """(m, NEIGHBOURS): the points nearest to each, nearest first, equal ones by row."""
    from scipy.spatial import KDTree

    tree, rows = KDTree(points), np.arange(len(points))
    result = np.empty((len(points), NEIGHBOURS), np.int64)
    searched = NEIGHBOURS + 1 + TIES
    while len(rows):  # where the last ones tie, others that are as near may be missing: search farther
        searched = min(searched, len(points))
        found = np.asarray(tree.query(points[rows], searched)[1], np.int64)
        square = ((points[found] - points[rows, None]) ** 2).sum(axis=2)
        order = np.lexsort((found, square), axis=1)[:, 1 : NEIGHBOURS + 1]  # distinct points: the first is the point
        taken = np.take_along_axis(square, order[:, -1:], axis=1)[:, 0]
        complete = (square.max(axis=1) > taken) | (searched == len(points))
        result[rows] = np.take_along_axis(found, order, axis=1)
        rows, searched = rows[~complete], 2 * searched
    return result


def _plane_normals(apart: Integers) -> Integers:
    """(m, 3): normals of length 2^NORMAL_BITS of the planes through the points `apart` (m, k, 3) and the origin.

    The adjugate of a covariance has the eigenvector of the smallest eigenvalue with the largest eigenvalue. Its column
    with the largest diagonal element is near that eigenvector where the points lie near a plane.
    """
    excess = np.maximum(_bit_length(np.abs(apart).max(axis=(1, 2))) - SPREAD_BITS, 0)
    near = apart >> excess[:, None, None]
    total = near.sum(axis=1)
    covariance = (near.shape[1] + 1) * np.einsum("nki,nkj->nij", near, near) - total[:, :, None] * total[:, None]
    xx, xy, xz, yy, yz, zz = covariance[:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)].T
    columns = np.stack(
        [
            [yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy],
            [xz * yz - xy * zz, xx * zz - xz * xz, xy * xz - xx * yz],
            [xy * yz - xz * yy, xy * xz - xx * yz, xx * yy - xy * xy],
        ]
    )  # (3 columns, 3, m)
    largest = np.stack([columns[k, k] for k in range(3)]).argmax(axis=0)
    column = columns[largest, :, np.arange(len(apart))]
    column = column >> np.maximum(_bit_length(np.abs(column).max(axis=1)) - COLUMN_BITS, 0)[:, None]
    length = np.sqrt((column**2).sum(axis=1)).astype(np.int64)  # below 2^42: rounding never reaches the next integer
    normals = (column << NORMAL_BITS) // np.maximum(length, 1)[:, None]
    normals[length == 0] = (0, 0, 1 << NORMAL_BITS)
    return normals


def _bit_length(values: Integers) -> Integers:
    """Binary digits of numbers from 0 to 2^62."""
    low = np.frexp((values & (1 << 31) - 1).astype(np.float64))[1]
    high = np.frexp((values >> 31).astype(np.float64))[1]
    return np.where(values >> 31 > 0, high + 31, low).astype(np.int64)
