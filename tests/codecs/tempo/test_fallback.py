"""hou2014 codes the chunks where it is smaller on the whole recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec import Motion, metrics
from mocodec.codecs.hou2014 import Hou2014
from mocodec.codecs.tempo import Tempo, fallback
from mocodec.codecs.tempo.pose.heading import from_y_up
from mocodec.codecs.tempo.preparation import prepare
from mocodec.testing import synthetic

from .motions import header


@pytest.mark.parametrize("settings", [{"max_error": 0.003}, {"mean_error": 0.002}, {"ratio": 80.0}])
def test_the_fallback_is_taken_where_it_is_smaller(settings: dict[str, float]) -> None:
    motion = synthetic.markers(frames=480, seed=2)
    plain, best = Tempo(**settings).encode_chunks(motion), Tempo(**settings).encode(motion)
    if "max_error" in settings:
        transformed = Tempo(**settings, model="transform", chunk_seconds=0.5).encode_chunks(motion)
        source = prepare(motion.positions, motion.up)
        smaller = fallback.smaller(transformed, motion, source, "max_error", settings["max_error"], 4.0)
        assert header(smaller).fallback is not None
        assert smaller.payload_bytes < transformed.payload_bytes
    errors = metrics.distances(motion.positions, Tempo.decode(best).positions)
    if "ratio" in settings:
        assert best.payload_bytes <= motion.raw_bytes / settings["ratio"]
        assert errors.mean() <= metrics.mean_distance(motion.positions, Tempo.decode(plain).positions)
    else:
        assert best.payload_bytes <= plain.payload_bytes
    if "max_error" in settings:
        assert errors.max() <= settings["max_error"]
    if "mean_error" in settings:
        assert 0.95 * settings["mean_error"] <= errors.mean() <= settings["mean_error"]
    assert dict(best.settings) == dict(plain.settings)


def test_chunks_of_the_fallback_keep_to_the_length_asked_for() -> None:
    motion = synthetic.markers(frames=1500, seed=2)
    encoded = Tempo(mean_error=0.002, chunk_seconds=1.0).encode(motion)
    assert max(chunk.frames for chunk in encoded.chunks) <= 2.5 * motion.rate + 1
    part = Tempo.decode(encoded, slice(700, 800)).positions
    assert part == pytest.approx(Tempo.decode(encoded).positions[700:800], abs=1e-9)


def test_fewer_bytes_are_taken_with_a_smaller_error_than_asked_for() -> None:
    random = np.random.default_rng(1)
    still = random.normal(0, 0.5, (24, 3)) + 0.0003 * random.standard_normal((300, 24, 3)).cumsum(0)
    noisy = Motion(still + 0.0005 * random.standard_normal(still.shape), 100.0, [f"M{i}" for i in range(24)])
    by_fallback = Tempo(mean_error=0.003, model="hou2014").encode(noisy)
    assert metrics.mean_distance(noisy.positions, Tempo.decode(by_fallback).positions) < 0.003
    assert Tempo(mean_error=0.003).encode(noisy).payload_bytes <= by_fallback.payload_bytes


def test_a_bound_that_is_searched_for_does_not_follow_the_last_bits_of_a_mean() -> None:
    motion = synthetic.markers(frames=200, seed=2)
    positions = motion.positions.copy()
    positions[50:90, 3] = np.nan
    with_gap = replace(motion, positions=positions)
    codec, filled = Hou2014(max_error=0.004), prepare(positions, motion.up).positions
    found = fallback._to_mean(codec, with_gap, from_y_up(filled, motion.up), 0.001)  # pyright: ignore[reportPrivateUsage]
    assert found is not None
    bound = found.settings["max_error"]
    assert bound != 0.004
    assert bound == np.float32(bound)


def test_a_basis_fitted_to_low_frequencies_is_enough_for_an_estimate() -> None:
    random = np.random.default_rng(3)
    curves = np.cumsum(random.normal(0, 0.01, (240, 8)), axis=0)
    curves[2:-2] = (curves[:-4] + curves[1:-3] + curves[2:-2] + curves[3:-1] + curves[4:]) / 5
    positions = (curves @ random.normal(size=(8, 450))).reshape(240, 150, 3)
    motion = Motion(positions + random.normal(0, 1e-4, positions.shape), 120.0, [f"M{i}" for i in range(150)])
    codec = Hou2014(max_error=0.003)
    whole = codec.prepared(motion, motion.positions).estimate()[0]
    sketch = codec.prepared(motion, motion.positions, fitted_hz=fallback.SKETCH_HZ)
    assert 0.9 * whole < sketch.estimate()[0] < 1.05 * whole
