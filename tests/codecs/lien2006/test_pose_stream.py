"""Poses of lien2006 as integers: full turns, and the frames that decide them."""

from __future__ import annotations

import numpy as np

from mocodec.codecs.lien2006 import pose_stream
from mocodec.geometry import articulation
from mocodec.testing import actors


def turning(frames: int, step: float) -> tuple[articulation.Body, articulation.Pose]:
    """A body whose arm turns on and on by `step` radians a frame, and whose other links rock."""
    actor = actors.capsules()
    body = articulation.from_skeleton(actor.names, actor.parents, actor.joints)
    vectors = 0.3 * np.sin(np.arange(frames)[:, None, None] / 5 + np.arange(3)) * np.ones((1, len(body), 1))
    vectors[:, body.names.index("LeftArm")] = step * np.arange(frames)[:, None] * [0.6, 0.0, 0.8]
    return body, articulation.Pose(articulation.exp(vectors), np.zeros((frames, 3)))


def test_turns_add_up_over_frames():
    body, poses = turning(40, 0.3)
    integers = pose_stream.quantise(body, poses)
    arm = body.names.index("LeftArm")
    vectors = integers[:, 3 + 3 * arm : 6 + 3 * arm] * pose_stream.joint_steps(body)[arm]
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 0.3 * np.arange(40), atol=0.02)
    for frame in (0, 11, 39):
        decoded = pose_stream.dequantise(body, integers[frame])
        np.testing.assert_allclose(decoded.rotations, poses.rotations[frame], atol=0.02)


def test_each_frame_follows_from_those_before():
    body, poses = turning(30, 0.4)
    integers = pose_stream.quantise(body, poses)
    some = articulation.Pose(poses.rotations[:13], poses.root[:13])
    np.testing.assert_array_equal(pose_stream.quantise(body, some), integers[:13])
