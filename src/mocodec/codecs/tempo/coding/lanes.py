"""Interleaved range coding (rANS) with static integer tables, many lanes of many chunks at a time.

    symbols + the table of each ─encode─► words, states        states carry raw bits on top, so that lanes cost nothing
    words, states ─Lanes.take(tables)─► symbols, one per lane, as often as there are steps

A lane's state x lies in [2¹⁶, 2³²). Coding a symbol of frequency f (of 2¹²) from c on: x → ⌊x/f⌋·2¹² + x mod f + c;
16 bits move out to a word when x would grow too large (Duda, "Asymmetric numeral systems", 2013; the lanes of one
chunk share one sequence of words, in the order in which the decoder asks for them). The encoder may start each lane at
2¹⁶ + any 16 bits: the decoder finds them there at the end, so up to 16 raw bits a lane ride along.

All arithmetic is on integers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ....errors import Corrupt

Integers = NDArray[np.int64]

PRECISION = 12
TOTAL = 1 << PRECISION
LOWEST = 1 << 16
_WITHIN, _PRECISION, _LOWEST, _WORD = (np.array(n) for n in (TOTAL - 1, PRECISION, LOWEST, 16))
"""NumPy takes its own numbers sooner than Python's, and a decoder takes each many times."""


@dataclass(frozen=True, eq=False)
class Tables:
    """Frequencies (tables, symbols) that sum to 2¹² in each row; one more table, `idle`, codes nothing at no cost."""

    frequencies: Integers
    starts: Integers
    packed: Integers
    """For each table and value of a state's low 12 bits, within its symbol's range << 16 | the range's width."""
    symbols: Integers
    """For the same, the symbol."""

    @classmethod
    def of(cls, frequencies: NDArray[np.integer]) -> Tables:
        rows = np.concatenate([np.asarray(frequencies, np.int64), np.zeros((1, frequencies.shape[1]), np.int64)])
        rows[-1, 0] = TOTAL
        assert (rows.sum(axis=1) == TOTAL).all()
        assert (rows >= 0).all()
        starts = np.cumsum(rows, axis=1) - rows
        symbols = np.repeat(np.tile(np.arange(rows.shape[1]), len(rows)), rows.ravel())
        at = np.arange(rows.size // rows.shape[1] * TOTAL) // TOTAL
        within = np.tile(np.arange(TOTAL), len(rows)) - starts[at, symbols]
        return cls(rows, starts, within << 16 | rows[at, symbols], symbols)

    @classmethod
    def empty(cls) -> Tables:
        return cls.of(np.zeros((0, 1), np.int64))

    @cached_property
    def within(self) -> Integers:
        """`packed` in two: within its symbol's range,"""
        return self.packed >> 16

    @cached_property
    def widths(self) -> Integers:
        """and the range's width."""
        return self.packed & 0xFFFF

    @property
    def idle(self) -> int:
        return len(self.frequencies) - 1

    @property
    def nothing(self) -> int:
        """A place in `symbols` that holds symbol 0."""
        return self.idle << PRECISION

    def cost(self) -> NDArray[np.float64]:
        """Bits of each symbol in each table, (tables, symbols); a symbol that a table cannot code costs 1000."""
        return np.where(self.frequencies > 0, PRECISION - np.log2(np.maximum(self.frequencies, 1)), 1e3)


def encode(
    layouts: Sequence[tuple[Integers, Integers]], coder: Tables, raw: Sequence[Integers]
) -> list[tuple[Integers, NDArray[np.uint16]]]:
    """Of each chunk symbols (steps, lanes) with the table of each, and 16 raw bits a lane (lanes,) → final states
    (lanes,), words. The chunks are coded side by side."""
    frequencies = [coder.frequencies[tables, symbols] for symbols, tables in layouts]
    starts = [coder.starts[tables, symbols] for symbols, tables in layouts]
    assert all((f > 0).all() for f in frequencies)
    states = [LOWEST + r.astype(np.int64) for r in raw]
    edges = np.cumsum([0, *map(len, states)])
    shape = (max(map(len, frequencies), default=0), int(edges[-1]))
    every_f, every_c = np.full(shape, TOTAL), np.zeros(shape, np.int64)  # a symbol that is certain changes nothing
    for f, c, first in zip(frequencies, starts, edges, strict=False):
        every_f[: len(f), first : first + f.shape[1]] = f
        every_c[: len(f), first : first + f.shape[1]] = c
    state = np.concatenate([*states, np.zeros(0, np.int64)])
    words, of_lane = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    limits = every_f << (32 - PRECISION)
    every_r = TOTAL - every_f
    for f, c, r, limit in zip(every_f[::-1], every_c[::-1], every_r[::-1], limits[::-1], strict=True):
        full = np.flatnonzero(state >= limit)
        if len(full):
            moved = state[full]
            words.append((moved & 0xFFFF)[::-1])
            of_lane.append(full[::-1])
            state[full] = moved >> 16
        state += state // f * r + c
    sequence = np.concatenate(words)[::-1].astype(np.uint16)
    chunk = np.searchsorted(edges, np.concatenate(of_lane)[::-1], side="right") - 1
    by_chunk = sequence[np.argsort(chunk, kind="stable")]
    counts = np.bincount(chunk, minlength=len(layouts))
    return list(zip(np.split(state, edges[1:-1]), np.split(by_chunk, np.cumsum(counts)[:-1]), strict=True))


class Lanes:
    """The decoder's side: lanes of several chunks side by side, each chunk with its own words."""

    def __init__(self, states: Sequence[Integers], words: Sequence[NDArray[np.uint16]], coder: Tables) -> None:
        """states: one (lanes,) array a chunk, padded here to the same number of lanes."""
        width, longest = max(map(len, states)), max(map(len, words))
        self.state = np.full((len(states), width), LOWEST, np.int64)
        padded = np.zeros((len(states), longest + width), np.int64)
        self.lengths = np.array([len(w) for w in words])
        for j, (s, w) in enumerate(zip(states, words, strict=True)):
            self.state[j, : len(s)] = s
            padded[j, : len(w)] = w
        self.words = padded.ravel()
        self.first = np.arange(len(states))[:, None] * padded.shape[1] - 1
        self.next = self.first.copy()
        self.coder = coder

    def take(self, tables: Integers) -> Integers:
        """The next symbol of every lane, (chunks, lanes), given the table of each, times 2¹².

        It comes as a place in `Tables.symbols`, to be looked up for many steps at once.
        """
        x = self.state
        place = x & _WITHIN
        place += tables
        x >>= _PRECISION
        x *= self.coder.widths.take(place)
        x += self.coder.within.take(place)
        empty = x < _LOWEST
        at = empty.astype(np.int64)
        np.add.accumulate(at, 1, out=at)
        at += self.next
        self.next = at[:, -1:]
        word = self.words.take(at, mode="clip")
        word |= x << _WORD
        np.putmask(x, empty, word)
        return place

    def finish(self) -> tuple[list[int], list[Integers]]:
        """How many words each chunk used, and its last states, (lanes,) a chunk."""
        return (self.next - self.first)[:, 0].tolist(), list(self.state)


def bits_from_final_states(states: Integers, used: int, length: int) -> Integers:
    """The raw bits that rode in a chunk's lanes, (lanes,), after so many of its words were used. Raises Corrupt."""
    if used > length or (states >> 17).any() or (states < LOWEST).any():
        raise Corrupt("tempo: the coded numbers do not end where they should")
    return states - LOWEST
