"""Scenes that are not one standing person: two people, a chair, a seated person, a newcomer. None may fail."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from mocodec.codecs.bodycast import Bodycast
from mocodec.codecs.bodycast.encoder import BodyEncoder
from mocodec.encoded import Encoded
from mocodec.metrics import point_clouds as measures
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences

pytest.importorskip("av")

FRAMES, POINTS = 4, 1500


def with_chair(clouds: PointClouds, place: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> PointClouds:
    """The clouds with a chair at a place, other points of it in every frame."""
    assert clouds.colours is not None
    positions, colours = [], []
    for frame in range(len(clouds)):
        points, wood = sequences.chair(700, seed=frame)
        positions.append(np.concatenate([clouds.positions[frame], points + np.asarray(place)]))
        colours.append(np.concatenate([clouds.colours[frame], wood]))
    return PointClouds(positions, clouds.rate, colours, None, clouds.up)


def two_people_and_a_chair() -> PointClouds:
    scene = sequences.record(sequences.pair(actors.capsules(), FRAMES), POINTS, seed=1)
    return with_chair(scene, (0.0, 0.0, 0.9))


def a_seated_person() -> PointClouds:
    return sequences.record(sequences.sitting(actors.capsules(), FRAMES), POINTS, seed=1)


def a_person_on_a_chair() -> PointClouds:
    return with_chair(a_seated_person())


def a_newcomer() -> PointClouds:
    """The second person is only in the last two frames."""
    first = sequences.jumping_jacks(actors.capsules(), FRAMES).moved((-0.7, 0.0, 0.0))
    second = sequences.turning(actors.capsules(), FRAMES).moved((0.7, 0.0, 0.0))
    both, alone = sequences.record((first, second), POINTS, seed=1), sequences.record(first, POINTS, seed=1)
    assert both.colours is not None
    assert alone.colours is not None
    positions = [*alone.positions[:2], *both.positions[2:]]
    colours = [*alone.colours[:2], *both.colours[2:]]
    return PointClouds(positions, 15.0, colours, None, "y")


def two_chairs() -> PointClouds:
    places = [
        np.concatenate([sequences.chair(500, k)[0], sequences.chair(500, k + 9)[0] + [1, 0, 0]]) for k in range(2)
    ]
    return PointClouds(places, 15.0)


SCENES = [two_people_and_a_chair, a_seated_person, a_person_on_a_chair, a_newcomer, two_chairs]


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)
def test_every_scene_as_a_surface_and_within_a_bound(scene, monkeypatch):
    """Decoded points are near all points, a bound holds, and bodies never cost much. Tracked once for both."""
    clouds, tracked, track = scene(), list[list[BodyEncoder]](), Bodycast._track

    def track_once(*arguments):
        tracked.extend([] if tracked else [track(*arguments)])
        return [copy.copy(body) for body in tracked[0]]

    monkeypatch.setattr(Bodycast, "_track", track_once)
    require_near_points(clouds, Bodycast().encode(clouds))
    require_bound(clouds, Bodycast(max_error=0.003).encode(clouds), 0.003)


def require_near_points(clouds: PointClouds, encoded: Encoded[PointClouds]) -> None:
    decoded = Bodycast.decode(encoded)
    for frame in range(len(clouds)):
        assert measures.d1(clouds, decoded, frame) < 0.05
    assert sum(map(len, encoded.shared)) + encoded.payload_bytes < clouds.raw_bytes / 4


def require_bound(clouds: PointClouds, encoded: Encoded[PointClouds], bound: float) -> None:
    assert measures.errors(clouds, Bodycast.decode(encoded)).max_error <= bound
    frames = [
        (np.asarray(p), None if clouds.colours is None else np.asarray(clouds.colours[i]))
        for i, p in enumerate(clouds.positions)
    ]
    coloured = clouds.colours is not None
    [alone] = Bodycast()._point_chunks([], frames, [slice(0, len(clouds))], coloured, 0, {"max_error": bound})
    assert sum(map(len, encoded.shared)) + encoded.payload_bytes <= 1.01 * len(alone)
