"""Jumps that no body makes. They are found before coding, so that the motion around them does not pay for them.

a sample far from both its neighbours, which agree       a spike: interpolated here, restored by a correction
a jump after which the motion goes on                    a discontinuity: a new chunk begins there
"""

from __future__ import annotations

import numpy as np

from .... import native
from ....typing import Booleans, Floats

SMALLEST_LEAP_M = 0.08
"""A step shorter than this between two frames is never a jump,"""
LEAP_FACTOR = 6.0
"""nor is a step shorter than this many times the steps before and after it."""
SCANNED_FRAMES = 256
"""Looked at together: so few that they stay in the processor's cache."""
MAX_PER_SECOND = 1.0
"""A recording with more discontinuities than this is coded without chunk borders at them."""


def spikes(positions: Floats) -> Booleans:
    """Mask (frames, points) of the samples of positions (frames, points, 3) that are spikes."""
    found = np.zeros(positions.shape[:2], bool)
    for first in range(1, len(positions) - 1, SCANNED_FRAMES):
        middle = positions[first : min(first + SCANNED_FRAMES, len(positions) - 1)]
        before, after = (positions[first + to : first + to + len(middle)] for to in (-1, 1))
        off = middle - (before + after) / 2
        largest = max(off.max(initial=0.0), -off.min(initial=0.0))
        if not largest * 3**0.5 <= SMALLEST_LEAP_M:  # otherwise no length is above it
            lengths, across = _length(off), _length(after - before)
            here = (lengths > SMALLEST_LEAP_M) & (lengths > LEAP_FACTOR / 2 * across)
            found[first : first + len(middle)] = here
    found[1:-1] &= ~(found[2:] | found[:-2])
    return found


def without_spikes(positions: Floats, spikes_: Booleans) -> Floats:
    """The positions with each spike replaced by the mean of its neighbours in time."""
    if not spikes_.any():
        return positions
    out = positions.copy()
    frame, point = np.nonzero(spikes_)
    out[frame, point] = (positions[frame - 1, point] + positions[frame + 1, point]) / 2
    return out


def discontinuities(positions: Floats, rate: float) -> list[int]:
    """First frames, rising, after a discontinuity, in positions without spikes."""
    if len(positions) < 4:
        return []
    if (kernel := native.kernel("leap_frames")) is not None:
        leaps: list[int] = kernel(positions, SMALLEST_LEAP_M, LEAP_FACTOR)
    else:
        leaps = _leaps(positions)
    return [] if len(leaps) > 2 + MAX_PER_SECOND * len(positions) / rate else leaps


def _leaps(positions: Floats) -> list[int]:
    step = _length(np.diff(positions, axis=0))
    around = np.maximum(
        np.concatenate([step[1:2], step[:-1]]),
        np.concatenate([step[1:], step[-2:-1]]),
    )
    return (np.flatnonzero(((step > SMALLEST_LEAP_M) & (step > LEAP_FACTOR * around)).any(axis=1)) + 1).tolist()


def _length(vectors: Floats) -> Floats:
    return np.sqrt(np.einsum("...c,...c->...", vectors, vectors))
