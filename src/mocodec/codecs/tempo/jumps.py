"""What no body does: points that leap in one frame. Found before coding, so that the motion around them does not pay.

a sample far from both its neighbours       a spike: bridged here, and put back by a correction
a leap after which the motion goes on       a cut: a new chunk begins there
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...motion import Floats

LEAP_M = 0.08
"""A step shorter than this is never a leap,"""
LEAP_TIMES = 6.0
"""nor is one shorter than this many times the steps before and after it."""
CUTS_PER_SECOND = 1.0
"""Motion that leaps more often than this is no body's, and is left as it is."""


def spikes(positions: Floats) -> NDArray[np.bool_]:
    """Which samples of positions (frames, points, 3) lie far from both neighbours, which agree: (frames, points)."""
    found = np.zeros(positions.shape[:2], bool)
    if len(positions) > 2:
        off = _length(positions[1:-1] - (positions[:-2] + positions[2:]) / 2)
        across = _length(positions[2:] - positions[:-2])
        found[1:-1] = (off > LEAP_M) & (off > LEAP_TIMES / 2 * across)
        found[1:-1] &= ~(found[2:] | found[:-2])
    return found


def bridged(positions: Floats, spikes_: NDArray[np.bool_]) -> Floats:
    """The positions with each spike replaced by the middle of its neighbours."""
    if not spikes_.any():
        return positions
    out = positions.copy()
    frame, point = np.nonzero(spikes_)
    out[frame, point] = (positions[frame - 1, point] + positions[frame + 1, point]) / 2
    return out


def cuts(positions: Floats, rate: float) -> list[int]:
    """Frames (rising) at which a leap ends and a new chunk should begin; spikes are to be bridged before."""
    if len(positions) < 4:
        return []
    step = _length(np.diff(positions, axis=0))
    around = np.maximum(
        np.concatenate([step[1:2], step[:-1]]),
        np.concatenate([step[1:], step[-2:-1]]),
    )
    leaps = np.flatnonzero(((step > LEAP_M) & (step > LEAP_TIMES * around)).any(axis=1)) + 1
    return [] if len(leaps) > 2 + CUTS_PER_SECOND * len(positions) / rate else leaps.tolist()


def _length(vectors: Floats) -> Floats:
    return np.sqrt(np.einsum("...c,...c->...", vectors, vectors))
