"""Quantised coefficients of chunks as bytes, and back.

    integers, step, threshold ─pack─► bytes            bytes of many chunks ─unpack─► integers of all of them

    head (varints): lane code, whether there are lists, threshold, in one · step · [length and tables of the lists]
    final states of the lanes · words · raw bits that did not fit into the initial states

Raw bits are signs and what symbols leave of large magnitudes. Each lane's initial state holds 16 of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ....entropy import bits, lanes, rans, symbols, varint
from ....errors import Corrupt
from ....typing import Bytes, Integers
from . import contexts, symbol_streams
from .plan import LANES, ChunkPlan, Expectations, plan
from .symbol_streams import CodedSymbols

MAX_STEP = 2048
LARGEST_THRESHOLD = 4096
LIST_TABLES = (contexts.SHAPES - 1) * contexts.CLASSES
"""Lists use the tables of the last shape."""
SIGNED_FIELDS = 3
"""Number of fields of a list that may be negative: the first ones."""
SYMBOLS_PER_LANE = 96
"""A lane carries at least this many symbols, or it would cost more than the time that it saves is worth."""
LISTED_PER_BYTE = 64
"""Items of lists per byte of a chunk, at most: an item has the sign of a number that is not zero, a raw bit."""
BITS_PER_LANE = 16
"""Raw bits that an initial state holds."""
LANE_CODE, HAS_LISTS, THRESHOLD_SHIFT = 7, 8, 4
"""Parts of the first number."""


class ChunkNumbers(NamedTuple):
    """A chunk's integers.

    values (frequencies, rows): those in the coded zone of the threshold, in this step. lists (fields, n): further
    integers, coded after the coefficients with one table a field.
    """

    frames: int
    values: Integers
    step: int
    threshold: int
    lists: Integers | None = None


class DecodedNumbers(NamedTuple):
    """values (frequencies, rows), step, and lists (fields, n) of a chunk."""

    values: Integers
    step: int
    lists: Integers


def pack(model: Expectations, chunks: Sequence[ChunkNumbers]) -> list[bytes]:
    """The bytes of each chunk. They are coded side by side."""
    plans: list[ChunkPlan] = []
    heads: list[bytes] = []
    raws: list[Bytes] = []
    coded: list[CodedSymbols] = []
    for frames, values, step, threshold, lists in chunks:
        wide = plan(model, frames, step, threshold, 0)
        known = values[: wide.frequencies][wide.inside]
        listed = np.zeros((0, 0), np.int64) if lists is None else lists
        list_symbols = symbols.of_magnitudes(np.abs(listed))
        tables = list_coding(model, listed)[0] if listed.size else np.zeros(0, np.int64)
        raw = symbols.raw_bits(known, symbols.of_magnitudes(np.abs(known)))
        raw = np.concatenate([raw, _raw_of_lists(listed, list_symbols)])
        lane_code = _lane_code(known.size + listed.size, len(raw))
        head = [lane_code | HAS_LISTS * bool(listed.size) | varint.signed(threshold) << THRESHOLD_SHIFT]
        head += [step + MAX_STEP]
        if listed.size:
            head += [listed.shape[1], *tables]
        chosen = plan(model, frames, step, threshold, lane_code)
        heads.append(varint.write(head))
        plans.append(chosen)
        raws.append(raw)
        each = np.repeat(LIST_TABLES + tables, listed.size // max(len(tables), 1))
        initial = _initial_bits(raw, chosen.lanes)
        coded.append(CodedSymbols(values[: chosen.frequencies], list_symbols.ravel(), each, initial))
    out: list[bytes] = []
    streams = symbol_streams.encode(model, plans, coded)
    for p, head, raw, c, (states, words) in zip(plans, heads, raws, coded, streams, strict=True):
        if not (p.frequencies or len(c.listed)):
            out.append(head)
            continue
        rest = np.packbits(raw[BITS_PER_LANE * p.lanes :])
        out.append(head + _write_states(states) + words.astype("<u2").tobytes() + rest.tobytes())
    return out


class Head(NamedTuple):
    """A chunk's bytes in parts; list_tables: of each symbol of the lists; rest: words and raw bits."""

    plan: ChunkPlan
    list_tables: Integers
    states: Integers
    rest: bytes


