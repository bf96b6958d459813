"""Some joints of a skeletal motion: what keeps a skeleton, and what is points alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec import Limits, Skeleton
from mocodec.geometry import kinematics
from mocodec.testing.skeletal import random_motion

NAMES = ("hips", "spine", "neck", "arm", "hand", "leg", "foot")
PARENTS = (-1, 0, 1, 1, 3, 0, 5)


def body(own_frame: bool = False):
    motion = random_motion(7, own_frame=own_frame)
    limits = Limits(("xyz",) * 7, np.tile([1.0, 0, 0, 0], (7, 1)), np.tile([-1.0, 1.0], (7, 3, 1)))
    skeleton = Skeleton(NAMES, PARENTS, motion.skeleton.offsets, limits)
    root = motion.positions[:, 0] - skeleton.offsets[0]
    positions = kinematics.forward(skeleton, motion.rotations, root, own_frame=own_frame)
    return replace(motion, positions=positions, names=NAMES, skeleton=skeleton)


@pytest.mark.parametrize("own_frame", [False, True])
@pytest.mark.parametrize(
    ("names", "parents"),
    [
        ("hips spine arm leg", (-1, 0, 1, 0)),  # leaves left out
        ("hips leg foot", (-1, 0, 1)),
        ("spine neck arm hand", (-1, 0, 0, 2)),  # a limb alone
        ("arm hand leg foot", (-1, 0, -1, 2)),  # two of them
        ("foot", (-1,)),
    ],
)
def test_a_part_that_is_a_skeleton_stays_one(own_frame, names, parents):
    motion = body(own_frame)
    part = motion.select(names.split())
    assert part.skeleton.names == part.names == tuple(names.split())
    assert part.skeleton.parents == parents
    root = np.zeros((len(part), 3))
    translations = {j: part.positions[:, j] for j, p in enumerate(parents) if p < 0}
    placed = kinematics.forward(part.skeleton, part.rotations, root, own_frame=own_frame, translations=translations)
    assert np.allclose(placed, part.positions)


@pytest.mark.parametrize("names", ["hips arm hand", "spine hips", "hips hips", "hand arm"])
def test_joints_that_are_no_skeleton_are_points(names):
    part = body().select(names.split())
    assert (part.skeleton, part.rotations) == (None, None)


def test_a_root_that_was_a_joint_has_no_limits():
    part = body().select(["spine", "neck"])
    assert np.isinf(part.skeleton.limits.ranges[0]).all()
    assert (part.skeleton.limits.ranges[1] == [-1, 1]).all()
