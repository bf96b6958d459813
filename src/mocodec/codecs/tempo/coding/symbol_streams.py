"""Symbols of coefficients on rANS lanes, in the order and with the tables that contexts determine.

    frequencies from the lowest, in groups ─► rows of a group in turn on the lanes ─► then the lists

The tables of a group follow from the groups before it, so a group is decoded at once, for many chunks side by side.
The compiled module does the same chunk by chunk.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .... import native
from ....entropy import lanes, rans, symbols
from ....entropy.lanes import LaneDecoder
from ....typing import AnyInteger, Integers
from . import contexts
from .plan import ChunkPlan, Expectations

Words = NDArray[np.uint16]


class CodedSymbols(NamedTuple):
    """values (frequencies, rows) of a chunk; symbols of its lists, and the table of each; initial bits of its lanes."""

    values: Integers
    listed: Integers
    list_tables: Integers
    initial_bits: Integers


class DecodedSymbols(NamedTuple):
    """symbols (frequencies, rows) of a chunk; listed: of its lists; used: words; states: that are left."""

    symbols: AnyInteger
    listed: Integers
    used: int
    states: Integers


def encode(
    model: Expectations, plans: Sequence[ChunkPlan], chunks: Sequence[CodedSymbols]
) -> list[tuple[Integers, Words]]:
    """Final states and words of each chunk."""
    tables = model.tables
    if (kernel := native.kernel("tempo_encode")) is not None:
        return [
            kernel(np.ascontiguousarray(c.values), p.base, p.coded, p.lanes, tables.frequencies, tables.starts,
                   c.listed, c.list_tables, rans.LOW + c.initial_bits, *contexts.lookup(p.frequencies))
            for p, c in zip(plans, chunks, strict=True)
        ]  # fmt: skip
    layouts: list[tuple[Integers, Integers]] = []
    for p, c in zip(plans, chunks, strict=True):
        before = _steps_before([p])
        own_steps = int(before[-1])
        shape = (own_steps - (-len(c.listed) // p.lanes), p.lanes)
        of_step = np.zeros(shape, np.int64)
        table_of_step = np.full(shape, tables.idle)
        if p.frequencies:
            symbol = symbols.of_magnitudes(np.abs(c.values))
            frequency, row, group, at, lane = p.order
            at = at + before[group]
            of_step[at, lane] = symbol[frequency, row]
            table_of_step[at, lane] = contexts.all_tables(p.base, symbols.SMALLEST[symbol])[frequency, row]
        of_step[own_steps:].flat[: len(c.listed)] = c.listed
        table_of_step[own_steps:].flat[: len(c.listed)] = c.list_tables
        layouts.append((of_step, table_of_step))
    return lanes.encode(layouts, tables, [c.initial_bits for c in chunks])


def decode(
    model: Expectations,
    plans: Sequence[ChunkPlan],
    states: Sequence[Integers],
    words: Sequence[Words],
    list_tables: Sequence[Integers],
) -> list[DecodedSymbols]:
    """The inverse of `encode`, given the table of each symbol of the lists."""
    tables = model.tables
    if (kernel := native.kernel("tempo_decode")) is not None:
        found = [
            kernel(p.base, p.coded, model.rows, s, np.array(w), tables.packed, tables.symbols, t,
                   *contexts.lookup(p.frequencies))
            for p, s, w, t in zip(plans, states, words, list_tables, strict=True)
        ]  # fmt: skip
        return [DecodedSymbols(symbol, listed, used, last) for symbol, listed, last, used in found]
    stream = LaneDecoder(states, words, tables)
    coded = _decode_coefficients(model, plans, stream)
    listed = _decode_lists(model, plans, list_tables, stream)
    return [
        DecodedSymbols(symbol[: p.frequencies], of_lists, used, last[: p.lanes])
        for p, symbol, of_lists, used, last in zip(plans, coded, listed, *stream.finish(), strict=True)
    ]


def _decode_coefficients(model: Expectations, plans: Sequence[ChunkPlan], stream: LaneDecoder) -> NDArray[np.uint8]:
    """Symbols (chunks, frequencies, rows) of all chunks."""
    chunks, rows = len(plans), model.rows
    longest = max(p.frequencies for p in plans)
    if not longest:
        return np.zeros((chunks, 0, rows), np.uint8)
    tables = model.tables
    starts, _ = contexts.groups(longest)
    sizes = np.diff(starts, append=longest)
    before = _steps_before(plans)
    most_coded = np.max([p.coded for p in plans], axis=0)
    widths = ((most_coded > starts[:, None]) * np.arange(1, rows + 1)).max(axis=1)  # rows that a group reaches to
    where = np.full((int(before[-1]), *stream.states.shape), -1)  # flat index in a group's (chunks, frequencies, rows)
    base = np.zeros((chunks, longest, rows), np.int64)
    for j, p in enumerate(plans):
        frequency, row, group, step, lane = p.order
        of_chunk = j * sizes[group] + frequency - starts[group]
        where[before[group] + step, j, lane] = of_chunk * widths[group] + row
        base[j, : p.frequencies] = p.base
    weights = contexts.weights(rows)
    magnitudes = contexts.ceiling(symbols.SMALLEST).astype(np.float32)
    neighbours = np.zeros((chunks, contexts.DEPTH + longest, rows), np.float32)
    flat = neighbours.reshape(chunks, -1)
    symbol = np.zeros((chunks, longest, rows), np.uint8)
    shapes = contexts.shapes(longest)[starts]
    for g, (k, end, w, shape) in enumerate(zip(starts, starts + sizes, widths, shapes, strict=True)):
        near = (flat[:, k * rows : (k + contexts.DEPTH) * rows] @ weights[:, :w]).astype(np.int64)
        chosen = np.full(chunks * (end - k) * w + 1, tables.idle_place)
        chosen[:-1] = contexts.tables(base[:, k:end, :w], near[:, None], shape).ravel()
        chosen[:-1] <<= lanes.PRECISION
        places = np.full(len(chosen), tables.idle_place)
        for at in where[before[g] : before[g + 1]]:
            places[at] = stream.next(chosen.take(at, mode="wrap"))
        here = tables.symbols.take(places[:-1]).reshape(chunks, end - k, w)
        symbol[:, k:end, :w] = here
        neighbours[:, k + contexts.DEPTH : end + contexts.DEPTH, :w] = magnitudes.take(here)
    return symbol


def _decode_lists(
    model: Expectations, plans: Sequence[ChunkPlan], list_tables: Sequence[Integers], stream: LaneDecoder
) -> list[Integers]:
    """Symbols of the lists of all chunks, given the table of each."""
    steps = [-(-len(t) // p.lanes) for t, p in zip(list_tables, plans, strict=True)]
    idle = model.tables.idle
    table_of_step = np.full((max(steps), *stream.states.shape), idle)
    for j, (t, p, n) in enumerate(zip(list_tables, plans, steps, strict=True)):
        padded = np.full(n * p.lanes, idle)
        padded[: len(t)] = t
        table_of_step[:n, j, : p.lanes] = padded.reshape(n, p.lanes)
    table_of_step <<= lanes.PRECISION
    symbol = np.zeros_like(table_of_step)
    for of_step, table in zip(symbol, table_of_step, strict=True):
        of_step[:] = model.tables.symbols.take(stream.next(table))
    return [
        symbol[:n, j, : p.lanes].ravel()[: len(t)]
        for j, (t, p, n) in enumerate(zip(list_tables, plans, steps, strict=True))
    ]


def _steps_before(plans: Sequence[ChunkPlan]) -> Integers:
    """How many steps come before each group, and in all, (groups + 1,), if these chunks are coded side by side."""
    each = [p.group_steps for p in plans]
    most = np.zeros(max(map(len, each)) + 1, np.int64)
    for steps in each:
        most[1 : len(steps) + 1] = np.maximum(most[1 : len(steps) + 1], steps)
    return np.cumsum(most)
