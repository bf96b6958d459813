"""Differences between two readings of a file, quantity by quantity."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from mocodec.typing import Booleans, Floats

from .witnesses import Reading

POSITION_TOLERANCE = 2.0**-22
"""Relative to the largest coordinate of a file: rounding of 32-bit numbers."""
ANALOG_TOLERANCE = 2.0**-20
"""Relative to the largest value of a channel."""
TIME_TOLERANCE_S = 1e-5


def compare(ours: Reading, theirs: Reading) -> dict[str, str]:
    """The difference in words, by quantity; an empty text for equal readings."""
    return {quantity: difference(ours, theirs) for quantity, difference in QUANTITIES.items()}


def gaps_of(reading: Reading) -> Booleans:
    """Mask (frames, points) of samples without all three coordinates."""
    return np.asarray(np.isnan(reading.positions).any(axis=2))


def _labels(ours: Reading, theirs: Reading) -> str:
    pairs = list(zip(ours.labels, theirs.labels, strict=False))
    differing = [(a, b) for a, b in pairs if a != b]
    if len(ours.labels) != len(theirs.labels):
        return f"{len(ours.labels)} here, {len(theirs.labels)} there"
    return f"{len(differing)} of {len(pairs)}: first {differing[0][0]!r} and {differing[0][1]!r}" if differing else ""


def _rates(ours: Reading, theirs: Reading) -> str:
    if np.allclose(ours.rates, theirs.rates, rtol=1e-5):
        return ""
    return "{:g} and {:g} Hz here, {:g} and {:g} Hz there".format(*ours.rates, *theirs.rates)


def _first_frame(ours: Reading, theirs: Reading) -> str:
    return "" if ours.first_frame == theirs.first_frame else f"{ours.first_frame} here, {theirs.first_frame} there"


def _positions(ours: Reading, theirs: Reading) -> str:
    if ours.positions.shape != theirs.positions.shape:
        sizes = *ours.positions.shape[:2], *theirs.positions.shape[:2]
        return "{} frames × {} points here, {} × {} there".format(*sizes)
    both = ~(gaps_of(ours) | gaps_of(theirs))
    apart = np.abs(ours.positions[both] - theirs.positions[both])
    largest = np.abs(ours.positions[both]).max(initial=0.0)
    wrong = (apart > POSITION_TOLERANCE * largest).any(axis=1)
    return f"{int(wrong.sum())} samples, by up to {apart.max():.6g}" if wrong.any() else ""


def _gaps(ours: Reading, theirs: Reading) -> str:
    if ours.positions.shape != theirs.positions.shape:
        return f"{int(gaps_of(ours).sum())} here, {int(gaps_of(theirs).sum())} there"
    only_ours, only_theirs = gaps_of(ours) & ~gaps_of(theirs), gaps_of(theirs) & ~gaps_of(ours)
    if not (only_ours.any() or only_theirs.any()):
        return ""
    return f"{int(only_ours.sum())} samples are gaps only here, {int(only_theirs.sum())} only there"


def _analog(ours: Reading, theirs: Reading) -> str:
    if ours.analog.shape != theirs.analog.shape:
        sizes = *ours.analog.shape, *theirs.analog.shape
        return "{} samples × {} channels here, {} × {} there".format(*sizes)
    apart = np.abs(ours.analog - theirs.analog)
    wrong = (apart > ANALOG_TOLERANCE * np.abs(ours.analog).max(axis=0, initial=0.0)).any(axis=0)
    if not wrong.any():
        return ""
    return f"{int(wrong.sum())} of {len(wrong)} channels, by up to {np.nanmax(apart):.6g} of their unit"


def _events(ours: Reading, theirs: Reading) -> str:
    labels = [[label for label, _ in reading.events] for reading in (ours, theirs)]
    times: list[Floats] = [np.array([time for _, time in reading.events]) for reading in (ours, theirs)]
    if labels[0] == labels[1] and np.allclose(*times, rtol=0, atol=TIME_TOLERANCE_S):
        return ""
    return f"{ours.events[:3]} here, {theirs.events[:3]} there"


def _start(ours: Reading, theirs: Reading) -> str:
    if np.isclose(ours.start, theirs.start, rtol=0, atol=TIME_TOLERANCE_S, equal_nan=True):
        return ""
    return f"{ours.start:g} s here, {theirs.start:g} s there"


QUANTITIES: Mapping[str, Callable[[Reading, Reading], str]] = {
    "labels": _labels,
    "rates": _rates,
    "first frame": _first_frame,
    "start time": _start,
    "positions": _positions,
    "gaps": _gaps,
    "analog values": _analog,
    "events": _events,
}
"""The comparison of each quantity."""
