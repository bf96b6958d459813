"""Damaged containers with right checksums: the parts behind the checksums are what is tested."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, cast

import numpy as np

from mocodec import container
from mocodec.container.stored_signals import StoredSignal
from mocodec.container.wire import checksum
from mocodec.encoded import Chunk
from mocodec.errors import MocodecError

from . import mutations

CRC = 4


def mutate(data: bytes, random: np.random.Generator) -> bytes:
    """A `.mocz` with damage in one of its parts: shared bytes or a payload of any length, or a part in place."""
    if random.random() < 0.6:
        changed = _blobs(data, random)
        if changed is not None:
            return changed
    return _in_place(data, random)


def _blobs(data: bytes, random: np.random.Generator) -> bytes | None:
    """Shared bytes, payloads or numbers of frames changed, packed again; None where the writer refuses."""
    with container.Reader(data) as reader:
        encoded = reader.encoded
        shared, chunks = list(encoded.shared), [Chunk(c.start, c.frames, c.payload) for c in encoded.chunks]
    place = int(random.integers(len(shared) + len(chunks)))
    if place < len(shared):
        shared[place] = mutations.mutate(shared[place], random)
    else:
        number = place - len(shared)
        one = chunks[number]
        frames = one.frames if random.random() < 0.8 else int(2 ** random.integers(0, 18))
        chunks[number] = Chunk(one.start, frames, mutations.mutate(one.payload, random))
    starts = np.cumsum([0, *(c.frames for c in chunks)]).tolist()
    chunks = [replace(c, start=start) for c, start in zip(chunks, starts, strict=False)]
    try:
        return container.pack(replace(encoded, shared=tuple(shared), chunks=chunks))
    except MocodecError:
        return None


def _in_place(data: bytes, random: np.random.Generator) -> bytes:
    """Bytes of the header, the extras, a chunk of a signal or of motion, or the index replaced, with the checksum of
    that part."""
    with container.Reader(data) as reader:
        at = reader.layout
        edges = [*reader.chunks.offsets, *(at.signals + offset for offset in _signal_chunks(reader))]
    edges = sorted({0, at.extras, at.signals, at.chunks, *edges, at.end})
    parts = [*pairwise(edges)]
    parts = [(a, b) for a, b in parts if b - a > CRC]
    a, b = parts[random.integers(len(parts))]
    body = mutations.same_length(data[a : b - CRC], random)
    return data[:a] + body + checksum(body) + data[b:]


def _signal_chunks(reader: container.Reader) -> list[int]:
    """Where in the signals' part of a file each chunk begins."""
    return [offset for signal in _signals(reader.encoded.about.extras) for offset in signal.stored.offsets]


def _signals(tree: Mapping[str, Any]) -> Iterator[StoredSignal]:
    for value in tree.values():
        if isinstance(value, StoredSignal):
            yield value
        elif isinstance(value, Mapping):
            yield from _signals(cast("Mapping[str, Any]", value))
