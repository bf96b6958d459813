"""All joints at once: followed closely, found again after a loss, and a first pose from nothing."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.evaluation.cloud import actors, sequences, tracking
from mocodec.geometry import articulated_icp, articulation, body_tracking, skinning
from mocodec.pointcloud import PointClouds


@pytest.fixture(scope="module")
def performance() -> sequences.Performance:
    return sequences.jumping_jacks(actors.capsules(), 14)


@pytest.fixture(scope="module")
def clouds(performance) -> PointClouds:
    return sequences.record(performance, 3000, seed=2)


def tracker_of(performance, clouds) -> body_tracking.Tracker:
    actor = performance.actor
    body = articulation.from_skeleton(actor.names, actor.parents, performance.joints[0])
    body, model = articulated_icp.make_model(body, clouds.positions[0], clouds.colours[0])
    skin = skinning.skin(body, model.points, model.links)
    return body_tracking.Tracker(body, skin, model.normals, model.colours)


def errors(tracker, performance, fit, frame) -> np.ndarray:
    joints = articulation.joints_of(tracker.body, *articulation.transforms(tracker.body, fit.pose))
    return np.linalg.norm(joints - performance.joints[frame][list(tracker.body.joints)], axis=1)


def test_joints_are_followed(performance, clouds):
    tracker = tracker_of(performance, clouds)
    mean = [
        errors(tracker, performance, tracker.fit(clouds.positions[f], clouds.colours[f], f), f).mean()
        for f in range(1, 14)
    ]
    assert np.mean(mean) < 0.015
    assert max(mean) < 0.04


def test_a_lost_limb_is_found_again_within_ten_frames(performance, clouds):
    tracker = tracker_of(performance, clouds)
    arm = tracker.body.names.index("LeftArm")
    tracker.fit(clouds.positions[1], clouds.colours[1], 1)
    lost = tracker.pose.rotations.copy()
    lost[arm] = articulation.exp(np.array([0.4, 0.6, 1.9])) @ lost[arm]
    tracker.pose = tracker.before = articulation.Pose(lost, tracker.pose.root)
    found = [
        errors(tracker, performance, tracker.fit(clouds.positions[f], clouds.colours[f], f), f).max()
        for f in range(2, 12)
    ]
    assert found[-1] < 0.06


def test_skin_follows_links_and_weights_sum_to_one(performance, clouds):
    tracker = tracker_of(performance, clouds)
    skin = tracker.skin
    np.testing.assert_allclose(skin.shares(len(tracker.body)).sum(axis=1), 1)
    a, b = articulation.transforms(tracker.body, articulation.Pose.canonical(len(tracker.body)))
    np.testing.assert_allclose(skin.posed(a, b), skin.points, atol=1e-12)
    assert (skin.weights < 1).any()
    assert (skin.weights >= 0.5).all()


def test_frames_that_show_nothing_leave_the_pose(performance, clouds):
    tracker = tracker_of(performance, clouds)
    before = tracker.fit(clouds.positions[1], clouds.colours[1]).pose
    for points in (np.zeros((0, 3)), np.zeros((3, 3))):
        assert tracker.fit(points).pose is before
    same = tracker.fit(np.zeros((50, 3)))  # all in one place
    assert np.isfinite(same.pose.rotations).all()


def test_tracking_is_measured_where_no_recordings_are(tmp_path, monkeypatch):
    monkeypatch.setattr(actors, "find", actors.capsules)
    results = tracking.run(tmp_path, 4)
    assert results["motions"].keys() == {"jumping jacks"}
    found = results["motions"]["jumping jacks"]["2,500 points"]
    assert found["mean_cm"] < 3
    assert found["lost_frames"] == found["longest_loss"] == 0
