"""Whole numbers of any size as a symbol from a small alphabet and some raw bits.

magnitude 0 … 10       the symbol itself, no bits
beyond                 ranges of 2, 4, 8, … 512 numbers, as many bits as say which
≥ 1033                 the last symbol and 48 bits
sign                   one bit after those, for a magnitude that is not 0
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import bits

Integers = NDArray[np.int64]

DIRECT = 11
RANGES = 9
SYMBOLS = DIRECT + RANGES + 1
LARGEST = (1 << 48) - 1

WIDTHS = np.array([0] * DIRECT + list(range(1, RANGES + 1)) + [48])
FIRSTS = np.array([*range(DIRECT), *(DIRECT + (1 << j) - 2 for j in range(1, RANGES + 2))])


_OF = np.searchsorted(FIRSTS, np.arange(FIRSTS[-1] + 1), side="right") - 1


def of(magnitudes: Integers) -> Integers:
    """The symbol of each magnitude ≥ 0."""
    return _OF.take(magnitudes, mode="clip")


def raw(values: Integers, symbol: Integers, signed: int | None = None) -> bits.Bits:
    """The bits beside the symbols of these values (n,): what remains of each magnitude, then the signs of the first
    `signed` values (all, if not given)."""
    rest = bits.pack(np.abs(values) - FIRSTS[symbol], WIDTHS[symbol])
    with_sign = values[:signed]
    return np.concatenate([rest, (with_sign[with_sign != 0] < 0).astype(np.uint8)])


def raw_count(symbol: Integers, signed: int | None = None) -> int:
    """How many bits `raw` makes."""
    return int(WIDTHS.take(symbol).sum() + (symbol[:signed] > 0).sum())


def values(symbol: Integers, raw_bits: bits.Bits, signed: int | None = None) -> Integers:
    """The values of `raw`."""
    widths = WIDTHS.take(symbol)
    rest = int(widths.sum())
    result = FIRSTS.take(symbol)
    large = widths > 0
    if rest:
        result[large] += bits.unpack(raw_bits[:rest], widths[large])
    nonzero = np.flatnonzero(symbol[:signed] > 0)
    result[nonzero[raw_bits[rest : rest + len(nonzero)] == 1]] *= -1
    return result
