"""Quaternions against matrices, and Euler angles there and back."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from mocodec import BadInput
from mocodec.geometry import rigid

ORDERS = ["".join(p) for n in (1, 2, 3) for p in permutations("xyz", n)]


def random_rotations(count: int = 50) -> np.ndarray:
    q = np.random.default_rng(5).normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def test_multiply_equals_the_matrix_product():
    a, b = random_rotations(), random_rotations()[::-1]
    assert np.allclose(rigid.to_matrix(rigid.multiply(a, b)), rigid.to_matrix(a) @ rigid.to_matrix(b))


def test_rotate_equals_the_matrix_times_the_vector():
    q, v = random_rotations(), np.random.default_rng(6).normal(size=(50, 3))
    assert np.allclose(rigid.rotate(q, v), np.einsum("nij,nj->ni", rigid.to_matrix(q), v))
    assert np.allclose(rigid.rotate(rigid.inverse(q), rigid.rotate(q, v)), v)


def test_quarter_turns():
    assert np.allclose(rigid.rotate(rigid.about_axis("z", np.array(np.pi / 2)), np.array([1.0, 0, 0])), [0, 1, 0])
    assert np.allclose(rigid.rotate(rigid.about_axis("x", np.array(np.pi / 2)), np.array([0, 1.0, 0])), [0, 0, 1])
    assert np.allclose(rigid.rotate(rigid.about_axis("y", np.array(np.pi / 2)), np.array([0, 0, 1.0])), [1, 0, 0])


@pytest.mark.parametrize("order", ORDERS)
def test_euler_angles_round_trip(order):
    angles = np.random.default_rng(7).uniform(-1.5, 1.5, (40, len(order)))
    assert np.allclose(rigid.to_euler(order, rigid.from_euler(order, angles)), angles)


@pytest.mark.parametrize("order", [o for o in ORDERS if len(o) == 3])
def test_rotations_round_trip_through_euler_angles(order):
    angles = np.random.default_rng(8).uniform(-7, 7, (100, 3))
    angles[:20, 1] = np.pi / 2 * np.sign(angles[:20, 1])  # gimbal lock
    q = rigid.from_euler(order, angles)
    again = rigid.from_euler(order, rigid.to_euler(order, q))
    assert np.allclose(rigid.to_matrix(again), rigid.to_matrix(q), atol=1e-7)


def test_slerp_turns_evenly_along_the_shorter_arc():
    a, b = rigid.about_axis("z", np.array(0.2)), -rigid.about_axis("z", np.array(1.4))
    between = rigid.slerp(a, b, np.array([0.0, 0.25, 1.0]))
    assert np.allclose(rigid.to_matrix(between), rigid.to_matrix(rigid.about_axis("z", np.array([0.2, 0.5, 1.4]))))
    assert np.allclose(rigid.slerp(a, a, np.array(0.5)), a)


def test_invalid_orders_and_axes_are_refused():
    with pytest.raises(BadInput, match="alone do not make"):
        rigid.to_euler("x", rigid.from_euler("xy", np.ones((3, 2))))
    for order in ("xyx", "abc"):
        with pytest.raises(BadInput, match="different axes"):
            rigid.to_euler(order, random_rotations())
    with pytest.raises(BadInput, match="an axis is"):
        rigid.about_axis("w", np.zeros(1))
