"""Animation tracks of glTF: key times and values, sampled at any times (glTF 2.0, appendix C)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...typing import Floats

DEFAULT_RATE = 30.0
"""Hertz, for tracks of one key."""


class Track(NamedTuple):
    """One animated property of a node: key times (keys,) in seconds, values, and STEP, LINEAR or CUBICSPLINE."""

    times: Floats
    values: Floats
    interpolation: str

    def sample(self, at: Floats, is_rotation: bool) -> Floats:
        """Values at the times `at`; rotations as unit quaternions, w first."""
        last = len(self.times) - 1
        key = np.clip(np.searchsorted(self.times, at + 1e-9, side="right") - 1, 0, max(last - 1, 0))
        after = np.minimum(key + 1, last)
        span = np.maximum(self.times[after] - self.times[key], 1e-12)
        share = np.clip((at - self.times[key]) / span, 0, 1)[:, None]
        if self.interpolation == "CUBICSPLINE":
            in_tangents, points, out_tangents = self.values[0::3], self.values[1::3], self.values[2::3]
            t = share
            values = (
                (2 * t**3 - 3 * t**2 + 1) * points[key] + span[:, None] * (t**3 - 2 * t**2 + t) * out_tangents[key]
                + (3 * t**2 - 2 * t**3) * points[after] + span[:, None] * (t**3 - t**2) * in_tangents[after]
            )  # fmt: skip
        elif self.interpolation == "STEP":
            values = np.where(share < 1, self.values[key], self.values[after])
        elif is_rotation:
            values = _slerp(self.values[key], self.values[after], share)
        else:
            values = self.values[key] + share * (self.values[after] - self.values[key])
        if not is_rotation:
            return values
        values = values[:, [3, 0, 1, 2]]
        return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)


def _slerp(a: Floats, b: Floats, share: Floats) -> Floats:
    """Spherical interpolation of quaternions along the shorter arc."""
    dot = np.sum(a * b, axis=1, keepdims=True)
    b, dot = np.where(dot < 0, -b, b), np.minimum(np.abs(dot), 1.0)
    angle = np.arccos(dot)
    is_small = angle < 1e-4
    sine = np.where(is_small, 1.0, np.sin(angle))
    weight_a = np.where(is_small, 1 - share, np.sin((1 - share) * angle) / sine)
    return weight_a * a + np.where(is_small, share, np.sin(share * angle) / sine) * b


def rate_of(times: Floats) -> float:
    """Hertz of key times (keys,): 1 / the median step, rounded to a whole number within 0.5 %."""
    if len(times) < 2:
        return DEFAULT_RATE
    rate = 1 / float(np.median(np.diff(times)))
    return float(round(rate)) if abs(rate - round(rate)) < 0.005 * rate else rate
