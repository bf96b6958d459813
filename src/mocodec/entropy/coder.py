"""Arrays of integers to bytes and back, whatever they are.

    values ─► differences? ─► sign · token · mantissa ─► law from the tokens around ─► rANS ─► bytes

Every token's law is chosen from tokens that are already known: those before it in its lane and those of the lanes
before it. Short arrays go through one state, symbol by symbol; long ones through many (`bulk`). What is best for an
array as a whole (how to weigh the neighbours, a wider or narrower ladder of laws, differences or not) is found by
counting and sent in a few bits. docs/entropy.md has format, figures and reasons.
"""

from __future__ import annotations

from functools import cache
from math import gcd
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..errors import Corrupt
from . import bulk, models
from .models import PRECISION, Tables
from .rans import LOW, MANY, MASK, Decoder, Encoder

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
BULK = 1  # first byte of a stream of many states, plus how often differences were taken

SCALAR_SYMBOLS = 8000  # up to here, one state and a loop
SCALAR_SYMBOLS_QUIET = 1 << 16  # or up to here, where hardly any symbol says something
SCALAR_LOUD = 4000  # how many may
LARGEST = 56  # token for which the short ladder will do
COUNTED = 3000  # symbols among which the best fields are looked for


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
def _bit_costs(laws: int) -> NDArray[np.float32]:
    """Bits of each token under each law, escapes included: (shapes, laws, 256); for choosing only, never for coding."""
    cost = np.full((len(models.SHAPES), laws, 256), 64, np.float32)
    for shape in range(len(models.SHAPES)):
        family = models.family(laws, shape)
        bits = _bits_of_tables(family)
        for law, size in enumerate(family.sizes[:-1].tolist()):
            cost[shape, law, : size - 1] = bits[law, : size - 1]
            cost[shape, law, size - 1 : family.width] = bits[law, size - 1] + bits[-1, : family.width - size + 1]
    return cost


