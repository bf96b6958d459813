"""Many tokens at a time: the layout and the rANS states of long arrays, where one NumPy operation moves thousands.

    tokens ─► segments ─► diagonals of all segments ─► law from those before ─► rANS, a state for each place ─► bytes

A segment is some lanes over some steps. Step t of lane l lies on diagonal t + l, so all that it looks at (before it in
its lane, beside it in lanes before) lies on the two diagonals before. Diagonals are the rows of one array: what a
symbol looks at is that array, shifted. States hold 32 bits and move words of 16; probabilities have 12 bits, so that
symbol, frequency and place of a slot are one 32-bit number of a table that stays in the cache.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import Corrupt
from . import models

Array = NDArray[Any]

PRECISION = 12  # bits of a probability
TOTAL = 1 << PRECISION
LOW = 1 << 16  # a state is at least this, and below 2^32
ESCAPE = 255  # the symbol after which follows how far a token is beyond its law

LANES = 64  # of a segment, at most
STEPS = 128  # of a segment, at least, unless there are fewer
WIDE = 4096  # symbols that a NumPy operation should take at a time
BITS_PER_STATE = 400
TURNS = 15  # one diagonal takes at most so many

HEAVY = np.uint32(1 << 31)  # marks an escape in `Laws.code`

# operands of the inner loops: arrays without axes are what NumPy takes fastest
_ONE, _8, _12, _16, _20 = (np.array(n, np.uint32) for n in (1, 8, 12, 16, 20))
_BYTE, _MASK, _TOTAL = (np.array(n, np.uint32) for n in (255, TOTAL - 1, TOTAL))
_ONE64, _5, _31, _32, _64 = (np.array(n, np.uint64) for n in (1, 5, 31, 32, 64))
_THREE, _FOUR, _EIGHT = (np.array(n, np.uint16) for n in (3, 4, 8))


class Mixing(NamedTuple):
    """How the law of a token follows from those around: weights of past, past2, beside, beside2, corner, mean, given
    (as in `coder.MIXTURES`), and the law of each expected token in sixteenths."""

    weights: tuple[int, ...]
    ladder: NDArray[np.uint8]


class Laws(NamedTuple):
    """A family of laws and, as the last, the table of excess, for the inner loops.

    slots: at law × 2^12 + slot: frequency << 20 | place of the slot in its symbol << 8 | symbol.
    code: at law × 256 + token: frequency << 12 | start, and HEAVY for an escape. last: each law's first escaped token.
    """

    slots: NDArray[np.uint32]
    code: NDArray[np.uint32]
    last: NDArray[np.int64]


@cache
def laws(count: int, shape: int) -> Laws:
    """The first `count` laws of the ladder in one of `models.SHAPES`."""
    weights = [models.law(q, shape, PRECISION) for q in range(count)]
    reach = models.TOKENS if count == models.LAWS_LARGE else 64
    weights.append(models.excess(reach))
    slots, code, last = [], [], []
    for law, row in enumerate(weights):
        frequency = np.array(models.normalised(row, PRECISION), np.uint32)
        starts = np.cumsum(frequency, dtype=np.uint32) - frequency
        symbols = np.arange(len(row), dtype=np.uint32)
        costs = frequency << np.uint32(PRECISION) | starts
        last.append(len(row) - 1)
        if law < count:
            symbols[-1] = ESCAPE
            costs[-1] |= HEAVY
        inside = np.arange(TOTAL, dtype=np.uint32) - np.repeat(starts, frequency)
        slots.append(np.repeat(frequency << np.uint32(20) | symbols, frequency) | inside << np.uint32(8))
        code.append(np.concatenate([costs, np.repeat(costs[-1:], 256 - len(row))]))
    return Laws(np.concatenate(slots), np.concatenate(code), np.array(last))


class Layout:
    """(steps, lanes) as diagonals of segments.

    The longer axis is cut into pieces, their last padded with zeros; the shorter one into groups of lanes, the first
    of which may have one lane more than the others. A segment is one piece of one group.
    """

    def __init__(self, plain: tuple[int, int]) -> None:
        self.plain = plain
        self.turned = plain[1] > plain[0]
        self._long, self._short = plain[::-1] if self.turned else plain
        groups = -(-self._short // LANES)
        self.lanes = -(-self._short // groups)
        pieces = max(1, min(WIDE // self._short, self._long // STEPS))
        self.steps = -(-self._long // pieces)
        self.pieces = -(-self._long // self.steps)
        self.segments = groups * self.pieces
        self._full = (self._short - groups * (self.lanes - 1)) * self.pieces  # segments that have all the lanes
        self.row = (self.lanes + 2) * self.segments  # two lanes and two diagonals lie outside
        self.width = min(self.steps, self.lanes) * self.segments

    def diagonals(self) -> Iterator[tuple[int, int, int]]:
        """(diagonal, begin, end): its places in the flat array of `skewed`."""
        for i in range(self.steps + self.lanes - 1):
            low, high = max(0, i - self.steps + 1), min(self.lanes, i + 1)
            begin = (i + 2) * self.row + (low + 2) * self.segments
            missing = self.segments - self._full if high == self.lanes else 0
            if (count := (high - low) * self.segments - missing) > 0:
                yield i, begin, begin + count

    def empty(self, dtype: Any) -> Array:
        return np.zeros((self.steps + self.lanes + 1) * self.row, dtype)

    def _cube(self, flat: Array) -> Array:
        """The places of (steps, lanes, segments) in a flat array."""
        item = flat.itemsize
        strides = (self.row * item, (self.row + self.segments) * item, item)
        inside = flat[2 * self.row + 2 * self.segments :]
        return np.lib.stride_tricks.as_strided(inside, (self.steps, self.lanes, self.segments), strides)

    def _parts(self, cube: Array) -> Iterator[tuple[Array, slice]]:
        """Parts of a cube (steps, lanes, groups, pieces), and the lanes of the plain array that they are."""
        first = self._full // self.pieces * self.lanes
        for segments, lanes, plain in (
            (slice(0, self._full), self.lanes, slice(0, first)),
            (slice(self._full, None), self.lanes - 1, slice(first, None)),
        ):
            part = cube[:, :lanes, segments]
            if part.size:
                yield part.reshape(self.steps, lanes, -1, self.pieces), plain

    def skewed(self, plain: Array, dtype: Any) -> Array:
        """Diagonals, flat, from (steps, lanes)."""
        long = plain.T if self.turned else plain
        if (more := self.pieces * self.steps - self._long) > 0:
            long = np.concatenate([long, np.zeros((more, self._short), long.dtype)])
        flat = self.empty(dtype)
        for part, lanes in self._parts(self._cube(flat)):
            some = long[:, lanes].reshape(self.pieces, self.steps, part.shape[2], part.shape[1])
            part[...] = some.transpose(1, 3, 2, 0)
        return flat

    def back(self, flat: Array, dtype: Any) -> Array:
        """(steps, lanes) from diagonals."""
        long = np.empty((self.pieces * self.steps, self._short), dtype)
        for part, lanes in self._parts(self._cube(flat)):
            some = long[:, lanes].reshape(self.pieces, self.steps, part.shape[2], part.shape[1])
            some[...] = part.transpose(3, 0, 2, 1)
            long[:, lanes] = some.reshape(len(long), -1)
        return long[: self._long].T if self.turned else long[: self._long]


class _Around:
    """What is expected of each diagonal, from those before."""

    def __init__(self, layout: Layout, tokens: Array, weights: tuple[int, ...], given: Array | None) -> None:
        """tokens: flat (uint16), filled diagonal by diagonal. given: flat tokens of the caller's contexts."""
        self._layout, self._tokens, self._given = layout, tokens, given
        row, k = layout.row, layout.segments
        *near, mean, from_given = weights
        self._mean_weight, self._given_weight = np.array(mean, np.uint16), np.array(from_given, np.uint16)
        offsets = (row, 2 * row, row + k, 2 * row + 2 * k, 2 * row + k)
        self._near = [
            (np.array(w, np.uint16), [o for o, v in zip(offsets, near, strict=True) if v == w])
            for w in sorted({w for w in near if w})
        ]
        self._mean = np.zeros(layout.lanes * k, np.uint16)
        self._sum, self._part = np.zeros((2, layout.width), np.uint16)

    def expected(self, i: int, begin: int, end: int) -> Array:
        """Expected tokens of diagonal i in sixteenths (uint16), valid until the next call."""
        tokens, count = self._tokens, end - begin
        result, part = self._sum[:count], self._part[:count]
        if not self._near:
            result[:] = 0
        for place, (weight, offsets) in enumerate(self._near):
            mixed = part if place else result
            first = tokens[begin - offsets[0] : end - offsets[0]]
            for o in offsets[1:]:
                first = np.add(first, tokens[begin - o : end - o], out=mixed)
            np.multiply(first, weight, out=mixed)
            if place:
                np.add(result, part, out=result)
        if self._mean_weight:
            np.right_shift(self._means(i, begin, end), _FOUR, out=part)
            np.multiply(part, self._mean_weight, out=part)
            np.right_shift(part, _FOUR, out=part)
            np.add(result, part, out=result)
        if self._given_weight and self._given is not None:
            np.multiply(self._given[begin:end], self._given_weight, out=part)
            np.add(result, part, out=result)
        return result

    def _means(self, i: int, begin: int, end: int) -> Array:
        first = begin - (i + 2) * self._layout.row - 2 * self._layout.segments
        return self._mean[first : first + end - begin]

    def known(self, i: int, begin: int, end: int) -> None:
        """The tokens of diagonal i are there: carries them over the edges, where the next ones look."""
        tokens, k, row = self._tokens, self._layout.segments, self._layout.row
        left = (i + 2) * row
        if i < self._layout.steps:  # outside the first lane
            tokens[left : left + k] = tokens[left + k : left + 2 * k] = tokens[left + 2 * k : left + 3 * k]
        if self._mean_weight:
            means = self._means(i, begin, end)
            if i < self._layout.lanes + 2:
                ages = i - np.arange(self._layout.lanes * k)[: len(means)] // k - max(0, i - self._layout.steps + 1)
                speed = np.where(ages == 0, 1, np.where(ages < 3, 2, 3)).astype(np.uint16)
            else:
                speed = _THREE
            means -= means >> speed
            means += tokens[begin:end] << _EIGHT - speed
        if i + 1 < self._layout.lanes:  # before the first step of the next lane
            ours = left + (i + 2) * k
            newest = tokens[ours : ours + k]
            tokens[ours + k : ours + 2 * k] = tokens[ours + k - row : ours + 2 * k - row] = newest
            self._mean[(i + 1) * k : (i + 2) * k] = newest << np.uint16(8)


