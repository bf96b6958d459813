"""Tracking of all joints: accuracy, growth of sparse templates, and re-acquisition of limbs and bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec.codecs import bodycast
from mocodec.geometry import articulated_icp, articulation, body_tracking, limb_chains, skinning
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences


@pytest.fixture(scope="module")
def performance() -> sequences.Performance:
    return sequences.jumping_jacks(actors.capsules(), 14)


@pytest.fixture(scope="module")
def clouds(performance) -> PointClouds:
    return sequences.record(performance, 3000, seed=2)


def tracker_of(performance, clouds) -> body_tracking.BodyTracker:
    actor = performance.actor
    body = articulation.from_skeleton(actor.names, actor.parents, performance.joints[0])
    colours = None if clouds.colours is None else clouds.colours[0]
    body, model = articulated_icp.make_model(body, clouds.positions[0], colours)
    skin = skinning.skin(body, model.points, model.links)
    return body_tracking.BodyTracker(body, skin, model.normals, model.colours)


def errors(tracker, performance, fit, frame) -> np.ndarray:
    return performance.joint_errors(tracker.body, fit.pose, frame)


def test_joints_are_tracked(performance, clouds):
    tracker = tracker_of(performance, clouds)
    mean = [
        errors(tracker, performance, tracker.fit(clouds.positions[f], clouds.colours[f], f), f).mean()
        for f in range(1, 14)
    ]
    assert np.mean(mean) < 0.015
    assert max(mean) < 0.04


def test_a_lost_limb_is_reacquired_within_ten_frames(performance, clouds):
    tracker = tracker_of(performance, clouds)
    arm = tracker.body.names.index("LeftArm")
    tracker.fit(clouds.positions[1], clouds.colours[1], 1)
    lost = tracker.pose.rotations.copy()
    lost[arm] = articulation.exp(np.array([0.4, 0.6, 1.9])) @ lost[arm]
    tracker.pose = tracker.previous_pose = articulation.Pose(lost, tracker.pose.root)
    found = [
        errors(tracker, performance, tracker.fit(clouds.positions[f], clouds.colours[f], f), f).max()
        for f in range(2, 12)
    ]
    assert found[-1] < 0.06


def test_a_sparse_template_grows(performance):
    """600 points a frame are tracked more accurately once the template has growing by those of several frames."""
    sparse = sequences.record(performance, 600, seed=3)
    trackers = [
        bodycast.start_tracking(sparse.positions[0], sparse.colours[0], performance.skeleton()[:1], "y", 2500)[1]
        for _ in range(2)
    ]
    growing, fixed = trackers
    fixed.is_sparse = False
    errors_m = np.zeros((2, 14))
    for frame in range(1, 14):
        for number, tracker in enumerate(trackers):
            fit = tracker.fit(sparse.positions[frame], sparse.colours[frame], frame)
            errors_m[number, frame] = errors(tracker, performance, fit, frame).mean()
    assert len(fixed.skin.points) <= 600
    assert len(growing.skin.points) > 1200
    assert len(growing.colours) == len(growing.normals) == len(growing.skin.points)
    assert errors_m[0, 6:].mean() < errors_m[1, 6:].mean()


def test_a_template_without_colours_grows_too(performance):
    sparse = sequences.record(performance, 300, seed=4)
    tracker = tracker_of(performance, replace(sparse, colours=None))
    for frame in range(1, 8):
        tracker.fit(sparse.positions[frame], sparse.colours[frame] if frame == 3 else None, frame)
    assert tracker.colours is None
    assert len(tracker.skin.points) > 300


def test_skin_follows_links_and_weights_sum_to_one(performance, clouds):
    tracker = tracker_of(performance, clouds)
    skin = tracker.skin
    np.testing.assert_allclose(skin.shares(len(tracker.body)).sum(axis=1), 1)
    a, b = articulation.transforms(tracker.body, articulation.Pose.canonical(len(tracker.body)))
    np.testing.assert_allclose(skin.posed(a, b), skin.points, atol=1e-12)
    assert (skin.weights < 1).any()
    assert (skin.weights >= 0.5).all()


def test_frames_without_points_leave_the_pose(performance, clouds):
    tracker = tracker_of(performance, clouds)
    before = tracker.fit(clouds.positions[1], clouds.colours[1]).pose
    for points in (np.zeros((0, 3)), np.zeros((3, 3))):
        assert tracker.fit(points).pose is before
    same = tracker.fit(np.zeros((50, 3)))  # all at one place
    assert np.isfinite(same.pose.rotations).all()


@pytest.mark.parametrize("limb", ["LeftArm", "RightArm", "LeftUpLeg", "RightUpLeg"])
def test_any_lost_limb_is_reacquired_within_ten_frames(performance, clouds, limb):
    tracker = tracker_of(performance, clouds)
    tracker.fit(clouds.positions[1], clouds.colours[1], 1)
    lost = tracker.pose.rotations.copy()
    link = tracker.body.names.index(limb)
    lost[link] = articulation.exp(np.array([-1.2, 0.3, 0.7])) @ lost[link]
    lost[link + 1] = articulation.exp(np.array([0.9, 0.9, -0.9])) @ lost[link + 1]
    tracker.pose = tracker.previous_pose = articulation.Pose(lost, tracker.pose.root)
    found = [
        errors(tracker, performance, tracker.fit(clouds.positions[f], clouds.colours[f], f), f).max()
        for f in range(2, 12)
    ]
    assert found[-1] < 0.06


def test_a_body_that_returns_elsewhere_is_reacquired(performance, clouds):
    tracker = tracker_of(performance, clouds)
    turn, shift = articulation.exp(np.array([0, 1.6, 0])), np.array([1.4, 0.0, -0.8])
    for f in (1, 2):
        tracker.fit(clouds.positions[f], clouds.colours[f], f)
    for f in range(3, 6):
        tracker.fit(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), f)
    for f in range(6, 12):
        fit = tracker.fit(clouds.positions[f] @ turn.T + shift, clouds.colours[f], f)
    joints = articulation.joint_positions(tracker.body, *articulation.transforms(tracker.body, fit.pose))
    true = performance.joints[11][list(tracker.body.joints)] @ turn.T + shift
    assert np.linalg.norm(joints - true, axis=1).max() < 0.06


def test_frames_of_unrelated_points_leave_the_pose(performance, clouds):
    tracker = tracker_of(performance, clouds)
    before = tracker.fit(clouds.positions[1], clouds.colours[1], 1).pose
    rng = np.random.default_rng(0)
    unrelated = rng.uniform(-2, 2, (300, 3)), rng.integers(0, 255, (300, 3)).astype(np.uint8)
    assert tracker.fit(*unrelated, 2).pose is before
    fit = tracker.fit(clouds.positions[2], clouds.colours[2], 3)
    assert errors(tracker, performance, fit, 2).max() < 0.06


def test_points_that_are_not_finite_are_ignored(performance, clouds):
    tracker = tracker_of(performance, clouds)
    points = clouds.positions[1].copy()
    points[::7] = np.nan
    points[5] = np.inf
    fit = tracker.fit(points, clouds.colours[1], 1)
    assert errors(tracker, performance, fit, 1).max() < 0.05
    assert tracker.fit(np.full((50, 3), np.nan), None, 2).pose is fit.pose


def test_a_body_is_tracked_without_colours(performance, clouds):
    tracker = tracker_of(performance, PointClouds(clouds.positions, clouds.rate, None, None, clouds.up))
    worst = [errors(tracker, performance, tracker.fit(clouds.positions[f], None, f), f).max() for f in range(1, 14)]
    assert max(worst) < 0.12
    assert np.median(worst) < 0.05


def test_confused_legs_are_swapped(performance, clouds):
    tracker = tracker_of(performance, clouds)
    tracker.fit(clouds.positions[1], clouds.colours[1], 1)
    assert len(tracker.limb_pairs) == 2  # arms and legs
    legs = max(tracker.limb_pairs, key=lambda pair: "Leg" in tracker.body.names[tracker.limbs[pair[0]].links[0]])
    tracker.pose = tracker.previous_pose = limb_chains.swapped(
        tracker.body, tracker.pose, *(tracker.limbs[i] for i in legs)
    )
    for f in range(2, 8):
        fit = tracker.fit(clouds.positions[f], clouds.colours[f], f)
    assert errors(tracker, performance, fit, 7).max() < 0.06


def test_reaching_limbs_touch_their_targets(performance, clouds):
    tracker = tracker_of(performance, clouds)
    limb = next(limb for limb in tracker.limbs if tracker.body.names[limb.links[0]] == "LeftArm")
    a, b = articulation.transforms(tracker.body, tracker.pose)
    (upper, bend), (lower, end) = limb_chains.bend_and_end(tracker.body, limb)
    start = a[upper] @ tracker.body.origins[upper] + b[upper]
    rng = np.random.default_rng(4)
    targets = start + rng.normal(size=(20, 3)) * 0.15
    shares, sides = rng.uniform(0.5, 1.3, 20), rng.normal(size=(20, 3))
    rotations = limb_chains.reaching(tracker.body, limb, tracker.pose, targets, shares, sides)
    length = np.linalg.norm(end - bend)
    for target, turned in zip(targets, rotations, strict=True):
        whole = tracker.pose.rotations.copy()
        whole[limb.links] = turned
        a, b = articulation.transforms(tracker.body, articulation.Pose(whole, tracker.pose.root))
        elbow, wrist = a[upper] @ bend + b[upper], a[lower] @ end + b[lower]
        along = np.clip((target - elbow) @ (wrist - elbow) / length**2, 0.5, 1.3)
        assert np.linalg.norm(elbow + along * (wrist - elbow) - target) < 0.01 or np.linalg.norm(target - start) < 0.1


def test_a_fast_turn_is_found_without_a_search_for_the_body(performance, clouds):
    tracker = tracker_of(performance, clouds)
    data = tracker.sample_frame(clouds.positions[1], clouds.colours[1], 0)
    good = tracker.solve(data, tracker.pose)
    again = tracker._reacquire_body(data, good, np.inf)
    assert again.cost <= good.cost
    turned = articulation.exp(np.array([0, 2.4, 0])) @ tracker.pose.rotations[0]
    away = tracker.pose.rotations.copy()
    away[0] = turned
    lost = tracker.solve(data, articulation.Pose(away, tracker.pose.root))
    found = tracker._reacquire_body(data, lost, 1.2 * good.cost)
    assert found.cost < 1.2 * good.cost


def test_typical_cost_is_calibrated_from_the_first_frame(performance):
    clouds = sequences.record(performance, 8000, seed=2)
    assert clouds.colours is not None
    first = slice(0, 3000), slice(3000, None)
    some, others = (PointClouds([clouds.positions[0][s]], 15.0, [clouds.colours[0][s]]) for s in first)
    tracker = tracker_of(performance, some)
    tracker.calibrate_cost(others.positions[0], others.colours[0])
    expected = tracker.typical_cost
    fit = tracker.fit(clouds.positions[1], clouds.colours[1], 1)
    assert 0.5 < fit.cost / expected < 2


def test_searches_in_vain_become_rarer(performance, clouds, monkeypatch):
    tracker = tracker_of(performance, clouds)
    fit = tracker.assess_frame(clouds.positions[1], clouds.colours[1])
    fit = replace(fit, residuals=np.ones_like(fit.residuals), gaps=np.zeros_like(fit.gaps))
    tracker.typical_cost = fit.cost / 2
    searches = list[int]()
    monkeypatch.setattr(tracker, "_swap_confused_limbs", lambda data, few, best, is_suspicious: best)

    def fail(data, few, best, limb, seed):
        searches.append(seed)
        return best

    monkeypatch.setattr(tracker, "_best_of_limb_poses", fail)
    for frame in range(20):
        assert tracker._reacquire_limbs(fit.data, fit, frame) is fit
    waits = np.diff(np.unique(searches))
    assert waits[0] == 2
    assert (waits[1:] == 3).all()
