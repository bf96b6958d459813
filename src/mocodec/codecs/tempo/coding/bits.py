"""Numbers of given widths as a row of bits, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .... import native

Integers = NDArray[np.int64]
Bits = NDArray[np.uint8]


def pack(values: Integers, widths: Integers) -> Bits:
    """Each value (n,) in its own number of bits (n,), highest first → one array of 0 and 1."""
    if (kernel := native.kernel("tempo_pack_bits")) is not None:
        return kernel(values, widths)
    number, place = _places(widths)
    return (values[number] >> place & 1).astype(np.uint8)


def unpack(bits: Bits, widths: Integers) -> Integers:
    """The values (n,) of `pack`; bits that are not there read as 0."""
    if (kernel := native.kernel("tempo_unpack_bits")) is not None:
        return kernel(bits, widths)
    number, place = _places(widths)
    have = np.zeros(len(number), np.int64)
    have[: len(bits)] = bits[: len(number)]
    return np.bincount(number, have * 2.0**place, minlength=len(widths)).astype(np.int64)


def of_words(words: Integers) -> Bits:
    """`pack` of numbers of 16 bits each."""
    return np.unpackbits(words.astype(">u2").view(np.uint8))


def _places(widths: Integers) -> tuple[Integers, Integers]:
    number = np.repeat(np.arange(len(widths)), widths)
    place = np.repeat(np.cumsum(widths), widths) - 1 - np.arange(len(number))
    return number, place
