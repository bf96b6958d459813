"""Points on a lattice: the compiled module and NumPy give the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.bodycast import integer_surface, lattice, octree, point_smoothing
from mocodec.codecs.bodycast.lattice_frames import LatticeFrame, LatticeGrid, to_lattice
from mocodec.codecs.bodycast.point_smoothing import SmoothedPoints
from mocodec.entropy.bit_arrays import BitDecoder, BitEncoder
from mocodec.errors import Corrupt

pytestmark = pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")
RNG = np.random.default_rng(3)
POINTS = RNG.normal(size=(500, 3))
CELLS = RNG.integers(0, 1 << 20, (500, 3))
GRID = LatticeGrid(0.0023, np.array([-400, 6, 1 << 30]), 20)


def require_same(function: Callable[..., Any], *arguments: Any) -> None:
    ours = function(*arguments)
    with native.without():
        theirs = function(*arguments)
    np.testing.assert_array_equal(ours, theirs)
    assert np.asarray(ours).dtype == np.asarray(theirs).dtype


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e9])
def test_nearest_lattice_points(scale):
    require_same(lattice.nearest, scale * POINTS, 0.0023)
    require_same(lattice.nearest, np.arange(-300, 300).reshape(-1, 3) * 0.5, 1.0)  # between two lattice points


def test_codes_and_cells():
    require_same(octree.morton_codes, CELLS)
    require_same(octree.morton_codes, CELLS[:0])
    require_same(octree.cells_of_codes, octree.morton_codes(CELLS))
    np.testing.assert_array_equal(octree.cells_of_codes(octree.morton_codes(CELLS)), CELLS)


def test_places_and_positions():
    require_same(GRID.places, CELLS)
    require_same(LatticeGrid(1e-7, np.array([-3, 0, 2]), 20).places, CELLS - 500_000)
    require_same(GRID.shifted_positions, CELLS, RNG.integers(-128, 129, (500, 3)), 8)


def test_distances_from_decoded_points():
    frame = LatticeFrame(np.arange(40), None, POINTS, RNG.integers(0, 40, 500))
    require_same(frame.own_distances, RNG.normal(size=(40, 3)))


@pytest.mark.parametrize("bound_m", [0.002, 0.5])
def test_frames_on_the_lattice(bound_m):
    """With the coarser bound most cells have several points."""
    colours = np.random.default_rng(4).integers(0, 256, (500, 3)).astype(np.uint8)

    def numbers() -> np.ndarray:
        grid, (frame,) = to_lattice([(POINTS, colours)], bound_m, coloured=True)
        assert frame.colours is not None
        assert frame.colours.dtype == np.uint8
        return np.concatenate([frame.codes, frame.rows, grid.corner, frame.colours.reshape(-1)])

    require_same(numbers)


@pytest.mark.parametrize("largest", [9, 1 << 40])
def test_spacing_of_samples(largest):
    neighbours = RNG.integers(0, 500, (500, 12))
    require_same(integer_surface._spacing_of, RNG.integers(-largest, largest, (500, 3)), neighbours)


def smoothed() -> tuple[SmoothedPoints, np.ndarray]:
    moves = RNG.integers(-128, 129, 700) * (RNG.random(700) < 0.7)
    stays = (RNG.random(700) < 0.1) | (moves == 0)
    return SmoothedPoints(np.zeros((700, 3), np.int64), moves, RNG.integers(0, 600, 700)), stays


def coded_stays(points: SmoothedPoints, stays: np.ndarray) -> bytes:
    coder = BitEncoder()
    np.testing.assert_array_equal(point_smoothing.code_stays(coder, points, stays), stays)
    return coder.finish()


def test_points_that_stay():
    points, stays = smoothed()
    data = coded_stays(points, stays)
    np.testing.assert_array_equal(point_smoothing.code_stays(BitDecoder(data), points, None), stays)
    with native.without():
        assert coded_stays(points, stays) == data


def test_points_that_stay_are_cut_off():
    points, stays = smoothed()
    with pytest.raises(Corrupt, match="cut off"):
        point_smoothing.code_stays(BitDecoder(coded_stays(points, stays)[:20]), points, None)
