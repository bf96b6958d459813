"""The papers' baselines: round trips, less error and more bytes at smaller steps, unusual shapes."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import metrics
from mocodec.codecs import baselines
from mocodec.codecs.hou2014 import Hou2014
from mocodec.errors import MissingExtra
from mocodec.testing import synthetic


@pytest.fixture(params=baselines.BASELINES, ids=lambda baseline: baseline.name)
def baseline(request: pytest.FixtureRequest) -> baselines.Baseline:
    try:
        request.param.encode(np.zeros((2, 1, 3)), 0.01)
    except MissingExtra as missing:
        pytest.skip(str(missing))
    return request.param


def test_smaller_steps_give_less_error_and_more_bytes(baseline: baselines.Baseline):
    positions = synthetic.markers(frames=420, seed=1).positions
    errors, sizes = [], []
    for step in (0.1, 0.02, 0.004):
        data = baseline.encode(positions, step)
        decoded = baseline.decode(data, positions.shape)
        assert decoded.shape == positions.shape
        errors.append(metrics.mean_distance(positions, decoded))
        sizes.append(len(data))
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.004
    assert sizes == sorted(sizes)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (30, 1), (281, 4), (5, 40)])
def test_unusual_shapes_round_trip(baseline: baselines.Baseline, shape: tuple[int, int]):
    positions = np.random.default_rng(0).normal(size=(*shape, 3))
    decoded = baseline.decode(baseline.encode(positions, 1e-4), positions.shape)
    assert np.abs(decoded - positions).max() < 1e-3


def test_hou2014_needs_fewer_bytes_at_equal_error(baseline: baselines.Baseline):
    motion = synthetic.markers(frames=900, seed=1)
    data = baseline.encode(motion.positions, 0.02)
    error = metrics.mean_distance(motion.positions, baseline.decode(data, motion.positions.shape))
    assert Hou2014(mean_error=error).encode(motion).payload_bytes < len(data)
