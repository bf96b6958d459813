"""What files leave unsaid or spell in many ways: units of length, and which way is up."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import BadInput
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


def first_frame(source: Mapping[str, Any]) -> int:
    """The number that a file's first frame has; 1 where its source does not say one that can be."""
    first = source.get("first_frame")
    return first if isinstance(first, int) and 0 <= first < 1 << 31 else 1


def unit_of(source: Mapping[str, Any]) -> float:
    """Metres in the source's unit. Raises BadInput where it does not say one that can be."""
    unit_m = source.get("unit_m")
    if not isinstance(unit_m, float | int) or not 1e-9 < unit_m < 1e9:
        raise BadInput(f"the motion's source does not say its unit: unit_m is {unit_m!r:.40}")
    return float(unit_m)
