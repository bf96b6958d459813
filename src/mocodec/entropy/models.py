"""Probabilities for the coder, in integers only: frequency tables, tokens for unbounded numbers, families of laws.

    number ──► sign, token, mantissa      tokens 0 … 15 are the magnitude itself; above, four tokens to an octave
    neighbours' tokens ──► expected magnitude ──► one law of `family`, a ladder of ever wider probability laws

A law is P(|v| ≥ a) = (1 + (β x + γ x²) / 12)⁻¹², x = (a − ½) / σ. With γ = 0 it is Lomax's: a Laplace law whose scale
is known only roughly, as it is here. The second shape comes near to a normal law. Both have tails heavy enough for
jumps and are computed exactly, in integers.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..typing import Bytes, Integers
from . import rans

PRECISION = 14  # bits of a probability
TOTAL = 1 << PRECISION

DIRECT = 16  # magnitudes that are tokens of their own
TOKENS = DIRECT + 4 * 59  # up to 2^63

SHAPES = ((25, 0), (16, 5))  # β and γ in twenty-fifths: Lomax, nearly normal
EXPONENT = 12
SCALE_UNIT = 4096  # a law's σ is an integer in these units
LADDER = (40, 50, 63)  # σ of the first three laws; each three on are twice as wide
LAWS, LAWS_LARGE = 54, 210  # laws for magnitudes up to about 2^14, and up to 2^62


class Tables:
    """Static probability tables: what a symbol costs under each of several laws.

    weights: for each table the symbols' integer weights, of any sum; tables may have different numbers of symbols, at
    least two and at most 65,535. A symbol of weight zero cannot be coded. Frequencies sum to 2^14 in each table.

    frequency, start: at table × width + symbol. symbol: at table × 2^14 + slot. sizes (count,): symbols of each table.
    """

    def __init__(self, weights: Sequence[Sequence[int] | NDArray[Any]]) -> None:
        self.count = len(weights)
        self.width = max(len(w) for w in weights)
        self.sizes = np.array([len(w) for w in weights])
        frequencies = np.zeros((self.count, self.width), np.int64)
        for table, row in enumerate(weights):
            frequencies[table, : len(row)] = rans.normalised([int(w) for w in row], PRECISION)
        self.frequency, self.start = frequencies.ravel(), rans.starts_of(frequencies).ravel()

    @cached_property
    def symbol(self) -> NDArray[Any]:
        """The symbol of each slot: what decoders need."""
        symbols = np.arange(self.width, dtype=np.uint8 if self.width <= 256 else np.uint16)
        return np.repeat(np.tile(symbols, self.count), self.frequency)

    @cached_property
    def lists(self) -> tuple[list[int], list[int], list[int]]:
        """frequency, start and symbol as lists: what a loop over single symbols reads fastest."""
        return self.frequency.tolist(), self.start.tolist(), self.symbol.tolist()


def tokens(magnitudes: NDArray[Any]) -> Bytes:
    """Token of each magnitude below 2^63."""
    table, most = _token_table(), int(magnitudes.max(initial=0))
    if most < len(table):
        return table.take(magnitudes.astype(np.int64, copy=False))
    rest, octaves = magnitudes, np.zeros(magnitudes.shape, np.uint8)
    while most >= len(table):
        large = rest >= len(table)
        rest = np.where(large, rest >> rest.dtype.type(12), rest)
        octaves += large * np.uint8(4 * 12)
        most >>= 12
    return table.take(rest.astype(np.int64, copy=False)) + octaves


@cache
def _token_table() -> Bytes:
    floors = [token_floor(t) for t in range(TOKENS) if token_floor(t) <= 1 << 16]
    return np.repeat(np.arange(len(floors) - 1, dtype=np.uint8), np.diff(floors))


def mantissa_bits(token: Bytes) -> Bytes:
    """Number of mantissa bits that follow each token."""
    return np.where(token < DIRECT, np.uint8(0), (np.maximum(token, DIRECT) - np.uint8(DIRECT)) // 4 + np.uint8(2))


def token_floor(token: int) -> int:
    """The smallest magnitude of a token."""
    return token if token < DIRECT else (4 + token % 4) << ((token - DIRECT) // 4 + 2)


@cache
def floors() -> Integers:
    """`token_floor` of all tokens."""
    return np.array([token_floor(t) for t in range(TOKENS)])


@cache
def family(laws: int, shape: int) -> Tables:
    """Tables of the first `laws` laws of the ladder in one of SHAPES, and of the excess as the last.

    The last symbol of a law is an escape: it stands for its token and all above. How far above follows as a symbol of
    the table of excess.
    """
    weights = [law(q, shape, PRECISION) for q in range(laws)]
    return Tables([*weights, excess(max(map(len, weights)))])


def excess(reach: int) -> list[int]:
    """Weights of how far a token is above the escape of its law, from 0 to `reach` − 1."""
    return [(1 << 20) // (e + 1) ** 2 for e in range(reach)]


def law(q: int, shape: int, precision: int) -> list[int]:
    """Weights of the tokens under law q of the ladder; the last is for all tokens that are together rarer than half of
    2^−precision."""
    scale, (linear, square) = LADDER[q % 3] << q // 3, SHAPES[shape]
    one = 1 << 62
    flat = 25 * EXPONENT * scale**2
    survival, weights = one, []
    for token in range(1, TOKENS):
        a = SCALE_UNIT * token_floor(token) - SCALE_UNIT // 2
        beyond = one * flat**EXPONENT // (flat + a * (linear * scale + square * a)) ** EXPONENT
        weights.append(max(1, survival - beyond))
        survival = beyond
        if survival << precision - 1 < one and token > 1:
            break
    return [*weights, max(1, survival)]


@cache
def law_of_expectation(laws: int, zero_law: int, offset: int) -> Bytes:
    """The law for each expected token in sixteenths, 0 … 16 × 255.

    zero_law: the law where all neighbours are zero. offset: how many rungs wider than usual the others are.
    """
    result = (usual_law() + offset).clip(0, laws - 1).astype(np.uint8)
    result[0] = zero_law
    return result


@cache
def usual_law() -> Integers:
    """The law of each expected token in sixteenths, 0 … 16 × 255, without an offset."""
    result = np.zeros(16 * 256, np.int64)
    law = 0
    for expected in range(1, len(result)):
        token = min(expected // 16, TOKENS - 2)
        low, high = token_floor(token), token_floor(token + 1)
        magnitude16 = 16 * low + (high - low) * (expected - 16 * token if expected < 16 * TOKENS else 0)
        scale = SCALE_UNIT * (15 * magnitude16 + 32) // 256  # σ = 15/16 |v| + 1/8
        while law < LAWS_LARGE and _rung(law) < scale:
            law += 1
        result[expected] = law
    return result


def _rung(q: int) -> int:
    """The widest σ for which law q is the nearest."""
    return (LADDER[q % 3] << q // 3) * 9 // 8
