"""Neighbours of points and cells: compiled and not."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.geometry import neighbours

needs_module = pytest.mark.skipif(not native.available(), reason="the compiled module is not built")


@needs_module
@pytest.mark.parametrize("count", [1, 7, 40])
def test_nearest_points(count):
    rng = np.random.default_rng(0)
    points, places = rng.normal(size=(40, 3)), rng.normal(size=(300, 3))
    distance, rows = neighbours.nearest(places, points, count)
    assert (np.diff(distance, axis=1) >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(points[rows] - places[:, None], axis=2), distance)
    with native.without():
        expected = neighbours.nearest(places, points, count)
    np.testing.assert_array_equal(rows, expected[1])
    np.testing.assert_allclose(distance, expected[0])


def test_groups_of_cells():
    cells = np.array([[0, 0, 0], [9, 9, 9], [1, -1, 1], [3, -1, 1], [9, 9, 11]])
    assert neighbours.groups(cells, 3).tolist() == [0, 1, 0, 2, 3]
    assert neighbours.groups(cells, 6).tolist() == [0, 1, 0, 0, 1]


@needs_module
@pytest.mark.parametrize("square", [1, 2, 3, 6])
def test_compiled_groups_are_the_same(square):
    rng = np.random.default_rng(square)
    cells = np.unique(rng.integers(-9, 9, (500, 3)), axis=0)
    cells = cells[rng.permutation(len(cells))]
    groups = neighbours.groups(cells, square)
    assert groups.max() > 0 or square > 2
    with native.without():
        np.testing.assert_array_equal(groups, neighbours.groups(cells, square))


@needs_module
def test_compiled_distances_of_cells_are_the_same():
    rng = np.random.default_rng(1)
    for shape, share in (((9, 14, 11), 0.02), ((1, 30, 1), 0.1), ((12, 12, 12), 0.5)):
        filled = rng.random(shape) < share
        filled[0, -1, 0] = True
        distances = neighbours.cell_distances(filled)
        with native.without():
            np.testing.assert_array_equal(distances, neighbours.cell_distances(filled))
