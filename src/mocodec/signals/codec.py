"""A signal to bytes: a head, then chunks of a few seconds, each of which decodes alone, channel by channel."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..entropy.deflated import deflate, inflate
from ..errors import Corrupt
from ..fields.cursor import Cursor, blob, varint
from . import chunks, forms
from .forms import Form

Array = NDArray[Any]

CHUNK_SECONDS = 8.0
MIN_CHUNK_SAMPLES, MAX_CHUNK_SAMPLES = 2048, 1 << 15
MAX_CHANNELS = 1 << 16
MAX_HEAD_BYTES = 1 << 24
SMALL_STEP = 2.0**-14
"""Counts of smaller steps than this part of the largest value may be places in a palette instead."""


@dataclass(frozen=True)
class Head:
    """What the chunks of a signal have in common. shape: of all samples; a channel is an item of the other axes."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    chunk_samples: int
    forms: tuple[Form, ...]
    chunk_bytes: tuple[int, ...]

    @property
    def samples(self) -> int:
        return self.shape[0]


def suits(values: Array) -> bool:
    """Whether `encode` takes an array: numbers of a type that has forms, not empty."""
    return forms.suits(values.dtype) and values.size > 0 and values[0].size <= MAX_CHANNELS


def encode(values: Array, rate: float, bounds: Sequence[float | None] | None = None) -> tuple[Head, list[bytes]] | None:
    """Head and chunks of a signal; None where its numbers are too large for the coder's integers.

    values (samples, …); rate in hertz; bounds: the largest error of each channel, None for an exact one.
    """
    table = values.reshape(len(values), -1)
    chosen = _forms(table, [None] * table.shape[1] if bounds is None else bounds)
    if chosen is None:
        return None
    channel_forms, used = chosen
    length = chunk_samples(len(table), rate)
    count = -(-len(table) // length)
    channel_forms = _with_palettes(table[:length], table, channel_forms, used, count)
    payloads = [
        b"".join(chunks.encode(table[start : start + length], channel_forms, used))
        for start in range(0, len(table), length)
    ]
    return Head(values.dtype, values.shape, length, tuple(channel_forms), tuple(map(len, payloads))), payloads


def _forms(table: Array, bounds: Sequence[float | None]) -> tuple[list[Form], list[float | None]] | None:
    """The form of each channel, and the bounds of those that are not exact; None if integers would be too large."""
    known: list[Form] = []
    chosen: list[Form] = []
    used: list[float | None] = []
    for i, bound in enumerate(bounds):
        column = np.ascontiguousarray(table[:, i])
        exact = None if bound is None else forms.bounded(column, bound)
        form = exact or forms.fit(column, known)
        if form is None:
            return None
        chosen.append(form)
        used.append(bound if exact is not None else None)
        if form.kind == forms.COUNTS and exact is None and form not in known:
            known.insert(0, form)
    return chosen, used


def _with_palettes(
    first: Array, table: Array, channel_forms: list[Form], bounds: list[float | None], count: int
) -> list[Form]:
    """The forms, with palettes for channels of which the first chunk is shorter with one; count: of chunks."""
    plain = (forms.CONSTANT, forms.COUNTS)
    palettes = {
        i: palette
        for i, form in enumerate(channel_forms)
        if form.kind not in plain or form.step < SMALL_STEP * np.abs(first[:, i]).max()
        if bounds[i] is None and (palette := forms.palette(np.ascontiguousarray(table[:, i]))) is not None
    }
    if not palettes:
        return channel_forms
    trial = [palettes.get(i, form) for i, form in enumerate(channel_forms)]
    sizes = [list(map(len, chunks.encode(first, tried, bounds))) for tried in (channel_forms, trial)]
    return [
        palettes[i]
        if i in palettes and sizes[1][i] + len(forms.pack(palettes[i])) / count < sizes[0][i]
        else form
        for i, form in enumerate(channel_forms)
    ]


def chunk_samples(samples: int, rate: float) -> int:
    """Samples of a chunk: some seconds, in chunks of equal length."""
    longest = min(MAX_CHUNK_SAMPLES, max(MIN_CHUNK_SAMPLES, round(min(rate, 1e6) * CHUNK_SECONDS)))
    return -(-samples // max(1, round(samples / longest)))


def pack(head: Head) -> bytes:
    """varint length and deflated fields: samples of a chunk, forms, bytes of each chunk."""
    fields = varint(head.chunk_samples) + b"".join(map(forms.pack, head.forms)) + b"".join(map(varint, head.chunk_bytes))
    return varint(len(fields)) + blob(deflate(fields))


def unpack(cursor: Cursor, dtype: np.dtype[Any], shape: tuple[int, ...]) -> Head:
    """The inverse of `pack`, for a signal of this type and shape. Raises Corrupt."""
    length = cursor.varint()
    if not shape or 0 in shape or not forms.suits(dtype) or length > MAX_HEAD_BYTES:
        raise cursor.corrupt("a signal's shape or type is out of range")
    channels = math.prod(shape[1:])
    inner = Cursor(inflate(cursor.blob(), length, cursor.what), cursor.what, ends_early=Corrupt)
    if channels > min(MAX_CHANNELS, inner.left):
        raise cursor.corrupt(f"a signal of {channels} channels in {inner.left} bytes")
    chunk = inner.varint()
    if not 0 < chunk <= max(shape[0], 1) or -(-shape[0] // chunk) > inner.left or chunk > MAX_CHUNK_SAMPLES * 2:
        raise cursor.corrupt("the chunks of a signal are out of range")
    channel_forms = tuple(forms.unpack(inner, dtype) for _ in range(channels))
    sizes = tuple(inner.varint() for _ in range(-(-shape[0] // chunk)))
    inner.done()
    return Head(dtype, shape, chunk, channel_forms, sizes)


def decode(
    head: Head,
    payload: Callable[[int], bytes],
    start: int = 0,
    stop: int | None = None,
    channels: Iterable[int] | None = None,
) -> Array:
    """Samples [start, stop) of the channels with these numbers, (samples, channels); by default everything.

    payload: the bytes of a chunk by its number; it is called for the chunks that are needed only. Raises Corrupt.
    """
    stop = head.samples if stop is None else stop
    wanted = list(range(len(head.forms)) if channels is None else channels)
    out = np.empty((max(0, stop - start), len(wanted)), head.dtype)
    if stop <= start:
        return out
    for number in range(start // head.chunk_samples, -(-stop // head.chunk_samples)):
        first = number * head.chunk_samples
        count = min(head.chunk_samples, head.samples - first)
        columns = chunks.decode(payload(number), head.forms, head.dtype, count, wanted)
        low, high = max(start, first), min(stop, first + count)
        for place, i in enumerate(wanted):
            out[low - start : high - start, place] = columns[i][low - first : high - first]
    return out
