"""Integers to bytes and back: interleaved rANS (Duda 2013), integer only, many lanes at a time with NumPy.

    pack:   values ─► differences? ─► sign · token · mantissa ─► law from the neighbours' tokens ─► rANS ─► bytes

`Encoder` and `Decoder` are the coder alone, for codecs that bring their own `Tables` and choose a table for each symbol
from what is already decoded. `pack` and `unpack` are for everything else. docs/entropy.md gives formats and reasons.

A stream has one state (few symbols: a loop over Python integers, nothing spent on the states) or many (a NumPy operation
moves all of them at once). A state holds 32 bits, moves words of 16, and starts with 16 bits of the raw bits hidden in
it, so that many states cost about 4 bits each and one state costs none.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import Corrupt
from . import models
from .models import PRECISION, TOTAL, Tables

Integers = NDArray[np.int64]
Array = NDArray[Any]

LOW = 1 << 16  # a state is at least this, and below 2^32
MASK = TOTAL - 1


class Encoder:
    """Collects symbols in the order in which they will be decoded; `finish` makes the bytes."""

    def __init__(self) -> None:
        self._groups: list[tuple[Array, Array]] = []
        self._raw = np.zeros(0, np.uint8)

    def put(self, tables: Tables, table: Array, symbols: Array) -> None:
        """Symbols (n,) under the tables of these numbers (n,) or (1,): one call for one call of `Decoder.next`.

        Raises ValueError for a symbol that its table cannot code.
        """
        at = np.asarray(table, np.int64) * tables.width + symbols
        frequency = tables.frequency[at]
        if not frequency.all():
            raise ValueError("a symbol of weight zero cannot be coded")
        self._groups.append((frequency, tables.start[at]))

    def raw(self, values: Array, bits: Array) -> None:
        """Non-negative integers of so many bits (0 … 64) each, without a model: once, after all symbols."""
        self._raw = _bits_of(values, bits)

    def finish(self, states: int = 1, tag: int = 0) -> bytes:
        """The bytes. states: 1, or a power of two up to 2^15 (more: faster for wide calls). tag: 0 … 15, for the caller."""
        first = bytes([(states.bit_length() - 1) | tag << 4])
        return first + (self._finish_one() if states == 1 else self._finish_many(states))

    def _finish_one(self) -> bytes:
        frequency = [f for group, _ in self._groups for f in group.tolist()]
        start = [c for _, group in self._groups for c in group.tolist()]
        state, words = 1, []
        padded = np.packbits(np.concatenate([np.zeros(-len(self._raw) % 8, np.uint8), self._raw])).tobytes()
        for byte, bits in zip(padded, [(len(self._raw) - 1) % 8 + 1, *[8] * (len(padded) - 1)], strict=False):
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
        heads = _bits_of(np.stack([extra, x ^ (1 << extra + 16)], axis=1), np.stack([extra * 0 + 4, extra + 16], axis=1))
        rest = self._raw[16 * states :]
        return b"".join([np.packbits(heads).tobytes(), *map(bytes, reversed(words)), np.packbits(rest).tobytes()])


class Decoder:
    """Gives the symbols of an `Encoder` back, call for call. Every method raises Corrupt for damaged data."""

    def __init__(self, data: bytes) -> None:
        if len(data) == 0:
            raise Corrupt("coded integers end too early")
        self.tag = data[0] >> 4
        self.states = 1 << (data[0] & 15)
        self._data = bytes(data)
        self.at = 0
        if self.states == 1:
            size = len(data) - 1 if len(data) <= 5 else 3 + len(data) % 2  # words follow only a state of three or four bytes
            self.x = int.from_bytes(data[1 : 1 + size], "little")
            self.words: Any = np.frombuffer(self._data, "<u2", offset=1 + size).tolist()
        else:
            self._open_many()

    def _open_many(self) -> None:
        body = np.frombuffer(self._data, np.uint8, offset=1)
        bits = np.unpackbits(body[: 5 * self.states])
        heads, at = [], 0
        weights = 1 << np.arange(4)[::-1]
        for _ in range(self.states):
            if at + 4 > len(bits):
                raise Corrupt("coded integers end too early")
            extra = int(bits[at : at + 4] @ weights)
            heads.append((at + 4, extra + 16))
            at += 20 + extra
        if at > len(bits):
            raise Corrupt("coded integers end too early")
        starts, lengths = np.array(heads).T
        self.x = (_numbers_at(bits, starts, lengths) | np.uint64(1) << lengths.astype(np.uint64)).astype(np.uint32)
        self._words_from = 1 + (at + 7) // 8
        count = (len(self._data) - self._words_from) // 2
        self.words = np.frombuffer(self._data, "<u2", count, self._words_from).astype(np.uint32)

    def next(self, tables: Tables, table: Array) -> Array:
        """The next symbols (n,), each under the table of its number (n,)."""
        table = np.asarray(table)
        if self.states == 1:
            return np.array([self._one(tables, t) for t in table.tolist()], tables.symbol.dtype)
        result = np.empty(len(table), tables.symbol.dtype)
        precision, low = np.uint32(PRECISION), np.uint32(16)
        for a in range(0, len(table), self.states):
            chosen = table[a : a + self.states].astype(np.int64)
            n = len(chosen)
            x = self.x[:n]
            slot = x & np.uint32(MASK)
            symbol = tables.symbol.take((chosen << PRECISION) + slot)
            chosen *= tables.width
            chosen += symbol
            x = tables.frequency.take(chosen) * (x >> precision) + slot - tables.start.take(chosen)
            short = np.flatnonzero(x < LOW)
            if len(short):
                words = self.words[self.at : self.at + len(short)]
                if len(words) < len(short):
                    raise Corrupt("coded integers end too early")
                self.at += len(short)
                x[short] = x[short] << low | words
            self.x[:n] = x
            result[a : a + n] = symbol
        return result

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
        """The integers of `Encoder.raw`: so many bits (0 … 64) each."""
        total = int(bits.sum(dtype=np.int64))
        if total > 8 * len(self._data) + 16 * self.states:
            raise Corrupt("coded integers end too early")
        if self.states == 1:
            return _numbers_of(self._raw_one(total), bits)
        if (self.x >> 16 != 1).any():
            raise Corrupt("coded integers do not end where they should")
        hidden = np.unpackbits((self.x & 0xFFFF).astype(">u2").view(np.uint8))
        rest = np.unpackbits(np.frombuffer(self._data, np.uint8, offset=self._words_from + 2 * self.at))
        every = np.concatenate([hidden, rest])
        if len(every) < total or not 0 <= len(rest) - max(0, total - len(hidden)) < 8 or every[total:].any():
            raise Corrupt("coded integers do not end where they should")
        return _numbers_of(every, bits)

    def _raw_one(self, total: int) -> Array:
        pieces = []
        for _ in range(total // 8):
            pieces.append(self.x & 0xFF)
            self.x >>= 8
            self._refill()
        first = total % 8
        pieces.append(self.x & (1 << first) - 1)
        self.x >>= first
        self._refill()
        if self.x != 1 or self.at != len(self.words):
            raise Corrupt("coded integers do not end where they should")
        return np.unpackbits(np.array(pieces[::-1], np.uint8))[8 - first :]


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
    for k in range(int(bits.max(initial=0))):
        more = np.flatnonzero(bits > k)
        result[more] = result[more] << np.uint64(1) | stream[starts[more] + k]
    return result


# ------------------------------------------------------------------------------------------------------- pack, unpack

# What neighbours count, in sixteenths: the lane's last and last but one; the lane before, at this step, and the one before
# that; the lane before at the last step; the lane's running mean; the context that the caller gave.
MIXTURES = (
    (5, 2, 5, 2, 2, 0, 0),
    (3, 2, 3, 1, 1, 6, 0),
    (3, 1, 1, 0, 0, 11, 0),
    (8, 5, 0, 0, 0, 3, 0),
    (0, 0, 8, 5, 3, 0, 0),
    (0, 0, 0, 0, 0, 0, 0),
    (3, 1, 3, 1, 0, 0, 8),
    (1, 0, 1, 0, 0, 2, 12),
)
SPARSE = 8  # a tag beyond the mixtures: places and values of what is not zero
WITHOUT_CONTEXTS = 6  # the first mixtures need none
OFFSETS = 8  # rungs −4 … 3

# The first symbols of a stream: law for silence (0 … 63), offset, order of differences, large magnitudes, rows and columns kept
HEADER = (64, OFFSETS, 3, 2, 32, 32)
SCALAR_SYMBOLS = 8000  # up to here, one state and a loop
SEGMENT_STEPS = 128  # lanes are not cut shorter
WIDE = 2000  # symbols a NumPy operation should take at a time
BITS_PER_STATE = 320


@cache
def _header_tables() -> Tables:
    likely_last = [1] * 31 + [31]
    return Tables([[1] * 64, [1, 2, 3, 6, 10, 6, 3, 1], [6, 2, 1], [15, 1], likely_last, likely_last])


@cache
def _bit_costs(laws: int) -> NDArray[np.float64]:
    """Bits of each token under each law, escapes included; for choosing only, never for coding."""
    family = models.family(laws)
    bits = PRECISION - np.log2(np.maximum(family.frequency.reshape(-1, family.width), 1))
    cost = np.full((laws, 256), 64.0)
    for law, size in enumerate(family.sizes[:-1].tolist()):
        cost[law, : size - 1] = bits[law, : size - 1]
        cost[law, size - 1 : family.width] = bits[law, size - 1] + bits[-1, : family.width - size + 1]
    return cost


def pack(values: Array, contexts: Array | None = None) -> bytes:
    """Integers (steps, lanes) as bytes; b"" where all are zero.

    Made for arrays with many zeros, sizes that differ from lane to lane and change slowly along steps or lanes; no
    knowledge of what they are is needed. contexts (steps, lanes): expected magnitudes that the decoder will know too.
    Raises ValueError for values beyond ±2^62.
    """
    v = np.asarray(values).astype(np.int64)
    if v.ndim != 2:
        raise ValueError(f"values must be (steps, lanes), not {v.shape}")
    if not v.any():
        return b""
    if max(-int(v.min()), int(v.max())) > 1 << 62:
        raise ValueError("values beyond ±2^62")
    nonzero = int(np.count_nonzero(v))
    dense = _pack_dense(v, contexts)
    if v.size > SCALAR_SYMBOLS and nonzero * 50 < v.size:
        sparse = _pack_sparse(v)
        if len(sparse) < len(dense):
            return sparse
    return dense


def unpack(data: bytes, shape: tuple[int, int], contexts: Array | None = None) -> Integers:
    """The integers of `pack`, of this shape. Raises Corrupt."""
    steps, lanes = shape
    if len(data) == 0 or steps * lanes == 0:
        if len(data):
            raise Corrupt("coded integers where there should be none")
        return np.zeros((steps, lanes), np.int64)
    if data[0] >> 4 == SPARSE:
        return _unpack_sparse(data, (steps, lanes))
    return _unpack_dense(data, (steps, lanes), contexts)


def _pack_sparse(v: Integers) -> bytes:
    places = np.flatnonzero(v)
    gaps = pack(np.diff(places, prepend=-1)[:, None])
    sizes = b"".join(n.to_bytes(4, "little") for n in (len(places), len(gaps)))
    return bytes([SPARSE << 4]) + sizes + gaps + pack(v.ravel()[places][:, None])


def _unpack_sparse(data: bytes, shape: tuple[int, int]) -> Integers:
    count, size = int.from_bytes(data[1:5], "little"), int.from_bytes(data[5:9], "little")
    result = np.zeros(shape, np.int64)
    if not 0 < count <= result.size or data[9:10] == bytes([SPARSE << 4]):
        raise Corrupt("coded integers: more than there can be")
    gaps = unpack(data[9 : 9 + size], (count, 1))[:, 0]
    if (gaps < 1).any() or gaps.max() > result.size or int(gaps.sum()) > result.size:
        raise Corrupt("coded integers outside their array")
    result.ravel()[np.cumsum(gaps) - 1] = unpack(data[9 + size :], (count, 1))[:, 0]
    return result


def _kept(extent: int, symbol: int) -> int:
    """Rows (or columns) that are coded: this many thirty-seconds of all, at least one; the others are zero."""
    return max(1, -(-extent * (symbol + 1) // 32))


def _kept_symbol(extent: int, needed: int) -> int:
    exact = next(s for s in range(32) if _kept(extent, s) >= needed)
    return 31 if _kept(extent, exact) == extent else exact


def _pack_dense(v: Integers, contexts: Array | None) -> bytes:
    order = _best_order(v)
    d = _difference(v, order)
    rows = _kept_symbol(d.shape[0], int(np.flatnonzero(d.any(axis=1))[-1]) + 1)
    columns = _kept_symbol(d.shape[1], int(np.flatnonzero(d.any(axis=0))[-1]) + 1)
    d = d[: _kept(d.shape[0], rows), : _kept(d.shape[1], columns)]
    cut = _Cut(d.shape, scalar := d.size <= SCALAR_SYMBOLS)
    magnitudes = np.abs(d).astype(np.uint64)
    token, shift = models.tokens(cut(magnitudes))
    large = bool(token.max() > 56)
    laws = models.LAWS_LARGE if large else models.LAWS
    around = _neighbours(token, None if contexts is None else cut(_context_tokens(contexts, d.shape)))
    mixture, silent, offset, bits = _choose(around, token, laws)
    law = models.law_of_expectation(laws, silent, offset - OFFSETS // 2).take(_mix(around, mixture))

    encoder = Encoder()
    fields = np.array([silent, offset, order, int(large), rows, columns])
    encoder.put(_header_tables(), np.arange(len(HEADER)), fields)
    family = models.family(laws)
    symbol = np.minimum(token, family.sizes[law] - 1)
    escaped = symbol == family.sizes[law] - 1
    excess = token - symbol
    if scalar:
        where = np.flatnonzero(escaped) + 1
        table = np.insert(law.ravel().astype(np.int64), where, laws)
        encoder.put(family, table, np.insert(symbol.ravel(), where, excess[escaped]))
    else:
        flat = [a.reshape(len(a), -1) for a in (law, symbol, escaped, excess)]
        for *_, diagonal in _diagonals(*token.shape[1:]):
            q, s, beyond, by = (a[:, diagonal].ravel() for a in flat)
            encoder.put(family, q, s)
            if beyond.any():
                encoder.put(family, np.full(int(beyond.sum()), laws), by[beyond])
    mantissa = cut(magnitudes) & (np.uint64(1) << shift.astype(np.uint64)) - np.uint64(1)
    negative = cut((d < 0).astype(np.uint64)) << shift.astype(np.uint64)
    encoder.raw((negative | mantissa).ravel(), ((token > 0) + shift).ravel())
    return encoder.finish(1 if scalar else _states(token.shape, bits), mixture)


def _states(shape: tuple[int, int, int], bits: float) -> int:
    """How many states: few where there are few bits, but not so few that a diagonal takes more than some twenty steps."""
    width = shape[0] * min(shape[1:])
    return 1 << min(15, max(4, int(max(min(bits / BITS_PER_STATE, width), width / 16)).bit_length() - 1))


class _Cut:
    """(steps, lanes) as segments (segments, steps of each, lanes), so that many symbols can be coded at a time.

    A loop over single symbols needs no segments. Otherwise the longer axis is the one that is cut; its end is padded with zeros.
    """

    def __init__(self, shape: tuple[int, int], scalar: bool) -> None:
        self.plain = shape
        self.turned = not scalar and shape[1] > shape[0]
        long, short = shape[::-1] if self.turned else shape
        segments = 1 if scalar else max(1, min(WIDE // short, long // SEGMENT_STEPS))
        steps = -(-long // segments)
        self.shape = -(-long // steps), steps, short

    def __call__(self, plain: Array) -> Array:
        turned = plain.T if self.turned else plain
        segments, steps, lanes = self.shape
        padded = np.zeros((segments * steps, lanes), plain.dtype)
        padded[: len(turned)] = turned
        return padded.reshape(self.shape)

    def back(self, segments: Array) -> Array:
        whole = segments.reshape(-1, self.shape[2])
        return whole[: self.plain[1]].T if self.turned else whole[: self.plain[0]]


def _diagonals(steps: int, lanes: int) -> Iterator[tuple[int, int, int, slice]]:
    """Step t of lane l belongs to diagonal t + l: (diagonal, first lane, last lane + 1, their places in a flat segment).

    Along it all neighbours that a symbol looks at (before it in its lane, beside it in lanes before) are known.
    """
    back = -(lanes - 1) or -1
    for i in range(steps + lanes - 1):
        low, high = max(0, i - steps + 1), min(lanes, i + 1)
        begin, end = i * lanes - low * (lanes - 1), i * lanes - (high - 1) * (lanes - 1)
        yield i, low, high, slice(begin, end - 1 if end > 0 else None, back)


def _difference(v: Integers, order: int) -> Integers:
    for _ in range(order):
        v = np.diff(v, axis=0, prepend=np.zeros((1, v.shape[1]), np.int64))
    return v


def _best_order(v: Integers) -> int:
    """How often to take differences along the steps: what makes the numbers shortest."""
    if len(v) < 3 or np.abs(v).max() >= 1 << 59:
        return 0
    sample = v[:: max(1, v.size // 100_000 // 8 * 8)] if v.size > 800_000 else v
    bits = [float(np.log2(1 + 2 * np.abs(_difference(sample, order))).sum()) for order in (0, 1, 2)]
    bits[0] *= 0.97  # a tie goes to the plain numbers
    return int(np.argmin(bits))


def _context_tokens(contexts: Array, shape: tuple[int, int]) -> NDArray[np.uint8]:
    return models.tokens(np.abs(np.asarray(contexts)[: shape[0], : shape[1]].astype(np.int64)).astype(np.uint64))[0]


def _warming(step: int) -> int:
    """How slowly a lane's running mean moves at this step."""
    return 1 if step == 0 else 2 if step < 3 else 3


