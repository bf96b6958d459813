"""Interleaved rANS with static integer tables: many lanes of many chunks at a time. The arithmetic is `rans`'s.

    symbols, the table of each ─encode─► final states, words         LaneDecoder.next(tables) ─► symbols of all lanes

A lane is a state of its own. The lanes of a chunk share one sequence of words, in the order in which the decoder needs
them. The encoder starts each lane at 2¹⁶ + 16 raw bits of the caller's, which the decoder finds in the state at the
end, so that a lane costs about four bits rather than 32.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..errors import Corrupt
from ..typing import AnyInteger, Floats, Integers
from . import rans
from .rans import LOW

PRECISION = 12
TOTAL = 1 << PRECISION
_SLOT_MASK, _LOW, _WORD_BITS = (np.array(n) for n in (TOTAL - 1, LOW, rans.WORD_BITS))
UNCODABLE_BITS = 1e3
"""The cost of a symbol that a table cannot code, for estimates."""


@dataclass(frozen=True, eq=False)
class StaticTables:
    """Frequencies (tables, symbols) that sum to 2¹² in each row. The last table, `idle`, codes symbol 0 at no cost."""

    frequencies: Integers
    starts: Integers

    @classmethod
    def of(cls, frequencies: NDArray[np.integer]) -> StaticTables:
        """From the frequencies of all tables but `idle`."""
        rows = np.concatenate([np.asarray(frequencies, np.int64), np.zeros((1, frequencies.shape[1]), np.int64)])
        rows[-1, 0] = TOTAL
        assert (rows.sum(axis=1) == TOTAL).all()
        assert (rows >= 0).all()
        return cls(rows, rans.starts_of(rows))

    @cached_property
    def _slots(self) -> tuple[Integers, Integers]:
        """`rans.slots_of`: megabytes, which the compiled decoder of whole chunks does not need."""
        return rans.slots_of(self.frequencies)

    @property
    def symbols(self) -> Integers:
        """For each table and slot, the symbol."""
        return self._slots[0]

    @cached_property
    def packed(self) -> Integers:
        """For each table and slot, offset from the symbol's first slot << 16 | frequency of the symbol."""
        symbols, offset = self._slots
        table = np.repeat(np.arange(len(self.frequencies)), TOTAL)
        return offset << 16 | self.frequencies[table, symbols]

    @cached_property
    def slot_offsets(self) -> Integers:
        """The first half of `packed`."""
        return self.packed >> 16

    @cached_property
    def slot_frequencies(self) -> Integers:
        """The second half of `packed`."""
        return self.packed & 0xFFFF

    @property
    def idle(self) -> int:
        """The table that codes symbol 0 and leaves the state as it is."""
        return len(self.frequencies) - 1

    @property
    def idle_place(self) -> int:
        """A place in `symbols` that holds symbol 0."""
        return self.idle << PRECISION

    @cached_property
    def cost(self) -> Floats:
        """Bits of each symbol in each table, (tables, symbols)."""
        bits = PRECISION - np.log2(np.maximum(self.frequencies, 1))
        return np.where(self.frequencies > 0, bits, UNCODABLE_BITS)


def encode(
    layouts: Sequence[tuple[AnyInteger, AnyInteger]], tables: StaticTables, initial_bits: Sequence[Integers]
) -> list[tuple[Integers, NDArray[np.uint16]]]:
    """Final states (lanes,) and words of each chunk.

    layouts: for each chunk symbols (steps, lanes) and the table of each, (steps, lanes). initial_bits: for each chunk
    16 raw bits a lane, (lanes,), which `bits_from_final_states` gives back. The chunks are coded side by side.
    """
    states = [LOW + bits.astype(np.int64) for bits in initial_bits]
    edges = np.cumsum([0, *map(len, states)])
    shape = (max((len(symbols) for symbols, _ in layouts), default=0), int(edges[-1]))
    frequency, start = np.full(shape, TOTAL), np.zeros(shape, np.int64)  # a certain symbol leaves a state as it is
    for (symbols, table), first in zip(layouts, edges, strict=False):
        here = np.s_[: len(symbols), first : first + symbols.shape[1]]
        frequency[here] = tables.frequencies[table, symbols]
        start[here] = tables.starts[table, symbols]
    assert (frequency > 0).all()
    state = np.concatenate([*states, np.zeros(0, np.int64)])
    words, of_lane = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for f, c in zip(frequency[::-1], start[::-1], strict=True):
        full, moved = rans.push(state, f, c, PRECISION)
        if len(full):
            words.append(moved[::-1])
            of_lane.append(full[::-1])
    sequence = np.concatenate(words)[::-1].astype(np.uint16)
    chunk = np.searchsorted(edges, np.concatenate(of_lane)[::-1], side="right") - 1
    by_chunk = sequence[np.argsort(chunk, kind="stable")]
    counts = np.bincount(chunk, minlength=len(layouts))
    return list(zip(np.split(state, edges[1:-1]), np.split(by_chunk, np.cumsum(counts)[:-1]), strict=True))


class LaneDecoder:
    """The inverse of `encode`: the lanes of several chunks side by side, each chunk with its own words.

    states (chunks, lanes): those of a chunk with fewer lanes are padded.
    """

    def __init__(self, states: Sequence[Integers], words: Sequence[NDArray[np.uint16]], tables: StaticTables) -> None:
        """states: the final states of each chunk, (lanes,)."""
        width, longest = max(map(len, states)), max(map(len, words))
        self.states = np.full((len(states), width), LOW, np.int64)
        padded = np.zeros((len(states), longest + width), np.int64)
        for j, (s, w) in enumerate(zip(states, words, strict=True)):
            self.states[j, : len(s)] = s
            padded[j, : len(w)] = w
        self._words = padded.ravel()
        self._first = np.arange(len(states))[:, None] * padded.shape[1] - 1
        self._last_taken = self._first.copy()
        self._tables = tables

    def next(self, tables: Integers) -> Integers:
        """The next symbol of every lane, (chunks, lanes), as a place in `StaticTables.symbols`, so that the symbols of
        many steps can be looked up at once. tables (chunks, lanes): the table of each, times 2¹²."""
        x = self.states
        place = x & _SLOT_MASK
        place += tables
        rans.pop(x, self._tables.slot_frequencies.take(place), self._tables.slot_offsets.take(place), PRECISION)
        empty = x < _LOW
        at = empty.astype(np.int64)
        np.add.accumulate(at, 1, out=at)
        at += self._last_taken
        self._last_taken = at[:, -1:]
        word = self._words.take(at, mode="clip")
        word |= x << _WORD_BITS
        np.putmask(x, empty, word)
        return place

    def finish(self) -> tuple[list[int], list[Integers]]:
        """How many words each chunk took, and its states that are left, (lanes,) a chunk."""
        return (self._last_taken - self._first)[:, 0].tolist(), list(self.states)


def bits_from_final_states(states: Integers, used: int, available: int) -> Integers:
    """The 16 raw bits that each lane (lanes,) started from, out of the states that are left after decoding.

    used, available: words that the chunk took and has. Raises Corrupt where no encoder started from such states.
    """
    if used > available or (states >> 17).any() or (states < LOW).any():
        raise Corrupt("coded integers do not end where they should")
    return states - LOW