def unpack(model: Expectations, frames: Sequence[int], payloads: Sequence[bytes], fields: int) -> list[DecodedNumbers]:
    """The integers of chunks that are decoded side by side. Raises Corrupt.

    frames: of each chunk. fields: how many the lists have.
    """
    heads = [read_head(model, count, payload, fields) for count, payload in zip(frames, payloads, strict=True)]
    words = [np.frombuffer(h.rest, "<u2", len(h.rest) // 2) for h in heads]
    streams = symbol_streams.decode(
        model, [h.plan for h in heads], [h.states for h in heads], words, [h.list_tables for h in heads]
    )
    result = []
    for head, word, stream in zip(heads, words, streams, strict=True):
        initial = lanes.bits_from_final_states(stream.states, stream.used, len(word))
        known, listed = stream.symbols.take(head.plan.places), stream.listed
        signed = SIGNED_FIELDS * (len(listed) // fields)
        count = symbols.raw_bit_count(known)
        total = count + symbols.raw_bit_count(listed, signed)
        first = bits.from_words(initial) if len(known) or len(listed) else np.zeros(0, np.uint8)
        beyond = max(0, total - len(first))
        if len(head.rest) != 2 * stream.used + (beyond + 7) // 8:
            raise Corrupt("tempo: a chunk that does not end where it should")
        later = np.unpackbits(np.frombuffer(head.rest, np.uint8, offset=2 * stream.used))
        raw = np.concatenate([first, later])
        if raw[total:].any():
            raise Corrupt("tempo: a chunk with bits behind its end")
        values = np.zeros((head.plan.frequencies, model.rows), np.int64)
        values.put(head.plan.places, symbols.values(known, raw[:count]))
        lists = symbols.values(listed, raw[count:total], signed).reshape(fields, -1)
        result.append(DecodedNumbers(values, head.plan.step, lists))
    return result


def read_head(model: Expectations, frames: int, payload: bytes, fields: int) -> Head:
    """The head of a chunk, and what follows it. fields: how many the lists have. Raises Corrupt."""
    (first, step), at = varint.read(payload, 2)
    threshold = varint.unsigned(first >> THRESHOLD_SHIFT)
    if step > 2 * MAX_STEP or abs(threshold) > LARGEST_THRESHOLD:
        raise Corrupt("tempo: a chunk whose step is out of range")
    list_tables = np.zeros(0, np.int64)
    if first & HAS_LISTS:
        (n, *classes), at = varint.read(payload, 1 + fields, at)
        if n > frames * model.points or max(classes) >= contexts.CLASSES:
            raise Corrupt("tempo: a chunk with more corrections than samples")
        if n > LISTED_PER_BYTE * len(payload):  # before tables for each are made
            raise Corrupt("tempo: a chunk with more corrections than its bytes can hold")
        list_tables = np.repeat(LIST_TABLES + np.array(classes), n)
    known = plan(model, frames, step - MAX_STEP, threshold, first & LANE_CODE)
    states = np.full(1, rans.LOW)
    if known.frequencies > 0 or len(list_tables) > 0:
        states, at = _read_states(payload, at, known.lanes)
    return Head(known, list_tables, states, payload[at:])


def list_coding(model: Expectations, lists: Integers) -> tuple[Integers, float]:
    """The class whose table codes each field of lists (fields, n) in the fewest bits, and an estimate of all bits."""
    symbol = symbols.of_magnitudes(np.abs(lists))
    counts = np.array([np.bincount(field, minlength=symbols.SYMBOLS) for field in symbol])
    price = model.tables.cost[LIST_TABLES : LIST_TABLES + contexts.CLASSES]
    # cumsum adds in order of the symbols, as the compiled module does
    bits_each = (price * counts[:, None]).cumsum(axis=2)[..., -1]
    chosen = bits_each.argmin(axis=1)
    raw = len(_raw_of_lists(lists, symbol)) if lists.size else 0
    return chosen.astype(np.int64), sum(bits_each[range(len(chosen)), chosen].tolist()) + raw


def _raw_of_lists(lists: Integers, symbol: Integers) -> Bytes:
    return symbols.raw_bits(lists.ravel(), symbol.ravel(), SIGNED_FIELDS * (lists.shape[1] if lists.size else 0))


def _initial_bits(raw: Bytes, count: int) -> Integers:
    """The raw bits that the initial states of `count` lanes hold."""
    first = np.zeros(BITS_PER_LANE * count, np.uint8)
    first[: len(raw)] = raw[: len(first)]
    return bits.unpack(first, np.full(count, BITS_PER_LANE))


def _lane_code(coded: int, raw: int) -> int:
    """The code of the number of lanes: as many as have 16 raw bits each, and enough symbols."""
    fitting = min(raw // BITS_PER_LANE, coded // SYMBOLS_PER_LANE)
    return int(np.searchsorted(LANES, max(1, fitting), side="right") - 1)


def _write_states(states: Integers) -> bytes:
    """A field of 4 bits for each state, its length in bits less 17; then each state without its top bit."""
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
    if area[end : (end + 7) // 8 * 8].any():
        raise Corrupt("tempo: a chunk with bits behind its states")
    return bits.unpack(area[4 * count :], sizes) + (1 << sizes), at + (end + 7) // 8
