"""The direction from which recordings are drawn flat."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.geometry import views

LEVEL = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}


def figure(up: str) -> np.ndarray:
    """Two frames of a tall figure that is wide along its first level axis; one point is missing."""
    right, back = LEVEL[up]
    points = np.zeros((2, 5, 3))
    points[:, :, "xyz".index(up)] = [0, 0.5, 1, 1.5, 1.7]
    points[:, :, right] = [-0.4, 0.4, 0, -0.8, 0.8]
    points[:, :, back] = [0.05, -0.05, 0.1, 0, 0]
    points[0, 2] = np.nan
    return points


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_the_widest_side_is_seen_from_above_and_not_mirrored(up: str) -> None:
    tilt = np.radians(10)
    view = views.directions(figure(up), up, tilt)
    np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(view) == pytest.approx(-1)  # right × up points to the viewer, `away` from him
    height = "xyz".index(up)
    assert view[0, height] == 0
    assert view[1, height] == pytest.approx(np.cos(tilt))
    assert view[2, height] == pytest.approx(-np.sin(tilt))  # what is higher is nearer: seen from above
    assert abs(view[0, LEVEL[up][0]]) > np.cos(np.radians(30))


def test_recordings_without_points_have_a_view() -> None:
    for shape in ((0, 3, 3), (4, 0, 3)):
        view = views.directions(np.zeros(shape), "y", 0.1)
        np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.abs(views.directions(np.full((3, 2, 3), np.nan), "z", 0.0)[1]), [0, 0, 1], atol=1e-12)
