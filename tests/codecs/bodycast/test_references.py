"""Points of earlier frames as samples of the surface: planes, motion, the choice of frames, damage."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.bodycast import Bodycast, reference_choice, reference_surface
from mocodec.codecs.bodycast.chunk_payload import unpack_chunk
from mocodec.codecs.bodycast.point_layer import REFERRED, SMOOTHED
from mocodec.codecs.bodycast.reference_points import EarlierFrames, Reference, pack_references, unpack_references
from mocodec.entropy import varint
from mocodec.entropy.bit_arrays import BitEncoder
from mocodec.errors import Corrupt
from mocodec.metrics import point_clouds as measures
from mocodec.pointcloud import PointClouds


def distinct(*shape: int, limit: int = 60) -> np.ndarray:
    return np.unique(np.random.default_rng(1).integers(0, limit, shape), axis=0)


def dish(k: int, points: int = 400) -> np.ndarray:
    """Other points of a curved surface in every frame, metres; it moves by 2 cm a frame."""
    flat = np.random.default_rng(k).uniform(-0.1, 0.1, (points, 2))
    return np.column_stack([flat[:, 0] + 0.02 * k, flat[:, 1], 3 * (flat**2).sum(axis=1)])


@pytest.mark.parametrize(
    "cells",
    [distinct(13, 3, limit=4000), distinct(300, 3, limit=8), distinct(500, 3), distinct(50, 3, limit=1 << 20)],
    ids=["few", "tied", "random", "far apart"],
)
def test_compiled_surfaces_are_those_of_numpy(cells):
    if not native.available():
        pytest.skip("the compiled module is not built")
    compiled = reference_surface.surface_of_points(cells)
    with native.without():
        plain = reference_surface.surface_of_points(cells)
    for own, other in zip(compiled, plain, strict=True):
        np.testing.assert_array_equal(own, other)


def test_samples_of_a_plane_have_its_normal_and_lie_on_it():
    flat = np.unique(np.random.default_rng(2).integers(0, 200, (400, 2)), axis=0)
    cells = np.column_stack([flat, np.full(len(flat), 50)])
    places, normals, neighbours = reference_surface.surface_of_points(cells)
    assert (np.abs(normals) == [0, 0, 1024]).all()
    assert (places[:, 2] == 50 * 16).all()
    assert (np.linalg.norm(cells[neighbours[:, 0]] - cells, axis=1) < 40).all()


def test_points_on_a_line_or_far_apart_have_some_normal():
    line = np.arange(40)[:, None] * [1, 2, 3]
    normals = reference_surface.surface_of_points(line).normals
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1024, atol=3)


@pytest.mark.parametrize("step", [(0, 0, 0), (7, -3, 2)])
def test_motion_is_found(step):
    x, y = np.random.default_rng(3).uniform(-60, 60, (2, 900))
    cells = np.unique(np.rint(np.column_stack([x, y, (x**2 + y**2) / 90])).astype(int) + 100, axis=0)
    places, normals, _ = reference_surface.surface_of_points(cells)
    found = reference_choice.estimated_motion(places / 16, normals / 1024, cells + step, (0, 0, 0))
    assert np.abs(np.subtract(found, step)).max() <= 1


def test_of_equal_points_the_latest_counts():
    earlier, cells = EarlierFrames(), distinct(100, 3)
    nothing = np.zeros(len(cells), bool)
    earlier.add(cells, nothing)
    earlier.move((1, 0, 0))
    earlier.add(cells + np.array([1, 0, 0]), nothing)
    found = earlier.references(2, 7, has_bodies=True)
    assert found is not None
    assert len(found.rows) == len(cells)
    assert (found.ages == 1).all()
    assert earlier.references(2, 3, has_bodies=True) is None  # too few within an octree of 8 cells a side


def test_explained_points_count_only_without_bodies():
    earlier, cells = EarlierFrames(), distinct(100, 3)
    earlier.add(cells, np.ones(len(cells), bool))
    assert earlier.references(1, 7, has_bodies=True) is None
    assert earlier.references(1, 7, has_bodies=False) is not None


def test_things_take_fewer_bytes_and_keep_their_bound():
    clouds = PointClouds([dish(k) for k in range(6)], 15.0)
    apart = [len(part_of(PointClouds([dish(k)], 15.0))) for k in range(6)]
    encoded = Bodycast(max_error=0.002).encode(clouds)
    assert measures.errors(clouds, Bodycast.decode(encoded)).max_error <= 0.002
    part = part_of(clouds)
    assert part[0] == REFERRED
    assert len(part) < 0.85 * sum(apart)


def test_noise_refers_to_nothing():
    rng = np.random.default_rng(5)
    places = [rng.uniform(-0.2, 0.2, (300, 3)) + k for k in range(3)]
    assert part_of(PointClouds(places, 15.0))[0] == SMOOTHED


def part_of(clouds: PointClouds) -> bytes:
    [chunk] = Bodycast(max_error=0.002).encode(clouds).chunks
    return unpack_chunk(chunk, 0).exact_points


def test_references_are_read_back_or_corrupt():
    references = [Reference(), Reference(4, (-5, 0, 35_000), True), Reference(1, (1, 2, 3))]
    data = pack_references(references)
    assert unpack_references(data + b"x", 3, 0) == (references, len(data))
    for damaged in (varint.write([10, 0, 0, 0]), varint.write([2, 0, 0, varint.signed(1 << 17)]), b"\x02"):
        with pytest.raises(Corrupt):
            unpack_references(damaged, 1, 0)


@pytest.mark.parametrize("pure", [True, False])
def test_a_copied_encoder_goes_on_by_itself(pure):
    def run() -> None:
        first = BitEncoder()
        bits = np.random.default_rng(6).random(200) < 0.2
        contexts, sets = np.zeros((200, 5), np.int64), np.zeros(200, np.int64)
        first.code(contexts, sets, bits)
        second = first.copy()
        second.code(contexts, sets, ~bits)
        first.code(contexts, sets, bits)
        assert second.size > first.size
        whole = BitEncoder()
        whole.code(np.tile(contexts, (2, 1)), np.tile(sets, 2), np.tile(bits, 2))
        assert first.finish() == whole.finish()

    if pure:
        with native.without():
            run()
    else:
        run()
