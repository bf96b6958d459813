"""Pose streams: spectra of a run of frames, single poses, swing and twist."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.bodycast import pose_stream, swing_twist
from mocodec.geometry import articulation, skinning
from mocodec.geometry.articulation import Body, Pose


@pytest.fixture
def arm() -> tuple[Body, skinning.Skin]:
    """Three links in a row, with points around them."""
    origins = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.8, 0, 0]])
    tips = np.array([[0.5, 0, 0], [0.8, 0, 0], [0.9, 0, 0]])
    body = Body(("root", "arm", "hand"), (-1, 0, 1), origins, tips, np.full(3, 0.05))
    rng = np.random.default_rng(2)
    points = rng.uniform([0, -0.05, -0.05], [0.9, 0.05, 0.05], (900, 3))
    links = np.searchsorted([0.5, 0.8], points[:, 0])
    return body, skinning.skin(body, points, links)


def swinging(frames: int, noise: float = 0.0) -> pose_stream.PoseSequence:
    time = np.arange(frames) / 15
    rng = np.random.default_rng(3)
    turns = np.stack([np.sin(time * k)[:, None] * [0.3 * k, 0.8, 0.2] for k in (1, 2, 3)], axis=1)
    turns[:, 0, 1] += 2.5 * time  # more than a full turn
    turns += noise * rng.normal(size=turns.shape)
    return pose_stream.PoseSequence(articulation.exp(turns), np.stack([time, 0 * time, np.cos(time)], axis=1))


@pytest.mark.parametrize("frames", [1, 2, 3, 90])
def test_decoded_poses_are_within_their_step(arm, frames):
    body, skin = arm
    sequence, before = swinging(frames), None
    skin_matrix = skinning.SkinMatrix.build(skin, len(body))
    truth = skin_matrix.posed(*sequence.transforms(body))
    for step in (0.02, 0.005, 0.001):
        steps = pose_stream.PoseSteps.for_skin(body, skin, step)
        data = pose_stream.pack_poses(body, sequence, steps)
        back = skin_matrix.posed(*pose_stream.unpack_poses(body, data, frames, steps).transforms(body))
        off = float(np.sqrt(((back - truth) ** 2).sum(axis=2).mean()))
        assert off < 2.5 * step
        assert before is None or frames < 3 or off < before
        before = off
    assert frames < 90 or len(data) < 12 * frames


def test_swing_and_twist_are_continuous(arm):
    body, _ = arm
    time = np.arange(200) / 15
    for most in (1.0, 3.0, 9.0):  # radians: far from half a turn, near it, and beyond
        swings = np.stack([most * np.sin(time), 0.3 * np.cos(time), 0 * time], axis=1)
        axes = swing_twist.link_frames(body)[1]
        values = swing_twist.to_swing_twist(swing_twist.from_swing_twist(swings, axes), axes)
        assert np.abs(np.diff(values, axis=0)).max() < 0.12 * most + 0.1
        np.testing.assert_allclose(
            swing_twist.from_swing_twist(values, axes), swing_twist.from_swing_twist(swings, axes), atol=1e-9
        )


def test_pose_steps_round_trip(arm):
    body, skin = arm
    steps = pose_stream.PoseSteps.for_skin(body, skin, 0.0030072)
    back, at = pose_stream.PoseSteps.unpack(body, b"xx" + steps.pack(), 2)
    assert at == 2 + len(steps.pack())
    np.testing.assert_allclose(back.step_sizes(), steps.step_sizes())
    sizes = steps.step_sizes()[3:].reshape(3, 3)
    assert (sizes[0] < sizes[2]).any()  # larger levers have smaller steps


def test_single_poses_round_trip(arm):
    body, skin = arm
    steps = pose_stream.PoseSteps.for_skin(body, skin, 0.004)
    sequence, previous = swinging(60), np.zeros(3 + 9, np.int64)
    jumps = list[int]()
    for frame in range(60):
        integers = pose_stream.quantise_pose(body, sequence[frame], steps, previous)
        back = pose_stream.dequantise_pose(body, integers, steps)
        a, b = articulation.transforms(body, sequence[frame])
        c, d = articulation.transforms(body, back)
        assert np.linalg.norm(skin.posed(a, b) - skin.posed(c, d), axis=1).mean() < 0.012
        jumps.append(int(np.abs(integers - previous).max()) if frame else 0)
        previous = integers
    assert max(jumps) < 400  # angles continue past half a turn


def test_a_skin_matrix_poses_like_its_skin(arm):
    body, skin = arm
    sequence = swinging(4)
    a, b = sequence.transforms(body)
    skin_matrix = skinning.SkinMatrix.build(skin, len(body))
    both = skin_matrix.posed(a, b)
    for frame in range(4):
        np.testing.assert_allclose(both[frame], skin.posed(a[frame], b[frame]), atol=1e-12)
    moved = skin.points + 0.01
    np.testing.assert_allclose(
        skin_matrix.with_points(moved).posed(a[1], b[1]),
        skinning.Skin(moved, skin.links, skin.weights).posed(a[1], b[1]),
    )
    assert isinstance(sequence[0], Pose)
