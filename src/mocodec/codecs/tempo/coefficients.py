"""Quantised coefficients of chunks as bytes, and back.

    coefficients, step, threshold ─pack─► bytes            bytes of many chunks ─unpack─► coefficients of all of them

Both step through the frequencies from the lowest; at each, the rows inside the zone are coded in turn on a few lanes,
each with the table that the coefficients below it call for. What symbols leave over, and signs, are raw bits, and ride
in the lanes' first states as far as they fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ... import native
from ...entropy import varint
from ...errors import Corrupt
from ...motion import Floats
from . import bits, contexts, lanes, symbols
from .model import HEADING, POSE, Model

Integers = NDArray[np.int64]

THRESHOLD_UNIT = 16
"""Zones are stored in half octaves."""
MAX_STEP = 2048
LANES = (1, 2, 4, 8, 12, 16, 24, 32)


@dataclass(frozen=True, eq=False)
class Plan:
    """What both sides know before the first symbol of a chunk."""

    frames: int
    step: int
    lanes: int
    expected: Integers
    reach: Integers

    @property
    def frequencies(self) -> int:
        return len(self.expected)

    @cached_property
    def base(self) -> Integers:
        """`contexts.base`, (frequencies, rows)."""
        return contexts.base(self.expected)

    @cached_property
    def inside(self) -> NDArray[np.bool_]:
        """Which coefficients are coded, (frequencies, rows)."""
        return np.arange(self.frequencies)[:, None] < self.reach

    @cached_property
    def order(self) -> tuple[Integers, Integers, Integers, Integers, Integers]:
        """For each coefficient that is coded: frequency, row, group, step within the group, and lane."""
        frequency, row = np.nonzero(self.inside)
        group = contexts.groups(self.frequencies)[1][frequency]
        first = np.searchsorted(group, np.arange(group.max(initial=-1) + 1))
        rank = np.arange(len(frequency)) - first[group]
        return frequency, row, group, rank // self.lanes, rank % self.lanes

    @cached_property
    def places(self) -> Integers:
        """Where in flat (frequencies, rows) those are."""
        return np.flatnonzero(self.inside)

    @cached_property
    def steps(self) -> Integers:
        """How many steps each group of frequencies takes."""
        starts, number = contexts.groups(self.frequencies)
        active = np.bincount(number, self.inside.sum(axis=1), minlength=len(starts)).astype(np.int64)
        return -(-active // self.lanes)


@lru_cache(maxsize=24)
def plan(model: Model, frames: int, step: int, threshold: int, lane_code: int) -> Plan:
    logs = model.expected(frames, step)
    reach = contexts.zone(logs, threshold * THRESHOLD_UNIT)
    return Plan(frames, step, LANES[lane_code], logs[: reach.max()], reach)


SLOPE = 0.16
"""λ: squared error, in squared steps, that one bit is worth. At high rates the theory of uniform quantisers says
2 ln 2 / 12 = 0.116; more pays where most coefficients are zero."""


def quantise(model: Model, scaled: Floats, step: int, slope: float = SLOPE) -> tuple[Integers, int, float]:
    """Whole numbers for coefficients in steps (frames, rows), the zone's threshold, and about how many bits they take.

    Rate–distortion optimised: of the two numbers next to each coefficient the one that costs less in error and bits
    together is taken, and the zone ends where coding further costs more than it mends.
    """
    ground_ = ground(model, len(scaled), step)
    values = np.zeros(scaled.shape, np.int64)
    nearest = np.rint(np.abs(scaled)).astype(np.int64)
    frequencies = int(np.flatnonzero(nearest.any(axis=1)).max(initial=-1)) + 1
    if not frequencies:
        return values, int(ground_.reached[0].max()) + 1, 0.0
    base, reached, nearest = ground_.base[:frequencies], ground_.reached[:frequencies], nearest[:frequencies]
    if (kernel := native.kernel("tempo_quantise")) is not None:
        some = np.ascontiguousarray(scaled[:frequencies])
        lookup = contexts.lookup(frequencies)
        values[:frequencies], *rest = kernel(some, base, reached, prices(model), slope, INWARD, HEADING + 1, *lookup)
        return values, *rest
    # A coefficient that is nearest to zero is zero; the others have a choice.
    there = np.flatnonzero(nearest)
    signed = scaled.ravel().take(there)
    size, high = np.abs(signed), nearest.ravel().take(there)
    free = there % scaled.shape[1] > HEADING
    low = high - (free & (size < high))
    high_symbol, low_symbol = symbols.of(high), symbols.of(low)
    high_error, low_error = (size - _stands_for(high)) ** 2, (size - _stands_for(low)) ** 2
    price = prices(model)
    magnitude = nearest
    magnitude.ravel()[there] = symbols.FIRSTS.take(high_symbol)
    for last in (False, True):
        tables = contexts.all_tables(base, magnitude)
        of_there = tables.ravel().take(there) * symbols.SYMBOLS
        up, down = price.take(of_there + high_symbol), price.take(of_there + low_symbol)
        lower = low_error + slope * down < high_error + slope * up
        if not last:
            magnitude.ravel()[there] = symbols.FIRSTS.take(np.where(lower, low_symbol, high_symbol))
    chosen, error = np.where(lower, low, high), np.where(lower, low_error, high_error)
    bits_each = price.take(tables * symbols.SYMBOLS)
    bits_each.ravel()[there] = np.where(lower, down, up)
    gain = bits_each * -slope
    gain.ravel()[there] += size**2 - error
    height = reached.ravel().take(there)
    must = height[(chosen > 0) & ~free]
    top = int(reached[0].max())
    highest = min(int(must.min(initial=top)), top)
    lowest = int(height[chosen > 0].min(initial=highest))
    above = np.maximum(reached - (lowest - 1), 0).ravel()  # 0: below every threshold that is thought of
    worth, spent = (np.bincount(above, each.ravel())[::-1].cumsum()[::-1] for each in (gain, bits_each))
    worth[1] = worth[0]  # the widest zone answers for what is below it too: tables thin out there
    threshold = lowest + int(worth[1 : highest - lowest + 2].argmax())
    values.ravel()[there] = np.where(height >= threshold, np.copysign(chosen, signed), 0)
    return values, threshold, float(spent[threshold - lowest + 1])


class Ground(NamedTuple):
    """What the model says of every coefficient of a chunk, (frequencies, rows), before any is known.

    base: see `contexts.base`. reached: the highest threshold with a zone that the coefficient is in.
    """

    base: Integers
    reached: Integers


@lru_cache(maxsize=8)
def ground(model: Model, frames: int, step: int) -> Ground:
    logs = model.expected(frames, step)
    reached = np.maximum.accumulate(logs[::-1], axis=0)[::-1] // THRESHOLD_UNIT
    return Ground(contexts.base(logs), np.ascontiguousarray(reached))


@lru_cache(maxsize=4)
def prices(model: Model) -> Floats:
    """Bits of each symbol in each table, with those beside it, (tables · symbols,)."""
    return (model.prior.coder.cost() + symbols.WIDTHS + (np.arange(symbols.SYMBOLS) > 0)).ravel()


def _stands_for(magnitudes: Integers) -> Floats:
    """Where in its cell a magnitude of the pose decodes to."""
    return magnitudes - INWARD * (magnitudes > 0)


INWARD = 0.05
"""How far inside of its cell's middle, in steps, a coefficient probably is: small ones are more likely than large."""


