"""The frame that follows the body."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.tempo.pose import heading


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_axes_come_back_and_y_is_up(up: str) -> None:
    positions = np.random.default_rng(0).normal(size=(4, 5, 3))
    upright = heading.to_y_up(positions, up)
    np.testing.assert_array_equal(heading.from_y_up(upright, up), positions)
    np.testing.assert_array_equal(upright[..., 1], positions[..., "xyz".index(up)])
    assert np.linalg.det(heading.to_y_up(np.eye(3), up)) == pytest.approx(1.0)


def test_the_heading_of_a_rotated_pose_is_its_angle() -> None:
    pose = np.random.default_rng(1).normal(size=(6, 3))
    angles = np.linspace(0.0, 7.0, 50)
    rotated = heading.rotate(np.repeat(pose[None], 50, axis=0), angles)
    assert heading.heading(rotated, pose) == pytest.approx(angles)
    assert heading.align(rotated, pose) == pytest.approx(np.repeat(pose[None], 50, axis=0))
