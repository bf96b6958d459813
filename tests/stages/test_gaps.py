"""Gaps: restored exactly, stored in few bytes, and filled smoothly."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocodec.errors import Corrupt
from mocodec.stages import gaps
from mocodec.testing import corruption


@settings(deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(1, 12), st.sampled_from([0.0, 0.01, 0.3, 0.97, 1.0]))
def test_a_mask_comes_back(seed: int, frames: int, points: int, share: float):
    mask = np.random.default_rng(seed).random((frames, points)) < share
    assert np.array_equal(gaps.unpack(gaps.pack(mask), mask.shape), mask)


@settings(deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(1, 6), st.sampled_from([0.0, 0.05, 0.5, 0.95, 1.0]))
def test_filling_leaves_no_gaps_and_changes_no_samples(seed: int, frames: int, points: int, share: float):
    random = np.random.default_rng(seed)
    positions = random.normal(size=(frames, points, 3)) * 10.0 ** random.integers(-6, 7)
    positions[random.random((frames, points)) < share] = np.nan
    filled, mask = gaps.fill(positions)
    assert np.isfinite(filled).all()
    assert np.array_equal(filled[~mask], positions[~mask])
    assert np.array_equal(gaps.apply(filled, mask), positions, equal_nan=True)


def test_masks_take_few_bytes():
    mask = np.zeros((600, 41), bool)
    assert gaps.pack(mask) == b""
    mask[100:120, 7] = True
    assert len(gaps.pack(mask)) <= 9
    lost = np.zeros((600, 41), bool)
    lost[300:310] = True
    assert len(gaps.pack(lost)) <= 9
    lost[:, 3] = True
    assert len(gaps.pack(lost)) <= 40


def test_a_gap_in_a_smooth_curve_is_filled_smoothly():
    seconds = np.arange(240) / 120
    curve = np.stack([np.sin(3 * seconds), np.cos(3 * seconds), seconds], axis=1)[:, None]
    broken = curve.copy()
    broken[100:120] = np.nan
    filled, _ = gaps.fill(broken)
    assert np.abs(filled - curve).max() < 0.005


def test_gaps_at_the_ends_repeat_the_nearest_sample():
    positions = np.arange(30.0).reshape(10, 1, 3)
    positions[:2] = positions[7:] = np.nan
    filled, _ = gaps.fill(positions)
    assert (filled[:2] == positions[2]).all()
    assert (filled[7:] == positions[6]).all()


def test_a_jump_beside_a_gap_does_not_overshoot():
    positions = np.zeros((10, 1, 3))
    positions[3] = 100.0
    positions[4:7] = np.nan
    filled, _ = gaps.fill(positions)
    assert filled.max() <= 100.0
    assert filled.min() >= 0.0


def test_damage_raises_or_gives_a_mask():
    random = np.random.default_rng(1)
    data = gaps.pack(random.random((50, 9)) < 0.1)
    for bad in [*corruption.prefixes(data), *corruption.damaged(data, 300)]:
        with contextlib.suppress(Corrupt):
            assert gaps.unpack(bad, (50, 9)).shape == (50, 9)


def test_more_gaps_than_frames_is_corrupt():
    data = gaps.pack(np.ones((500, 9), bool))
    with pytest.raises(Corrupt):
        gaps.unpack(data, (5, 2))
