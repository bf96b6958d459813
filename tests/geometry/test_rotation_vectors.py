"""Rotation vectors come back with their branch, also after small errors of the rotations."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.geometry import rigid, rotation_vectors


def random_vectors(longest: float, frames: int = 300, joints: int = 4) -> np.ndarray:
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(frames, joints, 3))
    return vectors * rng.uniform(0, longest, (frames, joints, 1)) / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_quaternions_of_known_vectors() -> None:
    quarter = rotation_vectors.to_quaternions(np.array([[0, 0, np.pi / 2], [0, 0, 0], [3 * np.pi / 2, 0, 0]]))
    root = np.sqrt(0.5)
    np.testing.assert_allclose(quarter, [[root, 0, 0, root], [1, 0, 0, 0], [-root, root, 0, 0]], atol=1e-15)
    turned = rigid.rotate(quarter[0], np.array([1.0, 0, 0]))
    np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("longest", [0, 1e-9, 1, 3, np.pi, 6.2, 30])
def test_every_branch_comes_back_whatever_the_sign_of_the_quaternions(longest: float) -> None:
    vectors = random_vectors(longest)
    codes = rotation_vectors.branches(vectors)
    signs = np.random.default_rng(1).choice([-1.0, 1.0], (*vectors.shape[:2], 1))
    again = rotation_vectors.with_branches(signs * rotation_vectors.to_quaternions(vectors), codes)
    np.testing.assert_allclose(again, vectors, atol=1e-13)


def test_errors_of_the_rotations_do_not_change_the_branch() -> None:
    frames = 2000  # three turns about a tilting axis, wrapped to less than a full turn as many tools do
    angle = np.linspace(0.3, 19, frames) % (2 * np.pi)
    angle = np.clip(angle, 0.3, 2 * np.pi - 0.3)
    axis = np.stack([np.sin(np.arange(frames) / 300), np.cos(np.arange(frames) / 300), np.full(frames, 0.3)], axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    vectors = (angle[:, None] * axis)[:, None]
    codes = rotation_vectors.branches(vectors)
    assert codes is not None
    assert codes.dtype == np.int8
    assert (np.diff(codes[:, 0]) != 0).sum() < 20  # long runs, which cost next to nothing
    noise = np.radians(3) * np.random.default_rng(0).normal(size=vectors.shape)
    noisy = rigid.multiply(rotation_vectors.to_quaternions(vectors), rotation_vectors.to_quaternions(noise))
    again = rotation_vectors.with_branches(-noisy, codes)
    alike = rotation_vectors.to_quaternions(again) * rotation_vectors.to_quaternions(vectors)
    assert alike.sum(axis=-1).min() > 0.95  # the same sign everywhere: near a full turn, vectors differ more than this


def test_short_vectors_need_no_branch() -> None:
    assert rotation_vectors.branches(random_vectors(2.0)) is None
