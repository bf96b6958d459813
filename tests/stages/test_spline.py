"""Key frames and splines: the paper's halving, its bits, and values that decode to within half a step."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocodec import native
from mocodec.errors import Corrupt
from mocodec.stages import spline


def trajectory(frames: int, k: int = 3, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    t = np.arange(frames)[:, None] / 30
    return np.sin(t * random.uniform(0.3, 3, k) + random.uniform(0, 6, k)) * random.uniform(0.1, 1, k)


def test_the_spline_is_the_natural_one() -> None:
    from scipy.interpolate import CubicSpline

    keys = np.array([0, 3, 4, 11, 20])
    values = np.random.default_rng(1).normal(size=(5, 2))
    ours = spline.interpolate(keys, values, np.arange(21))
    assert ours == pytest.approx(CubicSpline(keys, values, bc_type="natural")(np.arange(21)))


@pytest.mark.parametrize(("keys", "expected"), [([0], [2, 2, 2]), ([0, 2], [2, 3, 4]), ([0, 1, 2], [2, 5, 4])])
def test_few_key_frames(keys: list[int], expected: list[float]) -> None:
    values = np.array([[2.0], [5.0], [4.0]])[: len(keys)] if len(keys) != 2 else np.array([[2.0], [4.0]])
    assert spline.interpolate(np.array(keys), values, np.arange(3))[:, 0] == pytest.approx(expected)


@settings(deadline=None)
@given(st.integers(1, 400), st.sampled_from([1.0, 0.1, 1e-3, 0.0]))
def test_no_frame_is_beyond_the_tolerance_and_bits_give_the_key_frames_back(frames: int, tolerance: float) -> None:
    wanted = trajectory(frames)
    keys = spline.keyframes(wanted, tolerance)
    decoded = spline.through(keys, wanted[keys.by_level])
    assert np.linalg.norm(decoded - wanted, axis=1).max() <= tolerance + 1e-12
    bits = spline.splits(keys)
    again, used = spline.from_splits(np.append(bits, [1, 1, 1]).astype(np.uint8), frames)
    assert used == len(bits)
    assert [list(level) for level in again.levels] == [list(level) for level in keys.levels]


def test_four_key_frames_begin_and_the_middle_of_a_bad_interval_is_added() -> None:
    """Section 3.4: two at the ends, two at thirds; a bump in the last third adds the middle of that third."""
    wanted = np.zeros((91, 1))
    assert list(spline.keyframes(wanted, 0.1).by_level) == [0, 30, 60, 90]
    wanted[74:77] = 0.3
    assert list(spline.keyframes(wanted, 0.4).by_level) == [0, 30, 60, 90]
    assert list(spline.keyframes(wanted, 0.2).levels[1]) == [75]


@pytest.mark.parametrize("frames", [1, 2, 3, 5, 100])
@pytest.mark.parametrize("step", [0.5, 1e-3])
def test_values_decode_to_within_half_a_step(frames: int, step: float) -> None:
    wanted = trajectory(frames)
    keys = spline.keyframes(wanted, 0.05)
    numbers, decoded = spline.differences(keys, wanted[keys.by_level], step)
    assert np.abs(decoded - wanted[keys.by_level]).max() <= step / 2 + 1e-12
    assert np.array_equal(spline.values(keys, numbers, step), decoded)


def test_no_components_have_no_values() -> None:
    keys = spline.keyframes(np.zeros((50, 0)), 0.1)
    numbers, decoded = spline.differences(keys, np.zeros((4, 0)), 0.1)
    assert numbers.shape == decoded.shape == (4, 0)
    assert spline.through(keys, decoded).shape == (50, 0)


def test_bits_that_end_too_early_are_corrupt() -> None:
    bits = spline.splits(spline.keyframes(trajectory(200), 1e-3))
    with pytest.raises(Corrupt):
        spline.from_splits(bits[:-1], 200)


def test_the_compiled_spline_is_numpys_to_rounding() -> None:
    if native.kernel("spline_interpolate") is None:
        pytest.skip("the compiled module is not built")
    random = np.random.default_rng(2)
    for frames, count, k in ((2, 2, 1), (3, 3, 2), (60, 9, 4), (500, 130, 17), (9, 4, 0)):
        keys = np.sort(random.choice(frames, count, replace=False))
        values = random.normal(size=(count, k))
        at = random.integers(keys[0], keys[-1] + 1, 80)
        compiled = spline.interpolate(keys, values, at)
        with native.without():
            np.testing.assert_allclose(compiled, spline.interpolate(keys, values, at), rtol=0, atol=1e-12)


@pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")
@pytest.mark.parametrize("frames", [1, 2, 3, 5, 40, 700])
def test_compiled_key_frames(frames):
    wanted, step = trajectory(frames), 1e-3

    def found() -> list[np.ndarray]:
        keys = spline.keyframes(wanted, 2e-3)
        bits = spline.splits(keys)
        again, used = spline.from_splits(np.append(bits, 1).astype(np.uint8), frames)
        numbers, decoded = spline.differences(keys, wanted[keys.by_level], step)
        values = spline.values(again, numbers, step)
        return [keys.by_level, keys.sizes, bits, again.by_level, np.array(used), numbers, decoded, values]

    ours = found()
    with native.without():
        theirs = found()
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(one, other)
