"""Steps of the counts behind floats: candidates, which `forms` tries.

exact      all values are multiples of a number of few bits: the greatest common divisor
measured   the smallest gaps between values, refined on ever larger multiples; several offsets
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

SAMPLE = 1 << 14
"""Steps are found from about so many samples."""
FINEST = 2
"""Steps below 2 to this power last bits of the largest value are no counts, but the last bits of floats."""


def candidates(values: Array, mantissa_bits: int, most: int) -> list[tuple[float, float]]:
    """(step, offset) that may give a channel of floats (samples,) back, of at most `most` steps over its range."""
    finite = values[np.isfinite(values)].astype(np.float64)
    if len(finite) < 2:
        return []
    distinct = np.unique(finite[:: max(1, len(finite) // SAMPLE)])
    exact = binary(values, mantissa_bits)
    known = [] if exact is None else [(exact, 0.0)]
    gaps = np.diff(distinct)
    gaps = gaps[gaps > np.abs(distinct).max() * 2.0 ** (FINEST - mantissa_bits)]
    if not len(gaps) or (distinct[-1] - distinct[0]) / gaps.min() > most:
        return known
    gap = float(np.median(gaps[gaps <= 1.3 * gaps.min()]))
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
    significands, exponents = np.frexp(some)
    whole = np.ldexp(significands, 53).astype(np.int64)
    last_bits = exponents - 53 + np.frexp((whole & -whole).astype(np.float64))[1] - 1
    last = int(last_bits.min(initial=2000))
    if not len(some) or int(exponents.max()) - last > 53:
        return None
    step = float(np.ldexp(float(np.gcd.reduce(np.ldexp(some, -last).astype(np.int64))), last))
    return step if step >= float(np.abs(some).max()) * 2.0 ** (FINEST - mantissa_bits) else None


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
