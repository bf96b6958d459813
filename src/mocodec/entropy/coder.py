"""Arrays of integers to bytes and back, whatever they are.

    values ─► differences? ─► sign · token · mantissa ─► law from the neighbouring tokens ─► rANS ─► bytes

Every token's law follows from tokens that are known already: earlier ones of its lane and those of the lanes before it
(`neighbours`). Short arrays go through one state, symbol by symbol (`one_state`); long ones through many (`bulk`). The
parameters that suit an array (weights of neighbours, a wider or narrower ladder of laws, differences or not) are found
by counting (`choice`) and sent in a few bits. docs/entropy.md has format, figures and reasons.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from .. import native
from ..errors import CannotEncode, Corrupt
from ..typing import AnyInteger, Bytes, Integers
from . import bulk, choice, models
from .choice import Parameters, kept
from .models import PRECISION, Tables
from .neighbours import MIXTURES, WITHOUT_HINTS, Neighbours, mean_shift
from .one_state import MANY, MASK, StateDecoder, StateEncoder
from .rans import LOW, WORD_BITS

__all__ = ["StateDecoder", "StateEncoder", "Tables", "pack", "unpack"]

SPARSE = b"\0\0"
"""Instead of a stream: places and values of the integers that are not zero."""
BULK = 1
"""First byte of a stream of many states, plus the order of differences."""
MAX_MAGNITUDE = 1 << 62
MAX_INTEGERS = 1 << 24
"""The most integers of an array: more than the coordinates of the largest chunk."""

ONE_STATE_SYMBOLS = 8000
"""Up to here an array goes through one state,"""
ONE_STATE_SYMBOLS_SPARSE = 1 << 16
"""or up to here where it has at most"""
ONE_STATE_NONZERO = 4000
"""values that are not zero."""
SHORT_LADDER_TOKEN = 56
"""The short ladder of laws serves tokens up to this."""


def pack(values: AnyInteger, contexts: AnyInteger | None = None) -> bytes:
    """Integers (steps, lanes) as bytes; b"" where all are zero.

    Made for arrays with many zeros and with magnitudes that differ from lane to lane and change slowly along steps or
    lanes; it needs to know nothing else about them. contexts (steps, lanes): expected magnitudes that the decoder knows
    too. Raises ValueError for values beyond ±2^62, CannotEncode for more than MAX_INTEGERS.
    """
    v = np.asarray(values).astype(np.int64)
    if v.size > MAX_INTEGERS:
        raise CannotEncode(f"{v.size} integers in one array; at most {MAX_INTEGERS} can be coded")
    if v.ndim != 2:
        raise ValueError(f"values must be (steps, lanes), not {v.shape}")
    if not v.any():
        return b""
    if max(-int(v.min()), int(v.max())) > MAX_MAGNITUDE:
        raise ValueError("values beyond ±2^62")
    dense = _pack_dense(v, contexts)
    if v.size > ONE_STATE_SYMBOLS and np.count_nonzero(v) < min(v.size // 50, 1 << 20):
        sparse = _pack_sparse(v)
        if len(sparse) < len(dense):
            return sparse
    return dense


def unpack(
    data: bytes, shape: tuple[int, int], contexts: AnyInteger | None = None, most: int = MAX_INTEGERS
) -> Integers:
    """The integers of `pack`, of this shape. Raises Corrupt, also above `most` integers, since zeros take no bytes."""
    steps, lanes = shape
    if steps * lanes > most:
        raise Corrupt(f"coded integers: an array of {steps} × {lanes}, of at most {most} integers")
    if len(data) == 0 or steps * lanes == 0:
        if len(data):
            raise Corrupt("coded integers for an array that has none")
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
        raise Corrupt("coded integers: more than the array has places for")
    gaps = unpack(coded_gaps, (count, 1))[:, 0]
    if (gaps < 1).any() or gaps.max() > result.size or int(gaps.sum()) > result.size:
        raise Corrupt("coded integers outside their array")
    result.ravel()[np.cumsum(gaps) - 1] = unpack(coded_values, (count, 1))[:, 0]
    return result


def _pack_dense(v: Integers, contexts: AnyInteger | None) -> bytes:
    order = choice.best_order(v)
    d = choice.differences(v, order)
    rows = choice.kept_symbol(d.shape[0], int(np.flatnonzero(d.any(axis=1))[-1]) + 1)
    columns = choice.kept_symbol(d.shape[1], int(np.flatnonzero(d.any(axis=0))[-1]) + 1)
    d = d[: kept(d.shape[0], rows), : kept(d.shape[1], columns)]
    hints = None if contexts is None else _context_tokens(contexts, d.shape)
    token = models.tokens(np.abs(d))
    known = order, int(token.max() > SHORT_LADDER_TOKEN), rows, columns
    if not _suits_one_state(d):
        parameters, bits = choice.choose(*choice.sample(token, hints), *known)
        return _pack_bulk_head(parameters) + bulk.pack(token, d, *_of_bulk(parameters), hints, bits * token.size)
    parameters, _ = choice.choose(token, hints, *known)
    return _pack_one(d, token, hints, parameters)


def _pack_one(d: Integers, token: Bytes, hints: Bytes | None, parameters: Parameters) -> bytes:
    family, heads, ladder = parameters.family, choice.parameter_tables(), parameters.ladder
    if (kernel := native.kernel("entropy_pack_one")) is not None:
        return kernel(
            d, token, np.zeros((0, 0), np.uint8) if hints is None else hints, np.array(MIXTURES[parameters.mixture]),
            ladder, family.frequency, family.start, family.sizes,
            np.arange(len(parameters)) * heads.width + np.array(parameters), heads.frequency, heads.start,
        )  # fmt: skip
    encoder = StateEncoder()
    encoder.put(heads, np.arange(len(parameters)), np.array(parameters))
    law = ladder.take(Neighbours.of(token, hints).expected(parameters.mixture))
    last = family.sizes.take(law) - 1
    symbol = np.minimum(token, last)
    escaped = symbol == last
    if escaped.any():
        where = np.flatnonzero(escaped) + 1
        table = np.insert(law.ravel().astype(np.int64), where, parameters.laws)
        encoder.put(family, table, np.insert(symbol.ravel(), where, (token - symbol)[escaped]))
    else:
        encoder.put(family, law.ravel(), symbol.ravel())
    nonzero = np.flatnonzero(token)
    bits = models.mantissa_bits(token.ravel()[nonzero]).astype(np.uint64)
    signed = d.ravel()[nonzero]
    mantissa = np.abs(signed).astype(np.uint64) & (np.uint64(1) << bits) - np.uint64(1)
    encoder.raw((signed < 0).astype(np.uint64) << bits | mantissa, bits + np.uint64(1))
    return encoder.finish()


def _suits_one_state(values: Integers) -> bool:
    """Whether one state is best: for few symbols or few bits, of which many states would take a large part."""
    if values.size <= ONE_STATE_SYMBOLS:
        return True
    return values.size <= ONE_STATE_SYMBOLS_SPARSE and int(np.count_nonzero(values)) <= ONE_STATE_NONZERO


def _pack_bulk_head(parameters: Parameters) -> bytes:
    """Five bytes. The low 14 bits of the first two are less than `MANY`, which they never are in a stream of one
    state."""
    rest = parameters.rows | parameters.columns << 5 | parameters.zero_law << 10 | parameters.mixture << 15
    rest |= parameters.offset << 19 | parameters.shape << 22 | parameters.long_ladder << 23
    return bytes([BULK + parameters.order, 0]) + rest.to_bytes(3, "little")


def _unpack_bulk_head(head: bytes) -> Parameters:
    rest = int.from_bytes(head[2:], "little")
    mixture, order = rest >> 15 & 15, head[0] - BULK
    if len(head) < 5 or mixture >= len(MIXTURES) or not 0 <= order <= 2:
        raise Corrupt("coded integers of an unknown kind")
    return Parameters(
        mixture, rest >> 22 & 1, rest >> 10 & 31, rest >> 19 & 7, order, rest >> 23, rest & 31, rest >> 5 & 31
    )


def _context_tokens(contexts: AnyInteger, shape: tuple[int, int]) -> Bytes:
    return models.tokens(np.abs(np.asarray(contexts)[: shape[0], : shape[1]].astype(np.int64)).view(np.uint64))


@cache
def _state_streams(kernel: Callable[..., Any], long_ladder: bool) -> Any:
    """The compiled decoder of short arrays, with its tables."""
    streams = kernel(models.usual_law(), np.array(MIXTURES, np.int64), long_ladder)
    laws = models.LAWS_LARGE if long_ladder else models.LAWS
    families = [models.family(laws, shape) for shape in range(len(models.SHAPES))]
    for tables in (choice.parameter_tables(), *families):
        streams.add(tables.frequency, tables.start, tables.symbol, tables.sizes)
    return streams


def compiled_streams() -> tuple[Any, Any] | None:
    """The compiled decoders of short arrays, of the usual and of the long ladder of laws; None without the module."""
    kernel = native.kernel("StateStreams")
    return None if kernel is None else (_state_streams(kernel, False), _state_streams(kernel, True))


def _unpack_dense(data: bytes, shape: tuple[int, int], contexts: AnyInteger | None) -> Integers:
    if (kernel := native.kernel("StateStreams")) is not None and not _is_bulk(data):
        streams = _state_streams(kernel, False)
        if streams.has_long_ladder(data):
            streams = _state_streams(kernel, True)
        found = streams.unpack(data, *shape, ONE_STATE_SYMBOLS_SPARSE)
        if found is not None:
            return found
    decoder = None if _is_bulk(data) else StateDecoder(data)
    if decoder:
        parameters = Parameters(*decoder.next(choice.parameter_tables(), np.arange(len(Parameters._fields))).tolist())
    else:
        parameters = _unpack_bulk_head(data[:5])
    if parameters.mixture >= WITHOUT_HINTS and contexts is None:
        raise Corrupt("coded integers that need their contexts")
    coded = kept(shape[0], parameters.rows), kept(shape[1], parameters.columns)
    hints = None if contexts is None else _context_tokens(contexts, coded)
    if decoder:
        d = _unpack_one(decoder, parameters, coded, hints)
    else:
        d = bulk.unpack(data[5:], coded, *_of_bulk(parameters), hints)
    if coded == shape:
        whole = d
    else:
        whole = np.zeros(shape, np.int64)
        whole[: coded[0], : coded[1]] = d
    for _ in range(parameters.order):
        np.cumsum(whole, axis=0, out=whole)
    return whole


def _of_bulk(parameters: Parameters) -> tuple[bulk.Mixing, bulk.Laws]:
    mixing = bulk.Mixing(MIXTURES[parameters.mixture], parameters.ladder)
    return mixing, bulk.laws(parameters.laws, parameters.shape)


def _is_bulk(data: bytes) -> bool:
    return len(data) > 5 and int.from_bytes(data[:2], "little") & MASK < MANY


def _unpack_one(decoder: StateDecoder, parameters: Parameters, shape: tuple[int, int], hints: Bytes | None) -> Integers:
    if shape[0] * shape[1] > ONE_STATE_SYMBOLS_SPARSE:
        raise Corrupt("coded integers of an unknown kind")
    token = _decode_tokens(decoder, parameters, shape, hints)
    if token.max() >= models.TOKENS:
        raise Corrupt("coded integers out of range")
    nonzero = np.flatnonzero(token)
    tokens = token.ravel()[nonzero]
    shift = models.mantissa_bits(tokens).astype(np.int64)
    raw = decoder.raw(shift + 1).astype(np.int64)
    top = np.where(shift > 0, (tokens - np.uint8(models.DIRECT)) % 4 + 4, tokens).astype(np.int64)
    magnitude = top << shift | raw & (np.int64(1) << shift) - 1
    d = np.zeros(shape, np.int64)
    d.ravel()[nonzero] = np.where(raw >> shift & 1 == 1, -magnitude, magnitude)
    return d


def _decode_tokens(decoder: StateDecoder, parameters: Parameters, shape: tuple[int, int], hints: Bytes | None) -> Bytes:
    """Tokens (steps, lanes), one after the other."""
    family, ladder = parameters.family, parameters.ladder
    kernel = native.kernel("entropy_decode")
    if kernel is None or family.symbol.dtype != np.uint8:
        return _decode_tokens_in_python(decoder, parameters, shape, hints)
    token, decoder.x, decoder.at = kernel(
        family.frequency, family.start, family.symbol, family.sizes, family.width, family.count - 1, ladder,
        np.array(MIXTURES[parameters.mixture]), decoder.x, decoder.at, np.array(decoder.words, np.uint16), *shape,
        np.zeros((0, 0), np.uint8) if hints is None else np.ascontiguousarray(hints.reshape(shape)),
    )  # fmt: skip
    return token


def _decode_tokens_in_python(
    decoder: StateDecoder, parameters: Parameters, shape: tuple[int, int], hints: Bytes | None
) -> Bytes:
    """The same in Python. One function, with the decoder's step written out: calls would double its time."""
    steps, lanes = shape
    family = parameters.family
    frequency, start, symbols = family.lists
    width, sizes, excess = family.width, family.sizes.tolist(), family.count - 1
    law_of = parameters.ladder.tolist()
    w1, w2, v1, v2, w3, wm, wg = MIXTURES[parameters.mixture]
    zero_frequency = frequency[law_of[0] * width]
    x, at, words = decoder.x, decoder.at, decoder.words
    end = len(words)
    result = []
    means = [0] * lanes
    up = up2 = [0] * (lanes + 3)
    hint_rows: Any = None if hints is None else hints.reshape(steps, lanes).tolist()
    for t in range(steps):
        row = [0] * (lanes + 3)
        row[0] = row[1] = up[1] = up[2]
        shift = mean_shift(t)
        for l in range(lanes):  # noqa: E741
            if t == 0:
                means[l] = up[l + 2] << 8
            mixed = (
                w1 * up[l + 2] + w2 * up2[l + 2] + v1 * row[l + 1] + v2 * row[l] + w3 * up[l + 1] + (wm * means[l] >> 8)
            )
            if hint_rows is not None:
                mixed += wg * hint_rows[t][l]
            slot = x & MASK
            if mixed == 0 and slot < zero_frequency:  # the most frequent case: zero among zeros
                x = zero_frequency * (x >> PRECISION) + slot
                if x < LOW and at < end:
                    x = x << WORD_BITS | words[at]
                    at += 1
                if means[l]:
                    means[l] += -means[l] >> shift
                if l == 0:
                    row[1] = 0
                continue
            law = law_of[mixed]
            token = symbols[law << PRECISION | slot]
            place = law * width + token
            x = frequency[place] * (x >> PRECISION) + slot - start[place]
            if x < LOW and at < end:
                x = x << WORD_BITS | words[at]
                at += 1
            if token == sizes[law] - 1:
                slot = x & MASK
                beyond = symbols[excess << PRECISION | slot]
                place = excess * width + beyond
                x = frequency[place] * (x >> PRECISION) + slot - start[place]
                if x < LOW and at < end:
                    x = x << WORD_BITS | words[at]
                    at += 1
                token = min(token + beyond, 255)
            row[l + 2] = token
            if l == 0:
                row[1] = token
            if t == 0:
                up[l + 3] = token
            means[l] += (token << 8) - means[l] >> shift
        up2, up = up, row
        result.append(row[2 : lanes + 2])
    decoder.x, decoder.at = x, at
    return np.array(result, np.uint8)
