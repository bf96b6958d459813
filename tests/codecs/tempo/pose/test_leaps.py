"""Spikes and discontinuities are found."""

from __future__ import annotations

import numpy as np

from mocodec.codecs.tempo.pose import leaps
from mocodec.testing import synthetic


def test_a_spike_is_found_and_interpolated() -> None:
    positions = synthetic.markers(frames=100, seed=1).positions.copy()
    smooth = positions.copy()
    positions[50, 3] += 0.5
    found = leaps.spikes(positions)
    assert np.argwhere(found).tolist() == [[50, 3]]
    assert np.abs(leaps.without_spikes(positions, found) - smooth).max() < 0.02


def test_a_discontinuity_is_found() -> None:
    positions = synthetic.markers(frames=100, seed=1).positions.copy()
    assert leaps.discontinuities(positions, 120.0) == []
    positions[60:] += 0.5
    assert leaps.discontinuities(positions, 120.0) == [60]
    assert leaps.discontinuities(positions[:3], 120.0) == []