def pack(token: Array, values: Array, mixing: Mixing, table: Laws, given: Array | None, bits: float) -> bytes:
    """Tokens (steps, lanes) of `values`, laid out and coded. given: tokens of contexts. bits: how many are expected."""
    layout = Layout(token.shape)
    turns = min(TURNS, max(1, round(layout.width * BITS_PER_STATE / max(bits, 1))))
    index, ends = _indices(layout, token, mixing, given)
    code = table.code.take(index)
    there = np.flatnonzero(token)
    raw = _raw_bits(token.ravel()[there], values.ravel()[there])
    states = -(-layout.width // turns)
    hidden = np.zeros(16 * states, np.uint8)
    hidden[: len(raw)] = raw[: 16 * states]
    x = LOW | np.packbits(hidden).view(">u2").astype(np.uint32)

    words: list[bytes] = []
    escaped = np.flatnonzero(code >= HEAVY)
    law, tokens = (index[escaped] >> 8).astype(np.int64), index[escaped] & 255
    beyond = table.code.take((len(table.last) - 1) * 256 + tokens - table.last.take(law))
    code &= HEAVY - np.uint32(1)
    escapes_before = np.searchsorted(escaped, ends)
    for d in range(len(ends) - 1, 0, -1):
        if escapes_before[d] > escapes_before[d - 1]:
            _move_in(x, beyond[escapes_before[d - 1] : escapes_before[d]], words)
        _move_in(x, code[ends[d - 1] : ends[d]], words)

    extra = np.zeros(states, np.uint8)
    for k in range(17, 32):
        extra += x >> np.uint32(k) > 0
    nibbles = np.concatenate([extra, np.zeros(states % 2, np.uint8)]).reshape(-1, 2)
    heads = _fields((x ^ _ONE << extra.astype(np.uint32) + _16).astype(np.uint64), extra + np.uint8(16))
    return b"".join(
        [
            bytes([turns]),
            (nibbles[:, 0] << 4 | nibbles[:, 1]).tobytes(),
            np.packbits(heads).tobytes(),
            *reversed(words),
            np.packbits(raw[16 * states :]).tobytes(),
        ]
    )


def _indices(layout: Layout, token: Array, mixing: Mixing, given: Array | None) -> tuple[Array, list[int]]:
    """law × 256 + token of all symbols, diagonal after diagonal, and where each diagonal ends, from 0."""
    tokens = layout.skewed(token, np.uint16)
    hints = None if given is None else layout.skewed(given, np.uint16)
    around = _Around(layout, tokens, mixing.weights, hints)
    rung = mixing.ladder.astype(np.uint16) << np.uint16(8)
    index = np.empty(layout.steps * layout.lanes * layout.segments, np.uint16)
    ends = [0]
    for i, begin, end in layout.diagonals():
        here = index[ends[-1] : ends[-1] + end - begin]
        np.add(rung.take(around.expected(i, begin, end)), tokens[begin:end], out=here)
        around.known(i, begin, end)
        ends.append(ends[-1] + end - begin)
    return index[: ends[-1]], ends


def _move_in(x: Array, code: Array, words: list[bytes]) -> None:
    """Symbols into states, in turns where there are more, the last first."""
    states = len(x)
    for a in range((len(code) - 1) // states * states, -1, -states):
        some = code[a : a + states]
        s = x[: len(some)]
        frequency = some >> _12
        full = (s >= frequency << _20).nonzero()[0]
        if len(full):
            high = s.take(full)
            words.append(high.astype("<u2").tobytes())
            s[full] = high >> _16
        quotient = s // frequency
        np.subtract(_TOTAL, frequency, out=frequency)
        quotient *= frequency
        s += quotient
        s += some & _MASK


def unpack(data: bytes, shape: tuple[int, int], mixing: Mixing, table: Laws, given: Array | None) -> NDArray[np.int64]:
    """The values of `pack`. Raises Corrupt."""
    layout = Layout(shape)
    if not 1 <= data[0] <= TURNS:
        raise Corrupt("coded integers of an unknown kind")
    states = -(-layout.width // data[0])
    nibbles = np.frombuffer(data, np.uint8, min(len(data) - 1, (states + 1) // 2), 1)
    extra = np.stack([nibbles >> 4, nibbles & 15], axis=1).ravel()[:states].astype(np.uint8)
    at = 1 + len(nibbles)
    size = (int(extra.sum(dtype=np.int64)) + 16 * states + 7) // 8
    if len(extra) < states or len(data) < at + size:
        raise Corrupt("coded integers end too early")
    heads, _ = _numbers(np.unpackbits(np.frombuffer(data, np.uint8, size, at)), extra + np.uint8(16))
    x = heads.astype(np.uint32) | _ONE << extra.astype(np.uint32) + _16
    at += size
    words = np.frombuffer(data, "<u2", (len(data) - at) // 2, at).astype(np.uint32)

    token, used = _tokens(layout, x, words, mixing, table, given)
    rest = (
        np.unpackbits(np.frombuffer(data, np.uint8, offset=at + 2 * used)) if at + 2 * used < len(data) else extra[:0]
    )
    if (x >> np.uint32(16) != 1).any():
        raise Corrupt("coded integers do not end where they should")
    return _values(token, np.unpackbits((x & np.uint32(0xFFFF)).astype(">u2").view(np.uint8)), rest)


def _tokens(
    layout: Layout, x: Array, words: Array, mixing: Mixing, table: Laws, given: Array | None
) -> tuple[NDArray[np.uint8], int]:
    """Tokens (steps, lanes), and how many words they took. The states are left as they are after the last."""
    tokens = layout.empty(np.uint16)
    around = _Around(layout, tokens, mixing.weights, None if given is None else layout.skewed(given, np.uint16))
    rung = mixing.ladder.astype(np.int64) << PRECISION
    at = 0
    for i, begin, end in layout.diagonals():
        places = rung.take(around.expected(i, begin, end))
        here = tokens[begin:end]
        at = _move_out(x, table.slots, places, here, words, at)
        if b"\xff" in here.tobytes():
            escaped = (here == ESCAPE).nonzero()[0]
            last = table.last.take(mixing.ladder.take(around.expected(i, begin, end).take(escaped)))
            beyond = np.empty(len(escaped), np.uint16)
            at = _move_out(x, table.slots, np.full(len(escaped), len(table.last) - 1 << PRECISION), beyond, words, at)
            here[escaped] = np.minimum(last + beyond, 255)
        around.known(i, begin, end)
    token = layout.back(tokens, np.uint8)
    if token.max() >= models.TOKENS:
        raise Corrupt("coded integers out of range")
    return token, at


def _move_out(x: Array, slots: Array, places: Array, symbols: Array, words: Array, at: int) -> int:
    """Symbols out of states, each from 2^12 slots at its place; how many words have been taken."""
    states = len(x)
    for a in range(0, len(places), states):
        place = places[a : a + states]
        s = x[: len(place)]
        place += s & _MASK
        found = slots.take(place)
        symbols[a : a + states] = found & _BYTE
        s >>= _12
        s *= found >> _20
        found >>= _8
        found &= _MASK
        s += found
        short = (s < LOW).nonzero()[0]
        if len(short):
            new = words[at : at + len(short)]
            if len(new) < len(short):
                raise Corrupt("coded integers end too early")
            at += len(short)
            s[short] = s.take(short) << _16 | new
    return at


def _raw_bits(token: Array, values: Array) -> NDArray[np.uint8]:
    """Signs, then mantissas, as single bits; none of the values is zero."""
    signs = (values < 0).astype(np.uint8)
    bits = models.mantissa_bits(token)
    return np.concatenate([signs, _fields(np.abs(values).view(np.uint64), bits)]) if bits.any() else signs


def _values(token: NDArray[np.uint8], hidden: Array, rest: Array) -> NDArray[np.int64]:
    there = np.flatnonzero(token)
    every = np.concatenate([hidden, rest])
    if len(there) > len(every):
        raise Corrupt("coded integers end too early")
    values = token.astype(np.int64, order="C")
    flat, used = values.ravel(), len(there)
    if token.max() >= models.DIRECT:
        some = token.ravel()[there]
        mantissa, taken = _numbers(every[used:], models.mantissa_bits(some))
        used += taken
        flat[there] = models.floors().take(some) | mantissa.view(np.int64)
    if not 0 <= len(rest) - max(0, used - len(hidden)) < 8 or every[used:].any():
        raise Corrupt("coded integers do not end where they should")
    negative = there[every[: len(there)].view(np.bool_)]
    flat[negative] = -flat[negative]
    return values


def _fields(values: NDArray[np.uint64], bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The lowest so many bits (0 … 63) of each number, as single bits: first the lowest 32 of all that have as many,
    then the others of each."""
    wide = bits >= 32
    whole = np.zeros(0, np.uint8)
    if wide.any():
        whole = np.unpackbits(values[wide].astype(">u4").view(np.uint8))
        values, bits = np.where(wide, values >> np.uint64(32), values), np.where(wide, bits - np.uint8(32), bits)
    ends = np.cumsum(bits, dtype=np.uint64)
    starts = ends - bits
    word, place = (starts >> _5).astype(np.int64), starts & _31
    inside = values & (_ONE64 << bits.astype(np.uint64)) - _ONE64
    inside <<= _64 - place - bits
    first = np.flatnonzero(np.diff(word, prepend=-1))
    joined = np.bitwise_or.reduceat(inside, first)
    words = np.zeros(int(word[-1]) + 2, np.uint64)
    words[word[first]] = joined >> _32
    words[word[first] + 1] |= joined & np.uint64(0xFFFFFFFF)
    return np.concatenate([whole, np.unpackbits(words.astype(">u4").view(np.uint8))[: int(ends[-1])]])


def _numbers(stream: NDArray[np.uint8], bits: NDArray[np.uint8]) -> tuple[NDArray[np.uint64], int]:
    """The numbers of `_fields`, and how many bits of the stream they took. Raises Corrupt."""
    total = int(bits.sum(dtype=np.int64))
    if total > len(stream):
        raise Corrupt("coded integers end too early")
    wide = (bits >= 32).nonzero()[0]
    whole = np.packbits(stream[: 32 * len(wide)]).view(">u4")
    if len(wide):
        bits = np.where(bits >= 32, bits - np.uint8(32), bits)
    starts = np.cumsum(bits, dtype=np.uint64) - bits
    packed = np.packbits(stream[32 * len(wide) : total])
    words = np.concatenate([packed, np.zeros(8 - len(packed) % 4, np.uint8)]).view(">u4").astype(np.uint64)
    result = (words[:-1] << _32 | words[1:]).take((starts >> _5).astype(np.int64))
    result <<= starts & _31
    result >>= _64 - bits
    if len(wide):
        result[wide] = result[wide] << _32 | whole
    return result, total
