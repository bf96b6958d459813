"""Rendered views of point clouds."""

from __future__ import annotations

import numpy as np

from mocodec.metrics import splats


def test_nearer_points_cover_farther_ones():
    points = np.array([[0.5, 0, 0.0], [-0.5, 0, 0.0]])
    colours = np.array([[255, 0, 0], [0, 255, 0]], np.uint8)
    front = splats.render(points, colours, 0, np.zeros(3), 1.0, size=9, splat=1)
    back = splats.render(points, colours, 180, np.zeros(3), 1.0, size=9, splat=1)
    drawn = [tuple(image.reshape(-1, 3).max(axis=0)) for image in (front, back)]
    assert sorted(drawn) == [(0, 255, 0), (255, 0, 0)]
    assert (front.sum(axis=2) > 0).sum() == 1
