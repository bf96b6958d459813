"""The arithmetic of rANS that every coder here shares (Duda, "Asymmetric numeral systems", 2013), integers only.

A state x lies in [2¹⁶, 2³²) between symbols. For a symbol of frequency f, of 2^p in all, whose slots begin at c:

    push    x → ⌊x / f⌋ · 2^p + x mod f + c             first a word of 16 bits moves out where x ≥ f · 2^(32−p)
    pop     slot = x mod 2^p names the symbol;  x → f · ⌊x / 2^p⌋ + slot − c       then a word moves in where x < 2¹⁶

The decoder pops what the encoder pushed, last symbol first. The coders differ in how many states they have and in the
order of their words: `one_state` for short streams, `lanes` for static tables, `bulk` for long arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from ..typing import AnyInteger, Integers

LOW = 1 << 16
"""A state between symbols is at least this."""
STATE_BITS = 32
WORD_BITS = 16


@cache
def _scalars(dtype: np.dtype[np.generic], precision: int) -> tuple[AnyInteger, AnyInteger, AnyInteger, AnyInteger]:
    """precision, STATE_BITS − precision, 2^precision and WORD_BITS: NumPy is fastest with arrays without axes."""
    numbers = (precision, STATE_BITS - precision, 1 << precision, WORD_BITS)
    return tuple(np.array(n, dtype) for n in numbers)  # pyright: ignore[reportReturnType]


def push(states: AnyInteger, frequency: AnyInteger, start: AnyInteger, precision: int) -> tuple[AnyInteger, AnyInteger]:
    """A symbol into each state (n,), in place, given its frequency and first slot (n,).

    Returns which states moved a word out first, and those words, in the order of the states. All arrays have one type,
    int64 or uint32; frequencies are less than 2^precision for uint32.
    """
    _, limit_shift, total, word_bits = _scalars(states.dtype, precision)
    full = (states >= frequency << limit_shift).nonzero()[0]
    words = states.take(full)
    if len(full):
        states[full] = words >> word_bits
        words &= np.array(LOW - 1, states.dtype)
    quotient = states // frequency
    quotient *= total - frequency
    states += quotient
    states += start
    return full, words


def pop(states: AnyInteger, frequency: AnyInteger, offset: AnyInteger, precision: int) -> None:
    """Take symbols out of states, in place, before words move in. offset: of each state's slot from the first slot of
    its symbol, slot − c."""
    states >>= _scalars(states.dtype, precision)[0]
    states *= frequency
    states += offset


def normalised(weights: Sequence[int], precision: int) -> list[int]:
    """Frequencies that sum to 2^precision in proportion to weights: at least 1 for every weight that is not zero, and
    less than 2^precision."""
    used = [i for i, w in enumerate(weights) if w > 0]
    if len(used) == 1:  # a frequency of 2^precision would overflow a state of 32 bits
        used.append(used[0] + 1 if used[0] + 1 < len(weights) else used[0] - 1)
    room, total = (1 << precision) - len(used), sum(weights)
    frequency, below = [0] * len(weights), 0
    for i in used:
        upto = below + weights[i]
        frequency[i] = 1 + room * upto // total - room * below // total
        below = upto
    return frequency


def starts_of(frequencies: Integers) -> Integers:
    """The first slot of each symbol, (tables, symbols), from frequencies (tables, symbols)."""
    return np.cumsum(frequencies, axis=1) - frequencies


def slots_of(frequencies: Integers) -> tuple[Integers, Integers]:
    """The symbol of each slot and its offset from that symbol's first slot, (tables · 2^p,) each, table after table.

    frequencies (tables, symbols) sum to 2^p in each row.
    """
    tables, symbols = frequencies.shape
    total = int(frequencies[0].sum())
    flat = frequencies.ravel()
    offset = np.tile(np.arange(total), tables) - np.repeat(starts_of(frequencies).ravel(), flat)
    return np.repeat(np.tile(np.arange(symbols), tables), flat), offset
