"""Whole numbers of given widths as single bits, and back: for what no model predicts (signs, mantissas).

pack, unpack                one number after the other, highest bit first
pack_split, unpack_split    the same in bulk: of numbers of 32 bits or more, first the lowest 32, then the rest of each
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..errors import Corrupt
from ..typing import AnyInteger, Bytes, Integers

_ONE, _5, _31, _32, _64 = (np.array(n, np.uint64) for n in (1, 5, 31, 32, 64))


def pack(values: AnyInteger, widths: AnyInteger) -> Bytes:
    """Bits (sum of widths,), each 0 or 1, of values (n,) ≥ 0 in widths (n,) from 0 to 64."""
    values, widths = values.astype(np.int64), widths.astype(np.int64)
    if (kernel := native.kernel("entropy_pack_bits")) is not None:
        return kernel(values, widths)
    ends = np.cumsum(widths)
    place = np.repeat(ends, widths) - np.arange(1, widths.sum() + 1)
    return (np.repeat(values, widths) >> place & 1).astype(np.uint8)


def unpack(bits: Bytes, widths: AnyInteger) -> Integers:
    """The values (n,) of `pack`; bits that are missing at the end count as 0. A value of 64 bits wraps around."""
    widths = widths.astype(np.int64)
    if (kernel := native.kernel("entropy_unpack_bits")) is not None:
        return kernel(bits, widths)
    ends = np.cumsum(widths)
    total = int(widths.sum())
    stream = np.zeros(total, np.int64)
    stream[: len(bits)] = bits[:total]
    starts = ends - widths
    result = np.zeros(len(widths), np.int64)
    longer = np.arange(len(widths))
    for k in range(int(widths.max(initial=0))):
        longer = longer[widths[longer] > k]
        result[longer] = result[longer] << 1 | stream[starts[longer] + k]
    return result


def from_words(words: AnyInteger) -> Bytes:
    """The bits of words of 16 bits, highest first."""
    return np.unpackbits(words.astype(">u2").view(np.uint8))


def pack_split(values: NDArray[np.uint64], widths: Bytes) -> Bytes:
    """Bits of the lowest `widths` (0 … 63) bits of each value: first the lowest 32 of all that have as many, then what
    is left of each."""
    wide = widths >= 32
    whole = np.zeros(0, np.uint8)
    if wide.any():
        whole = np.unpackbits(values[wide].astype(">u4").view(np.uint8))
        values, widths = np.where(wide, values >> _32, values), np.where(wide, widths - np.uint8(32), widths)
    ends = np.cumsum(widths, dtype=np.uint64)
    starts = ends - widths
    word, place = (starts >> _5).astype(np.int64), starts & _31
    inside = values & (_ONE << widths.astype(np.uint64)) - _ONE
    inside <<= _64 - place - widths
    first = np.flatnonzero(np.diff(word, prepend=-1))
    joined = np.bitwise_or.reduceat(inside, first)
    words = np.zeros(int(word[-1]) + 2, np.uint64)
    words[word[first]] = joined >> _32
    words[word[first] + 1] |= joined & np.uint64(0xFFFFFFFF)
    return np.concatenate([whole, np.unpackbits(words.astype(">u4").view(np.uint8))[: int(ends[-1])]])


def unpack_split(bits: Bytes, widths: Bytes) -> tuple[NDArray[np.uint64], int]:
    """The values of `pack_split`, and how many bits they took. Raises Corrupt where there are too few."""
    total = int(widths.sum(dtype=np.int64))
    if total > len(bits):
        raise Corrupt("coded integers end too early")
    wide = (widths >= 32).nonzero()[0]
    whole = np.packbits(bits[: 32 * len(wide)]).view(">u4")
    if len(wide):
        widths = np.where(widths >= 32, widths - np.uint8(32), widths)
    starts = np.cumsum(widths, dtype=np.uint64) - widths
    packed = np.packbits(bits[32 * len(wide) : total])
    words = np.concatenate([packed, np.zeros(8 - len(packed) % 4, np.uint8)]).view(">u4").astype(np.uint64)
    result = (words[:-1] << _32 | words[1:]).take((starts >> _5).astype(np.int64))
    result <<= starts & _31
    result >>= _64 - widths
    if len(wide):
        result[wide] = result[wide] << _32 | whole
    return result, total
