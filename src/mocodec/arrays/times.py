# pyright: strict
"""Frame numbers as seconds, and back to a rate and a first frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import BadInput
from ..typing import Floats

LARGEST_JITTER = 0.01
"""How far a time may be from an even grid, in frames; times are often rounded to milliseconds or float32."""


def seconds(frames: int, rate: float) -> Floats:
    """The time of each frame, seconds from the first."""
    return np.arange(frames) / rate


def rate_of(times: ArrayLike, attributes: Mapping[str, Any]) -> float:
    """Frames per second of evenly spaced times (frames,) in seconds; of a single frame, the attribute rate or fps.

    An attribute that agrees with the times is more exact than they are. Raises BadInput without either, and for times
    that are not evenly spaced.
    """
    at = np.asarray(times, np.float64)
    given = next((float(attributes[name]) for name in ("rate", "fps") if attributes.get(name)), None)
    if len(at) < 2:
        if given is None:
            raise BadInput("the rate of a single frame is needed: set the attribute rate (hertz)")
        return given
    step = float(at[-1] - at[0]) / (len(at) - 1)
    if not (np.isfinite(step) and step > 0):
        raise BadInput("times must be seconds that increase from frame to frame")
    even = at[0] + step * np.arange(len(at))
    if np.abs(at - even).max() > max(LARGEST_JITTER * step, 1e-3 if given is not None else 0):
        raise BadInput("times must be evenly spaced; resample them first")
    is_confirmed = given is not None and abs(given * step - 1) < LARGEST_JITTER
    return given if given is not None and is_confirmed else 1 / step
