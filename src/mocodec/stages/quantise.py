"""Uniform quantisation: lengths ⇄ integers.

    values ─forward─► ⌊|v| / step + rounding⌋ with v's sign ─inverse─► multiples of the step

Steps come from a ladder of 2^(1/64), so that a file holds one small integer for a step.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import CannotEncode
from ..motion import Floats

LADDER = 64
"""Rungs to an octave of steps."""

LARGEST = 2.0**52
"""No quantised value is beyond this: above it a float64 no longer tells integers apart."""


def forward(values: Floats, step: float | Floats, rounding: float | Floats = 0.5) -> NDArray[np.int64]:
    """Integers of values; step broadcasts against them.

    rounding 0.5 is the nearest multiple; less widens the zone around zero, which costs error and saves more bits
    (entropy-coded coefficients are Laplacian: 0.35 to 0.45 is near the best trade). Raises CannotEncode beyond ±2^52.
    """
    scaled = np.asarray(values / step)
    if scaled.size and not np.abs(scaled).max() < LARGEST:
        raise CannotEncode(f"a value is more than 2^52 steps of {np.min(step):g} m: ask for a larger error")
    return np.copysign(np.floor(np.abs(scaled) + rounding), scaled).astype(np.int64)


def inverse(integers: NDArray[np.int64], step: float | Floats) -> Floats:
    """Values of integers: exact multiples of the step."""
    return np.asarray(integers * step, np.float64)


def rung(step: float) -> int:
    """The ladder's nearest rung for a step in metres: step ≈ 2^(rung / 64). Raises CannotEncode outside 2^±60."""
    if not 2.0**-60 <= step <= 2.0**60:
        raise CannotEncode(f"a step of {step:g} m is outside what can be stored")
    return round(LADDER * math.log2(step))


def step(rung: Any) -> float:
    """The step in metres of a rung."""
    octave, part = divmod(int(rung), LADDER)
    return math.ldexp(2.0 ** (part / LADDER), octave)
