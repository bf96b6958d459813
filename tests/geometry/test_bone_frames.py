"""Own frames (ASF) to the usual ones and back: the same positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec import BadInput, Limits
from mocodec.geometry import bone_frames, kinematics
from mocodec.testing.skeletal import random_motion


def placed(motion, own_frame=False):
    """Positions by forward kinematics of the motion's skeleton and rotations."""
    root = motion.positions[:, 0] - motion.skeleton.offsets[0]
    return kinematics.forward(motion.skeleton, motion.rotations, root, own_frame=own_frame)


def farthest(points, among) -> float:
    """How far the farthest of `points` (frames, n, 3) is from the nearest of `among`, over all frames."""
    return float(np.abs(points[:, :, None] - among[:, None]).max(axis=(0, 3)).min(axis=1).max())


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("zeros", [0.0, 0.3])
def test_starts_of_bones_have_the_positions_of_the_ends(seed, zeros):
    motion = random_motion(1 + 3 * seed, seed=seed, own_frame=True, zeros=zeros)
    usual = bone_frames.to_starts(motion)
    assert np.abs(placed(usual) - usual.positions).max() < 1e-9
    assert farthest(motion.positions, usual.positions) < 1e-9
    assert set(motion.names) <= set(usual.names)
    assert len(set(usual.names)) == len(usual.names)
    assert usual.source.get("format") != "amc"


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("zeros", [0.0, 0.3])
def test_any_skeleton_has_bones(seed, zeros):
    motion = random_motion(2 + 3 * seed, seed=seed, zeros=zeros)
    own = bone_frames.to_ends(motion)
    assert np.abs(placed(own, own_frame=True) - own.positions).max() < 1e-9
    assert farthest(motion.positions, own.positions) < 1e-9
    again = bone_frames.to_starts(own)
    assert farthest(motion.positions, again.positions) < 1e-9


def test_there_and_back_is_the_same_skeleton():
    motion = random_motion(12, seed=3, own_frame=True)
    again = bone_frames.to_ends(bone_frames.to_starts(motion))
    columns = [again.names.index(name) for name in motion.names]
    assert again.points == motion.points
    assert np.abs(again.positions[:, columns] - motion.positions).max() < 1e-9
    assert np.abs(again.skeleton.offsets[columns] - motion.skeleton.offsets).max() < 1e-12
    assert np.abs(np.abs(np.sum(again.rotations[:, columns] * motion.rotations, axis=2)) - 1).max() < 1e-12


def test_limits_follow_their_bones():
    motion = random_motion(5, seed=2, own_frame=True)
    ranges = np.tile([-1.0, 1.0], (5, 3, 1)) * np.arange(1, 6)[:, None, None]
    limits = Limits(("xyz",) * 5, np.tile([1.0, 0, 0, 0], (5, 1)), ranges)
    usual = bone_frames.to_starts(replace(motion, skeleton=replace(motion.skeleton, limits=limits)))
    found = usual.skeleton.limits.ranges
    for joint, name in enumerate(usual.names):
        expected = np.zeros((3, 2)) if name.endswith("_end") else ranges[motion.names.index(name)]
        assert np.array_equal(found[joint], expected)


def test_what_has_no_bones_is_refused():
    motion = random_motion(6)
    with pytest.raises(BadInput, match="no skeleton and rotations"):
        bone_frames.to_ends(replace(motion, rotations=None))
    two = replace(motion.skeleton, parents=(-1, 0, 1, -1, 3, 4))
    with pytest.raises(BadInput, match="one root, this skeleton has 2: j0, j3"):
        bone_frames.to_ends(replace(motion, skeleton=two))
    sliding = motion.positions.copy()
    sliding[:, -1, 0] += np.linspace(0, 0.1, len(motion))
    with pytest.raises(BadInput, match="joint j5 moves against its parent"):
        bone_frames.to_ends(replace(motion, positions=sliding))
    assert bone_frames.to_starts(motion) is motion
