"""Uniform quantisation with a dead zone: values ⇄ integers.

    values ─forward─► ⌊|v| / step + rounding⌋ with the sign of v ─inverse─► multiples of the step

Steps are powers of 2^(1/64), a ladder whose rungs are numbered, so that a file stores a step as a small integer.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..errors import CannotEncode
from ..typing import Floats, Integers

LADDER = 64
"""Rungs to an octave of steps."""

LARGEST = 2.0**52
"""The limit of quantised values: above it float64 does not represent all integers."""


def forward(values: Floats, step: float | Floats, rounding: float | Floats = 0.5) -> Integers:
    """Integers of values; step broadcasts against them.

    rounding: 0.5 takes the nearest multiple. Less widens the dead zone around zero, which adds error and saves bits;
    for Laplacian coefficients 0.35 to 0.45 is near the best trade. Raises CannotEncode beyond ±2^52.
    """
    scaled = np.asarray(values / step)
    if scaled.size:
        require_exact(np.abs(scaled).max(), float(np.min(step)))
    return np.copysign(np.floor(np.abs(scaled) + rounding), scaled).astype(np.int64)


def require_exact(largest: float, step: float) -> None:
    """Raises CannotEncode for a largest magnitude, in steps of `step` metres, that float64 does not round exactly."""
    if not largest < LARGEST:
        raise CannotEncode(f"a value is more than 2^52 steps of {step:g} m: ask for a larger error")


def inverse(integers: Integers, step: float | Floats) -> Floats:
    """The values of integers: multiples of the step."""
    return np.asarray(integers * step, np.float64)


def rung(step: float) -> int:
    """The rung that is nearest to a step in metres: step ≈ 2^(rung / 64). Raises CannotEncode outside 2^±60."""
    if not 2.0**-60 <= step <= 2.0**60:
        raise CannotEncode(f"a step of {step:g} m is outside what can be stored")
    return round(LADDER * math.log2(step))


def step(rung: Any) -> float:
    """The step in metres of a rung."""
    octave, part = divmod(int(rung), LADDER)
    return math.ldexp(2.0 ** (part / LADDER), octave)