@cache
def _offset_costs(laws: int) -> NDArray[np.float32]:
    """The same with each offset along the ladder: (shapes × offsets, laws × 256)."""
    rungs = np.clip(np.arange(laws) + np.arange(OFFSETS)[:, None] - OFFSETS // 2, 0, laws - 1)
    return _bit_costs(laws)[:, rungs].reshape(-1, laws * 256)


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
    given = None if contexts is None else _context_tokens(contexts, d.shape)
    token = models.tokens(np.abs(d))
    known = order, int(token.max() > LARGEST), rows, columns
    if not _is_scalar(d):
        around = _neighbours(*_sample(token, given))
        fields, bits = _choose(around, *known)
        mixing, laws = bulk.Mixing(MIXTURES[fields.mixture], fields.ladder), bulk.laws(fields.laws, fields.shape)
        return _bulk_head(fields) + bulk.pack(token, d, mixing, laws, given, bits * token.size)
    around = _neighbours(token, given)
    fields, _ = _choose(around, *known)
    return _pack_one(d, token, around, fields)


def _pack_one(d: Integers, token: Array, around: _Around, fields: _Fields) -> bytes:
    encoder, family = Encoder(), fields.family
    encoder.put(_header(), np.arange(len(fields)), np.array(fields))
    law = fields.ladder.take(around.mixed(fields.mixture))
    last = family.sizes.take(law) - 1
    symbol = np.minimum(token, last)
    escaped = symbol == last
    if escaped.any():
        where = np.flatnonzero(escaped) + 1
        table = np.insert(law.ravel().astype(np.int64), where, fields.laws)
        encoder.put(family, table, np.insert(symbol.ravel(), where, (token - symbol)[escaped]))
    else:
        encoder.put(family, law.ravel(), symbol.ravel())
    there = np.flatnonzero(token)
    bits = models.mantissa_bits(token.ravel()[there]).astype(np.uint64)
    signed = d.ravel()[there]
    mantissa = np.abs(signed).astype(np.uint64) & (np.uint64(1) << bits) - np.uint64(1)
    encoder.raw((signed < 0).astype(np.uint64) << bits | mantissa, bits + np.uint64(1))
    return encoder.finish()


def _is_scalar(values: Integers) -> bool:
    """Whether one state is best: where there are few symbols, or few bits, which many states would add to."""
    if values.size <= SCALAR_SYMBOLS:
        return True
    return values.size <= SCALAR_SYMBOLS_QUIET and int(np.count_nonzero(values)) <= SCALAR_LOUD


def _bulk_head(fields: _Fields) -> bytes:
    """Five bytes; the low 14 bits of the first two are less than 64, as in no stream of one state."""
    rest = fields.rows | fields.columns << 5 | fields.silent << 10 | fields.mixture << 15
    rest |= fields.offset << 19 | fields.shape << 22 | fields.large << 23
    return bytes([BULK + fields.order, 0]) + rest.to_bytes(3, "little")


def _bulk_fields(head: bytes) -> _Fields:
    rest = int.from_bytes(head[2:], "little")
    mixture, order = rest >> 15 & 15, head[0] - BULK
    if len(head) < 5 or mixture >= len(MIXTURES) or not 0 <= order <= 2:
        raise Corrupt("coded integers of an unknown kind")
    return _Fields(
        mixture, rest >> 22 & 1, rest >> 10 & 31, rest >> 19 & 7, order, rest >> 23, rest & 31, rest >> 5 & 31
    )


def _difference(v: Integers, order: int) -> Integers:
    for _ in range(order):
        v = np.diff(v, axis=0, prepend=np.zeros((1, v.shape[1]), np.int64))
    return v


def _best_order(v: Integers) -> int:
    """How often to take differences along the steps: what makes the numbers shortest."""
    if len(v) < 3 or np.abs(v).max() >= 1 << 59:
        return 0
    v = v[:, :: max(1, v.shape[1] // 512)]
    if v.size > 8 * COUNTED and len(v) >= 64:  # eight runs of steps
        steps = max(8, COUNTED // v.shape[1])
        begins = np.linspace(0, len(v) - steps, 8).astype(int).tolist()
        bits = np.sum([_bits_by_order(v[a : a + steps], 2) for a in begins], axis=0)
    else:
        bits = _bits_by_order(v)
    bits[0] *= 0.97  # a tie goes to the plain numbers
    return int(np.argmin(bits))


def _bits_by_order(v: Integers, begin: int = 0) -> NDArray[np.float64]:
    """About how many bits the steps from `begin` take, plain and as first and second differences."""
    return np.array([np.log2(1 + 2 * np.abs(_difference(v, order)[begin:])).sum() for order in (0, 1, 2)])


def _context_tokens(contexts: Array, shape: tuple[int, int]) -> NDArray[np.uint8]:
    return models.tokens(np.abs(np.asarray(contexts)[: shape[0], : shape[1]].astype(np.int64)).view(np.uint64))


def _sample(token: Array, given: Array | None) -> tuple[Array, Array | None]:
    """Some runs of steps of a long array, one below the other, along its longer axis (as `bulk` codes it)."""
    if token.shape[1] > len(token):
        token, given = token.T, None if given is None else given.T
    if token.size <= 10 * COUNTED:
        return token, given
    runs = min(8, max(1, len(token) // 128))
    steps = min(len(token), max(1, 10 * COUNTED // (runs * token.shape[1])))
    begins = np.linspace(0, len(token) - steps, runs).astype(int)
    places = np.unique(begins[:, None] + np.arange(steps))
    return token[places], None if given is None else given[places]


def _warming(step: int) -> int:
    """How slowly a lane's running mean moves at this step."""
    return 1 if step == 0 else 2 if step < 3 else 3


class _Around(NamedTuple):
    """What each symbol (steps, lanes) looks at, as in MIXTURES; outside, what is nearest inside."""

    token: Array
    near: tuple[Array, ...]
    given: Array | None

    def mixed(self, mixture: int) -> Array:
        """Expected token in sixteenths."""
        *weights, mean, given = MIXTURES[mixture]
        result = _means(self.token, self.near[0]) * mean >> 8 if mean else np.zeros(self.token.shape, np.int32)
        return self._add(result, weights, given)

    def likely(self, mixture: int, means: Array) -> Array:
        """The same from means that need not be exact, for choosing."""
        *weights, mean, given = MIXTURES[mixture]
        return self._add((means * mean).astype(np.int32), weights, given)

    def _add(self, result: Array, weights: list[int], given: int) -> Array:
        for a, w in zip(self.near, weights, strict=True):
            if w:
                result += a * np.int32(w)
        if self.given is not None and given:
            result += self.given * np.int32(given)
        return result


def _neighbours(token: NDArray[np.uint8], given: NDArray[np.uint8] | None) -> _Around:
    n, lanes = token.shape
    padded = np.zeros((n + 2, lanes + 2), np.int32)
    padded[2:, 2:] = token
    padded[:2, 3:] = token[:1, :-1]
    past, past2 = padded[1:-1, 2:], padded[:-2, 2:]
    padded[2:, 0] = padded[2:, 1] = past[:, 0]
    beside, beside2, corner = padded[2:, 1:-1], padded[2:, :-2].copy(), padded[1:-1, 1:-1].copy()
    beside2[:, 1:2] = token[:, :1]
    corner[:, 0] = past[:, 0]
    return _Around(token, (past, past2, beside, beside2, corner), None if given is None else given.astype(np.int32))


def _means(token: Array, past: Array) -> Array:
    """Each lane's running mean before each step, × 256: what `_decode_one` does."""
    if (kernel := native.kernel("entropy_means")) is not None:
        return kernel(token, past[0].astype(np.int32))
    n, lanes = token.shape
    result = np.empty((n, lanes), np.int32)
    result[0] = past[0] << 8
    if lanes < 8:  # lists are faster than arrays so short
        for lane in range(lanes):
            value, values = int(result[0, lane]), []
            for t, now in enumerate(token[:, lane].tolist()):
                values.append(value)
                value += (now << 8) - value >> _warming(t)
            result[:, lane] = values
    else:
        steps = token.astype(np.int32) << 8
        for t in range(n - 1):
            np.add(result[t], steps[t] - result[t] >> _warming(t), out=result[t + 1])
    return result


def _likely_means(token: Array, past: Array) -> NDArray[np.float32]:
    """About `_means`/256, without a loop over steps: one in seven eighths of the mean before, by doubling."""
    means = past.astype(np.float32)
    means[1:] /= 8
    keep, reach = np.float32(7 / 8), 1
    while reach < min(len(token), 32):
        means[reach:] += means[:-reach] * keep
        keep, reach = keep * keep, 2 * reach
    return means


def _choose(around: _Around, order: int, large: int, rows: int, columns: int) -> tuple[_Fields, float]:
    """What codes these tokens shortest, and in how many bits a symbol (without signs and mantissas)."""
    token = around.token
    most = int(token.max()) + 1
    laws = models.LAWS_LARGE if large else models.LAWS
    mixtures = len(MIXTURES) if around.given is not None else WITHOUT_CONTEXTS
    ladder = _rung_or_silence(laws)
    means = _likely_means(token, around.near[0])
    some, share, silences = _some(around, means)
    near = tuple(a.ravel()[some] for a in around.near)
    given = None if around.given is None else around.given.ravel()[some]
    few = _Around(token.ravel()[some], near, given)
    means = means.ravel()[some]
    keys = np.stack([ladder.take(few.likely(m, means)) + m * (laws + 1) for m in range(mixtures)]) * most
    keys += few.token
    counts = np.bincount(keys.ravel(), minlength=mixtures * (laws + 1) * most).reshape(mixtures, laws + 1, most)
    counts = counts * share
    counts[:, laws, 0] += silences

    field_bits = _bits_of_tables(_header())
    cost = _bit_costs(laws)
    silence = counts[:, laws] @ cost[:, :SILENT, :most].reshape(-1, most).T
    silence = silence.reshape(mixtures, -1, SILENT) + field_bits[2, :SILENT]
    sounding = counts[:, :laws].reshape(mixtures, -1)
    seen = np.flatnonzero(sounding.any(axis=0))
    costs = _offset_costs(laws).take(seen // most * 256 + seen % most, axis=1)
    expected = sounding[:, seen].astype(np.float32) @ costs.T
    expected = expected.reshape(mixtures, -1, OFFSETS) + field_bits[3, :OFFSETS]
    total = silence.min(axis=2) + expected.min(axis=2) + field_bits[0, :mixtures, None] + field_bits[1, :2]
    mixture, shape = (int(a) for a in np.unravel_index(total.argmin(), total.shape))
    silent, offset = int(silence[mixture, shape].argmin()), int(expected[mixture, shape].argmin())
    fields = _Fields(mixture, shape, silent, offset, order, large, rows, columns)
    return fields, float(total[mixture, shape]) / token.size


def _some(around: _Around, means: Array) -> tuple[Array, float, int]:
    """Some of the symbols that are not zero among zeros, of how many each is one, and how many zeros among zeros."""
    any_sound = np.bitwise_or.reduce([around.token, *around.near] + ([] if around.given is None else [around.given]))
    sounding = np.flatnonzero((any_sound > 0) | (means >= 1 / 16))
    stride, lanes = max(1, len(sounding) // COUNTED), around.token.shape[1]
    while gcd(stride, lanes) > 1:  # all lanes alike
        stride -= 1
    some = sounding[::stride]
    return some, len(sounding) / max(1, len(some)), any_sound.size - len(sounding)


@cache
def _rung_or_silence(laws: int) -> NDArray[np.int64]:
    """The law of each expected token; `laws` where it is zero."""
    ladder = models.law_of_expectation(laws, 0, 0).astype(np.int64)
    ladder[0] = laws
    return ladder


def _unpack_dense(data: bytes, shape: tuple[int, int], contexts: Array | None) -> Integers:
    decoder = None if _is_bulk(data) else Decoder(data)
    if decoder:
        fields = _Fields(*decoder.next(_header(), np.arange(len(_Fields._fields))).tolist())
    else:
        fields = _bulk_fields(data[:5])
    if fields.mixture >= WITHOUT_CONTEXTS and contexts is None:
        raise Corrupt("coded integers that need their contexts")
    kept = _kept(shape[0], fields.rows), _kept(shape[1], fields.columns)
    given = None if contexts is None else _context_tokens(contexts, kept)
    if decoder:
        d = _unpack_one(decoder, fields, kept, given)
    else:
        mixing, laws = bulk.Mixing(MIXTURES[fields.mixture], fields.ladder), bulk.laws(fields.laws, fields.shape)
        d = bulk.unpack(data[5:], kept, mixing, laws, given)
    if kept == shape:
        whole = d
    else:
        whole = np.zeros(shape, np.int64)
        whole[: kept[0], : kept[1]] = d
    for _ in range(fields.order):
        np.cumsum(whole, axis=0, out=whole)
    return whole


def _is_bulk(data: bytes) -> bool:
    return len(data) > 5 and int.from_bytes(data[:2], "little") & MASK < MANY


def _unpack_one(decoder: Decoder, fields: _Fields, kept: tuple[int, int], given: Array | None) -> Integers:
    if kept[0] * kept[1] > SCALAR_SYMBOLS_QUIET:
        raise Corrupt("coded integers of an unknown kind")
    token = _decode_one(decoder, fields, kept, given)
    if token.max() >= models.TOKENS:
        raise Corrupt("coded integers out of range")
    there = np.flatnonzero(token)
    tokens = token.ravel()[there]
    shift = models.mantissa_bits(tokens).astype(np.int64)
    raw = decoder.raw(shift + 1).astype(np.int64)
    top = np.where(shift > 0, (tokens - np.uint8(models.DIRECT)) % 4 + 4, tokens).astype(np.int64)
    magnitude = top << shift | raw & (np.int64(1) << shift) - 1
    d = np.zeros(kept, np.int64)
    d.ravel()[there] = np.where(raw >> shift & 1 == 1, -magnitude, magnitude)
    return d


def _decode_one(decoder: Decoder, fields: _Fields, shape: tuple[int, int], given: Array | None) -> NDArray[np.uint8]:
    """Tokens (steps, lanes), one after the other."""
    steps, lanes = shape
    family, ladder = fields.family, fields.ladder
    if (kernel := native.kernel("entropy_decode")) is not None and family.symbol.dtype == np.uint8:
        token, decoder.x, decoder.at = kernel(
            family.frequency, family.start, family.symbol, family.sizes, family.width, family.count - 1, ladder,
            np.array(MIXTURES[fields.mixture]), decoder.x, decoder.at, np.array(decoder.words, np.uint16), steps, lanes,
            np.zeros((0, 0), np.uint8) if given is None else np.ascontiguousarray(given.reshape(steps, lanes)),
        )  # fmt: skip
        return token
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
    return np.array(result, np.uint8)
