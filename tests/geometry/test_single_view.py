"""Points that one camera has seen: the camera is found, and places behind the points are hidden."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.geometry import body_fit, single_view
from mocodec.geometry.capsules import HIDDEN_M, DistanceField
from mocodec.testing import actors, poses, sequences

CAMERA = np.array([0.5, 1.2, 2.6])


def sphere(points: int = 4000, radius: float = 0.3) -> np.ndarray:
    """Random points of a sphere at the origin, metres."""
    x = np.random.default_rng(0).normal(size=(points, 3))
    return radius * x / np.linalg.norm(x, axis=1, keepdims=True)


def seen_part(points: np.ndarray) -> np.ndarray:
    """The points of the sphere that face the camera."""
    return points[np.sum(points * (CAMERA - points), axis=1) > 0]


def test_the_camera_of_half_a_sphere_is_found_and_a_whole_one_has_none():
    assert single_view.camera_place(sphere()) is None
    assert single_view.camera_place(sphere(5)) is None
    place = single_view.camera_place(seen_part(sphere()))
    assert place is not None
    cosine = place @ CAMERA / np.linalg.norm(place) / np.linalg.norm(CAMERA)
    assert cosine > np.cos(np.radians(5))


@pytest.mark.parametrize("pose", ["T", "walking", "seated, hands on thighs"])
@pytest.mark.parametrize("views", [0, 1, 3])
def test_the_camera_of_a_person_is_found(pose, views):
    act = poses.posed(actors.capsules(), *poses.POSES[pose])
    points = sequences.record(act, 3000, views=views, seed=4).positions[0]
    place = single_view.camera_place(points)
    assert (place is not None) == (views == 1)
    if place is not None:
        towards = np.array([np.sin(0.2), 0.12, np.cos(0.2)])  # where `sequences.record` has its first camera
        offset = place - points.mean(axis=0)
        assert offset @ towards / np.linalg.norm(offset) / np.linalg.norm(towards) > np.cos(np.radians(25))


def test_places_behind_the_points_are_hidden():
    points = seen_part(sphere())
    towards = CAMERA / np.linalg.norm(CAMERA)
    across = np.cross(towards, [0, 1.0, 0])
    places = np.array([-0.2 * towards, -2.0 * towards, 0.5 * towards, 0.31 * towards, 0.5 * across, 10 * towards])
    hidden = single_view.is_hidden(places, points, CAMERA)
    np.testing.assert_array_equal(hidden, [True, True, False, False, False, False])


def test_hidden_places_are_near_in_a_distance_field():
    whole, part = DistanceField(sphere()), DistanceField(seen_part(sphere()))
    towards = CAMERA / np.linalg.norm(CAMERA)
    behind, beside = -0.2 * towards, 0.45 * np.cross(towards, [0, 1.0, 0])
    assert not whole.is_hidden(behind)
    assert part.is_hidden(behind)
    assert whole(behind) == pytest.approx(0.1, abs=0.04)
    assert part(behind) == pytest.approx(HIDDEN_M)
    assert not part.is_hidden(beside)
    assert part(beside) > HIDDEN_M


def test_exchanged_limbs_take_the_directions_of_the_other_side():
    act = poses.posed(actors.capsules(), *poses.POSES["walking"])
    points = sequences.record(act, 2000, seed=3).positions[0]
    search = body_fit.PoseSearch(points)
    fitter = body_fit.StockBodyFitter(points, search)
    start = body_fit.estimate_of(search.best(1, draws=300, rounds=1), 0)
    names, links = fitter.body.names, {}
    for number, estimate in enumerate([start, *fitter.limbs_exchanged(start)]):
        a = fitter._posed(estimate.rotations, estimate.root, estimate.build).a
        links[number] = {n: a[i] @ fitter.body.axes[i] for i, n in enumerate(names)}
    for number, changed in ((1, ("Arm", "ForeArm")), (2, ("UpLeg", "Leg"))):
        for name in ("Arm", "ForeArm", "UpLeg", "Leg"):
            other = f"Right{name}" if name in changed else f"Left{name}"
            np.testing.assert_allclose(links[number][f"Left{name}"], links[0][other], atol=1e-9)
