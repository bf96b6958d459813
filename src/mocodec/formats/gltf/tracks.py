"""Animation tracks of glTF: key times and values, sampled at any times (glTF 2.0, appendix C)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...errors import BadInput
from ...typing import Floats

INTERPOLATIONS = {"STEP": 1, "LINEAR": 1, "CUBICSPLINE": 3}
"""Values for each key: a cubic spline has an in-tangent, the value and an out-tangent."""
KEY_TOLERANCE = 1e-3
"""Share of a frame within which a sample is taken at a key: key times are float32."""


class Track(NamedTuple):
    """One animated property of a node: key times (keys,) in seconds, values, and STEP, LINEAR or CUBICSPLINE."""

    times: Floats
    values: Floats
    interpolation: str

    def sample(self, at: Floats, is_rotation: bool, rate: float) -> Floats:
        """Values at the times `at`, which are 1 / rate apart; rotations as unit quaternions, w first.

        Raises BadInput for rotations of length zero.
        """
        near, last = KEY_TOLERANCE / rate, len(self.times) - 1
        key = np.clip(np.searchsorted(self.times, at + near, side="right") - 1, 0, max(last - 1, 0))
        after = np.minimum(key + 1, last)
        span = np.maximum(self.times[after] - self.times[key], 1e-12)
        share = np.clip((at - self.times[key]) / span, 0, 1)
        share = np.where(np.abs(at - self.times[key]) <= near, 0.0, share)
        share = np.where(np.abs(at - self.times[after]) <= near, 1.0, share)[:, None]
        if self.interpolation == "CUBICSPLINE":
            in_tangents, points, out_tangents = self.values[0::3], self.values[1::3], self.values[2::3]
            t, span = share, span[:, None]
            values = (
                (2 * t**3 - 3 * t**2 + 1) * points[key] + span * (t**3 - 2 * t**2 + t) * out_tangents[key]
                + (3 * t**2 - 2 * t**3) * points[after] + span * (t**3 - t**2) * in_tangents[after]
            )  # fmt: skip
        elif self.interpolation == "STEP":
            values = np.where(share < 1, self.values[key], self.values[after])
        elif is_rotation:
            values = _slerp(_unit(self.values[key]), _unit(self.values[after]), share)
        else:
            values = self.values[key] + share * (self.values[after] - self.values[key])
        return _unit(values)[:, [3, 0, 1, 2]] if is_rotation else values


def _unit(quaternions: Floats) -> Floats:
    """Quaternions (frames, 4) of length 1. Raises BadInput for one of length zero."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    if lengths.min(initial=1.0) < 1e-9:
        raise BadInput("damaged: a rotation of length zero")
    return quaternions / lengths


def _slerp(a: Floats, b: Floats, share: Floats) -> Floats:
    """Spherical interpolation of unit quaternions along the shorter arc."""
    dot = np.sum(a * b, axis=1, keepdims=True)
    b, dot = np.where(dot < 0, -b, b), np.minimum(np.abs(dot), 1.0)
    angle = np.arccos(dot)
    is_small = angle < 1e-4
    sine = np.where(is_small, 1.0, np.sin(angle))
    weight_a = np.where(is_small, 1 - share, np.sin((1 - share) * angle) / sine)
    return weight_a * a + np.where(is_small, share, np.sin(share * angle) / sine) * b
