"""Integers for coefficients, chosen by error and bits together (rate–distortion optimisation).

coefficients in steps ─quantise─► integers, threshold of the coded zone, bits ─dequantise─► coefficients
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .... import native
from ....entropy import symbols
from ....typing import Floats, Integers
from . import contexts
from .plan import THRESHOLD_UNIT, Expectations
from .rows import HEADING, POSE

SLOPE = 0.16
"""λ: squared error, in squared steps, that one bit is worth. High-rate theory of uniform quantisers says 2 ln 2 / 12 =
0.116; more is better where most coefficients are zero."""
INWARD = 0.05
"""Reconstruction points lie this many steps inside the middle of their cells: small coefficients are likelier."""
FIRST_FREE_ROW = HEADING + 1
"""Integers of rows from here on are chosen by error and bits; those before are rounded to the nearest."""


class Quantised(NamedTuple):
    """values (frequencies, rows); threshold of the coded zone, in `THRESHOLD_UNIT`; bits: an estimate."""

    values: Integers
    threshold: int
    bits: float


def quantise(model: Expectations, scaled: Floats, step: int, slope: float = SLOPE) -> Quantised:
    """Integers for coefficients in steps, (frames, rows).

    Of the two integers next to each coefficient the one with less error² + λ · bits is chosen, and the coded zone ends
    where coding further coefficients costs more than the error that it removes. λ is `slope`. The heading is always
    rounded to the nearest integer.
    """
    known = _prediction(model, len(scaled), step)
    values = np.zeros(scaled.shape, np.int64)
    nearest = np.rint(np.abs(scaled)).astype(np.int64)
    frequencies = int(np.flatnonzero(nearest.any(axis=1)).max(initial=-1)) + 1
    if not frequencies:
        return Quantised(values, int(known.highest[0].max()) + 1, 0.0)
    base, highest, some = known.base[:frequencies], known.highest[:frequencies], scaled[:frequencies]
    if (kernel := native.kernel("tempo_quantise")) is not None:
        lookup = contexts.lookup(frequencies)
        some = np.ascontiguousarray(some)
        values[:frequencies], *rest = kernel(some, base, highest, prices(model), slope, INWARD, FIRST_FREE_ROW, *lookup)
        return Quantised(values, *rest)
    values[:frequencies], threshold, bits = _quantise(some, nearest[:frequencies], base, highest, prices(model), slope)
    return Quantised(values, threshold, bits)


def _quantise(
    scaled: Floats, nearest: Integers, base: Integers, highest: Integers, price: Floats, slope: float
) -> tuple[Integers, int, float]:
    """A coefficient whose nearest integer is zero becomes zero; the others are chosen in two passes."""
    there = np.flatnonzero(nearest)
    signed = scaled.ravel().take(there)
    size, high = np.abs(signed), nearest.ravel().take(there)
    free = there % scaled.shape[1] >= FIRST_FREE_ROW
    low = high - (free & (size < high))
    high_symbol, low_symbol = symbols.of_magnitudes(high), symbols.of_magnitudes(low)
    high_error, low_error = (size - _reconstructed(high)) ** 2, (size - _reconstructed(low)) ** 2
    magnitude = nearest
    magnitude.ravel()[there] = symbols.SMALLEST.take(high_symbol)
    for last in (False, True):
        tables = contexts.all_tables(base, magnitude)
        of_there = tables.ravel().take(there) * symbols.SYMBOLS
        high_bits, low_bits = price.take(of_there + high_symbol), price.take(of_there + low_symbol)
        lower = low_error + slope * low_bits < high_error + slope * high_bits
        if not last:
            magnitude.ravel()[there] = symbols.SMALLEST.take(np.where(lower, low_symbol, high_symbol))
    chosen, error = np.where(lower, low, high), np.where(lower, low_error, high_error)
    bits_each = price.take(tables * symbols.SYMBOLS)
    bits_each.ravel()[there] = np.where(lower, low_bits, high_bits)
    gain = bits_each * -slope
    gain.ravel()[there] += size**2 - error
    height = highest.ravel().take(there)
    must = height[(chosen > 0) & ~free]
    top = int(highest[0].max())
    uppermost = min(int(must.min(initial=top)), top)
    lowest = int(height[chosen > 0].min(initial=uppermost))
    above = np.maximum(highest - (lowest - 1), 0).ravel()  # 0: below every threshold that is considered
    worth, spent = (np.bincount(above, each.ravel())[::-1].cumsum()[::-1] for each in (gain, bits_each))
    worth[1] = worth[0]  # below `lowest` nothing is worth coding; the bits of the widest zone stand for all of it
    threshold = lowest + int(worth[1 : uppermost - lowest + 2].argmax())
    values = np.zeros(scaled.shape, np.int64)
    values.ravel()[there] = np.where(height >= threshold, np.copysign(chosen, signed), 0)
    return values, threshold, float(spent[threshold - lowest + 1])


def dequantise(values: Integers, sizes: Floats) -> Floats:
    """Coefficients of integers (frequencies, rows) and the step of each row."""
    inward = np.where(np.arange(values.shape[1]) < POSE, 0.0, INWARD)
    return (values - np.sign(values) * inward) * sizes


def _reconstructed(magnitudes: Integers) -> Floats:
    """What a magnitude of the pose decodes to."""
    return magnitudes - INWARD * (magnitudes > 0)


class _Prediction(NamedTuple):
    """What the model says of every coefficient of a chunk, (frames, rows): `contexts.base`, and the highest threshold
    whose coded zone includes the coefficient."""

    base: Integers
    highest: Integers


@lru_cache(maxsize=8)
def _prediction(model: Expectations, frames: int, step: int) -> _Prediction:
    logs = model.expected(frames, step)
    highest = np.maximum.accumulate(logs[::-1], axis=0)[::-1] // THRESHOLD_UNIT
    return _Prediction(contexts.base(logs), np.ascontiguousarray(highest))


@lru_cache(maxsize=4)
def prices(model: Expectations) -> Floats:
    """Bits of each symbol in each table, with its raw bits, (tables · symbols,)."""
    return (model.tables.cost + symbols.RAW_BITS + (np.arange(symbols.SYMBOLS) > 0)).ravel()
