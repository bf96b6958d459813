"""Errors of signals by range and by label: every sample is within its bound, and files are smaller."""

from __future__ import annotations

import numpy as np
import pytest

import mocodec as mc
from mocodec.errors import BadInput
from mocodec.motion import Motion, Signal
from mocodec.signals import bounds, codec, forms
from mocodec.testing.signals import noise, plate, slow


def lab(samples: int = 3000) -> Motion:
    """Two forces and an EMG channel as floats, counts of a force with a scale, and masks."""
    table = np.stack([slow(samples, 800) + noise(samples, 2), slow(samples, 40), noise(samples, 1e-4)], axis=1)
    counts = np.rint(slow(samples, 2000) + noise(samples, 9)).astype(np.int16)[:, None]
    extras = {
        "model": {"outputs": Signal(table.astype(np.float32), 1000.0, ("Fz1", "Fz2", "EMG1"), ("N", "kN", "V"))},
        "analog": Signal(counts, 1000.0, ("Fx",), ("N",)),
        "parameters": {"ANALOG": {"SCALE": np.array([0.25], np.float32), "GEN_SCALE": np.array([2.0], np.float32)}},
        "masks": Signal(np.arange(samples).astype(np.int16), 1000.0),
    }
    return Motion(np.cumsum(np.ones((300, 2, 3)), 0) / 1000, 100.0, extras=extras)


def values(motion: Motion) -> dict[str, np.ndarray]:
    found = {"masks": motion.extras["masks"].values, "Fx": motion.extras["analog"].values[:, 0]}
    return found | dict(zip(("Fz1", "Fz2", "EMG1"), motion.extras["model"]["outputs"].values.T, strict=True))


def errors(motion: Motion, text: str) -> dict[str, float]:
    decoded = mc.decode(mc.encode(motion, signal_error=text))
    assert isinstance(decoded, Motion)
    wanted, got = values(motion), values(decoded)
    return {name: float(np.abs(wanted[name].astype(float) - got[name]).max()) for name in wanted}


@pytest.mark.parametrize(("text", "share"), [("12bit", 1 / 8192), ("0.1%", 1 / 1000), ("6 bits", 1 / 128)])
def test_a_share_of_the_range_bounds_every_sample(text: str, share: float) -> None:
    motion = lab()
    found = errors(motion, text)
    assert found.pop("masks") == 0
    for name, error in found.items():
        assert 0 <= error <= np.ptp(values(motion)[name].astype(float)) * share
    assert found["Fz1"] > 0


def test_units_by_label() -> None:
    motion = lab()
    found = errors(motion, "Fz*=500mN, Fx=2N")
    assert 0.4 < found["Fz1"] <= 0.5
    assert found["Fz2"] <= 0.0005
    assert found["Fx"] == 4  # counts of 0.5 N
    assert found["EMG1"] == 0


def test_the_file_promises_it_and_is_smaller() -> None:
    exact, bounded = mc.encode(lab()), mc.encode(lab(), signal_error="10bit")
    assert len(bounded) < 0.7 * len(exact)
    with mc.open(bounded) as f:
        assert f.info["settings"]["signal_error"] == "10bit"
        assert not list(bounds.broken(lab().extras, f[:].extras, "10bit"))
        assert list(bounds.broken(lab().extras, f[:].extras, "14bit"))


def test_gaps_and_full_range_survive() -> None:
    samples = np.array([np.nan, np.inf, -0.0, 1.5, 3e38, 7.25] * 20, np.float32)
    full = np.array([-32768, 32767, 5] * 40, np.int16)
    extras = {"a": Signal(samples, 10.0), "b": Signal(full, 10.0, ("x",))}
    changed = bounds.bounded(extras, "4bit")
    np.testing.assert_array_equal(np.isnan(changed["a"].values), np.isnan(samples))
    assert not list(bounds.broken(extras, changed, "4bit"))
    assert not list(bounds.broken(extras, bounds.bounded(extras, "x=37"), "x=37"))


@pytest.mark.parametrize(
    "text", ["", "12", "0bit", "1.5bit", "30bit", "-1%", "Fz*=", "=3N", "0.5N", "Fy=1N", "Fz*=1V", "EMG1=2kN", "x;y"]
)
def test_what_does_not_fit_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match="signal error"):
        mc.encode(lab(20), signal_error=text)


def test_counts_with_large_steps_stay_exact() -> None:
    counts = np.rint(slow(2000, 40) + noise(2000, 3))[:, None]
    signal = Signal((counts * 0.5).astype(np.float32), 1000.0, ("Fz",), ("N",))
    assert bounds.bounded({"a": signal}, "12bit")["a"].values.tobytes() == signal.values.tobytes()


def test_forces_that_follow_from_sensors_stay_exact() -> None:
    values = plate(3000)
    signal = Signal(values, 1000.0, tuple("abcdef"))
    changed = bounds.bounded({"a": signal}, "12bit")["a"].values
    assert changed.tobytes() == values.tobytes()


def test_counts_that_differ_in_their_last_bits_become_counts() -> None:
    counts = np.rint(slow(3000, 40) + noise(3000, 3))
    jitter = np.float32(1) + np.arange(3000).astype(np.float32) % 3 * np.float32(2e-7)
    values = ((counts * 0.1 - 7.3).astype(np.float32) * jitter)[:, None]
    extras = {"a": Signal(values, 1000.0, ("Fz",), ("N",))}
    changed = bounds.bounded(extras, "12bit")
    assert not list(bounds.broken(extras, changed, "12bit"))
    assert len(np.unique(changed["a"].values)) == len(np.unique(counts))


def test_steps_are_found_again() -> None:
    values = np.stack([slow(400, size) + noise(400, size / 50) for size in (1e-3, 0.7, 31, 4e4)], axis=1)
    for offset in (0.0, 900.0):
        signal = Signal((values + offset).astype(np.float32), 100.0, tuple("abcd"))
        changed = np.asarray(bounds.bounded({"a": signal}, "0.5%")["a"].values)
        found = codec.encode(changed, 100.0)
        assert found is not None
        for column, form in zip(changed.T, found[0].forms, strict=True):
            if offset < 1000 * np.ptp(column):
                assert form.kind == forms.COUNTS
                assert len(np.unique(np.round(column / form.step))) == len(np.unique(column))
