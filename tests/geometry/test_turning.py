"""Another vertical axis: the same motion, turned with its skeleton."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from mocodec import BadInput, Limits
from mocodec.geometry import kinematics, rigid
from mocodec.testing.skeletal import random_motion


@pytest.mark.parametrize(("old", "new"), list(permutations("xyz", 2)))
@pytest.mark.parametrize("own_frame", [False, True])
def test_the_motion_turns_with_its_skeleton(old, new, own_frame):
    motion = replace(random_motion(7, own_frame=own_frame), up=old)
    again = motion.turned(new)
    assert again.up == new
    assert np.allclose(again.positions[..., "xyz".index(new)], motion.positions[..., "xyz".index(old)])
    root = again.positions[:, 0] - again.skeleton.offsets[0]
    assert np.allclose(kinematics.forward(again.skeleton, again.rotations, root, own_frame=own_frame), again.positions)
    there_and_back = again.turned(old)
    assert np.allclose(there_and_back.positions, motion.positions)
    assert np.allclose(there_and_back.rotations, motion.rotations)
    distances = np.linalg.norm(np.diff(motion.positions, axis=1), axis=2)
    assert np.allclose(np.linalg.norm(np.diff(again.positions, axis=1), axis=2), distances)
    third = next(axis for axis in "xyz" if axis not in (old, new))
    assert np.allclose(again.positions[..., "xyz".index(third)], motion.positions[..., "xyz".index(third)])


def test_limits_turn_too():
    motion = random_motion(3)
    limits = Limits(("zyx",) * 3, np.tile([1.0, 0, 0, 0], (3, 1)), np.tile([-1.0, 1.0], (3, 3, 1)))
    motion = replace(motion, skeleton=replace(motion.skeleton, limits=limits))
    turned = motion.turned("z").skeleton.limits
    hinge = rigid.about_axis("x", np.array(0.4))
    frame = turned.axes[1]
    assert np.allclose(
        rigid.multiply(rigid.multiply(frame, hinge), rigid.inverse(frame)),
        replace(motion, rotations=np.broadcast_to(hinge, (24, 3, 4))).turned("z").rotations[0, 1],
    )


def test_gaps_points_and_wrong_axes():
    motion = random_motion(3)
    positions = motion.positions.copy()
    positions[2, 1] = np.nan
    points = replace(motion, positions=positions, skeleton=None, rotations=None)
    assert np.array_equal(points.turned("z").gaps, points.gaps)
    assert points.turned("y") is points
    with pytest.raises(BadInput, match="up is one of"):
        points.turned("w")
