"""Long arrays of tokens: thousands of rANS states, where one NumPy operation moves thousands of symbols.

    tokens ─► diagonals of segments (`layout`) ─► law from the two diagonals before ─► rANS ─► bytes

There is a state for each place of a diagonal. Probabilities have 12 bits, so that symbol, frequency and offset of a
slot are one 32-bit number, and the table of all slots stays in the processor's cache.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..errors import Corrupt
from ..typing import AnyInteger, Bytes, Integers
from . import bits as bit_fields
from . import models, rans
from .layout import Layout

PRECISION = 12
"""Bits of a probability."""
TOTAL = 1 << PRECISION
ESCAPE = 255
"""The symbol for a token beyond its law; how far beyond follows."""

BITS_PER_STATE = 400
"""Bits per state at which the cost of a state is small."""
MAX_TURNS = 15
"""A diagonal is coded in at most this many turns, each with all states."""

ESCAPE_FLAG = np.uint32(1 << 31)
"""Marks an escape in `Laws.code`."""

# operands of the inner loops: NumPy is fastest with arrays without axes
_ONE, _8, _12, _16, _20 = (np.array(n, np.uint32) for n in (1, 8, 12, 16, 20))
_BYTE, _MASK = (np.array(n, np.uint32) for n in (255, TOTAL - 1))
_THREE, _FOUR, _EIGHT = (np.array(n, np.uint16) for n in (3, 4, 8))


class Mixing(NamedTuple):
    """How the law of a token follows from its neighbours: their weights (one of `neighbours.MIXTURES`), and the law of
    each expected token in sixteenths."""

    weights: tuple[int, ...]
    ladder: Bytes


class Laws(NamedTuple):
    """The tables of a family of laws, and of the excess as the last, for the inner loops.

    slots: at law × 2^12 + slot: frequency << 20 | offset of the slot in its symbol << 8 | symbol. symbols: those of the
    slots alone. code: at law × 256 + token: frequency << 12 | start, and ESCAPE_FLAG for an escape. last: each law's
    first token that is an escape.
    """

    slots: NDArray[np.uint32]
    symbols: Bytes
    code: NDArray[np.uint32]
    last: Integers


@cache
def laws(count: int, shape: int) -> Laws:
    """The first `count` laws of the ladder in one of `models.SHAPES`."""
    weights = [models.law(q, shape, PRECISION) for q in range(count)]
    weights.append(models.excess(models.TOKENS if count == models.LAWS_LARGE else 64))
    slots, code, last = [], [], []
    for law, row in enumerate(weights):
        frequency = np.array([rans.normalised(row, PRECISION)])
        costs = (frequency << PRECISION | rans.starts_of(frequency))[0].astype(np.uint32)
        symbol, offset = rans.slots_of(frequency)
        slot_frequency = frequency[0].take(symbol)
        last.append(len(row) - 1)
        if law < count:
            symbol[symbol == len(row) - 1] = ESCAPE
            costs[-1] |= ESCAPE_FLAG
        slots.append((slot_frequency << 20 | offset << 8 | symbol).astype(np.uint32))
        code.append(np.concatenate([costs, np.repeat(costs[-1:], 256 - len(row))]))
    of_slots = np.concatenate(slots)
    return Laws(of_slots, of_slots.astype(np.uint8), np.concatenate(code), np.array(last))


class _DiagonalContexts:
    """The expected tokens of each diagonal, from the diagonals before it."""

    def __init__(self, layout: Layout, tokens: AnyInteger, weights: tuple[int, ...], hints: AnyInteger | None) -> None:
        """tokens: flat (uint16), filled diagonal by diagonal. hints (steps, lanes): tokens of the magnitudes that the
        caller of `coder.pack` expects."""
        self._layout, self._tokens = layout, tokens
        self._hints = None if hints is None else layout.skewed(hints, np.uint16)
        row, k = layout.row, layout.segments
        *near, mean, hint_weight = weights
        self._mean_weight, self._hint_weight = np.array(mean, np.uint16), np.array(hint_weight, np.uint16)
        offsets = (row, 2 * row, row + k, 2 * row + 2 * k, 2 * row + k)
        self._near = [
            (np.array(w, np.uint16), [o for o, v in zip(offsets, near, strict=True) if v == w])
            for w in sorted({w for w in near if w})
        ]
        self._mean = np.zeros(layout.lanes * k, np.uint16)
        self._sum, self._part = np.zeros((2, layout.width), np.uint16)

    def expected(self, i: int, begin: int, end: int) -> AnyInteger:
        """Expected tokens of diagonal i in sixteenths (uint16); the array is used again by the next call."""
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
        if self._hint_weight and self._hints is not None:
            np.multiply(self._hints[begin:end], self._hint_weight, out=part)
            np.add(result, part, out=result)
        return result

    def _means(self, i: int, begin: int, end: int) -> AnyInteger:
        first = begin - (i + 2) * self._layout.row - 2 * self._layout.segments
        return self._mean[first : first + end - begin]

    def update(self, i: int, begin: int, end: int) -> None:
        """Take note that the tokens of diagonal i are known: update means, and the padding at the edges of segments."""
        tokens, k, row = self._tokens, self._layout.segments, self._layout.row
        left = (i + 2) * row
        if i < self._layout.steps:  # padding beside the first lane
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
        if i + 1 < self._layout.lanes:  # padding before the first step of the next lane
            ours = left + (i + 2) * k
            newest = tokens[ours : ours + k]
            tokens[ours + k : ours + 2 * k] = tokens[ours + k - row : ours + 2 * k - row] = newest
            self._mean[(i + 1) * k : (i + 2) * k] = newest << np.uint16(8)


def pack(
    token: Bytes, values: Integers, mixing: Mixing, table: Laws, hints: AnyInteger | None, expected_bits: float
) -> bytes:
    """The bytes of values (steps, lanes) with their tokens.

    hints (steps, lanes): tokens of expected magnitudes. expected_bits: about how many bits the tokens will take, which
    decides how many states are worth their cost.
    """
    layout = Layout(token.shape)
    turns = min(MAX_TURNS, max(1, round(layout.width * BITS_PER_STATE / max(expected_bits, 1))))
    nonzero = np.flatnonzero(token)
    raw = _raw_bits(token.ravel()[nonzero], values.ravel()[nonzero])
    states = -(-layout.width // turns)
    in_states = np.zeros(16 * states, np.uint8)
    in_states[: len(raw)] = raw[: 16 * states]
    x = rans.LOW | np.packbits(in_states).view(">u2").astype(np.uint32)
    if (kernel := native.kernel("bulk_push")) is not None:
        skewed, weights = _skewed_hints(layout, mixing, hints), np.array(mixing.weights, np.uint16)
        words = kernel(x, token, weights, mixing.ladder, table.code, table.last, skewed).astype("<u2").tobytes()
    else:
        index, ends = _indices(layout, token, mixing, hints)
        words = b"".join(reversed(_push_all(x, index, ends, table)))
    return b"".join([bytes([turns]), _pack_states(x), words, np.packbits(raw[16 * states :]).tobytes()])


def _skewed_hints(layout: Layout, mixing: Mixing, hints: AnyInteger | None) -> AnyInteger:
    """Hints as the compiled module takes them: flat, diagonal after diagonal; none where they have no weight."""
    return np.zeros(0, np.uint16) if hints is None or not mixing.weights[-1] else layout.skewed(hints, np.uint16)


def _push_all(x: AnyInteger, index: AnyInteger, ends: list[int], table: Laws) -> list[bytes]:
    """Push all symbols, last diagonal first, the excess of escapes before the escapes; the words that move out."""
    words: list[bytes] = []
    code = table.code.take(index)
    escaped = np.flatnonzero(code >= ESCAPE_FLAG)
    law, tokens = (index[escaped] >> 8).astype(np.int64), index[escaped] & 255
    beyond = table.code.take((len(table.last) - 1) * 256 + tokens - table.last.take(law))
    code &= ESCAPE_FLAG - np.uint32(1)
    escapes_before = np.searchsorted(escaped, ends)
    for d in range(len(ends) - 1, 0, -1):
        if escapes_before[d] > escapes_before[d - 1]:
            _push(x, beyond[escapes_before[d - 1] : escapes_before[d]], words)
        _push(x, code[ends[d - 1] : ends[d]], words)
    return words


def _push(x: AnyInteger, code: AnyInteger, words: list[bytes]) -> None:
    """Symbols into states, in turns where there are more symbols, the last turn first."""
    states = len(x)
    for a in range((len(code) - 1) // states * states, -1, -states):
        turn = code[a : a + states]
        _, moved = rans.push(x[: len(turn)], turn >> _12, turn & _MASK, PRECISION)
        if len(moved):
            words.append(moved.astype("<u2").tobytes())


def _pack_states(x: AnyInteger) -> bytes:
    """States as 4 bits each for how many bits they have above 17, then all bits but the highest of each."""
    extra = np.zeros(len(x), np.uint8)
    for k in range(17, 32):
        extra += x >> np.uint32(k) > 0
    nibbles = np.concatenate([extra, np.zeros(len(x) % 2, np.uint8)]).reshape(-1, 2)
    lower = bit_fields.pack_split((x ^ _ONE << extra.astype(np.uint32) + _16).astype(np.uint64), extra + np.uint8(16))
    return (nibbles[:, 0] << 4 | nibbles[:, 1]).tobytes() + np.packbits(lower).tobytes()


def _unpack_states(data: bytes, at: int, states: int) -> tuple[NDArray[np.uint32], int]:
    """The states, and the position after them. Raises Corrupt."""
    nibbles = np.frombuffer(data, np.uint8, min(len(data) - at, (states + 1) // 2), at)
    extra = np.stack([nibbles >> 4, nibbles & 15], axis=1).ravel()[:states].astype(np.uint8)
    at += len(nibbles)
    size = (int(extra.sum(dtype=np.int64)) + 16 * states + 7) // 8
    if len(extra) < states or len(data) < at + size:
        raise Corrupt("coded integers end too early")
    stored = np.unpackbits(np.frombuffer(data, np.uint8, size, at))
    lower, taken = bit_fields.unpack_split(stored, extra + np.uint8(16))
    if stored[taken:].any() or (states % 2 and nibbles[-1] & 15):
        raise Corrupt("coded integers with bits behind their states")
    return lower.astype(np.uint32) | _ONE << extra.astype(np.uint32) + _16, at + size


def _indices(
    layout: Layout, token: AnyInteger, mixing: Mixing, hints: AnyInteger | None
) -> tuple[AnyInteger, list[int]]:
    """law × 256 + token of all symbols, diagonal after diagonal, and the edges between diagonals, from 0."""
    tokens = layout.skewed(token, np.uint16)
    around = _DiagonalContexts(layout, tokens, mixing.weights, hints)
    rung = mixing.ladder.astype(np.uint16) << np.uint16(8)
    index = np.empty(layout.steps * layout.lanes * layout.segments, np.uint16)
    ends = [0]
    for i, begin, end in layout.diagonals():
        here = index[ends[-1] : ends[-1] + end - begin]
        np.add(rung.take(around.expected(i, begin, end)), tokens[begin:end], out=here)
        around.update(i, begin, end)
        ends.append(ends[-1] + end - begin)
    return index[: ends[-1]], ends


def unpack(data: bytes, shape: tuple[int, int], mixing: Mixing, table: Laws, hints: AnyInteger | None) -> Integers:
    """The values of `pack`. Raises Corrupt."""
    layout = Layout(shape)
    if (kernel := native.kernel("bulk_unpack")) is not None:
        skewed, weights = _skewed_hints(layout, mixing, hints), np.array(mixing.weights, np.uint16)
        values = kernel(data, *shape, weights, mixing.ladder, table.symbols, table.code, table.last, skewed)
        if values is not None:
            return values
    if not 1 <= data[0] <= MAX_TURNS:
        raise Corrupt("coded integers of an unknown kind")
    x, at = _unpack_states(data, 1, -(-layout.width // data[0]))
    words = np.frombuffer(data, "<u2", (len(data) - at) // 2, at).astype(np.uint32)
    tokens = layout.empty(np.uint16)
    used = _tokens(layout, tokens, x, words, mixing, table, hints)
    token = layout.unskewed(tokens, np.uint8)
    if token.max() >= models.TOKENS:
        raise Corrupt("coded integers out of range")
    rest = np.unpackbits(np.frombuffer(data[at + 2 * used :], np.uint8))
    if (x >> np.uint32(16) != 1).any():
        raise Corrupt("coded integers do not end where they should")
    return _values(token, np.unpackbits((x & np.uint32(0xFFFF)).astype(">u2").view(np.uint8)), rest)


def _tokens(
    layout: Layout, tokens: AnyInteger, x: AnyInteger, words: AnyInteger, mixing: Mixing, table: Laws,
    hints: AnyInteger | None,
) -> int:  # fmt: skip
    """Fills `tokens`, flat and of zeros, and returns how many words they took. Raises Corrupt."""
    around = _DiagonalContexts(layout, tokens, mixing.weights, hints)
    rung = mixing.ladder.astype(np.int64) << PRECISION
    at = 0
    for i, begin, end in layout.diagonals():
        places = rung.take(around.expected(i, begin, end))
        here = tokens[begin:end]
        at = _pop(x, table.slots, places, here, words, at)
        if b"\xff" in here.tobytes():
            escaped = (here == ESCAPE).nonzero()[0]
            last = table.last.take(mixing.ladder.take(around.expected(i, begin, end).take(escaped)))
            beyond = np.empty(len(escaped), np.uint16)
            at = _pop(x, table.slots, np.full(len(escaped), len(table.last) - 1 << PRECISION), beyond, words, at)
            here[escaped] = np.minimum(last + beyond, 255)
        around.update(i, begin, end)
    return at


def _pop(
    x: NDArray[np.uint32], slots: AnyInteger, places: Integers, symbols: AnyInteger, words: AnyInteger, at: int
) -> int:
    """Symbols out of states in turns, each from the 2^12 slots that begin at its place; returns the words taken so far.

    Raises Corrupt where there are too few words.
    """
    states = len(x)
    for a in range(0, len(places), states):
        place = places[a : a + states]
        s = x[: len(place)]
        place += s & _MASK
        found = slots.take(place)
        symbols[a : a + states] = found & _BYTE
        rans.pop(s, found >> _20, found >> _8 & _MASK, PRECISION)
        short = (s < rans.LOW).nonzero()[0]
        if len(short):
            new = words[at : at + len(short)]
            if len(new) < len(short):
                raise Corrupt("coded integers end too early")
            at += len(short)
            s[short] = s.take(short) << _16 | new
    return at


def _raw_bits(token: AnyInteger, values: AnyInteger) -> Bytes:
    """Signs, then mantissas, as single bits; none of the values is zero."""
    signs = (values < 0).astype(np.uint8)
    bits = models.mantissa_bits(token)
    return np.concatenate([signs, bit_fields.pack_split(np.abs(values).view(np.uint64), bits)]) if bits.any() else signs


def _values(token: Bytes, first_bits: Bytes, later_bits: Bytes) -> Integers:
    """Values from tokens and raw bits: those from the states, then those behind the words. Raises Corrupt."""
    nonzero = np.flatnonzero(token)
    raw = np.concatenate([first_bits, later_bits])
    if len(nonzero) > len(raw):
        raise Corrupt("coded integers end too early")
    values = token.astype(np.int64, order="C")
    flat, used = values.ravel(), len(nonzero)
    if token.max() >= models.DIRECT:
        tokens = token.ravel()[nonzero]
        mantissa, taken = bit_fields.unpack_split(raw[used:], models.mantissa_bits(tokens))
        used += taken
        flat[nonzero] = models.floors().take(tokens) | mantissa.view(np.int64)
    if not 0 <= len(later_bits) - max(0, used - len(first_bits)) < 8 or raw[used:].any():
        raise Corrupt("coded integers do not end where they should")
    negative = nonzero[raw[: len(nonzero)].view(np.bool_)]
    flat[negative] = -flat[negative]
    return values