def _neighbours(token: NDArray[np.uint8], given: NDArray[np.uint8] | None) -> list[Array]:
    """What each symbol (segments, steps, lanes) looks at, in the order of MIXTURES; what lies outside is replaced by what is near."""
    k, n, lanes = token.shape
    padded = np.zeros((k, n + 2, lanes + 2), np.int32)
    padded[:, 2:, 2:] = token
    padded[:, :2, 3:] = token[:, :1, :-1]
    past, past2 = padded[:, 1:-1, 2:], padded[:, :-2, 2:]
    beside, beside2, corner = padded[:, 2:, 1:-1].copy(), padded[:, 2:, :-2].copy(), padded[:, 1:-1, 1:-1].copy()
    beside[:, :, 0] = beside2[:, :, 0] = corner[:, :, 0] = past[:, :, 0]
    beside2[:, :, 1:2] = token[:, :, :1]
    mean = np.zeros((k, n, lanes), np.int32)
    mean[:, 0] = past[:, 0] << 8
    for t in range(n - 1):
        mean[:, t + 1] = mean[:, t] + ((padded[:, t + 2, 2:] << 8) - mean[:, t] >> _warming(t))
    return [past, past2, beside, beside2, corner, mean, given if given is not None else np.zeros(1, np.uint8)]


