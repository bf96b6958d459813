"""What a prior predicts of other coordinates than its own: bases, and the spreads of their rows.

    components of the prior ─linear map─► movements of these coordinates ─► bases (orthonormal, strongest first)
    spreads of the components ─squared map─► variances ─levels─► spreads

Five levels adapt the spreads to a recording: the gain of the predicted part at 1 Hz, and its slope per octave; the
strength of the unpredicted part at 1 Hz, and its slope; and white noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from ....errors import Corrupt
from ....typing import Floats, Integers
from ..coding import contexts
from ..coding.rows import HEADING, POSE
from . import ordered
from .model import BAND_EDGES_MHZ, Statistics

LEVEL_NAMES = ("gain", "gain_rise", "rest", "rest_rise", "white")
LEVELS = len(LEVEL_NAMES)
LEVEL_UNIT = 4
"""Levels are stored in 4/32 octave, that is, eighths of an octave."""
LARGEST_LEVEL = 2000
MEAN_BELOW = 128
"""The mean of a component over a chunk is expected this far (1/32 octave) below its spread at 0.2 Hz."""


@dataclass(frozen=True, eq=False)
class PredictedMotion:
    """For each band orthonormal rows (dimensions, coordinates), and the variance that the prior predicts of each at
    each frequency, (dimensions, frequencies)."""

    bases: tuple[Floats, ...]
    variances: tuple[Floats, ...]


def spreads(predicted: PredictedMotion, median_spread: Integers, levels: Integers) -> Integers:
    """Spreads of the rows, (rows, frequencies), at these levels. median_spread (frequencies,): of the prior's rows.

    Raises Corrupt for levels that overflow.
    """
    gain, gain_rise, rest, rest_rise, white = (int(v) * LEVEL_UNIT for v in levels)
    gains = ordered.square_of_exp2(gain + gain_rise * _OCTAVES // contexts.OCTAVE)
    noise = ordered.square_of_exp2(median_spread + rest + rest_rise * _OCTAVES // contexts.OCTAVE)
    noise = noise + ordered.square_of_exp2(np.full(len(_OCTAVES), white))
    if not (np.isfinite(gains).all() and np.isfinite(noise).all() and (noise > 0).all()):
        raise Corrupt("tempo: levels that are out of range")
    curves = [contexts.log2_of(v * gains + noise) // 2 for v in predicted.variances]
    return np.stack([curves[_band_of(f)][:, i] for i, f in enumerate(contexts.BANDS_MHZ)], axis=1)


_OCTAVES = contexts.log2(np.maximum(np.array(contexts.BANDS_MHZ), 1)) - contexts.log2(np.array([1000]))
_OCTAVES[0] = _OCTAVES[1]


def with_heading_and_place(
    known: Statistics, known_points: int, points: int, bases: tuple[Floats, ...], pose: Integers, means: Integers
) -> Statistics:
    """Statistics of other rows of the pose, (rows, frequencies) and (rows,): the heading and the place move as those
    of the prior's points do. Place is a mean times √points, so it scales with their number."""
    change = int(contexts.log2(np.array([known_points]))[0] - contexts.log2(np.array([points]))[0]) // 2
    moved, still = known.spreads[:POSE].copy(), known.means[:POSE].copy()
    moved[HEADING + 1 :] -= change
    still[HEADING + 1 :] -= change
    return Statistics(bases, np.concatenate([moved, pose]), np.concatenate([still, means]))


@cache
def frequencies_of(band: int) -> slice:
    """The frequencies among `BANDS_MHZ` that one basis serves."""
    inside = [i for i, f in enumerate(contexts.BANDS_MHZ) if _band_of(f) == band]
    return slice(inside[0], inside[-1] + 1)


@cache
def _band_of(millihertz: int) -> int:
    return sum(millihertz > e for e in BAND_EDGES_MHZ)
