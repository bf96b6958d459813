"""What files leave unsaid or spell in many ways: units of length, and which way is up."""

from __future__ import annotations

import numpy as np

from ..motion import Floats

UNITS_M = {"mm": 1e-3, "cm": 1e-2, "dm": 1e-1, "m": 1.0, "in": 0.0254, "inch": 0.0254, "inches": 0.0254, "ft": 0.3048}


def guess_up(positions: Floats) -> str:
    """The vertical axis, "y" or "z", of people on a floor; positions (frames, points, 3) in metres.

    Along it the lowest point of a frame stays where it is while the body extends far: the axis with the smaller
    (standard deviation of the lowest point + 2 cm) / (median extent).
    """
    some = positions[:: max(1, len(positions) // 500)]
    some = some[~np.isnan(some[:, :, 0]).all(axis=1)]
    if not len(some):
        return "z"
    lowest, highest = np.nanmin(some, axis=1), np.nanmax(some, axis=1)
    scores = (lowest.std(axis=0) + 0.02) / (np.median(highest - lowest, axis=0) + 1e-6)
    return "y" if scores[1] < scores[2] else "z"
