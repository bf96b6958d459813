"""Exact points, outliers and the octree below them: round trips, sizes, damage."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.bodycast import exact_points, octree, outliers
from mocodec.errors import CannotEncode, Corrupt
from mocodec.testing import corruption


def sphere(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    points *= 0.5 / np.linalg.norm(points, axis=1, keepdims=True)
    return (points + np.array([0.1, -3.0, 40.0])).astype(np.float32).astype(np.float64), rng.integers(
        0, 256, (count, 3), np.uint8
    )


def in_order(cloud) -> np.ndarray:
    """Points and colours in one order, whatever order they came in."""
    points, colours = cloud
    rows = np.concatenate([points.astype(np.float32), np.zeros((len(points), 0)) if colours is None else colours], 1)
    return rows[np.lexsort(rows.T)]


def test_morton_codes_invert():
    cells = np.random.default_rng(1).integers(0, 1 << octree.MAX_DEPTH, (500, 3))
    np.testing.assert_array_equal(octree.cells_of_codes(octree.morton_codes(cells)), cells)
    assert octree.morton_codes(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [3, 0, 0]])).tolist() == [1, 2, 4, 9]


@pytest.mark.parametrize("coloured", [True, False])
def test_every_bit_of_a_float_is_kept(coloured):
    odd = np.array([[0.0, -0.0, 1e-30], [-1e-7, 3.0, 2**-10], [1e-3, -(2**-10), 0.3], [5.0, 5.0, 5.0], [5.0, 5.0, 5.0]])
    frames = [sphere(700), (np.zeros((0, 3)), np.zeros((0, 3), np.uint8)), (odd, np.zeros((5, 3), np.uint8)), sphere(1)]
    frames = [(p.astype(np.float32).astype(np.float64), c if coloured else None) for p, c in frames]
    back = exact_points.unpack_exact(exact_points.pack_exact(frames, 0.0, coloured), len(frames), coloured)
    for was, now in zip(frames, back, strict=True):
        np.testing.assert_array_equal(in_order(was), in_order(now))


@pytest.mark.parametrize("step", [0.001, 0.004, 1 / 256, 0.0025])
def test_points_on_a_grid_cost_only_their_cells(step):
    points, colours = sphere(4000)
    cells = np.unique(np.round(points / step), axis=0)
    gridded = cells * step, colours[: len(cells)]
    packed = exact_points.pack_exact([gridded], 0.0, True)
    np.testing.assert_array_equal(in_order(exact_points.unpack_exact(packed, 1, True)[0]), in_order(gridded))
    assert len(exact_points.pack_exact([(gridded[0], None)], 0.0, False)) < 5.0 * len(cells)


def test_a_stated_precision_is_kept_and_a_surface_costs_few_bits():
    points, _ = sphere(60_000)
    packed = exact_points.pack_exact([(points, None)], 0.01, False)
    [(back, _)] = exact_points.unpack_exact(packed, 1, False)
    assert np.abs(np.sort(back[:, 2]) - np.sort(points[:, 2])).max() <= 0.005 + 1e-9
    cells = len(np.unique(np.round(points / 0.01), axis=0))
    assert 8 * len(packed) / cells < 5.5  # bits for each cell, with its number of points


def test_points_too_far_apart_are_refused():
    with pytest.raises(CannotEncode, match="apart"):
        exact_points.pack_exact([(np.array([[1.2345e-4, 0, 0], [5003.7, 0, 0]]), None)], 0.0, False)


def test_damaged_points_raise_corrupt_or_decode():
    frames = [sphere(120), sphere(80, 1)]
    for data, read in (
        (exact_points.pack_exact(frames, 0.0, True), lambda d: exact_points.unpack_exact(d, 2, True)),
        (exact_points.pack_exact(frames, 0.002, True), lambda d: exact_points.unpack_exact(d, 2, True)),
        (outliers.pack_outliers(frames, True), lambda d: outliers.unpack_outliers(d, 2, True)),
    ):
        assert len(read(data)) == 2
        for bad in (*corruption.prefixes(data, every=29), *corruption.damaged(data, 40, seed=3)):
            try:
                read(bad)
            except Corrupt:
                continue
