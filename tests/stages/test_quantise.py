"""Quantiser and ladder of steps."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.errors import CannotEncode
from mocodec.stages import quantise


def test_nearest_multiples():
    values = np.array([0.0, 0.049, 0.051, -0.051, -0.26, 1e6])
    integers = quantise.forward(values, 0.1)
    assert integers.tolist() == [0, 0, 1, -1, -3, 10_000_000]
    assert np.abs(quantise.inverse(integers, 0.1) - values).max() <= 0.05 + 1e-9


def test_a_wider_dead_zone():
    assert quantise.forward(np.array([0.06, -0.06, 0.07, 0.16]), 0.1, 0.35).tolist() == [0, 0, 1, 1]


def test_the_ladder_reaches_every_step_within_half_a_rung():
    for metres in (1e-9, 3.3e-4, 0.01, 1.0, 7e5):
        rung = quantise.rung(metres)
        assert abs(np.log2(quantise.step(rung) / metres)) <= 0.5 / quantise.LADDER + 1e-12
    assert quantise.step(0) == 1.0
    assert quantise.step(-3 * quantise.LADDER) == 0.125


def test_values_and_steps_out_of_range_cannot_be_encoded():
    with pytest.raises(CannotEncode):
        quantise.forward(np.array([1e9]), 1e-9)
    with pytest.raises(CannotEncode):
        quantise.rung(0.0)
