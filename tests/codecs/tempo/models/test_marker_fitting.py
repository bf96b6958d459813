"""The search for the bones that markers sit on."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.tempo.models import marker_fitting


def test_the_nearest_bones() -> None:
    joints = np.array([[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]])
    points = np.array([[[0.1, 0.25, 0.0], [0.5, 1.2, 0.0], [2.0, 1.0, 0.0]]])
    bone, share, distance = marker_fitting._nearest_bones(points, joints, np.array([0, 0, 1]))
    assert bone.tolist() == [[1, 2, 2]]
    assert share[..., 0] == pytest.approx(np.array([[0.25, 0.5, 1.0]]))
    assert distance == pytest.approx(np.array([[0.1, 0.2, 1.0]]))


@pytest.mark.skipif(native.kernel("nearest_bones") is None, reason="the compiled module is not built")
def test_the_compiled_module_finds_the_same_bones() -> None:
    random = np.random.default_rng(1)
    poses, joints = random.normal(size=(5, 40, 3)), random.normal(size=(5, 12, 3))
    poses[:, 3] = joints[:, 7]  # at the end of one bone and the start of others
    parents = np.array([0, 0, 1, 2, 0, 4, 5, 3, 7, 7, 9, 0])
    compiled = marker_fitting._nearest_bones(poses, joints, parents)
    with native.without():
        plain = marker_fitting._nearest_bones(poses, joints, parents)
    for one, other in zip(compiled, plain, strict=True):
        np.testing.assert_array_equal(one, other)
