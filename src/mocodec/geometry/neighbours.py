"""Neighbours of points, and of the cells of a grid that points lie in."""

from __future__ import annotations

import numpy as np

from .. import native
from ..typing import AnyInteger, Booleans, Floats, Integers


def nearest(places: Floats, points: Floats, count: int) -> tuple[Floats, Integers]:
    """Distances and rows (n, count) of the points (m, 3) nearest to places (n, 3), nearest first; count ≤ m."""
    if (kernel := native.kernel("nearest_points")) is not None:
        distance, rows = kernel(places, points, count)
        return distance, rows
    from scipy.spatial import KDTree

    tree = KDTree(points, leafsize=16, compact_nodes=False, balanced_tree=False)
    distance, rows = tree.query(places, k=count)
    return np.asarray(distance).reshape(-1, count), np.asarray(rows, np.int64).reshape(-1, count)


def groups(cells: AnyInteger, square: int) -> Integers:
    """(n,): the group of each of distinct cells (n, 3), numbered in the order of their first cells. Cells are connected
    up to this squared distance.
    """
    if (kernel := native.kernel("cell_groups")) is not None:
        return np.asarray(kernel(cells, square))
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    pairs = KDTree(cells).query_pairs(np.sqrt(square + 0.5), output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), bool), tuple(pairs.T)), shape=(len(cells),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def cell_distances(filled: Booleans) -> Floats:
    """(x, y, z): the distance of each cell of a grid from the nearest filled one, in cells; at least one is filled."""
    if (kernel := native.kernel("cell_distances")) is not None:
        return np.asarray(kernel(filled))
    from scipy.ndimage import distance_transform_edt

    return np.asarray(distance_transform_edt(~filled))
