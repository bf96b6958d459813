"""rANS with one state: symbols under static tables, one after the other. The arithmetic is `rans`'s.

For short streams: a loop over Python integers that spends no bits on the state. The table of each symbol may depend on
the symbols before it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..errors import Corrupt
from ..typing import AnyInteger, Bytes
from . import bits as bit_fields
from .models import PRECISION, TOTAL, Tables
from .rans import LOW, STATE_BITS, WORD_BITS

MASK = TOTAL - 1
MANY = 64
"""The low 14 bits of a stream with one state are at least this; those of a stream with many states are less."""


class StateEncoder:
    """Collects symbols in the order in which they will be decoded; `finish` makes the bytes."""

    def __init__(self) -> None:
        self._groups: list[tuple[AnyInteger, AnyInteger]] = []
        self._raw: Bytes = np.zeros(0, np.uint8)

    def put(self, tables: Tables, table: AnyInteger, symbols: AnyInteger) -> None:
        """Symbols (n,), each under the table of its number (n,): one call for each call of `StateDecoder.next`.

        Raises ValueError for a symbol that its table cannot code.
        """
        at = np.asarray(table, np.int64) * tables.width + symbols
        frequency = tables.frequency.take(at)
        if not frequency.all():
            raise ValueError("a symbol of weight zero cannot be coded")
        self._groups.append((frequency, tables.start.take(at)))

    def raw(self, values: AnyInteger, bits: AnyInteger) -> None:
        """Integers ≥ 0 of the given numbers of bits (0 … 64), without a model: once, behind all symbols."""
        self._raw = bit_fields.pack(np.asarray(values).ravel(), np.asarray(bits).ravel())

    def finish(self) -> bytes:
        """The bytes."""
        if (kernel := native.kernel("entropy_encode")) is not None:
            groups = [(np.zeros(0, np.int64), np.zeros(0, np.int64)), *self._groups]
            return kernel(*(np.concatenate(each) for each in zip(*groups, strict=True)), self._raw)
        frequency = np.concatenate([[TOTAL - MANY], *(f for f, _ in self._groups)])[::-1]
        start = np.concatenate([[MANY], *(c for _, c in self._groups)])[::-1]
        state, words = 1, list[int]()
        padded = np.packbits(np.concatenate([np.zeros(-len(self._raw) % 8, np.uint8), self._raw])).tobytes()
        for place, byte in enumerate(padded):
            bits = 8 if place else (len(self._raw) - 1) % 8 + 1
            if state >> STATE_BITS - bits:
                words.append(state & LOW - 1)
                state >>= WORD_BITS
            state = state << bits | byte
        limits, rest = frequency << STATE_BITS - PRECISION, TOTAL - frequency
        for f, c, limit, r in zip(frequency.tolist(), start.tolist(), limits.tolist(), rest.tolist(), strict=True):
            if state >= limit:
                words.append(state & LOW - 1)
                state >>= WORD_BITS
            state += state // f * r + c
        head = state.to_bytes((state.bit_length() + 7) // 8, "little")
        return head + np.array(words[::-1], "<u2").tobytes()


class StateDecoder:
    """Returns the symbols of an `StateEncoder`, call for call. Every method raises Corrupt for damaged data.

    x: the state; words, at: those still to come are `words[at:]`.
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

    def next(self, tables: Tables, table: AnyInteger) -> AnyInteger:
        """The next symbols (n,), each under the table of its number (n,)."""
        frequency, start, symbols = tables.lists
        x, at, words, width = self.x, self.at, self.words, tables.width
        found = list[int]()
        for own in table.tolist():
            slot = x & MASK
            symbol = symbols[own << PRECISION | slot]
            row = own * width + symbol
            x = frequency[row] * (x >> PRECISION) + slot - start[row]
            if x < LOW and at < len(words):
                x = x << WORD_BITS | words[at]
                at += 1
            found.append(symbol)
        self.x, self.at = x, at
        return np.array(found, tables.symbol.dtype)

    def _refill(self) -> None:
        if self.x < LOW and self.at < len(self.words):
            self.x = self.x << WORD_BITS | self.words[self.at]
            self.at += 1

    def raw(self, bits: AnyInteger) -> NDArray[np.uint64]:
        """The integers of `StateEncoder.raw`, given their widths (0 … 64 bits): once, at the end, which is checked."""
        total = int(bits.sum(dtype=np.int64))
        if total > 16 * len(self.words) + 32:
            raise Corrupt("coded integers end too early")
        pieces = self._low_bits(total)
        if self.x != 1 or self.at != len(self.words):
            raise Corrupt("coded integers do not end where they should")
        stream = np.unpackbits(pieces[::-1])[8 - total % 8 :]
        return bit_fields.unpack(stream, bits.ravel()).view(np.uint64).reshape(bits.shape)

    def _low_bits(self, total: int) -> Bytes:
        """`total` bits from the low end of the state: whole bytes, then the bits left over."""
        if (kernel := native.kernel("entropy_raw")) is not None:
            pieces, self.x, self.at = kernel(self.x, self.at, np.array(self.words, np.uint16), total)
            return pieces
        found: list[int] = []
        for width in (*[8] * (total // 8), total % 8):
            found.append(self.x & (1 << width) - 1)
            self.x >>= width
            self._refill()
        return np.array(found, np.uint8)
