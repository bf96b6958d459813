"""Synthetic point clouds of people: the same for the same seed, true to their skeleton, limited by cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mocodec.geometry import kinematics
from mocodec.testing import actors, sequences


@pytest.fixture(scope="module")
def performance() -> sequences.Performance:
    return sequences.jumping_jacks(actors.capsules(), 4)


def test_the_seed_decides_the_points(performance):
    whole = sequences.record(performance, 500, keep=0.5, noise_m=0.01, seed=7)
    again = sequences.record(performance, 500, keep=0.5, noise_m=0.01, seed=7)
    other = sequences.record(performance, 500, keep=0.5, noise_m=0.01, seed=8)
    for a, b in zip(whole.positions, again.positions, strict=True):
        np.testing.assert_array_equal(a, b)
    assert len(other.positions[0]) != len(whole.positions[0]) or (other.positions[0] != whole.positions[0]).any()
    assert 150 < len(whole.positions[1]) < 350


def test_skeleton_matches_the_true_joints(performance):
    skeleton = performance.skeleton()
    assert skeleton.skeleton is not None
    assert skeleton.rotations is not None
    places = kinematics.forward(skeleton.skeleton, skeleton.rotations, skeleton.positions[:, 0])
    order = [performance.actor.names.index(name) for name in skeleton.names]
    np.testing.assert_allclose(places, performance.joints[:, order], atol=1e-9)


def test_points_lie_on_the_body(performance):
    clouds = sequences.record(performance, 2000)
    away = np.linalg.norm(clouds.positions[3][:, None] - performance.joints[3][None], axis=2).min(axis=1)
    assert away.max() < 0.35
    assert np.ptp(clouds.positions[0][:, 1]) == pytest.approx(1.75, abs=0.15)


def test_views_and_rigs_see_less(performance):
    one = sequences.record(performance, 3000, views=1)
    all_around = sequences.record(performance, 3000)
    assert np.ptp(one.positions[0][:, 2]) <= np.ptp(all_around.positions[0][:, 2]) + 0.02
    assert one.positions[0][:, 2].mean() > all_around.positions[0][:, 2].mean() + 0.02  # the side of the camera
    rig = sequences.record(performance, 3000, rig=sequences.Rig(cameras=3))
    assert len(rig.positions[0]) == 3000


def test_blur_and_dark_places_of_a_rig(performance):
    ideal = sequences.Rig(cameras=4, noise_m=0, calibration_m=0, flying=0, holes=0)
    sharp, blurred, bald = (
        sequences.record(performance, 3000, rig=rig)
        for rig in (ideal, replace(ideal, blur=0.5), replace(ideal, dark=("Head",), dark_m=0.1))
    )
    still, moving = (
        np.percentile(cKDTree(sharp.positions[frame]).query(blurred.positions[frame])[0], 99) for frame in (0, 3)
    )
    assert moving > 1.3 * still  # nothing has moved before the first frame
    head = performance.joints[3][performance.actor.names.index("Head")]
    assert np.linalg.norm(bald.positions[3] - head, axis=1).min() > 0.1
    assert np.linalg.norm(sharp.positions[3] - head, axis=1).min() < 0.1


def test_several_people_share_a_scene():
    jumper, turner = sequences.pair(actors.capsules(), 3, apart=1.2)
    clouds = sequences.record((jumper, turner), 1500, seed=4)
    assert [len(points) for points in clouds.positions] == [3000] * 3
    left = clouds.positions[0][:, 0] < 0
    assert 1300 < left.sum() < 1700
    assert jumper.joints[0, 0, 0] == pytest.approx(-0.6, abs=0.05)
    assert not np.array_equal(jumper.actor.colours, turner.actor.colours)
    hidden = sequences.record((jumper, turner), 1500, views=1)
    assert len(hidden.positions[0]) <= 3000


def test_a_moved_performance_keeps_its_pose():
    act = sequences.turning(actors.capsules(), 4)
    moved = act.moved((1.0, 0, 2.0), np.pi / 2)
    turn = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
    np.testing.assert_allclose(moved.joints, act.joints @ turn.T + [1.0, 0, 2.0], atol=1e-9)
