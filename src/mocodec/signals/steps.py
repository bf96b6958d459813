"""Steps of the counts behind floats: candidates, which `form_choice` tries.

exact      all values are multiples of a number of few bits: the greatest common divisor
measured   the smallest gaps between values, refined on ever larger multiples; several offsets
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

SAMPLE = 1 << 13
"""Number of samples that steps are found from, about."""
FINEST = 2
"""Steps below 2 to this power last bits of the largest value are no counts, but the last bits of floats."""
FIRST_SAMPLE = 64
"""Number of values that show that most channels of floats have no exact step."""
NEAR_GAPS, MOST_STEPS_OF_GAP = 12, 20.5
MOST_DEVIATION = 0.2
"""Gaps between counts are whole numbers of steps: where at least NEAR_GAPS of up to MOST_STEPS_OF_GAP steps are farther
from them on average, there are no counts. It is 0.25 for gaps of any size."""


def candidates(values: Array, exact: float | None, mantissa_bits: int, most: int) -> list[tuple[float, float]]:
    """(step, offset) that may give a channel of floats (samples,) back, of at most `most` steps over its range.

    exact: the step that `binary` finds.
    """
    finite = values[np.isfinite(values)].astype(np.float64)
    if len(finite) < 2:
        return []
    distinct = distinct_of(finite[:: max(1, len(finite) // SAMPLE)])
    known = [] if exact is None else [(exact, 0.0)]
    if exact is not None and np.gcd.reduce(np.rint((distinct - distinct[0]) / exact).astype(np.int64)) == 1:
        return known  # no larger step gives all values back
    gaps = np.diff(distinct)
    gaps = gaps[gaps > np.abs(distinct).max() * 2.0 ** (FINEST - mantissa_bits)]
    if not len(gaps) or (distinct[-1] - distinct[0]) / gaps.min() > most:
        return known
    gap = _median(gaps[gaps <= 1.3 * gaps.min()])
    near = gaps[gaps < MOST_STEPS_OF_GAP * gap] / gap
    if len(near) >= NEAR_GAPS and np.abs(near - np.rint(near)).mean() > MOST_DEVIATION:
        return known
    found: list[tuple[float, float]] = []
    for offset in (0.0, float(distinct[np.abs(distinct).argmin()]), float(distinct[len(distinct) // 2])):
        step, counts = _refined(distinct, gap, offset)
        found += [(step, offset), (float(np.float32(step)), offset)]
        if offset and len(distinct) > 2 and np.ptp(counts):
            slope, intercept = _line(counts, distinct)
            found += [(slope, intercept), (slope, float(np.float32(intercept)))]
    return known + [(step, offset) for step, offset in dict.fromkeys(found) if step > 0]


def binary(values: Array, mantissa_bits: int) -> float | None:
    """The largest step of which a sample of values are exact multiples; None if it is too fine for counts."""
    some = values[:: max(1, len(values) // SAMPLE)].astype(np.float64)
    some = some[np.isfinite(some) & (some != 0)]
    if len(some) > 4 * FIRST_SAMPLE and _multiples(some[:: len(some) // FIRST_SAMPLE], mantissa_bits) is None:
        return None
    return _multiples(some, mantissa_bits)


def _multiples(values: NDArray[np.float64], mantissa_bits: int) -> float | None:
    """`binary` for all of these finite values other than 0."""
    if not len(values):
        return None
    significands, exponents = np.frexp(values)
    whole = np.ldexp(significands, 53).astype(np.int64)
    last_bits = exponents - 53 + np.frexp((whole & -whole).astype(np.float64))[1] - 1
    last = int(last_bits.min())
    least = float(np.abs(values).max()) * 2.0 ** (FINEST - mantissa_bits)
    if int(exponents.max()) - last > 53:
        return None
    step = float(np.ldexp(float(np.gcd.reduce(np.ldexp(values, -last).astype(np.int64))), last))
    return step if step >= least else None


def distinct_of(values: Array) -> Array:
    """The distinct ones of values (n,) that are no NaN, ascending."""
    ordered = np.sort(values)
    return ordered[np.concatenate([[True], ordered[1:] != ordered[:-1]])[: len(ordered)]]


def _median(values: NDArray[np.float64]) -> float:
    """As np.median, which takes longer for a few values."""
    ordered = np.sort(values)
    return float(ordered[(len(values) - 1) // 2] + ordered[len(values) // 2]) / 2


def _line(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Slope and intercept of the line through points (n,) in least squares."""
    x_mean, y_mean = x.mean(), y.mean()
    slope = float(((x - x_mean) * (y - y_mean)).sum() / ((x - x_mean) ** 2).sum())
    return slope, float(y_mean - slope * x_mean)


def _refined(distinct: NDArray[np.float64], step: float, offset: float) -> tuple[float, NDArray[np.float64]]:
    """The step of which values − offset are multiples, refined on ever larger multiples, and these multiples."""
    from_offset = distinct - offset
    by_size = from_offset[np.argsort(np.abs(from_offset))]
    count = 2
    while True:
        part = by_size[:count]
        multiples = np.rint(part / step)
        if (square := float((multiples * multiples).sum())) > 0:
            step = float((part * multiples).sum() / square) or step
        if count >= len(by_size):
            return step, np.rint(from_offset / step)
        count *= 2
