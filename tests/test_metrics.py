"""Each measure on numbers that were worked out by hand."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mocodec import BadInput, Motion, compare, metrics

A = np.zeros((2, 2, 3))
A[1] = [[2, 0, 0], [0, 4, 0]]
B = A + np.array([[[0, 0, 0.3], [0, 0, 0.4]], [[0, 0, 0], [0.3, 0.4, 0]]])


def test_distances_and_their_mean() -> None:
    assert metrics.distances(A, B) == pytest.approx(np.array([[0.3, 0.4], [0, 0.5]]))
    assert metrics.mean_distance(A, B) == pytest.approx(0.3)  # Hou (11)


def test_distortion_is_relative_to_the_spread_about_the_average_pose() -> None:
    # ‖A − Ã‖² = .09 + .16 + .25 = .5; ‖A − E(A)‖² = 2 (1 + 4) = 10
    assert metrics.distortion_percent(A, B) == pytest.approx(100 * np.sqrt(0.05))
    assert metrics.distortion_percent(A[:1], B[:1]) == 0.0


def test_rms_of_each_frame() -> None:
    assert metrics.rms_per_frame(A, B) == pytest.approx([np.sqrt(0.125), np.sqrt(0.125)])


def test_gaps_are_left_out_of_all_measures() -> None:
    holes = A.copy()
    holes[:, 1] = np.nan
    holes[0] = np.nan
    missing = np.where(np.isnan(holes), np.nan, B)
    assert metrics.mean_distance(holes, missing) == 0.0
    assert metrics.distortion_percent(holes, missing) == 0.0
    assert np.isnan(metrics.rms_per_frame(holes, missing)[0])
    result = compare(Motion(holes, rate=10), Motion(missing, rate=10))
    assert result.max_error == 0.0
    assert result.gaps_equal
    assert list(result.per_point) == ["P1"]


def test_comparison_locates_the_largest_error_and_matches_points_by_name() -> None:
    a, b = Motion(A, rate=10, names=("x", "y")), Motion(B[:, ::-1], rate=10, names=("y", "x"))
    result = compare(a, b, stored_bytes=12)
    assert result.max_at == (1, "y")
    assert result.max_error == pytest.approx(0.5)
    assert result.ratio == pytest.approx(2 * 2 * 3 * 4 / 12)
    assert json.loads(result.to_json(unit="m"))["per_point"]["x"]["max_error"] == pytest.approx(0.3)


def test_motions_of_different_sizes_are_not_compared() -> None:
    with pytest.raises(BadInput, match="frames"):
        compare(Motion(A, rate=10), Motion(B[:1], rate=10))


def test_a_comparison_shows_itself_in_notebooks() -> None:
    hostile = "<script>alert(1)</script>"
    rng = np.random.default_rng(0)
    original = Motion(rng.normal(size=(20, 2, 3)), 60, (hostile, "b"))
    moved = Motion(original.positions + np.array([0.003, 0, 0]), 60, original.names)
    made = compare(original, moved)._repr_html_()
    assert "3 mm" in made
    assert hostile not in made
    assert "&lt;script&gt;" in made
