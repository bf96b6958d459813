"""Quantised coefficients of chunks as bytes, and back.

    integers, step, threshold ─pack─► bytes            bytes of many chunks ─unpack─► integers of all of them

Both go through the frequencies from the lowest; at each, the rows inside the coded zone are coded in turn on a few
rANS lanes, each with the table that the coefficients at lower frequencies select. Signs and the raw bits of large
magnitudes are stored in the lanes' initial states as far as they fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .... import native
from ....entropy import varint
from ....errors import Corrupt
from ....typing import AnyInteger, Integers
from . import bits, contexts, lanes, symbols
from .plan import LANES, ChunkPlan, Expectations, plan

MAX_STEP = 2048
LARGEST_THRESHOLD = 4096
SYMBOLS_PER_LANE = 96
"""A lane carries at least this many symbols, or it would cost more than it saves time."""


class ChunkNumbers(NamedTuple):
    """A chunk's integers.

    values (frequencies, rows): those in the coded zone of the threshold, in this step. lists (fields, n): further
    integers, coded after the coefficients with one table a field; the first `SIGNED_FIELDS` fields may be negative.
    """

    frames: int
    values: Integers
    step: int
    threshold: int
    lists: Integers | None = None


def pack(model: Expectations, of_chunks: Sequence[ChunkNumbers]) -> list[bytes]:
    """The bytes of each chunk. All are coded side by side."""
    plans: list[ChunkPlan] = []
    heads: list[bytes] = []
    raws: list[bits.Bits] = []
    lists: list[tuple[Integers, Integers]] = []
    for frames, values, step, threshold, more in of_chunks:
        p = plan(model, frames, step, threshold, 0)
        known = values[: p.frequencies][p.inside]
        listed = np.zeros((0, 0), np.int64) if more is None else more
        listed_symbol = symbols.of(np.abs(listed))
        chosen = _list_tables(model, listed_symbol)
        raw = np.concatenate([symbols.raw(known, symbols.of(np.abs(known))), _raw_of_lists(listed, listed_symbol)])
        coded = known.size + listed.size
        lane_code = _lanes_for(coded, len(raw))
        head = [lane_code | bool(listed.size) << 3 | varint.signed(threshold) << 4, step + MAX_STEP]
        if listed.size:
            head += [listed.shape[1], *chosen]
        heads.append(varint.write(head))
        plans.append(plan(model, frames, step, threshold, lane_code))
        raws.append(raw)
        lists.append((listed_symbol.ravel(), np.repeat(LIST_TABLES + chosen, listed.size // max(len(chosen), 1))))
    in_states = [_initial_bits(raw, p.lanes) for raw, p in zip(raws, plans, strict=True)]
    streams = _encode(
        model, plans, [n.values[: p.frequencies] for n, p in zip(of_chunks, plans, strict=True)], lists, in_states
    )
    out: list[bytes] = []
    for p, head, raw, (listed, _), (states, words) in zip(plans, heads, raws, lists, streams, strict=True):
        if not (p.frequencies or len(listed)):
            out.append(head)
            continue
        beyond = np.packbits(raw[16 * p.lanes :])
        out.append(head + _write_states(states) + words.astype("<u2").tobytes() + beyond.tobytes())
    return out


def _initial_bits(raw: bits.Bits, count: int) -> Integers:
    """The raw bits that the initial states of `count` lanes hold, 16 each."""
    first = np.zeros(16 * count, np.uint8)
    first[: len(raw)] = raw[: len(first)]
    return bits.unpack(first, np.full(count, 16))


def _encode(
    model: Expectations,
    plans: Sequence[ChunkPlan],
    values: Sequence[Integers],
    lists: Sequence[tuple[Integers, Integers]],
    in_states: Sequence[Integers],
) -> list[tuple[Integers, NDArray[np.uint16]]]:
    """Final states and words of each chunk: of its values, then of its lists' symbols, given the table of each."""
    coder = model.tables
    if (kernel := native.kernel("tempo_encode")) is not None:
        return [
            kernel(np.ascontiguousarray(v), p.base, p.coded, p.lanes, coder.frequencies, coder.starts, *listed,
                   lanes.LOWEST + initial, *contexts.lookup(p.frequencies))
            for p, v, listed, initial in zip(plans, values, lists, in_states, strict=True)
        ]  # fmt: skip
    layouts: list[tuple[Integers, Integers]] = []
    for p, v, (listed, tables) in zip(plans, values, lists, strict=True):
        before = _steps_before([p])
        own_steps = int(before[-1])
        shape = (own_steps - (-len(listed) // p.lanes), p.lanes)
        of_step = np.zeros(shape, np.int64)
        by_table = np.full(shape, coder.idle)
        if p.frequencies:
            symbol = symbols.of(np.abs(v))
            frequency, row, group, at, lane = p.order
            at = at + before[group]
            of_step[at, lane] = symbol[frequency, row]
            by_table[at, lane] = contexts.all_tables(p.base, symbols.FIRSTS[symbol])[frequency, row]
        of_step[own_steps:].flat[: len(listed)] = listed
        by_table[own_steps:].flat[: len(listed)] = tables
        layouts.append((of_step, by_table))
    return lanes.encode(layouts, coder, in_states)


LIST_TABLES = (contexts.SHAPES - 1) * contexts.CLASSES
"""Lists use the tables of the last shape."""
SIGNED_FIELDS = 3


def _list_tables(model: Expectations, symbol: Integers) -> Integers:
    """The class whose table codes each field (fields, n) in the fewest bits."""
    price = model.tables.cost()[LIST_TABLES : LIST_TABLES + contexts.CLASSES]
    return np.array([price[:, field].sum(axis=1).argmin() for field in symbol], np.int64)


def list_bits(model: Expectations, lists: Integers) -> float:
    """About how many bits the lists (fields, n) take."""
    symbol = symbols.of(np.abs(lists))
    price = model.tables.cost()[LIST_TABLES + _list_tables(model, symbol)[:, None], symbol]
    return float(price.sum() + len(_raw_of_lists(lists, symbol)))


def _raw_of_lists(lists: Integers, symbol: Integers) -> bits.Bits:
    return symbols.raw(lists.ravel(), symbol.ravel(), SIGNED_FIELDS * (lists.shape[1] if lists.size else 0))


def _steps_before(plans: Sequence[ChunkPlan]) -> Integers:
    """How many steps come before each group, and in all, (groups + 1,), if these chunks are coded side by side."""
    each = [p.group_steps for p in plans]
    most = np.zeros(max(map(len, each)) + 1, np.int64)
    for steps in each:
        most[1 : len(steps) + 1] = np.maximum(most[1 : len(steps) + 1], steps)
    return np.cumsum(most)


def _lanes_for(coded: int, raw: int) -> int:
    """The code of the number of lanes: a lane costs about half a byte, less if its state holds 16 raw bits."""
    fitting = min(raw // 16, coded // SYMBOLS_PER_LANE)
    return int(np.searchsorted(LANES, max(1, fitting), side="right") - 1)


class DecodedNumbers(NamedTuple):
    """values (frequencies, rows), step, and lists (fields, n) of a chunk."""

    values: Integers
    step: int
    lists: Integers


def unpack(
    model: Expectations, frames: Sequence[int], payloads: Sequence[bytes], fields: int
) -> list[DecodedNumbers]:
    """The integers of chunks that are decoded side by side. Raises Corrupt.

    frames: of each chunk. fields: how many the lists have.
    """
    plans: list[ChunkPlan] = []
    states: list[Integers] = []
    words: list[NDArray[np.uint16]] = []
    rests: list[bytes] = []
    lists: list[Integers] = []
    for count, payload in zip(frames, payloads, strict=True):
        (head, step), at = varint.read(payload, 2)
        threshold = varint.unsigned(head >> 4)
        if step > 2 * MAX_STEP or abs(threshold) > LARGEST_THRESHOLD:
            raise Corrupt("tempo: a chunk whose step is out of range")
        listed = np.zeros(0, np.int64)
        if head & 8:
            (n, *classes), at = varint.read(payload, 1 + fields, at)
            if n > count * model.points or max(classes) >= contexts.CLASSES:
                raise Corrupt("tempo: a chunk with more corrections than samples")
            listed = np.repeat(LIST_TABLES + np.array(classes), n)
        p = plan(model, count, step - MAX_STEP, threshold, head & 7)
        plans.append(p)
        lists.append(listed)
        coded = p.frequencies > 0 or len(listed) > 0
        state, at = _read_states(payload, at, p.lanes) if coded else (np.full(1, lanes.LOWEST), at)
        states.append(state)
        rests.append(payload[at:])
        words.append(np.frombuffer(payload, "<u2", (len(payload) - at) // 2, at))
    result = []
    streams = _decode(model, plans, states, words, lists)
    for p, word, rest, (symbol, listed, used, last) in zip(plans, words, rests, streams, strict=True):
        initial = lanes.bits_from_final_states(last, used, len(word))
        known = symbol.take(p.places)
        signed = SIGNED_FIELDS * (len(listed) // fields)
        count = symbols.raw_count(known)
        total = count + symbols.raw_count(listed, signed)
        first = bits.of_words(initial) if len(known) or len(listed) else np.zeros(0, np.uint8)
        beyond = max(0, total - len(first))
        if len(rest) != 2 * used + (beyond + 7) // 8:
            raise Corrupt("tempo: a chunk that does not end where it should")
        later = np.unpackbits(np.frombuffer(rest, np.uint8, offset=2 * used), count=beyond)
        raw = np.concatenate([first, later])
        values = np.zeros((p.frequencies, model.rows), np.int64)
        values.put(p.places, symbols.values(known, raw[:count]))
        extra = symbols.values(listed, raw[count:total], signed).reshape(fields, -1)
        result.append(DecodedNumbers(values, p.step, extra))
    return result


def _write_states(states: Integers) -> bytes:
    sizes = np.array([int(s).bit_length() for s in states])
    widths = np.full(len(states), 4)
    return np.packbits(
        np.concatenate([bits.pack(sizes - 17, widths), bits.pack(states - (1 << (sizes - 1)), sizes - 1)])
    ).tobytes()


def _read_states(payload: bytes, at: int, count: int) -> tuple[Integers, int]:
    area = np.unpackbits(np.frombuffer(payload, np.uint8, min(4 * count + (count + 1) // 2, len(payload) - at), at))
    sizes = np.resize(area, 4 * count).reshape(count, 4) @ [8, 4, 2, 1] + 16
    end = 4 * count + int(sizes.sum())
    if end > len(area):
        raise Corrupt("tempo: a chunk that ends within its head")
    return bits.unpack(area[4 * count :], sizes) + (1 << sizes), at + (end + 7) // 8


class _DecodedSymbols(NamedTuple):
    """symbols (frequencies, rows) of a chunk; listed: of its lists; used: words; states: the final ones."""

    symbols: AnyInteger
    listed: Integers
    used: int
    states: Integers


def _decode(
    model: Expectations,
    plans: Sequence[ChunkPlan],
    states: Sequence[Integers],
    words: Sequence[NDArray[np.uint16]],
    lists: Sequence[Integers],
) -> list[_DecodedSymbols]:
    """The inverse of `_encode`, given the table of each symbol of the lists."""
    coder = model.tables
    if (kernel := native.kernel("tempo_decode")) is not None:
        found = [
            kernel(
                p.base,
                p.coded,
                model.rows,
                s,
                np.array(w),
                coder.packed,
                coder.symbols,
                t,
                *contexts.lookup(p.frequencies),
            )
            for p, s, w, t in zip(plans, states, words, lists, strict=True)
        ]
        return [_DecodedSymbols(symbol, listed, used, last) for symbol, listed, last, used in found]
    stream = lanes.Lanes(states, words, coder)
    coded = _decode_coefficients(model, plans, stream)
    more = _decode_lists(model, plans, lists, stream)
    return [
        _DecodedSymbols(symbol[: p.frequencies], listed, used, last[: p.lanes])
        for p, symbol, listed, used, last in zip(plans, coded, more, *stream.finish(), strict=True)
    ]


def _decode_coefficients(model: Expectations, plans: Sequence[ChunkPlan], stream: lanes.Lanes) -> NDArray[np.uint8]:
    """Symbols (chunks, frequencies, rows) of all chunks."""
    chunks, rows = len(plans), model.rows
    longest = max(p.frequencies for p in plans)
    if not longest:
        return np.zeros((chunks, 0, rows), np.uint8)
    coder = model.tables
    starts, _ = contexts.groups(longest)
    sizes = np.diff(starts, append=longest)
    before = _steps_before(plans)
    farthest = np.zeros(rows, np.int64)
    for p in plans:
        np.maximum(farthest, p.coded, out=farthest)
    widest = ((farthest > starts[:, None]) * np.arange(1, rows + 1)).max(axis=1)
    where = np.full((int(before[-1]), *stream.state.shape), -1)  # within a group's (chunks, frequencies, rows), flat
    base = np.zeros((chunks, longest, rows), np.int64)
    for j, p in enumerate(plans):
        frequency, row, group, step, lane = p.order
        of_chunk = j * sizes[group] + frequency - starts[group]
        where[before[group] + step, j, lane] = of_chunk * widest[group] + row
        base[j, : p.frequencies] = p.base
    weights = contexts.weights(rows)
    firsts = contexts.ceiling(symbols.FIRSTS).astype(np.float32)
    magnitude = np.zeros((chunks, contexts.DEPTH + longest, rows), np.float32)
    flat = magnitude.reshape(chunks, -1)
    symbol = np.zeros((chunks, longest, rows), np.uint8)
    shapes = contexts.shapes(longest)[starts]
    for g, (k, end, w, shape) in enumerate(zip(starts, starts + sizes, widest, shapes, strict=True)):
        near = (flat[:, k * rows : (k + contexts.DEPTH) * rows] @ weights[:, :w]).astype(np.int64)
        chosen = np.full(chunks * (end - k) * w + 1, coder.nothing)
        chosen[:-1] = contexts.tables(base[:, k:end, :w], near[:, None], shape).ravel()
        chosen[:-1] <<= lanes.PRECISION
        places = np.full(len(chosen), coder.nothing)
        for at in where[before[g] : before[g + 1]]:
            places[at] = stream.take(chosen.take(at, mode="wrap"))
        here = coder.symbols.take(places[:-1]).reshape(chunks, end - k, w)
        symbol[:, k:end, :w] = here
        magnitude[:, k + contexts.DEPTH : end + contexts.DEPTH, :w] = firsts.take(here)
    return symbol


def _decode_lists(
    model: Expectations, plans: Sequence[ChunkPlan], tables: Sequence[Integers], stream: lanes.Lanes
) -> list[Integers]:
    """Symbols of the lists of all chunks, given the table of each."""
    steps = [-(-len(t) // p.lanes) for t, p in zip(tables, plans, strict=True)]
    idle = model.tables.idle
    by_table = np.full((max(steps), *stream.state.shape), idle)
    for j, (t, p, n) in enumerate(zip(tables, plans, steps, strict=True)):
        padded = np.full(n * p.lanes, idle)
        padded[: len(t)] = t
        by_table[:n, j, : p.lanes] = padded.reshape(n, p.lanes)
    by_table <<= lanes.PRECISION
    symbol = np.zeros_like(by_table)
    for found, t in zip(symbol, by_table, strict=True):
        found[:] = model.tables.symbols.take(stream.take(t))
    return [
        symbol[:n, j, : p.lanes].ravel()[: len(t)] for j, (t, p, n) in enumerate(zip(tables, plans, steps, strict=True))
    ]