def dequantise(values: Integers, sizes: Floats) -> Floats:
    """Coefficients from whole numbers (frequencies, rows) and the step of each row."""
    inward = np.where(np.arange(values.shape[1]) < POSE, 0.0, INWARD)
    return (values - np.sign(values) * inward) * sizes


class Numbers(NamedTuple):
    """What `pack` makes bytes of.

    values (frequencies, rows): those in the zone of the threshold, in this step, of so many frames. lists (fields, n):
    more numbers to go with them, coded after the coefficients with one table a field; the first three fields may be
    negative.
    """

    frames: int
    values: Integers
    step: int
    threshold: int
    lists: Integers | None = None


def pack(model: Model, of_chunks: Sequence[Numbers]) -> list[bytes]:
    """The bytes of each chunk. All are coded side by side."""
    plans: list[Plan] = []
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
    ridden = [_riding(raw, p.lanes) for raw, p in zip(raws, plans, strict=True)]
    streams = _encode(
        model, plans, [n.values[: p.frequencies] for n, p in zip(of_chunks, plans, strict=True)], lists, ridden
    )
    out: list[bytes] = []
    for p, head, raw, (listed, _), (states, words) in zip(plans, heads, raws, lists, streams, strict=True):
        if not (p.frequencies or len(listed)):
            out.append(head)
            continue
        beyond = np.packbits(raw[16 * p.lanes :])
        out.append(head + _write_states(states) + words.astype("<u2").tobytes() + beyond.tobytes())
    return out


