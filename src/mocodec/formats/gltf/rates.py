"""The frame rate at which animation tracks are sampled, from their key times.

dense, evenly spaced keys   their own rate
sparse or irregular keys    the lowest usual rate of at least 30 Hz that has a frame at every key,
                            else the lowest that is at least the rate of the median key distance
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...typing import Floats
from ..conventions import USUAL_RATES
from .tracks import Track

DEFAULT_RATE = 30.0
"""Hertz, for tracks of one key, and the lowest for sparse ones."""
MIN_DENSE_KEYS = 8
MIN_DENSE_RATE = 5.0
"""Evenly spaced linear keys below 30 Hz are a recording if there are this many, at this many hertz at least."""
SAMPLING_RATES = sorted(r for r in USUAL_RATES if DEFAULT_RATE <= r <= 240 and r == round(r))
EPSILON = float(np.finfo(np.float32).eps)


def rate_of(tracks: Sequence[Track]) -> tuple[float, bool]:
    """Hertz, and whether it was chosen for sparse or irregular keys."""
    densest = max(tracks, key=lambda track: len(track.times))
    times = densest.times
    if len(times) < 2:
        return DEFAULT_RATE, False
    steps = np.diff(times)
    median = float(np.median(steps))
    rounding = 4 * EPSILON * float(np.abs(times).max())
    rate = _usual((len(times) - 1) / float(times[-1] - times[0]))
    if float(np.abs(steps - median).max()) <= 0.02 * median + rounding and len(times) > 2:
        is_recording = len(times) >= MIN_DENSE_KEYS and densest.interpolation != "CUBICSPLINE"
        if rate >= 0.999 * DEFAULT_RATE or (is_recording and rate >= MIN_DENSE_RATE):
            return rate, False
    keys = np.unique(np.concatenate([track.times for track in tracks]))
    keys = keys - keys[0]
    for usual in SAMPLING_RATES:
        frames = keys * usual
        if float(np.abs(frames - np.rint(frames)).max()) <= 0.01 + usual * rounding:
            return usual, True
    wanted = max(DEFAULT_RATE, 0.98 / median)
    return next((usual for usual in SAMPLING_RATES if usual >= wanted), _usual(1 / median)), True


def _usual(rate: float) -> float:
    """The usual rate, or the whole number of hertz, within 0.01 %; else the rate itself."""
    for candidate in (*USUAL_RATES, float(round(rate))):
        if candidate and abs(rate - candidate) < 1e-4 * candidate:
            return float(candidate)
    return rate


def key_times(tracks: Sequence[Track]) -> tuple[float, float]:
    """The first and the last key time of all tracks, seconds."""
    return min(float(t.times[0]) for t in tracks), max(float(t.times[-1]) for t in tracks)


def frame_times(begin: float, end: float, rate: float) -> Floats:
    """Times of frames 1 / rate apart from `begin` to `end`."""
    return begin + np.arange(round((end - begin) * rate) + 1) / rate
