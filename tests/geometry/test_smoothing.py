"""Noisy points are projected to the surface that they sample."""

import numpy as np
import pytest

from mocodec.geometry.smoothing import project_to_surface


def sphere(count: int, radius: float, seed: int) -> np.ndarray:
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def rms_error(points: np.ndarray, radius: float) -> float:
    """Root mean square distance from a sphere about the origin, metres."""
    return float(np.sqrt(np.mean((np.linalg.norm(points, axis=1) - radius) ** 2)))


def test_noise_is_reduced() -> None:
    noisy = sphere(2000, 0.15, 1) + np.random.default_rng(2).normal(size=(2000, 3)) * 0.005
    assert rms_error(project_to_surface(noisy[:500], noisy), 0.15) < 0.5 * rms_error(noisy[:500], 0.15)


def test_curved_surfaces_are_kept() -> None:
    points = sphere(2000, 0.15, 1)
    assert rms_error(project_to_surface(points, points), 0.15) < 2e-4


def test_outliers_have_little_influence() -> None:
    points = sphere(2000, 0.15, 1)
    points[::20] *= 1.3
    near = np.flatnonzero(np.arange(2000) % 20)
    assert rms_error(project_to_surface(points[near], points), 0.15) < 3e-3


@pytest.mark.parametrize("count", [0, 1, 5, 23])
def test_too_few_points_are_unchanged(count: int) -> None:
    points = sphere(count, 0.1, 3)
    np.testing.assert_array_equal(project_to_surface(points, points), points)


@pytest.mark.parametrize("points", [np.zeros((40, 3)), np.outer(np.arange(40.0), [0.0, 0.0, 0.01])])
def test_degenerate_points_stay_finite(points: np.ndarray) -> None:
    assert np.isfinite(project_to_surface(points, points)).all()
