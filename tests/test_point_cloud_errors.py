"""Errors of point clouds: distances in both directions, lost frames, colours, the resampling floor, by joint."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.errors import BadInput
from mocodec.metrics import point_clouds as measures
from mocodec.motion import Motion
from mocodec.pointcloud import PointClouds


def cloud(*frames: list[list[float]], colours: list[list[list[int]]] | None = None) -> PointClouds:
    positions = [np.array(frame, float).reshape(-1, 3) for frame in frames]
    return PointClouds(positions, 10.0, None if colours is None else [np.array(c, np.uint8) for c in colours])


def test_neither_lost_nor_invented_points_hide():
    near, far = [0.0, 0, 0], [3.0, 0, 0]
    for a, b in ((cloud([near, far]), cloud([near])), (cloud([near]), cloud([near, far]))):
        found = measures.errors(a, b)
        assert found.max_error == 3.0
        assert found.mean_error == 1.5
        assert found.d1 == pytest.approx(np.sqrt(4.5))


def test_a_frame_that_lost_all_points_has_no_bound():
    assert measures.errors(cloud([[0, 0, 0]], []), cloud([[0, 0, 0]], [])).max_error == 0
    assert measures.errors(cloud([[0, 0, 0]], [[1, 1, 1]]), cloud([[0, 0, 0]], [])).max_error == np.inf
    with pytest.raises(BadInput, match="1 frame"):
        measures.errors(cloud([[0, 0, 0]]), cloud([[0, 0, 0]], []))


def test_points_that_are_not_finite_do_not_count():
    assert measures.errors(cloud([[0, 0, 0], [np.nan, 0, 0]]), cloud([[0, 0, 0]])).max_error == 0


def test_colours_between_nearest_points():
    a = cloud([[0, 0, 0], [1, 0, 0]], colours=[[[10, 10, 10], [50, 50, 50]]])
    b = cloud([[0, 0, 0], [1, 0, 0]], colours=[[[10, 10, 10], [60, 60, 60]]])
    assert measures.errors(a, b).psnr == pytest.approx(10 * np.log10(255**2 / 50))
    assert np.isnan(measures.errors(a, cloud([[0, 0, 0]])).psnr)


def test_the_floor_is_what_a_second_sample_scores():
    rng = np.random.default_rng(0)
    a, b = (PointClouds([rng.uniform(0, 1, (3000, 3)) * [1, 1, 0]], 10.0) for _ in range(2))
    assert measures.resampling_floor(a, [0]) == pytest.approx(measures.d1(a, b, 0), rel=0.05)
    assert np.isnan(measures.resampling_floor(cloud([[0, 0, 0]]), [0]))


def test_errors_by_joint():
    body = Motion(np.array([[[0.0, 0, 0], [10, 0, 0], [20, 0, 0]]]), 10.0, ("a", "b", "c"))
    a, b = cloud([[0, 1, 0], [10, 1, 0]]), cloud([[0, 1, 0], [10, 3, 0]])
    assert measures.errors_by_joint(a, b, body, [0]) == {"a": 0.0, "b": 2.0}
