"""Lattice points chosen by bits and errors: within the bound, in fewer bytes, the same in NumPy and compiled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from mocodec import native
from mocodec.codecs.bodycast import Bodycast, cube_octree, lattice_frames, octree, point_choice
from mocodec.codecs.bodycast.integer_surface import hints_of_samples, nearest_samples
from mocodec.codecs.bodycast.lattice_frames import LatticeFrame, LatticeGrid
from mocodec.codecs.bodycast.surface_hints import SurfaceHints
from mocodec.entropy.bit_arrays import BitEncoder
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences

BOUND_M = 0.01


def _sphere(count: int, seed: int) -> np.ndarray:
    """(count, 3): unit vectors."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def _ball(points: int) -> tuple[LatticeGrid, LatticeFrame, SurfaceHints]:
    """Points on a ball of 0.2 m and away from it, on a lattice for BOUND_M, with samples of the ball."""
    places = np.concatenate([0.2 * _sphere(points, 1), 0.2 * _sphere(points, 2)[:20] + [0.5, 0, 0]])
    colours = np.random.default_rng(3).integers(0, 256, (len(places), 3)).astype(np.uint8)
    grid, [frame] = lattice_frames.to_lattice([(places, colours)], BOUND_M / point_choice.FREEDOM, True)
    directions = _sphere(600, 4)
    samples = np.floor((0.2 * directions / grid.step_m - grid.corner) * 16).astype(np.int64)
    normals = np.floor(1024 * directions).astype(np.int64)
    return grid, frame, hints_of_samples(samples, normals, nearest_samples(samples, normals), grid.depth, True)


@pytest.mark.parametrize("points", [1, 40, 1000])
def test_chosen_cells_are_within_the_bound_and_have_points(points):
    grid, frame, hints = _ball(points)
    chosen = point_choice.chosen_cells(frame, grid, hints, BOUND_M)
    cells = octree.cells_of_codes(chosen.codes)
    assert chosen.own_distances(grid.positions(cells)).max() <= BOUND_M
    assert np.array_equal(np.unique(chosen.rows), np.arange(len(chosen.codes)))
    assert np.isin((cells & 1).sum(axis=1), (0, 3)).all()
    for row in range(0, len(chosen.codes), 50):
        mean = np.asarray(chosen.own_colours)[chosen.rows == row].mean(axis=0)
        assert np.abs(np.asarray(chosen.colours)[row] - mean).max() <= 0.5


@pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")
@pytest.mark.parametrize("points", [40, 800])
def test_compiled_and_numpy_choices_are_the_same(points):
    grid, frame, hints = _ball(points)
    compiled = point_choice.chosen_cells(frame, grid, hints, BOUND_M)
    with native.without():
        pure = point_choice.chosen_cells(frame, grid, hints, BOUND_M)
    np.testing.assert_array_equal(compiled.codes, pure.codes)
    np.testing.assert_array_equal(compiled.rows, pure.rows)


def test_octrees_are_the_same_with_and_without_samples_of_the_choice():
    """The choice leaves samples near cubes in the surface that an octree of the same frame takes."""
    grid, frame, hints = _ball(1000)
    codes = point_choice.chosen_cells(frame, grid, hints, BOUND_M).codes
    assert not np.array_equal(codes, frame.codes)

    def coded(surface: SurfaceHints) -> tuple[bytes, list[int]]:
        coder = BitEncoder()
        _, nearest = cube_octree.code_octree(coder, codes, grid.depth, len(codes), surface)
        return coder.finish(), nearest.tolist()

    assert coded(hints) == coded(replace(hints))


@pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")
def test_what_is_not_there_is_refused():
    kernel = native.kernel("PointChoice")
    assert kernel is not None
    grid, frame, hints = _ball(40)
    codes, rows, costs = frame.codes.astype(np.uint64), frame.rows, np.ones(point_choice.CLASSES + 1, np.int64)

    def choice(points=frame.originals, codes=codes, rows=rows, reach=300):
        return kernel(hints.compiled, points, grid.step_m, grid.corner, codes, rows, reach, 2 * hints.spacing)

    assert len(choice().choose(costs, hints.spacing, 1, 3)[1]) == len(rows)
    with pytest.raises(ValueError, match="outside the octree"):
        choice(points=frame.originals + 10)
    with pytest.raises(ValueError, match="not sorted"):
        choice(codes=codes[::-1])
    for bad in (rows - 1, rows + len(codes)):
        with pytest.raises(ValueError, match="beyond the codes"):
            choice(rows=bad)
    with pytest.raises(ValueError, match="shapes differ"):
        choice(rows=rows[:-1])
    with pytest.raises(ValueError, match="costs of another shape"):
        choice().choose(costs[:-1], hints.spacing, 1, 3)


@pytest.fixture(scope="module")
def recorded() -> tuple[sequences.Performance, PointClouds]:
    performance = sequences.jumping_jacks(actors.capsules(), 3)
    return performance, replace(sequences.record(performance, 1500, seed=1), normals=None)


def _error(clouds: PointClouds, decoded: PointClouds) -> tuple[float, float]:
    """Root mean square and largest distance to the nearest point, by SciPy alone."""
    pairs = [(np.asarray(a), np.asarray(b)) for a, b in zip(clouds.positions, decoded.positions, strict=True)]
    there = np.concatenate([KDTree(b).query(a)[0] for a, b in pairs])
    back = np.concatenate([KDTree(a).query(b)[0] for a, b in pairs])
    return max(float(np.sqrt(np.mean(d**2))) for d in (there, back)), float(max(there.max(), back.max()))


def test_chosen_points_keep_the_bound_and_are_smaller_at_the_same_error(recorded, monkeypatch):
    pytest.importorskip("av")
    performance, clouds = recorded
    bound = 0.0103
    ours = Bodycast(max_error=bound, skeleton=performance.skeleton()).encode(clouds)
    rms, largest = _error(clouds, Bodycast.decode(ours))
    assert ours.promise == {"max_error": bound}
    assert largest <= bound
    monkeypatch.setattr(point_choice, "FREEDOM", 1.0)
    monkeypatch.setattr(point_choice, "chosen_cells", lambda frame, *_: frame)
    nearest = Bodycast(max_error=0.01, skeleton=performance.skeleton()).encode(clouds)
    assert rms <= _error(clouds, Bodycast.decode(nearest))[0]
    assert ours.payload_bytes < nearest.payload_bytes
