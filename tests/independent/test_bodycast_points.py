"""docs/payloads/bodycast-points.md holds all that a decoder of points within a bound needs beside the surface."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocodec import api
from mocodec.codecs.bodycast import Bodycast, exact_octree, integer_surface
from mocodec.codecs.bodycast.body_model import unpack_models
from mocodec.codecs.bodycast.chunk_payload import unpack_chunk
from mocodec.codecs.bodycast.point_layer import CUBED, REFERRED
from mocodec.codecs.bodycast.point_scene import SurfaceTexture
from mocodec.codecs.bodycast.pose_stream import unpack_poses
from mocodec.encoded import Encoded
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences

from . import bodycast_points
from .bodycast_points import Posed, Surface

pytest.importorskip("av")


def rows(values: np.ndarray) -> list[tuple[int, ...]]:
    return [tuple(row) for row in values.tolist()]


def decoded_from_the_page(encoded: Encoded[PointClouds]) -> list[tuple[np.ndarray, np.ndarray]]:
    """All frames of a file with at most one body, which is in every frame."""
    [chunk] = encoded.chunks
    models = unpack_models(encoded.shared)
    streams = unpack_chunk(chunk, len(models))
    surface, posed = Surface(), lambda k, shifts: Posed()
    if models:
        [model], [body] = models, streams.bodies
        texture = SurfaceTexture(model)
        whole = texture.integers(texture.shift)
        surface = Surface(rows(whole.points), whole.neighbours.tolist(), rows(texture.colours))
        poses = unpack_poses(model.atlas.body, body.poses, chunk.frames, model.pose_steps)

        def posed(k: int, shifts: list[int]) -> Posed:
            values = integer_surface.pose_values(model.atlas.body, poses[k])
            places, normals, turns = integer_surface.posed_samples(whole, values, shifts[k])
            return Posed(
                rows(places),
                rows(normals),
                turns[whole.links[:, 0]].tolist(),
            )

    count = chunk.frames * len(models)
    found = bodycast_points.points(streams.exact_points, chunk.frames, len(models), count, surface, posed)
    return [(np.array(places).reshape(-1, 3), np.array(colours).reshape(-1, 3)) for places, colours in found]


@pytest.mark.parametrize("step", [0.004, 0.03])
@pytest.mark.parametrize("coloured", [True, False])
def test_frames_without_a_body(step: float, coloured: bool) -> None:
    rng = np.random.default_rng(3)
    positions = [rng.uniform(-1, 1, (n, 3)) * [0.3, 0.05, 0.2] for n in (90, 0, 1, 40)]
    colours = [rng.integers(0, 256, (len(p), 3)).astype(np.uint8) for p in positions]
    encoded = Bodycast(max_error=step).encode(PointClouds(positions, 15.0, colours if coloured else None))
    compare(encoded, coloured)


@pytest.mark.parametrize(("psnr", "bound"), [(32, 0.004), (None, 0.012)])
def test_a_body_and_what_its_frames_teach(psnr: float | None, bound: float) -> None:
    performance = sequences.jumping_jacks(actors.capsules(), 3)
    clouds = replace(sequences.record(performance, 250, seed=1), normals=None)
    codec = Bodycast(max_error=bound, psnr=psnr, skeleton=performance.skeleton())
    encoded = codec.encode(clouds)
    assert kind_of(encoded) == CUBED
    compare(encoded, coloured=True)


@pytest.mark.parametrize("coloured", [True, False])
def test_frames_that_refer_to_earlier_ones(coloured: bool) -> None:
    rng, places = np.random.default_rng(4), list[np.ndarray]()
    for k in range(6):  # a dish that moves, with other points in every frame
        flat = rng.uniform(-0.1, 0.1, (150, 2))
        places.append(np.column_stack([flat[:, 0] + 0.02 * k, flat[:, 1], 3 * (flat**2).sum(axis=1)]))
    places[3] = places[3][:0]
    colours = [(128 + 900 * p).clip(0, 255).astype(np.uint8) for p in places]
    encoded = Bodycast(max_error=0.003).encode(PointClouds(places, 15.0, colours if coloured else None))
    assert kind_of(encoded) == REFERRED
    compare(encoded, coloured)


def test_a_body_beside_a_thing() -> None:
    performance = sequences.jumping_jacks(actors.capsules(), 2)
    clouds = sequences.record(performance, 250, seed=1)
    assert clouds.colours is not None
    positions, colours = list[np.ndarray](), list[np.ndarray]()
    for k in range(2):
        wall = np.random.default_rng(k).uniform(-0.1, 0.1, (150, 3)) * [1, 1, 0] + [1.0, 0.5, 0.3]
        positions.append(np.concatenate([clouds.positions[k], wall]))
        colours.append(np.concatenate([clouds.colours[k], np.tile(np.uint8([90, 60, 30]), (150, 1))]))
    codec = Bodycast(max_error=0.004, skeleton=performance.skeleton())
    encoded = codec.encode(PointClouds(positions, 15.0, colours, None, "y"))
    assert kind_of(encoded) == REFERRED
    compare(encoded, coloured=True)


@pytest.mark.parametrize("precision", [0.0, 0.002])
@pytest.mark.parametrize("coloured", [True, False])
def test_exact_points(precision: float, coloured: bool) -> None:
    performance = sequences.jumping_jacks(actors.capsules(), 2)
    clouds = sequences.record(performance, 250, seed=1)
    assert clouds.colours is not None
    twice = [np.concatenate([p, p[:40]]) for p in clouds.positions]
    colours = [np.concatenate([c, c[:40] // 2]) for c in clouds.colours] if coloured else None
    codec = Bodycast(residual="exact", precision=precision, skeleton=performance.skeleton())
    encoded = codec.encode(PointClouds(twice, 15.0, colours, None, "y"))
    assert kind_of(encoded) == exact_octree.KIND
    compare(encoded, coloured)


def test_a_body_that_is_hidden() -> None:
    with api.open(Path(__file__).parent.parent / "golden/bodycast-covered.mocz", PointClouds) as file:
        encoded = file.encoded
    assert kind_of(encoded) == REFERRED
    compare(encoded, coloured=True)


def kind_of(encoded: Encoded[PointClouds]) -> int:
    """The kind of the points of the only chunk."""
    [chunk] = encoded.chunks
    return unpack_chunk(chunk, len(encoded.shared)).exact_points[0]


def compare(encoded: Encoded[PointClouds], coloured: bool) -> None:
    wanted = Bodycast.decode(encoded)
    for frame, (places, colours) in enumerate(decoded_from_the_page(encoded)):
        np.testing.assert_allclose(places, wanted.positions[frame], rtol=0, atol=1e-12)
        if coloured:
            assert wanted.colours is not None
            np.testing.assert_array_equal(colours, wanted.colours[frame])
