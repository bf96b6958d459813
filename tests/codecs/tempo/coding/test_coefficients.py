"""Integers of chunks come back from their bytes, with and without the compiled module, which gives the same bytes."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.tempo.coding import coefficients, contexts, quantise
from mocodec.codecs.tempo.coding.plan import plan
from mocodec.codecs.tempo.models import prior
from mocodec.codecs.tempo.models.points import NamedPoints
from mocodec.motion import Motion

KNOWN = prior.for_points()
NAMES = KNOWN.joints.names
MODEL = NamedPoints(KNOWN).model(Motion(np.zeros((0, len(NAMES), 3)), 120.0, NAMES))


@pytest.mark.parametrize("step", [-500, -250, -120])
@pytest.mark.parametrize("frames", [1, 2, 17, 130, 480])
def test_coefficients_are_coded_alike_with_and_without_the_compiled_module(step: int, frames: int) -> None:
    rng = np.random.default_rng(frames)
    expected = 2.0 ** (MODEL.expected(frames, step) / contexts.OCTAVE)
    scaled = rng.laplace(size=expected.shape) * expected
    scaled[rng.integers(frames), rng.integers(MODEL.rows)] *= 1e3
    quantised, numbers = [], []
    for slope in (quantise.SLOPE, 0.0):
        quantised.append(quantise.quantise(MODEL, scaled, step, slope))
        values, threshold, _ = quantised[-1]
        inside = values[: plan(MODEL, frames, step, threshold, 0).frequencies]
        lists = rng.integers(-40, 40, (5, rng.integers(min(31 * frames, 60))))
        lists[3:] = np.abs(lists[3:])
        numbers.append(coefficients.ChunkNumbers(frames, inside, step, threshold, lists if lists.size else None))
    payloads = coefficients.pack(MODEL, numbers)
    decoded = coefficients.unpack(MODEL, [frames, frames], payloads, 5)
    with native.without():
        for ours, slope in zip(quantised, (quantise.SLOPE, 0.0), strict=True):
            theirs = quantise.quantise(MODEL, scaled, step, slope)
            np.testing.assert_array_equal(ours[0], theirs[0])
            assert ours[1:] == theirs[1:]
        assert payloads == coefficients.pack(MODEL, numbers)
        pure = coefficients.unpack(MODEL, [frames, frames], payloads, 5)
    for ours, theirs, given in zip(decoded, pure, numbers, strict=True):
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(ours[0], given.values)
