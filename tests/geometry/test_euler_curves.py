"""Euler angles over time: continuous, also at gimbal lock, and nearest where some are given."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from mocodec import BadInput
from mocodec.geometry import euler_curves, rigid

ORDERS = ["".join(order) for order in permutations("xyz")]


def same(a: np.ndarray, b: np.ndarray, tolerance: float = 1e-7) -> bool:
    """Whether quaternions are the same rotations."""
    return bool(np.abs(np.abs(np.sum(a * b, axis=-1)) - 1).max() < tolerance)


@pytest.mark.parametrize("order", ORDERS)
def test_continuous_angles_round_trip(order):
    angles = np.cumsum(np.random.default_rng(9).normal(0.02, 0.1, (300, 3)), axis=0)
    assert np.abs(angles).max() > np.pi
    assert np.allclose(euler_curves.along_time(order, rigid.from_euler(order, angles)), angles, atol=1e-6)


def test_angles_begin_near_those_that_are_given():
    angles = np.array([3.0, 2.5, -9.0]) + np.cumsum(np.random.default_rng(1).normal(0, 0.1, (50, 3)), axis=0)
    q = rigid.from_euler("zxy", angles)
    assert np.allclose(euler_curves.along_time("zxy", q, near=np.array([3.1, 2.0, -9.2])), angles, atol=1e-6)
    assert np.abs(euler_curves.along_time("zxy", q)[0]).max() < np.pi
    one = euler_curves.along_time("y", rigid.from_euler("y", angles[:, :1]), near=np.array([3.0]))
    assert np.allclose(one, angles[:, :1], atol=1e-6)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("side", [1, -1])
def test_gimbal_lock_makes_no_jump(order, side):
    t = np.linspace(0, 1, 60)
    middle = side * np.where((t > 0.3) & (t < 0.6), np.pi / 2, np.pi / 2 - 0.3)
    angles = np.stack([0.4 + t, middle, 0.8 - 0.2 * t], axis=1)
    q = rigid.from_euler(order, angles)
    curves = euler_curves.along_time(order, q)
    assert same(rigid.from_euler(order, curves), q)
    steps = np.abs(np.diff(curves, axis=0))[:, [0, 2]]
    assert steps.max() < 0.15
    still = euler_curves.along_time(order, np.repeat(q[30:31], 5, axis=0), near=np.array([0.0, 1.5 * side, 0.7]))
    assert np.allclose(still[:, 2], 0.7)
    assert same(rigid.from_euler(order, still), q[30])


def test_the_middle_angle_passes_a_quarter_turn():
    angles = np.stack([0.1 * np.ones(80), np.linspace(0.9, 2.3, 80), 0.2 * np.ones(80)], axis=1)
    assert np.allclose(euler_curves.along_time("xyz", rigid.from_euler("xyz", angles)), angles, atol=1e-6)


@pytest.mark.parametrize("order", ["x", "y", "xy", "zy", "xz"])
def test_fewer_axes_are_exact_where_they_suffice_and_nearest_elsewhere(order):
    rng = np.random.default_rng(3)
    angles = rng.uniform(-3, 3, (50, len(order)))
    q = rigid.from_euler(order, angles)
    assert np.allclose(euler_curves.nearest(order, q), angles)
    off = rigid.from_euler("xyz", rng.normal(0, 0.1, (50, 3)))
    mixed = rigid.multiply(q, off)
    found = euler_curves.nearest(order, mixed)
    best = euler_curves.distance(order, found, mixed)
    for _ in range(20):
        assert (euler_curves.distance(order, found + rng.normal(0, 0.05, found.shape), mixed) >= best - 1e-9).all()


@pytest.mark.parametrize(
    "fixed", [{0: 0.3}, {1: 1.2}, {2: -0.5}, {0: 0.3, 2: 0.0}, {1: np.pi / 2, 2: 0.1}, {0: 0, 1: 0}]
)
def test_given_angles_stay_as_they_are(fixed):
    angles = np.cumsum(np.random.default_rng(4).normal(0, 0.1, (60, 3)), axis=0)
    for i, value in fixed.items():
        angles[:, i] = value
    q = rigid.from_euler("zxy", angles)
    found = euler_curves.along_time(
        "zxy", rigid.multiply(q, rigid.from_euler("xyz", np.full((60, 3), 1e-3))), fixed=fixed
    )
    for i, value in fixed.items():
        assert (found[:, i] == value).all()
    assert np.abs(euler_curves.distance("zxy", found, q)).max() < 5e-3
    assert np.allclose(euler_curves.along_time("zxy", q, fixed=fixed), angles, atol=1e-6)


def test_nothing_to_turn_and_wrong_orders():
    q = np.array([[1.0, 0, 0, 0]] * 3)
    assert euler_curves.along_time("", q).shape == (3, 0)
    assert euler_curves.along_time("xyz", q[:0]).shape == (0, 3)
    assert np.allclose(euler_curves.distance("", np.zeros((3, 0)), q), 0)
    with pytest.raises(BadInput, match="different axes"):
        euler_curves.nearest("xyx", q)
