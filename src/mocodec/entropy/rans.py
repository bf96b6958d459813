"""rANS (Duda 2013) with one state, integer only: symbols under static tables, one after the other.

For short streams: a loop over Python integers, and nothing spent on the state. Each symbol's table may be chosen from
what is already decoded. The state holds 32 bits and moves words of 16. `bulk` has many states for long streams.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..errors import Corrupt
from .models import PRECISION, TOTAL, Tables

Array = NDArray[Any]

LOW = 1 << 16  # a state is at least this, and below 2^32
MASK = TOTAL - 1
MANY = 64  # the low 14 bits of a stream with many states are less, of this one never


class Encoder:
    """Collects symbols in the order in which they will be decoded; `finish` makes the bytes."""

    def __init__(self) -> None:
        self._groups: list[tuple[Array, Array]] = []
        self._raw = np.zeros(0, np.uint8)

    def put(self, tables: Tables, table: Array, symbols: Array) -> None:
        """Symbols (n,), each under the table of its number (n,): one call for each call of `Decoder.next`.

        Raises ValueError for a symbol that its table cannot code.
        """
        at = np.asarray(table, np.int64) * tables.width + symbols
        frequency = tables.frequency.take(at)
        if not frequency.all():
            raise ValueError("a symbol of weight zero cannot be coded")
        self._groups.append((frequency, tables.start.take(at)))

    def raw(self, values: Array, bits: Array) -> None:
        """Non-negative integers of so many bits (0 … 64) each, without a model: once, after all symbols."""
        self._raw = _bits_of(values, bits)

    def finish(self) -> bytes:
        """The bytes."""
        frequency = np.concatenate([[TOTAL - MANY], *(f for f, _ in self._groups)])[::-1]
        start = np.concatenate([[MANY], *(c for _, c in self._groups)])[::-1]
        state, words = 1, []
        padded = np.packbits(np.concatenate([np.zeros(-len(self._raw) % 8, np.uint8), self._raw])).tobytes()
        for place, byte in enumerate(padded):
            bits = 8 if place else (len(self._raw) - 1) % 8 + 1
            if state >> 32 - bits:
                words.append(state & 0xFFFF)
                state >>= 16
            state = state << bits | byte
        if (kernel := native.kernel("entropy_encode")) is not None:
            state, more = kernel(frequency, start, state)
            head = state.to_bytes((state.bit_length() + 7) // 8, "little")
            return head + more[::-1].astype("<u2").tobytes() + np.array(words[::-1], "<u2").tobytes()
        full, rest = frequency << 32 - PRECISION, TOTAL - frequency
        for f, c, limit, r in zip(frequency.tolist(), start.tolist(), full.tolist(), rest.tolist(), strict=True):
            if state >= limit:
                words.append(state & 0xFFFF)
                state >>= 16
            state += state // f * r + c
        head = state.to_bytes((state.bit_length() + 7) // 8, "little")
        return head + np.array(words[::-1], "<u2").tobytes()


class Decoder:
    """Gives the symbols of an `Encoder` back, call for call. Every method raises Corrupt for damaged data.

    x: the state; words, at: those still to come from `words[at]`.
    """

    def __init__(self, data: bytes) -> None:
        if len(data) < 2:
            raise Corrupt("coded integers end too early")
        if int.from_bytes(data[:2], "little") & MASK < MANY:
            raise Corrupt("coded integers of an unknown kind")
        size = len(data) if len(data) <= 4 else 4 - len(data) % 2  # words follow only a state of three or four bytes
        self.at = 0
        self.words: list[int] = np.frombuffer(data, "<u2", offset=size).tolist() if size < len(data) else []
        x = int.from_bytes(data[:size], "little")
        self.x = (TOTAL - MANY) * (x >> PRECISION) + (x & MASK) - MANY
        self._refill()

    def next(self, tables: Tables, table: Array) -> Array:
        """The next symbols (n,), each under the table of its number (n,)."""
        return np.array([self._one(tables, t) for t in table.tolist()], tables.symbol.dtype)

    def _one(self, tables: Tables, table: int) -> int:
        frequency, start, symbols = tables.lists
        slot = self.x & MASK
        symbol = symbols[table << PRECISION | slot]
        at = table * tables.width + symbol
        self.x = frequency[at] * (self.x >> PRECISION) + slot - start[at]
        self._refill()
        return symbol

    def _refill(self) -> None:
        if self.x < LOW and self.at < len(self.words):
            self.x = self.x << 16 | self.words[self.at]
            self.at += 1

    def raw(self, bits: Array) -> NDArray[np.uint64]:
        """The integers of `Encoder.raw`, so many bits (0 … 64) each; once, at the end, which is checked."""
        total = int(bits.sum(dtype=np.int64))
        if total > 16 * len(self.words) + 32:
            raise Corrupt("coded integers end too early")
        pieces = []
        for some in (*[8] * (total // 8), total % 8):
            pieces.append(self.x & (1 << some) - 1)
            self.x >>= some
            self._refill()
        if self.x != 1 or self.at != len(self.words):
            raise Corrupt("coded integers do not end where they should")
        return _numbers_of(np.unpackbits(np.array(pieces[::-1], np.uint8))[8 - total % 8 :], bits)


def _bits_of(values: Array, bits: Array) -> NDArray[np.uint8]:
    """Integers of so many bits each as single bits, highest first."""
    values, bits = np.asarray(values).ravel().astype(np.uint64), np.asarray(bits).ravel().astype(np.int64)
    ends = np.cumsum(bits)
    total = int(ends[-1]) if len(ends) else 0
    place = np.repeat(ends, bits) - np.arange(1, total + 1)
    return (np.repeat(values, bits) >> place.astype(np.uint64) & np.uint64(1)).astype(np.uint8)


def _numbers_of(stream: Array, bits: Array) -> NDArray[np.uint64]:
    """The integers of `_bits_of`."""
    flat = np.asarray(bits).ravel().astype(np.int64)
    starts = np.cumsum(flat) - flat
    result = np.zeros(len(flat), np.uint64)
    more = np.arange(len(flat))
    for k in range(int(flat.max(initial=0))):
        more = more[flat[more] > k]
        result[more] = result[more] << np.uint64(1) | stream[starts[more] + k]
    return result.reshape(np.shape(bits))
