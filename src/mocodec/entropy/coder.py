"""Arrays of integers to bytes and back, whatever they are.

    values ─► differences? ─► sign · token · mantissa ─► law from the tokens around ─► rANS ─► bytes

Every token's law is chosen from tokens that are already known: those before it in its lane and those of the lanes
before it. Long arrays are cut into segments, and one diagonal of all segments is coded at a time. What is best for an
array as a whole (how to weigh the neighbours, a wider or narrower ladder of laws, differences or not) is found by
counting and sent in a few bits. docs/entropy.md has format, figures and reasons.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import Corrupt
from . import models
from .models import PRECISION, Tables
from .rans import LOW, MASK, Decoder, Encoder

__all__ = ["Decoder", "Encoder", "Tables", "pack", "unpack"]

Integers = NDArray[np.int64]
Array = NDArray[Any]

# What neighbours count, in sixteenths: the lane's last and last but one; the lane before, at this step, and the one
# before that; the lane before at the last step; the lane's running mean; the context that the caller gave.
MIXTURES = (
    (5, 2, 5, 2, 2, 0, 0),
    (0, 0, 0, 0, 0, 16, 0),
    (3, 1, 7, 3, 2, 0, 0),
    (0, 0, 8, 5, 3, 0, 0),
    (4, 2, 3, 2, 1, 4, 0),
    (7, 3, 3, 1, 2, 0, 0),
    (0, 0, 0, 0, 0, 0, 0),
    (3, 1, 3, 1, 0, 0, 8),
    (2, 0, 2, 0, 0, 4, 8),
    (1, 0, 1, 0, 0, 2, 12),
)
WITHOUT_CONTEXTS = 7  # the first mixtures need none
OFFSETS = 8  # rungs −4 … 3
SILENT = 32  # laws that silence may have
SPARSE = b"\0\0"  # instead of a stream: places and values of what is not zero

SCALAR_SYMBOLS = 8000  # up to here, one state and a loop
SCALAR_SYMBOLS_QUIET = 1 << 16  # or up to here, where hardly any symbol says something
SCALAR_LOUD = 4000  # how many may
SEGMENT_STEPS = 128  # lanes are not cut shorter
WIDE = 4000  # symbols a NumPy operation should take at a time
BITS_PER_STATE = 320


@cache
def _header() -> Tables:
    """One table for each of `_Fields`, with what is likely."""
    whole = [1] * 31 + [120]
    silent = [2] * 4 + [4] * 8 + [6] * 10 + [3] * 6 + [1] * 4
    return Tables(
        [[12, 5, 8, 4, 6, 5, 5, 4, 4, 4], [2, 1], silent, [1, 2, 3, 5, 8, 5, 3, 2], [6, 2, 1], [20, 1], whole, whole]
    )


class _Fields(NamedTuple):
    """What a stream of `pack` begins with."""

    mixture: int
    shape: int  # of the laws
    silent: int  # the law where all around is zero
    offset: int  # how many rungs wider than usual the other laws are, + 4
    order: int  # of differences along the steps
    large: int  # whether the ladder is the long one
    rows: int  # how much is coded: see `_kept`
    columns: int

    @property
    def laws(self) -> int:
        return models.LAWS_LARGE if self.large else models.LAWS

    @property
    def family(self) -> Tables:
        return models.family(self.laws, self.shape)

    @property
    def ladder(self) -> NDArray[np.uint8]:
        return models.law_of_expectation(self.laws, self.silent, self.offset - OFFSETS // 2)


def _bits_of_tables(tables: Tables) -> NDArray[np.float64]:
    return PRECISION - np.log2(np.maximum(tables.frequency.reshape(-1, tables.width), 1))


@cache
def _bit_costs(laws: int, shape: int) -> NDArray[np.float64]:
    """Bits of each token under each law, escapes included; for choosing only, never for coding."""
    family = models.family(laws, shape)
    bits = _bits_of_tables(family)
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
    dense = _pack_dense(v, contexts)
    if v.size > SCALAR_SYMBOLS and np.count_nonzero(v) < min(v.size // 50, 1 << 20):
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
    if data[:2] == SPARSE:
        return _unpack_sparse(data, (steps, lanes))
    return _unpack_dense(data, (steps, lanes), contexts)


def _pack_sparse(v: Integers) -> bytes:
    places = np.flatnonzero(v)
    gaps = pack(np.diff(places, prepend=-1)[:, None])
    sizes = b"".join(n.to_bytes(3, "little") for n in (len(places), len(gaps)))
    return SPARSE + sizes + gaps + pack(v.ravel()[places][:, None])


def _unpack_sparse(data: bytes, shape: tuple[int, int]) -> Integers:
    count, size = int.from_bytes(data[2:5], "little"), int.from_bytes(data[5:8], "little")
    result = np.zeros(shape, np.int64)
    coded_gaps, coded_values = data[8 : 8 + size], data[8 + size :]
    if not 0 < count <= result.size or SPARSE in (coded_gaps[:2], coded_values[:2]):
        raise Corrupt("coded integers: more than there can be")
    gaps = unpack(coded_gaps, (count, 1))[:, 0]
    if (gaps < 1).any() or gaps.max() > result.size or int(gaps.sum()) > result.size:
        raise Corrupt("coded integers outside their array")
    result.ravel()[np.cumsum(gaps) - 1] = unpack(coded_values, (count, 1))[:, 0]
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
    cut = _Cut(d.shape, scalar := _is_scalar(d))
    token, shift = models.tokens(cut(np.abs(d).astype(np.uint64)))
    around = _neighbours(token, None if contexts is None else cut(_context_tokens(contexts, d.shape)))
    fields, expected_bits = _choose(around, token, order, rows, columns)

    encoder, family = Encoder(), fields.family
    encoder.put(_header(), np.arange(len(fields)), np.array(fields))
    law = fields.ladder.take(_mix(around, fields.mixture))
    symbol = np.minimum(token, family.sizes[law] - 1)
    escaped = symbol == family.sizes[law] - 1
    excess = token - symbol
    if scalar:
        where = np.flatnonzero(escaped) + 1
        table = np.insert(law.ravel().astype(np.int64), where, fields.laws)
        encoder.put(family, table, np.insert(symbol.ravel(), where, excess[escaped]))
    else:
        flat = [a.reshape(len(a), -1).T for a in (law, symbol, escaped, excess)]
        for *_, diagonal in _diagonals(*token.shape[1:]):
            q, s, beyond, by = (a[diagonal].ravel() for a in flat)
            encoder.put(family, q, s)
            if beyond.any():
                encoder.put(family, np.full(int(beyond.sum()), fields.laws), by[beyond])
    there = np.flatnonzero(token)
    bits = shift.ravel()[there].astype(np.uint64)
    signed = cut(d).ravel()[there]
    mantissa = np.abs(signed).astype(np.uint64) & (np.uint64(1) << bits) - np.uint64(1)
    encoder.raw((signed < 0).astype(np.uint64) << bits | mantissa, bits + np.uint64(1))
    return encoder.finish(1 if scalar else _states(token.shape, expected_bits))


def _is_scalar(values: Integers) -> bool:
    """Whether one state is best: where there are few symbols, or few bits, which many states would add to."""
    if values.size <= SCALAR_SYMBOLS:
        return True
    return values.size <= SCALAR_SYMBOLS_QUIET and int(np.count_nonzero(values)) <= SCALAR_LOUD


def _states(shape: tuple[int, int, int], bits: float) -> int:
    """How many states: few where there are few bits, but a diagonal should not take more than some thirty turns."""
    width = shape[0] * min(shape[1:])
    return 1 << min(15, max(4, int(max(min(bits / BITS_PER_STATE, width), width / 16)).bit_length() - 1))


class _Cut:
    """(steps, lanes) as segments (segments, steps of each, lanes), so that many symbols can be coded at a time.

    A loop over single symbols needs no segments. Otherwise the longer axis is cut, its end padded with zeros.
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
    """Step t of lane l belongs to diagonal t + l: (diagonal, first lane, last lane + 1, places in a flat segment).

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
    """What each symbol (segments, steps, lanes) looks at, as in MIXTURES; outside, what is nearest inside."""
    k, n, lanes = token.shape
    padded = np.zeros((k, n + 2, lanes + 2), np.int32)
    padded[:, 2:, 2:] = token
    padded[:, :2, 3:] = token[:, :1, :-1]
    past, past2 = padded[:, 1:-1, 2:], padded[:, :-2, 2:]
    beside, beside2, corner = padded[:, 2:, 1:-1].copy(), padded[:, 2:, :-2].copy(), padded[:, 1:-1, 1:-1].copy()
    beside[:, :, 0] = beside2[:, :, 0] = corner[:, :, 0] = past[:, :, 0]
    beside2[:, :, 1:2] = token[:, :, :1]
    mean = np.empty((n, k, lanes), np.int32)
    mean[0] = past[:, 0] << 8
    if k * lanes < 8:  # lists are faster than arrays so short
        for segment in range(k):
            for lane in range(lanes):
                value, values = int(mean[0, segment, lane]), []
                for t, now in enumerate(token[segment, :, lane].tolist()):
                    values.append(value)
                    value += (now << 8) - value >> _warming(t)
                mean[:, segment, lane] = values
    else:
        steps = np.ascontiguousarray(padded[:, 2:, 2:].transpose(1, 0, 2)) << 8
        for t in range(n - 1):
            np.add(mean[t], steps[t] - mean[t] >> _warming(t), out=mean[t + 1])
    mean = mean.transpose(1, 0, 2)
    return [past, past2, beside, beside2, corner, mean, given if given is not None else np.zeros(1, np.uint8)]


def _mix(around: list[Array], mixture: int) -> Array:
    """Expected token in sixteenths."""
    *weights, mean, given = MIXTURES[mixture]
    mixed = (around[5] * mean >> 8) + around[6].astype(np.int32) * given
    for a, w in zip(around, weights, strict=False):
        if w:
            mixed += a * w
    return mixed


def _choose(around: list[Array], token: Array, order: int, rows: int, columns: int) -> tuple[_Fields, float]:
    """What codes these tokens shortest, and in how many bits (without signs and mantissas)."""
    large = int(token.max() > 56)
    laws = models.LAWS_LARGE if large else models.LAWS
    every = max(1, token.size // 60_000)
    some = token[::every]
    around = [a[::every] if a.size > 1 else a for a in around]
    ladder = models.law_of_expectation(laws, 0, 0)
    field_bits = _bits_of_tables(_header())
    best, least = _Fields(0, 0, 0, 0, order, large, rows, columns), np.inf
    for mixture in range(len(MIXTURES) if around[6].size > 1 else WITHOUT_CONTEXTS):
        mixed = _mix(around, mixture)
        key = np.where(mixed == 0, laws, ladder.take(mixed)).astype(np.int64) * 256 + some
        counts = np.bincount(key.ravel(), minlength=(laws + 1) * 256)
        silent_counts = counts[laws * 256 :]
        pairs = np.flatnonzero(counts[: laws * 256])
        law, seen, times = pairs // 256, pairs % 256, counts[pairs]
        rungs = np.clip(law + np.arange(OFFSETS)[:, None] - OFFSETS // 2, 0, laws - 1)
        for shape in range(len(models.SHAPES)):
            cost = _bit_costs(laws, shape)
            silence = cost[:SILENT] @ silent_counts + field_bits[2, :SILENT]
            sounding = cost[rungs, seen] @ times + field_bits[3, :OFFSETS]
            bits = float(silence.min() + sounding.min() + field_bits[0, mixture] + field_bits[1, shape])
            if bits < least:
                silent, offset = int(silence.argmin()), int(sounding.argmin())
                best, least = best._replace(mixture=mixture, shape=shape, silent=silent, offset=offset), bits
    return best, least * token.size / some.size


def _unpack_dense(data: bytes, shape: tuple[int, int], contexts: Array | None) -> Integers:
    decoder = Decoder(data)
    fields = _Fields(*decoder.next(_header(), np.arange(len(_Fields._fields))).tolist())
    if fields.mixture >= WITHOUT_CONTEXTS and contexts is None:
        raise Corrupt("coded integers that need their contexts")
    kept = _kept(shape[0], fields.rows), _kept(shape[1], fields.columns)
    scalar = decoder.states == 1
    if scalar and kept[0] * kept[1] > SCALAR_SYMBOLS_QUIET:
        raise Corrupt("coded integers of an unknown kind")
    cut = _Cut(kept, scalar)
    given = None if contexts is None else cut(_context_tokens(contexts, kept))
    decode = _decode_one if scalar else _decode_many
    token = decode(decoder, fields, cut.shape, given)
    if token.max() >= models.TOKENS:
        raise Corrupt("coded integers out of range")
    there = np.flatnonzero(token)
    tokens = token.ravel()[there]
    shift = models.mantissa_bits(tokens).astype(np.int64)
    raw = decoder.raw(shift + 1).astype(np.int64)
    top = np.where(shift > 0, (tokens - np.uint8(models.DIRECT)) % 4 + 4, tokens).astype(np.int64)
    magnitude = top << shift | raw & (np.int64(1) << shift) - 1
    d = np.zeros(token.shape, np.int64)
    d.ravel()[there] = np.where(raw >> shift & 1 == 1, -magnitude, magnitude)
    d = cut.back(d)
    whole = np.zeros(shape, np.int64)
    whole[: kept[0], : kept[1]] = d
    for _ in range(fields.order):
        whole = np.cumsum(whole, axis=0)
    return whole


def _decode_one(
    decoder: Decoder, fields: _Fields, shape: tuple[int, int, int], given: Array | None
) -> NDArray[np.uint8]:
    """Tokens (1, steps, lanes), one after the other."""
    _, steps, lanes = shape
    family, ladder = fields.family, fields.ladder
    frequency, start, symbols = family.lists
    width, sizes, excess = family.width, family.sizes.tolist(), family.count - 1
    law_of = ladder.tolist()
    w1, w2, v1, v2, w3, wm, wg = MIXTURES[fields.mixture]
    quiet = frequency[law_of[0] * width]
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
            mixed = (
                w1 * up[l + 2] + w2 * up2[l + 2] + v1 * row[l + 1] + v2 * row[l] + w3 * up[l + 1] + (wm * means[l] >> 8)
            )
            if hints is not None:
                mixed += wg * hints[t][l]
            slot = x & MASK
            if mixed == 0 and slot < quiet:  # the usual: another zero among zeros
                x = quiet * (x >> PRECISION) + slot
                if x < LOW and at < end:
                    x = x << 16 | words[at]
                    at += 1
                if means[l]:
                    means[l] += -means[l] >> warming
                if l == 0:
                    row[1] = 0
                continue
            law = law_of[mixed]
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
    decoder: Decoder, fields: _Fields, shape: tuple[int, int, int], given: Array | None
) -> NDArray[np.uint8]:
    """Tokens (segments, steps, lanes), one diagonal of all segments after the other."""
    k, n, lanes = shape
    family, ladder = fields.family, fields.ladder
    w1, w2, v1, v2, w3, wm, wg = MIXTURES[fields.mixture]
    last, before = np.zeros((2, (lanes + 2) * k), np.int32)  # of each lane, those of all segments; two lanes outside
    mean = np.zeros(lanes * k, np.int32)
    warming = np.repeat(np.array([_warming(t) for t in range(n)], np.int32)[::-1], k)
    result = np.zeros((n * lanes, k), np.uint8)
    hints = None if given is None else given.reshape(k, n * lanes).T
    last_of = (family.sizes - 1).astype(np.uint8)
    for i, low, high, diagonal in _diagonals(n, lanes):
        if i < lanes:  # a lane begins
            beside = last[(i + 1) * k : (i + 2) * k]
            last[(i + 2) * k : (i + 3) * k] = before[(i + 2) * k : (i + 3) * k] = beside
            mean[i * k : (i + 1) * k] = beside << 8
        last[:k] = last[k : 2 * k] = before[:k] = before[k : 2 * k] = last[2 * k : 3 * k]
        if low >= 2:  # a lane has ended
            before[low * k : (low + 1) * k] = last[low * k : (low + 1) * k]
        m = mean[low * k : high * k]
        mixed = m * wm >> 8 if wm else np.zeros(len(m), np.int32)
        for w, a, shift in ((w1, last, 2), (w2, before, 2), (v1, last, 1), (v2, before, 0), (w3, before, 1)):
            if w:
                mixed += w * a[(low + shift) * k : (high + shift) * k]
        if hints is not None and wg:
            mixed += hints[diagonal].ravel().astype(np.int32) * wg
        law = ladder.take(mixed)
        token = decoder.next(family, law)
        escaped = (token == last_of.take(law)).nonzero()[0]
        if len(escaped):
            beyond = decoder.next(family, np.full(len(escaped), family.count - 1))
            token[escaped] = np.minimum(token[escaped].astype(np.int64) + beyond, 255)
        result[diagonal] = token.reshape(high - low, k)
        here = slice((low + 2) * k, (high + 2) * k)
        before[here] = last[here]
        last[here] = token
        if wm:
            m += (last[here] << 8) - m >> warming[(n - 1 - i + low) * k : (n - 1 - i + high) * k]
    return np.ascontiguousarray(result.T).reshape(shape)
