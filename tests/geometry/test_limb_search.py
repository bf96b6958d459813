"""Random search for the pose of one limb: it finds a limb, and the compiled search is the NumPy one."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.geometry import articulation, body_tracking, joint_limits, limb_search
from mocodec.geometry.body_matching import FramePoints

compiled = pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or left aside")


@pytest.fixture(scope="module")
def scene(jumper):
    return jumper(2500)


def tracker_of(scene, limits=joint_limits.NO_LIMITS) -> body_tracking.BodyTracker:
    _, body, model, skin = scene
    return body_tracking.BodyTracker(body, skin, model.normals, limits=limits)


def search_of(tracker, clouds, name: str, turned: float) -> limb_search.LimbSearch:
    """The search for a limb that has been turned away from its points."""
    limb = next(limb for limb in tracker.limbs if tracker.body.names[limb.links[0]] == name)
    rotations = tracker.pose.rotations.copy()
    rotations[limb.links[0]] = articulation.exp(turned * np.array([0.6, 0.2, 0.77])) @ rotations[limb.links[0]]
    pose = articulation.Pose(rotations, tracker.pose.root)
    data = tracker.sample_frame(clouds.positions[0], None, 0)
    unexplained = data.points[tracker.assess(data, pose).residuals > 0.045][:40]
    assert len(unexplained) > 10
    places = FramePoints.build(data.points)
    return limb_search.LimbSearch(
        tracker.matcher, limb, tracker.limits, places, unexplained, pose, tracker.pose, limb.rows[::3]
    )


@pytest.mark.parametrize("name", ["LeftArm", "RightUpLeg"])
def test_a_limb_that_was_turned_away_is_found(scene, name):
    tracker = tracker_of(scene)
    search = search_of(tracker, scene[0], name, 1.6)
    draws = limb_search.LimbDraws.of(search.limb, search.pose, search.unexplained, np.random.default_rng(1))
    found = search.best(draws)
    first = len(search.limb.base)
    along = tracker.body.axes[search.limb.links[0]]
    assert 1 <= len(found) <= limb_search.REFINED
    assert np.degrees(np.arccos((found[:, first] @ along) @ along)).min() < 25  # the first pose is the true one


@compiled
@pytest.mark.parametrize("name", ["LeftArm", "RightUpLeg"])
@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("seen", [True, False])
def test_the_compiled_search_equals_numpy(scene, name, limited, seen):
    clouds, body, *_ = scene
    links = np.array([body.names.index(n) for n in ("LeftForeArm", "RightUpLeg")])
    order = np.argsort(links)
    axes, half_width = np.tile(np.eye(3), (2, 1, 1)), np.array([[0.8, 0.4, 0.4], [1.0, 0.5, 0.3]])
    some = joint_limits.LinkLimits(links[order], axes, axes, np.zeros((2, 3)), half_width)
    found = list[np.ndarray]()
    for is_compiled in (True, False):
        with native.without() if not is_compiled else pytest.MonkeyPatch.context():
            tracker = tracker_of(scene, some if limited else joint_limits.NO_LIMITS)
            search = search_of(tracker, clouds, name, 1.6)
            if not seen:
                search = search._replace(unexplained=np.zeros((0, 3)))
            draws = limb_search.LimbDraws.of(search.limb, search.pose, search.unexplained, np.random.default_rng(1))
            found.append(search.best(draws))
    assert found[0].shape == found[1].shape
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)


@compiled
def test_a_limb_beyond_the_body_is_refused(scene):
    tracker = tracker_of(scene)
    search = search_of(tracker, scene[0], "LeftArm", 1.6)
    draws = limb_search.LimbDraws.of(search.limb, search.pose, search.unexplained, np.random.default_rng(1))
    search.limb.links[0] += 1000
    with pytest.raises((ValueError, IndexError)):
        search.best(draws)
