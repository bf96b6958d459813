"""Whole numbers of any size as a symbol from a small alphabet and some raw bits (Exp-Golomb above `DIRECT`).

    magnitude 0 … 10     the symbol itself, no raw bits
    beyond               ranges of 2, 4, 8, … 512 magnitudes; as many raw bits as tell them apart
    ≥ 1033               the last symbol and 48 raw bits
    sign                 one raw bit behind all of those, for a magnitude that is not 0

`models.tokens` is a finer alphabet (four symbols an octave), for parametric laws; this one is for learned tables, which
should be small.
"""

from __future__ import annotations

import numpy as np

from ..typing import AnyInteger, Bytes, Integers
from . import bits

DIRECT = 11
RANGES = 9
SYMBOLS = DIRECT + RANGES + 1
LARGEST = (1 << 48) - 1

RAW_BITS = np.array([0] * DIRECT + list(range(1, RANGES + 1)) + [48])
"""How many raw bits each symbol has, without the sign."""
SMALLEST = np.array([*range(DIRECT), *(DIRECT + (1 << j) - 2 for j in range(1, RANGES + 2))])
"""The smallest magnitude of each symbol."""

_OF_MAGNITUDE = np.searchsorted(SMALLEST, np.arange(SMALLEST[-1] + 1), side="right") - 1


def of_magnitudes(magnitudes: AnyInteger) -> Integers:
    """The symbol of each magnitude from 0 to LARGEST."""
    return _OF_MAGNITUDE.take(magnitudes, mode="clip")


def raw_bits(values: Integers, symbols: AnyInteger, signed: int | None = None) -> Bytes:
    """The raw bits of values (n,) beside their symbols (n,): the rest of each magnitude, then the signs.

    signed: only the first `signed` values have signs, the others are not negative; all by default.
    """
    rest = bits.pack(np.abs(values) - SMALLEST[symbols], RAW_BITS[symbols])
    with_sign = values[:signed]
    return np.concatenate([rest, (with_sign[with_sign != 0] < 0).astype(np.uint8)])


def raw_bit_count(symbols: AnyInteger, signed: int | None = None) -> int:
    """How many raw bits values with these symbols have."""
    return int(RAW_BITS.take(symbols).sum() + (symbols[:signed] > 0).sum())


def values(symbols: AnyInteger, raw: Bytes, signed: int | None = None) -> Integers:
    """The values (n,) of symbols (n,) and the raw bits of `raw_bits`."""
    widths = RAW_BITS.take(symbols)
    rest = int(widths.sum())
    result = SMALLEST.take(symbols)
    if rest:
        large = widths > 0
        result[large] += bits.unpack(raw[:rest], widths[large])
    nonzero = np.flatnonzero(symbols[:signed] > 0)
    result[nonzero[raw[rest : rest + len(nonzero)] == 1]] *= -1
    return result
