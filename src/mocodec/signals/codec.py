"""A signal to bytes: a head, then chunks of a few seconds, each of which decodes alone, channel by channel."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..entropy.compressors import deflate, inflate
from ..errors import Corrupt
from ..fields.cursor import Cursor, blob, varint
from . import chunks, form_choice, forms
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


def encode(values: Array, rate: float) -> tuple[Head, list[bytes]] | None:
    """Head and chunks of a signal (samples, …); None where its numbers are too large for the coder's integers.

    rate in hertz: a chunk has some seconds.
    """
    table = values.reshape(len(values), -1)
    length = chunk_samples(len(table), rate)
    found = _first_chunk(table, length)
    if found is None:
        return None
    channel_forms, records = found
    starts = range(length, len(table), length)
    payloads = [b"".join(records)]
    for start in starts:
        payloads.append(b"".join(chunks.pack(chunks.encode(table[start : start + length], channel_forms))))
    return Head(values.dtype, values.shape, length, tuple(channel_forms), tuple(map(len, payloads))), payloads


def channel_sizes(values: Array, rate: float) -> list[int] | None:
    """The bytes that each channel of a signal takes in the first chunk, its form included; None as in `encode`."""
    table = values.reshape(len(values), -1)
    found = _first_chunk(table, chunk_samples(len(table), rate))
    return None if found is None else [len(record) + len(forms.pack(form)) for form, record in zip(*found, strict=True)]


def _first_chunk(table: Array, length: int) -> tuple[list[Form], list[bytes]] | None:
    """The form of each channel, and the records of the first chunk; None where integers would be too large.

    length: samples of a chunk.
    """
    known: list[Form] = []
    result: list[Form] = []
    places: dict[bytes, int] = {}
    for number in range(table.shape[1]):
        column = np.ascontiguousarray(table[:, number])
        place = places.setdefault(sha256(column.view(np.uint8).data).digest(), len(result))
        is_copy = place < len(result) and result[place].kind != forms.CONSTANT
        form = Form(forms.COPY, channel=place) if is_copy else form_choice.fit(column, known)
        if form is None:
            return None
        result.append(form)
        if form.kind == forms.COUNTS and form not in known:
            known.insert(0, form)
    parts = chunks.encode(table[:length], result)
    records = chunks.pack(parts)
    palettes = _palettes(table, length, result, list(map(len, records)))
    if not palettes:
        return result, records
    result = [palettes[i][0] if i in palettes else form for i, form in enumerate(result)]
    if any(part is not None and part.references & palettes.keys() for part in parts):
        parts = chunks.encode(table[:length], result)
    else:
        parts = [palettes[i][1] if i in palettes else part for i, part in enumerate(parts)]
    return result, chunks.pack(parts)


def _palettes(
    table: Array, length: int, channel_forms: list[Form], sizes: list[int]
) -> dict[int, tuple[Form, chunks.Part | None]]:
    """Palettes of the channels that are shorter with one, coded alone, than their records of these sizes."""
    first = table[:length]
    palettes: dict[int, Form] = {}
    for i, form in enumerate(channel_forms):
        fine_steps = form.kind == forms.COUNTS and form.step < SMALL_STEP * np.abs(first[:, i]).max()
        if form.kind in (forms.GRID, forms.CORRECTED) or fine_steps:
            palette = form_choice.palette(np.ascontiguousarray(table[:, i]))
            palettes |= {} if palette is None else {i: palette}
    share = length / len(table)
    spare = {i: sizes[i] - share * len(deflate(forms.pack(palette))) for i, palette in palettes.items()}
    tried = [i for i in palettes if spare[i] > 0]
    if not tried:
        return {}
    parts = chunks.encode(first[:, tried], [palettes[i] for i in tried], alone=True)
    records = chunks.pack(parts)
    return {
        i: (palettes[i], part) for i, part, record in zip(tried, parts, records, strict=True) if len(record) < spare[i]
    }


def chunk_samples(samples: int, rate: float) -> int:
    """Samples of a chunk: some seconds, in chunks of equal length."""
    longest = min(MAX_CHUNK_SAMPLES, max(MIN_CHUNK_SAMPLES, round(min(rate, 1e6) * CHUNK_SECONDS)))
    return -(-samples // max(1, round(samples / longest)))


def pack(head: Head) -> bytes:
    """varint length and deflated fields: samples of a chunk, forms, bytes of each chunk."""
    fields = (
        varint(head.chunk_samples) + b"".join(map(forms.pack, head.forms)) + b"".join(map(varint, head.chunk_bytes))
    )
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
    channel_forms: list[Form] = []
    for _ in range(channels):
        form = forms.unpack(inner, dtype)
        if form.kind == forms.COPY and (
            form.channel >= len(channel_forms) or channel_forms[form.channel].kind == form.kind
        ):
            raise cursor.corrupt("a channel copies one that does not come before it")
        channel_forms.append(form)
    sizes = tuple(inner.varint() for _ in range(-(-shape[0] // chunk)))
    inner.done()
    return Head(dtype, shape, chunk, tuple(channel_forms), sizes)


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
    decoder = chunks.Decoder(head.forms, head.dtype)
    for number in range(start // head.chunk_samples, -(-stop // head.chunk_samples)):
        first = number * head.chunk_samples
        count = min(head.chunk_samples, head.samples - first)
        low, high = max(start, first), min(stop, first + count)
        decoder.decode(payload(number), count, low - first, wanted, out[low - start : high - start])
    return out