def _riding(raw: bits.Bits, count: int) -> Integers:
    """The first states of so many lanes' raw bits, 16 each."""
    first = np.zeros(16 * count, np.uint8)
    first[: len(raw)] = raw[: len(first)]
    return bits.unpack(first, np.full(count, 16))


def _encode(
    model: Model,
    plans: Sequence[Plan],
    values: Sequence[Integers],
    lists: Sequence[tuple[Integers, Integers]],
    ridden: Sequence[Integers],
) -> list[tuple[Integers, NDArray[np.uint16]]]:
    """Last states and words of each chunk: of its values, then of its lists' symbols with the table of each."""
    coder = model.prior.coder
    if (kernel := native.kernel("tempo_encode")) is not None:
        return [
            kernel(np.ascontiguousarray(v), p.base, p.reach, p.lanes, coder.frequencies, coder.starts, *listed,
                   lanes.LOWEST + ride, *contexts.lookup(p.frequencies))
            for p, v, listed, ride in zip(plans, values, lists, ridden, strict=True)
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
    return lanes.encode(layouts, coder, ridden)


LIST_TABLES = (contexts.SHAPES - 1) * contexts.CLASSES
"""Lists are coded with the tables of the last shape."""
SIGNED_FIELDS = 3


def _list_tables(model: Model, symbol: Integers) -> Integers:
    """The class whose table codes each field (fields, n) in the fewest bits."""
    price = model.prior.coder.cost()[LIST_TABLES : LIST_TABLES + contexts.CLASSES]
    return np.array([price[:, field].sum(axis=1).argmin() for field in symbol], np.int64)


def list_bits(model: Model, lists: Integers) -> float:
    """About how many bits the lists (fields, n) take."""
    symbol = symbols.of(np.abs(lists))
    price = model.prior.coder.cost()[LIST_TABLES + _list_tables(model, symbol)[:, None], symbol]
    return float(price.sum() + len(_raw_of_lists(lists, symbol)))


def _raw_of_lists(lists: Integers, symbol: Integers) -> bits.Bits:
    return symbols.raw(lists.ravel(), symbol.ravel(), SIGNED_FIELDS * (lists.shape[1] if lists.size else 0))


def _steps_before(plans: Sequence[Plan]) -> Integers:
    """How many steps come before each group, and all of them, (groups + 1,), when these chunks go together."""
    each = [p.steps for p in plans]
    most = np.zeros(max(map(len, each)) + 1, np.int64)
    for steps in each:
        most[1 : len(steps) + 1] = np.maximum(most[1 : len(steps) + 1], steps)
    return np.cumsum(most)


def _lanes_for(coded: int, raw: int) -> int:
    """A lane costs about half a byte and saves time; it should carry 16 raw bits."""
    fitting = min(raw // 16, coded // 96)
    return int(np.searchsorted(LANES, max(1, fitting), side="right") - 1)


def unpack(
    model: Model, frames: Sequence[int], payloads: Sequence[bytes], fields: int
) -> list[tuple[Integers, int, Integers]]:
    """Of each payload the coefficients (frequencies, rows), the step, and the lists (fields, n). Raises Corrupt.

    All are decoded side by side.
    """
    plans: list[Plan] = []
    states: list[Integers] = []
    words: list[NDArray[np.uint16]] = []
    rests: list[bytes] = []
    lists: list[Integers] = []
    for count, payload in zip(frames, payloads, strict=True):
        (head, step), at = varint.read(payload, 2)
        threshold = varint.unsigned(head >> 4)
        if step > 2 * MAX_STEP or abs(threshold) > 4096:
            raise Corrupt("tempo: a chunk whose step is out of range")
        listed = np.zeros(0, np.int64)
        if head & 8:
            (n, *classes), at = varint.read(payload, 1 + fields, at)
            if n > count * len(model.points.names) or max(classes) >= contexts.CLASSES:
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
        riding = lanes.riding(last, used, len(word))
        known = symbol.take(p.places)
        signed = SIGNED_FIELDS * (len(listed) // fields)
        count = symbols.raw_count(known)
        total = count + symbols.raw_count(listed, signed)
        first = bits.of_words(riding) if len(known) or len(listed) else np.zeros(0, np.uint8)
        beyond = max(0, total - len(first))
        if len(rest) != 2 * used + (beyond + 7) // 8:
            raise Corrupt("tempo: a chunk that does not end where it should")
        later = np.unpackbits(np.frombuffer(rest, np.uint8, offset=2 * used), count=beyond)
        raw = np.concatenate([first, later])
        values = np.zeros((p.frequencies, model.rows), np.int64)
        values.put(p.places, symbols.values(known, raw[:count]))
        extra = symbols.values(listed, raw[count:total], signed).reshape(fields, -1)
        result.append((values, p.step, extra))
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


class Stream(NamedTuple):
    """What a chunk's words decode to: symbols (frequencies, rows), symbols of its lists, words used, last states."""

    symbols: contexts.Array
    listed: Integers
    used: int
    states: Integers


def _decode(
    model: Model,
    plans: Sequence[Plan],
    states: Sequence[Integers],
    words: Sequence[NDArray[np.uint16]],
    lists: Sequence[Integers],
) -> list[Stream]:
    """The inverse of `_encode`, given the table of each of the lists' symbols."""
    coder = model.prior.coder
    if (kernel := native.kernel("tempo_decode")) is not None:
        found = [
            kernel(
                p.base,
                p.reach,
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
        return [Stream(symbol, listed, used, last) for symbol, listed, last, used in found]
    stream = lanes.Lanes(states, words, coder)
    coded = _decode_coefficients(model, plans, stream)
    more = _decode_lists(model, plans, lists, stream)
    return [
        Stream(symbol[: p.frequencies], listed, used, last[: p.lanes])
        for p, symbol, listed, used, last in zip(plans, coded, more, *stream.finish(), strict=True)
    ]


def _decode_coefficients(model: Model, plans: Sequence[Plan], stream: lanes.Lanes) -> NDArray[np.uint8]:
    """The symbols (chunks, frequencies, rows) of all chunks."""
    chunks, rows = len(plans), model.rows
    longest = max(p.frequencies for p in plans)
    if not longest:
        return np.zeros((chunks, 0, rows), np.uint8)
    coder = model.prior.coder
    starts, _ = contexts.groups(longest)
    sizes = np.diff(starts, append=longest)
    before = _steps_before(plans)
    farthest = np.zeros(rows, np.int64)
    for p in plans:
        np.maximum(farthest, p.reach, out=farthest)
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
    model: Model, plans: Sequence[Plan], tables: Sequence[Integers], stream: lanes.Lanes
) -> list[Integers]:
    """The symbols of the lists of all chunks, each coded with the table that is given."""
    steps = [-(-len(t) // p.lanes) for t, p in zip(tables, plans, strict=True)]
    idle = model.prior.coder.idle
    by_table = np.full((max(steps), *stream.state.shape), idle)
    for j, (t, p, n) in enumerate(zip(tables, plans, steps, strict=True)):
        padded = np.full(n * p.lanes, idle)
        padded[: len(t)] = t
        by_table[:n, j, : p.lanes] = padded.reshape(n, p.lanes)
    by_table <<= lanes.PRECISION
    symbol = np.zeros_like(by_table)
    for found, t in zip(symbol, by_table, strict=True):
        found[:] = model.prior.coder.symbols.take(stream.take(t))
    return [
        symbol[:n, j, : p.lanes].ravel()[: len(t)] for j, (t, p, n) in enumerate(zip(tables, plans, steps, strict=True))
    ]
