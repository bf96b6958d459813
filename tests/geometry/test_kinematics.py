"""Forward kinematics against explicit matrix products."""

from __future__ import annotations

import numpy as np

from mocodec import Skeleton
from mocodec.geometry import kinematics, rigid

OFFSETS = np.array([[0, 1.5, 0], [0.3, 0, 0], [0.25, 0, 0], [0.2, 0.05, 0]])
ARM = Skeleton(("shoulder", "elbow", "hand", "thumb"), (-1, 0, 1, 1), OFFSETS)


def random_rotations(frames: int = 6) -> np.ndarray:
    return rigid.from_euler("zyx", np.random.default_rng(1).uniform(-3, 3, (frames, 4, 3)))


def test_joints_follow_their_parents():
    q, root = random_rotations(), np.arange(18.0).reshape(6, 3)
    found = kinematics.forward(ARM, q, root)
    m = rigid.to_matrix(q)
    elbow = root + ARM.offsets[0] + m[:, 0] @ ARM.offsets[1]
    assert np.allclose(found[:, 0], root + ARM.offsets[0])
    assert np.allclose(found[:, 1], elbow)
    assert np.allclose(found[:, 3], elbow + m[:, 0] @ m[:, 1] @ ARM.offsets[3])


def test_own_frame_rotates_the_own_offset():
    q = random_rotations()
    found = kinematics.forward(ARM, q, np.zeros((6, 3)), own_frame=True)
    m = rigid.to_matrix(q)
    assert np.allclose(found[:, 1] - found[:, 0], m[:, 0] @ m[:, 1] @ ARM.offsets[1])


def test_translations_replace_offsets():
    slide = np.random.default_rng(2).normal(size=(6, 3))
    q = random_rotations()
    found = kinematics.forward(ARM, q, np.zeros((6, 3)), translations={2: slide})
    world = kinematics.world_rotations(ARM, q)
    assert np.allclose(found[:, 2] - found[:, 1], rigid.rotate(world[:, 1], slide))


def test_bones_keep_their_length_also_without_frames():
    found = kinematics.forward(ARM, random_rotations(), np.zeros((6, 3)))
    assert np.allclose(np.linalg.norm(found[:, 2] - found[:, 1], axis=1), 0.25)
    assert kinematics.forward(ARM, random_rotations(0), np.zeros((0, 3))).shape == (0, 4, 3)
