"""Motions at other rates: between the samples, never across gaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec import BadInput, Motion, Signal
from mocodec.geometry import kinematics, rigid
from mocodec.testing.skeletal import random_motion


def curve(rate: float, seconds: float = 2.0, points: int = 3) -> Motion:
    t = np.arange(round(seconds * rate) + 1) / rate
    p = np.arange(points)
    return Motion(
        np.stack([np.sin(3 * t[:, None] + p), t[:, None] * (p + 1), np.cos(2 * t[:, None] - p)], axis=2), rate
    )


@pytest.mark.parametrize("rate", [30.0, 48.0, 100.0, 240.0, 120000 / 1001])
def test_positions_follow_the_curve(rate):
    motion = curve(120.0).resample(rate)
    assert motion.rate == rate
    assert len(motion) == int(2.0 * rate + 1e-9) + 1
    t = np.arange(len(motion)) / rate
    assert np.abs(motion.positions[:, 0, 0] - np.sin(3 * t)).max() < 1e-6


def test_samples_at_the_same_times_are_the_same():
    motion = curve(120.0)
    assert np.array_equal(motion.resample(30.0).positions, motion.positions[::4])
    assert np.array_equal(motion.resample(240.0).positions[::2], motion.positions)
    assert motion.resample(120.0) is motion
    skeletal = random_motion()
    assert np.allclose(skeletal.resample(40.0).positions, skeletal.positions[::3], atol=1e-12)
    assert np.array_equal(skeletal.resample(40.0).rotations, skeletal.rotations[::3])


def test_gaps_stay_gaps_and_nothing_crosses_them():
    motion = curve(100.0)
    positions = motion.positions.copy()
    positions[50:60, 1] = np.nan
    positions[70, 1] = np.nan
    positions[72:, 1] = np.nan  # one sample alone at 71
    positions[60:70, 1, 0] = 100.0  # far off: must not be felt on the other side
    motion = replace(motion, positions=positions)
    again = motion.resample(250.0)
    t = np.arange(len(again)) / 2.5
    before, after = np.floor(t + 1e-9).astype(int), np.ceil(t - 1e-9).astype(int)
    assert np.array_equal(again.gaps[:, 1], motion.gaps[before, 1] | motion.gaps[after, 1])
    assert not again.gaps[:, 0].any()
    assert np.abs(again.positions[:120, 1, 0] - np.sin(3 * t[:120] / 100 + 1)).max() < 1e-5
    assert np.nanmax(np.abs(again.positions[150:175, 1, 0] - 100)) < 1e-9


@pytest.mark.parametrize("own_frame", [False, True])
def test_bones_keep_their_length(own_frame):
    motion = random_motion(9, 60, own_frame=own_frame)
    again = motion.resample(77.0)
    root = again.positions[:, 0] - motion.skeleton.offsets[0]
    assert np.allclose(kinematics.forward(motion.skeleton, again.rotations, root, own_frame=own_frame), again.positions)
    assert np.allclose(np.linalg.norm(again.rotations, axis=2), 1)
    fine = random_motion(9, 60, own_frame=own_frame).resample(480.0)
    assert np.abs(fine.positions[::4] - motion.positions).max() < 1e-9


def test_rotations_turn_evenly_whatever_their_signs():
    motion = random_motion(1, 2)
    rotations = np.stack([rigid.about_axis("x", np.array([[0.2]])), -rigid.about_axis("x", np.array([[0.6]]))])[:, 0]
    again = replace(motion, rotations=rotations).resample(480.0)
    expected = rigid.about_axis("x", np.array([[0.2], [0.3], [0.4], [0.5], [0.6]]))
    assert np.allclose(rigid.to_matrix(again.rotations), rigid.to_matrix(expected))


def test_a_joint_that_slides_keeps_sliding():
    motion = random_motion(5, 60)
    positions = motion.positions.copy()
    t = np.arange(60) / 120
    positions[:, 4] += np.stack([0.1 * np.sin(5 * t)] * 3, axis=1)
    again = replace(motion, positions=positions).resample(480.0)
    assert np.abs(again.positions[::4] - positions).max() < 1e-9


def test_gaps_of_a_skeletal_motion():
    motion = random_motion(5, 40)
    positions = motion.positions.copy()
    positions[10:20] = np.nan
    again = replace(motion, positions=positions).resample(240.0)
    assert again.gaps[20:38].all()
    assert not again.gaps[:19].any()
    assert not again.gaps[40:].any()


def test_events_and_signals_keep_their_times_and_frames_their_start():
    analog = Signal(np.arange(2410), 1200.0)
    marks = Signal(np.arange(241), 120.0)
    extras = {"analog": analog, "events": [{"label": "a", "time_s": 0.5}], "zero_samples": marks}
    motion = replace(curve(120.0), extras=extras, source={"format": "c3d", "first_frame": 61})
    again = motion.resample(30.0)
    assert again.extras["analog"] is analog
    assert again.extras["events"] == extras["events"]
    assert (again.extras["zero_samples"].values == np.arange(0, 241, 4)).all()
    assert again.extras["zero_samples"].rate == 30.0
    assert again.source == {"format": "c3d", "time_of_frame_1": 0.5}


def test_few_frames_and_wrong_rates():
    one = curve(120.0)[:1].resample(7.0)
    assert (len(one), one.rate) == (1, 7.0)
    assert len(curve(120.0)[:0].resample(60.0)) == 0
    assert np.allclose(curve(120.0)[:2].resample(240.0).positions[1], curve(120.0).positions[:2].mean(axis=0))
    assert len(random_motion()[:1].resample(60.0)) == 1
    for rate in (0.0, -1.0, np.inf, np.nan, 1e13):
        with pytest.raises(BadInput, match=r"Hz|hertz"):
            curve(120.0).resample(rate)
