"""Interleaved rANS (Duda 2013), integer only: symbols under static tables, any number of states at a time.

For codecs that bring their own `Tables` and choose each symbol's table from what is already decoded. A stream has one
state (few symbols: a loop over Python integers, nothing spent on the state) or many (a NumPy operation moves all of
them). A state holds 32 bits and moves words of 16; many states start with 16 raw bits hidden in each, so that one
costs about 4 bits.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import Corrupt
from .models import PRECISION, TOTAL, Tables

Array = NDArray[Any]

LOW = 1 << 16  # a state is at least this, and below 2^32
MASK = TOTAL - 1
MANY = 64  # the first 14 bits of a stream with many states are less (the logarithm of their number), of one state never


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
        self._groups.append((frequency.astype(np.uint32), tables.start.take(at).astype(np.uint32)))

    def raw(self, values: Array, bits: Array) -> None:
        """Non-negative integers of so many bits (0 … 64) each, without a model: once, after all symbols."""
        self._raw = _bits_of(values, bits)

    def finish(self, states: int = 1) -> bytes:
        """The bytes. states: 1, or a power of two up to 2^15: more: faster where a call of `put` has many symbols."""
        return self._finish_one() if states == 1 else self._finish_many(states)

    def _finish_one(self) -> bytes:
        frequency = [TOTAL - MANY, *(f for group, _ in self._groups for f in group.tolist())]
        start = [MANY, *(c for _, group in self._groups for c in group.tolist())]
        state, words = 1, []
        padded = np.packbits(np.concatenate([np.zeros(-len(self._raw) % 8, np.uint8), self._raw])).tobytes()
        for place, byte in enumerate(padded):
            bits = 8 if place else (len(self._raw) - 1) % 8 + 1
            if state >> 32 - bits:
                words.append(state & 0xFFFF)
                state >>= 16
            state = state << bits | byte
        for f, c in zip(reversed(frequency), reversed(start), strict=True):
            if state >= f << 32 - PRECISION:
                words.append(state & 0xFFFF)
                state >>= 16
            state = (state // f << PRECISION) + state % f + c
        head = state.to_bytes((state.bit_length() + 7) // 8, "little")
        return head + np.array(words[::-1], "<u2").tobytes()

    def _finish_many(self, states: int) -> bytes:
        hidden = np.zeros(16 * states, np.uint8)
        hidden[: len(self._raw)] = self._raw[: 16 * states]
        x = LOW | np.packbits(hidden.reshape(states, 16), axis=1).view(">u2")[:, 0].astype(np.uint32)
        limit, low, precision = np.uint32(32 - PRECISION), np.uint32(16), np.uint32(PRECISION)
        words: list[Array] = []
        for frequency, start in reversed(self._groups):
            for a in reversed(range(0, len(frequency), states)):
                f, c = frequency[a : a + states], start[a : a + states]
                s = x[: len(f)]
                full = s >= f << limit
                words.append(s[full].astype("<u2"))
                s = np.where(full, s >> low, s)
                quotient = s // f
                x[: len(f)] = (quotient << precision) + (s - quotient * f) + c
        extra = (x[:, None] >> np.arange(17, 32, dtype=np.uint32) > 0).sum(axis=1)  # bits above the 17 that there are
        heads = _bits_of(
            np.stack([extra, x ^ (1 << extra + 16)], axis=1), np.stack([extra * 0 + 4, extra + 16], axis=1)
        )
        head = (states.bit_length() - 1).to_bytes(2, "little") + np.packbits(heads).tobytes()
        return b"".join(
            [head, *(w.tobytes() for w in reversed(words)), np.packbits(self._raw[16 * states :]).tobytes()]
        )


class Decoder:
    """Gives the symbols of an `Encoder` back, call for call. Every method raises Corrupt for damaged data.

    x: the state (an integer) or states (int64); words, at: those still to come from `words[at]`.
    """

    def __init__(self, data: bytes) -> None:
        self._data = bytes(data)
        first = int.from_bytes(data[:2], "little")
        self.at = 0
        if first & MASK >= MANY:
            self.states = 1
            size = (
                len(data) if len(data) <= 4 else 4 - len(data) % 2
            )  # words follow only a state of three or four bytes
            self.x: Any = int.from_bytes(data[:size], "little")
            self.words: Any = np.frombuffer(self._data, "<u2", offset=size).tolist() if size < len(data) else []
            self.x = (TOTAL - MANY) * (self.x >> PRECISION) + (self.x & MASK) - MANY
            self._refill()
        elif len(data) > 2 and 0 < first < 16:
            self.states = 1 << first
            self._open_many()
        else:
            raise Corrupt("coded integers end too early" if len(data) < 2 else "coded integers of an unknown kind")

    def _open_many(self) -> None:
        bits = np.unpackbits(np.frombuffer(self._data, np.uint8, count=-1, offset=2)[: 5 * self.states])
        nibble = (
            np.convolve(bits, [1, 2, 4, 8])[3:] if len(bits) > 3 else bits
        )  # at each place, the four bits from there
        at, starts, extra = 0, [], []
        for _ in range(self.states):
            if at >= len(bits) - 3:
                raise Corrupt("coded integers end too early")
            extra.append(int(nibble[at]) + 16)
            starts.append(at + 4)
            at += 4 + extra[-1]
        if at > len(bits):
            raise Corrupt("coded integers end too early")
        lengths = np.array(extra)
        self.x = (_numbers_at(bits, np.array(starts), lengths) | np.uint64(1) << lengths.astype(np.uint64)).astype(
            np.int64
        )
        self._words_from = 2 + (at + 7) // 8
        count = (len(self._data) - self._words_from) // 2
        self.words = np.frombuffer(self._data, "<u2", count, self._words_from).astype(np.int64) if count else self.x[:0]

    def next(self, tables: Tables, table: Array) -> Array:
        """The next symbols (n,), each under the table of its number (n,)."""
        if self.states == 1:
            return np.array([self._one(tables, t) for t in table.tolist()], tables.symbol.dtype)
        if len(table) <= self.states:
            return self._some(tables, table)
        parts = range(0, len(table), self.states)
        return np.concatenate([self._some(tables, table[a : a + self.states]) for a in parts])

    def _some(self, tables: Tables, table: Array) -> Array:
        at = table.astype(np.int64)
        x = self.x[: len(at)]
        slot = x & MASK
        symbol = tables.symbol.take((at << PRECISION) + slot)
        at *= tables.width
        at += symbol
        x >>= PRECISION
        x *= tables.frequency.take(at)
        x += slot
        x -= tables.start.take(at)
        short = (x < LOW).nonzero()[0]
        if len(short):
            words = self.words[self.at : self.at + len(short)]
            if len(words) < len(short):
                raise Corrupt("coded integers end too early")
            self.at += len(short)
            x[short] = (x.take(short) << 16) | words
        return symbol

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
        if total > 8 * len(self._data) + 16 * self.states:
            raise Corrupt("coded integers end too early")
        return _numbers_of(self._raw_one(total) if self.states == 1 else self._raw_many(total), bits)

    def _raw_one(self, total: int) -> Array:
        pieces = []
        for bits in (*[8] * (total // 8), total % 8):
            pieces.append(self.x & (1 << bits) - 1)
            self.x >>= bits
            self._refill()
        if self.x != 1 or self.at != len(self.words):
            raise Corrupt("coded integers do not end where they should")
        return np.unpackbits(np.array(pieces[::-1], np.uint8))[8 - total % 8 :]

    def _raw_many(self, total: int) -> Array:
        hidden = np.unpackbits((self.x & 0xFFFF).astype(">u2").view(np.uint8))
        rest = np.unpackbits(np.frombuffer(self._data[self._words_from + 2 * self.at :], np.uint8))
        every = np.concatenate([hidden, rest])
        wrong = not 0 <= len(rest) - max(0, total - len(hidden)) < 8 or every[total:].any()
        if wrong or (self.x >> 16 != 1).any():
            raise Corrupt("coded integers do not end where they should")
        return every


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
    return _numbers_at(stream, np.cumsum(flat) - flat, flat).reshape(np.shape(bits))


def _numbers_at(stream: Array, starts: Array, bits: Array) -> NDArray[np.uint64]:
    result = np.zeros(len(starts), np.uint64)
    more = np.arange(len(starts))
    for k in range(int(bits.max(initial=0))):
        more = more[bits[more] > k]
        result[more] = result[more] << np.uint64(1) | stream[starts[more] + k]
    return result
