"""Corrections: the bound holds in space for any prediction, and takes no bytes where the prediction keeps it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocodec import metrics, native
from mocodec.errors import CannotEncode, Corrupt
from mocodec.stages import bounded, gaps, lattice
from mocodec.testing import corruption


def slow(frames: int, points: int, seed: int = 0) -> np.ndarray:
    """Errors that change slowly, of magnitude about 1."""
    rng = np.random.default_rng(seed)
    coarse = rng.normal(size=(frames // 10 + 2, points, 3))
    at = np.arange(frames) / 10
    left = at.astype(int)
    share = (at - left)[:, None, None]
    return coarse[left] * (1 - share) + coarse[left + 1] * share


@settings(deadline=None, derandomize=True, max_examples=40)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 300),
    st.integers(1, 6),
    st.sampled_from([1e-6, 1e-3, 0.3, 1.0, 2.0, 50.0]),
    st.booleans(),
)
def test_the_bound_holds(seed: int, frames: int, points: int, size: float, gappy: bool):
    rng = np.random.default_rng(seed)
    prediction = rng.normal(size=(frames, points, 3))
    original = prediction + 0.01 * size * slow(frames, points, seed)
    if gappy:
        original[rng.random((frames, points)) < 0.3] = np.nan
    data = bounded.pack(original, prediction, 0.01)
    fixed = bounded.unpack(data, prediction, 0.01)
    assert np.nanmax(metrics.distances(original, fixed), initial=0) <= 0.01
    assert np.isfinite(fixed).all()


def test_no_bytes_where_the_prediction_is_within_the_bound():
    prediction = np.random.default_rng(0).normal(size=(50, 4, 3))
    original = prediction + 0.009 / np.sqrt(3)
    assert bounded.pack(original, prediction, 0.01) == b""
    assert bounded.unpack(b"", prediction, 0.01) is prediction
    original[3, 2] = np.nan
    assert bounded.pack(original, prediction, 0.01) == b""


def test_a_slow_excursion_takes_fewer_bytes_than_its_frames():
    prediction = np.zeros((400, 10, 3))
    original = prediction.copy()
    original[100:160, 4] = 0.012
    data = bounded.pack(original, prediction, 0.01)
    assert len(data) < 24
    assert data[0] == bounded.RUNS
    assert metrics.distances(original, bounded.unpack(data, prediction, 0.01)).max() <= 0.01


def test_dense_where_most_points_need_it():
    rng = np.random.default_rng(0)
    prediction = np.zeros((60, 10, 3))
    original = rng.normal(size=prediction.shape)
    data = bounded.pack(original, prediction, 0.01)
    assert data[0] == bounded.DENSE
    assert metrics.distances(original, bounded.unpack(data, prediction, 0.01)).max() <= 0.01


@pytest.mark.parametrize("stride", [0, 2])
def test_the_lattice_engine_codes_errors_far_beyond_the_bound(monkeypatch: pytest.MonkeyPatch, stride: int):
    monkeypatch.setattr(bounded, "ENGINE_STRIDES", (stride,))
    prediction = np.random.default_rng(0).normal(size=(120, 6, 3))
    angles = np.arange(120)[:, None, None] / 12 + np.arange(18).reshape(6, 3)
    original = prediction + np.sin(angles) + np.cos(0.7 * angles) + 0.02 * slow(120, 1)
    missing = np.zeros((120, 6), bool)
    missing[20:50, 1] = missing[:3] = missing[100:, 4] = True
    original[missing] = np.nan
    known = lattice.neighbours(np.where(missing[..., None], prediction, original))
    packed_gaps = gaps.pack(missing)
    data = bounded.pack(original, prediction, 0.01, known)
    assert data[0] == bounded.ENGINE
    assert len(data) < 0.8 * len(bounded.pack(original, prediction, 0.01))
    fixed = bounded.unpack(data, prediction, 0.01, packed_gaps)
    assert metrics.distances(original, fixed)[~missing].max() <= 0.01
    for bad in corruption.damaged(data, 20, seed=1):
        try:
            assert bounded.unpack(bad, prediction, 0.01, packed_gaps).shape == prediction.shape
        except Corrupt:
            continue


@pytest.mark.parametrize(("frames", "points", "scale"), [(1, 1, 2.0), (300, 7, 0.8), (128, 3, 0.4), (129, 5, 3.0)])
def test_lasting_corrections_are_those_of_numpy(frames: int, points: int, scale: float):
    if native.kernel("lasting_corrections") is None:
        pytest.skip("the compiled module is not built")
    random = np.random.default_rng(frames)
    error = scale * np.cumsum(random.normal(0, 0.2, (frames, points, 3)), axis=0) + random.normal(
        0, 0.3, (1, points, 3)
    )
    error[:, -1] *= 0.01
    nearest = np.rint(error).astype(np.int64)
    outside = (error**2).sum(axis=2) > 0.75
    compiled = bounded._lasting_corrections(error, nearest, outside)
    with native.without():
        np.testing.assert_array_equal(compiled, bounded._lasting_corrections(error, nearest, outside))


def test_a_bound_below_the_precision_of_floats_is_refused():
    with pytest.raises(CannotEncode):
        bounded.pack(np.full((2, 1, 3), 1e9), np.zeros((2, 1, 3)), 1e-9)


def test_damage_is_corrupt_or_decodes():
    prediction = np.zeros((80, 5, 3))
    original = 0.01 * slow(80, 5)
    data = bounded.pack(original, prediction, 0.01)
    for bad in [b"\x07", b"\x00", b"\x00\xff\xff\xff\xff\x7f", *corruption.damaged(data, 80, seed=1)]:
        try:
            fixed = bounded.unpack(bad, prediction, 0.01)
        except Corrupt:
            continue
        assert fixed.shape == prediction.shape