def _mix(around: list[Array], mixture: int) -> Array:
    """Expected token in sixteenths."""
    *weights, mean, given = MIXTURES[mixture]
    mixed = (around[5] * mean >> 8) + around[6].astype(np.int32) * given
    for a, w in zip(around, weights, strict=False):
        if w:
            mixed += a * w
    return mixed


def _choose(around: list[Array], token: Array, laws: int) -> tuple[int, int, int, float]:
    """(mixture, silent, offset, bits without signs and mantissas): what codes these tokens shortest."""
    every = max(1, token.size // 60_000)
    some = token[::every]
    around = [a[::every] if a.size > 1 else a for a in around]
    cost, ladder = _bit_costs(laws), models.law_of_expectation(laws, 0, 0)
    best = (0, 0, 0, np.inf)
    for mixture in range(len(MIXTURES) if around[6].size > 1 else WITHOUT_CONTEXTS):
        mixed = _mix(around, mixture)
        key = np.where(mixed == 0, laws, ladder.take(mixed)).astype(np.int64) * 256 + some
        counts = np.bincount(key.ravel(), minlength=(laws + 1) * 256).reshape(laws + 1, 256)
        silence = cost[:64] @ counts[laws]
        by_offset = [
            (counts[:laws] * cost[np.clip(np.arange(laws) + o - OFFSETS // 2, 0, laws - 1)]).sum() for o in range(OFFSETS)
        ]
        bits = float(silence.min() + min(by_offset))
        if bits < best[3]:
            best = mixture, int(silence.argmin()), int(np.argmin(by_offset)), bits
    return best[0], best[1], best[2], best[3] * token.size / some.size


def _unpack_dense(data: bytes, shape: tuple[int, int], contexts: Array | None) -> Integers:
    decoder = Decoder(data)
    if decoder.tag >= len(MIXTURES) or (decoder.tag >= WITHOUT_CONTEXTS and contexts is None):
        raise Corrupt("coded integers of an unknown kind")
    fields = decoder.next(_header_tables(), np.arange(len(HEADER))).tolist()
    silent, offset, order, large, rows, columns = fields
    kept = _kept(shape[0], rows), _kept(shape[1], columns)
    laws = models.LAWS_LARGE if large else models.LAWS
    if silent >= laws:
        raise Corrupt("coded integers of an unknown kind")
    ladder = models.law_of_expectation(laws, silent, offset - OFFSETS // 2)
    cut = _Cut(kept, kept[0] * kept[1] <= SCALAR_SYMBOLS)
    given = None if contexts is None else cut(_context_tokens(contexts, kept))
    weights = MIXTURES[decoder.tag]
    if decoder.states == 1:
        token = _decode_one(decoder, models.family(laws), ladder, weights, kept, given)
    else:
        token = _decode_many(decoder, models.family(laws), ladder, weights, cut.shape, given)
    if token.max() >= models.TOKENS:
        raise Corrupt("coded integers out of range")
    shift = models.mantissa_bits(token)
    raw = decoder.raw((token > 0) + shift)
    shift64 = shift.astype(np.uint64)
    top = np.where(shift > 0, (token - np.uint8(models.DIRECT)) % 4 + 4, token).astype(np.uint64)
    magnitude = (top << shift64 | raw & (np.uint64(1) << shift64) - np.uint64(1)).astype(np.int64)
    d = cut.back(np.where(raw >> shift64 & np.uint64(1) == 1, -magnitude, magnitude))
    whole = np.zeros(shape, np.int64)
    whole[: kept[0], : kept[1]] = d
    for _ in range(order):
        whole = np.cumsum(whole, axis=0)
    return whole


def _decode_one(
    decoder: Decoder, family: Tables, ladder: Array, weights: tuple[int, ...], shape: tuple[int, int], given: Array | None
) -> NDArray[np.uint8]:
    """Tokens (1, steps, lanes), one after the other."""
    steps, lanes = shape
    frequency, start, symbols = family.lists
    width, sizes, excess = family.width, family.sizes.tolist(), family.count - 1
    law_of = ladder.tolist()
    w1, w2, v1, v2, w3, wm, wg = weights
    x, at, words = decoder.x, decoder.at, decoder.words
    end = len(words)
    result = []
    means = [0] * lanes
    up = up2 = [0] * (lanes + 3)
    hints: Any = None if given is None else given.reshape(steps, lanes).tolist()
    for t in range(steps):
        row = [0] * (lanes + 3)
        row[0] = row[1] = up[1] = up[2]
        warming = _warming(t)
        for l in range(lanes):  # noqa: E741
            if t == 0:
                means[l] = up[l + 2] << 8
            mixed = w1 * up[l + 2] + w2 * up2[l + 2] + v1 * row[l + 1] + v2 * row[l] + w3 * up[l + 1] + (wm * means[l] >> 8)
            if hints is not None:
                mixed += wg * hints[t][l]
            law = law_of[mixed]
            slot = x & MASK
            token = symbols[law << PRECISION | slot]
            place = law * width + token
            x = frequency[place] * (x >> PRECISION) + slot - start[place]
            if x < LOW and at < end:
                x = x << 16 | words[at]
                at += 1
            if token == sizes[law] - 1:
                slot = x & MASK
                beyond = symbols[excess << PRECISION | slot]
                place = excess * width + beyond
                x = frequency[place] * (x >> PRECISION) + slot - start[place]
                if x < LOW and at < end:
                    x = x << 16 | words[at]
                    at += 1
                token = min(token + beyond, 255)
            row[l + 2] = token
            if l == 0:
                row[1] = token
            if t == 0:
                up[l + 3] = token
            means[l] += (token << 8) - means[l] >> warming
        up2, up = up, row
        result.append(row[2 : lanes + 2])
    decoder.x, decoder.at = x, at
    return np.array([result], np.uint8)


def _decode_many(
    decoder: Decoder, family: Tables, ladder: Array, weights: tuple[int, ...], shape: tuple[int, int, int], given: Array | None
) -> NDArray[np.uint8]:
    """Tokens (segments, steps, lanes), one diagonal of all segments after the other."""
    k, n, lanes = shape
    w1, w2, v1, v2, w3, wm, wg = weights
    last, before = np.zeros((2, k, lanes + 2), np.int32)
    mean = np.zeros((k, lanes), np.int32)
    warming = np.array([_warming(t) for t in range(n)], np.int32)[::-1]
    result = np.zeros((k, n * lanes), np.uint8)
    hints = None if given is None else given.reshape(k, n * lanes)
    last_of = family.sizes - 1
    for i, low, high, diagonal in _diagonals(n, lanes):
        if i < lanes:  # a lane begins
            last[:, i + 2] = before[:, i + 2] = last[:, i + 1]
            mean[:, i] = last[:, i + 1] << 8
        last[:, :2] = before[:, :2] = last[:, 2:3]
        if low >= 2:  # a lane has ended
            before[:, low] = last[:, low]
        m = mean[:, low:high]
        mixed = m * wm >> 8
        for w, a, shift in ((w1, last, 2), (w2, before, 2), (v1, last, 1), (v2, before, 0), (w3, before, 1)):
            if w:
                mixed += w * a[:, low + shift : high + shift]
        if hints is not None and wg:
            mixed += hints[:, diagonal].astype(np.int32) * wg
        law = ladder.take(mixed.ravel())
        token = decoder.next(family, law)
        escaped = np.flatnonzero(token == last_of.take(law))
        if len(escaped):
            beyond = decoder.next(family, np.full(len(escaped), family.count - 1))
            token[escaped] = np.minimum(token[escaped].astype(np.int64) + beyond, 255)
        token = token.reshape(k, high - low)
        result[:, diagonal] = token
        before[:, low + 2 : high + 2] = last[:, low + 2 : high + 2]
        last[:, low + 2 : high + 2] = token
        m += (last[:, low + 2 : high + 2] << 8) - m >> warming[n - 1 - i + low : n - 1 - i + high]
    return result.reshape(shape)
