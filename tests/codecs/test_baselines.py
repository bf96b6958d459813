"""The papers' rivals: bytes come back, a finer step means less error and more bytes, short and odd shapes work."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import metrics
from mocodec.codecs import baselines
from mocodec.codecs.hou2014 import Hou2014
from mocodec.errors import MissingExtra
from mocodec.testing import synthetic


@pytest.fixture(params=baselines.ALL, ids=lambda rival: rival.name)
def rival(request: pytest.FixtureRequest) -> baselines.Baseline:
    try:
        request.param.encode(np.zeros((2, 1, 3)), 0.01)
    except MissingExtra as missing:
        pytest.skip(str(missing))
    return request.param


def test_finer_steps(rival: baselines.Baseline):
    positions = synthetic.markers(frames=420, seed=1).positions
    errors, sizes = [], []
    for step in (0.1, 0.02, 0.004):
        data = rival.encode(positions, step)
        decoded = rival.decode(data, positions.shape)
        assert decoded.shape == positions.shape
        errors.append(metrics.mean_distance(positions, decoded))
        sizes.append(len(data))
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.004
    assert sizes == sorted(sizes)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (30, 1), (281, 4), (5, 40)])
def test_odd_shapes(rival: baselines.Baseline, shape: tuple[int, int]):
    positions = np.random.default_rng(0).normal(size=(*shape, 3))
    decoded = rival.decode(rival.encode(positions, 1e-4), positions.shape)
    assert np.abs(decoded - positions).max() < 1e-3


def test_hou_is_better_at_equal_error(rival: baselines.Baseline):
    motion = synthetic.markers(frames=900, seed=1)
    data = rival.encode(motion.positions, 0.02)
    error = metrics.mean_distance(motion.positions, rival.decode(data, motion.positions.shape))
    assert Hou2014(mean_error=error).encode(motion).payload_bytes < len(data)
