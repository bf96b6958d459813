# pyright: strict
"""Decoded chunks of open files, so that windows of a few frames are cut from memory.

    f[a:b] ─► chunks of frames [a, b) ──in the cache──► frames of these
                     ├──used before──► decoded whole ──► cache, the least recently used chunks leave it
                     └──never used──► frames [a, b) decoded alone, where the codec can: a single window is fastest so

One cache serves all open files of a process. It holds 64 MB of positions and rotations; MOCODEC_CACHE_MB in the
environment sets another size, 0 turns it off. It may be used from several threads.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Sequence
from itertools import count
from threading import Lock
from typing import NamedTuple

import numpy as np

from .encoded import Encoded, restore
from .motion import Motion
from .typing import Floats, Integers

DEFAULT_MB = 64
BYTES_PER_SAMPLE = 3 * 8
MOST_CHUNKS = 4
"""Windows of more chunks are decoded as a whole and not kept, since such readers read on."""


class DecodedChunk(NamedTuple):
    """positions (frames, points, 3), metres; rotations (frames, joints, 4) or None. Never written to."""

    positions: Floats
    rotations: Floats | None

    @classmethod
    def of(cls, motion: Motion, frames: slice) -> DecodedChunk:
        """Some frames of a motion; a copy, unless they are all."""
        if frames == slice(0, len(motion)):
            return cls(motion.positions, motion.rotations)
        turned = motion.rotations
        return cls(motion.positions[frames].copy(), None if turned is None else turned[frames].copy())

    @property
    def bytes(self) -> int:
        return self.positions.nbytes + (0 if self.rotations is None else self.rotations.nbytes)


class ChunkCache:
    """Chunks by (file, number of the chunk), at most `most_bytes` of them."""

    def __init__(self, most_bytes: int) -> None:
        self.most_bytes = most_bytes
        self.bytes = 0
        self._chunks: OrderedDict[tuple[int, int], DecodedChunk] = OrderedDict()
        self._used = set[tuple[int, int]]()
        self._lock = Lock()

    def get(self, file: int, number: int) -> DecodedChunk | None:
        """A chunk, which becomes the most recently used one; None if the cache does not have it."""
        with self._lock:
            found = self._chunks.get((file, number))
            if found is not None:
                self._chunks.move_to_end((file, number))
            return found

    def first_use(self, file: int, numbers: range) -> bool:
        """Whether none of these chunks of a file was used before; from now on they were."""
        keys = [(file, number) for number in numbers]
        with self._lock:
            unused = self._used.isdisjoint(keys)
            self._used.update(keys)
            return unused

    def put(self, file: int, number: int, chunk: DecodedChunk) -> None:
        """Keep a chunk, and drop the least recently used ones beyond `most_bytes`."""
        with self._lock:
            self._remove((file, number))
            self._chunks[file, number] = chunk
            self.bytes += chunk.bytes
            while self.bytes > self.most_bytes:
                self._remove(next(iter(self._chunks)))

    def drop(self, file: int) -> None:
        """Forget all chunks of a file."""
        with self._lock:
            for key in [key for key in self._chunks if key[0] == file]:
                self._remove(key)
            self._used -= {key for key in self._used if key[0] == file}

    def forget_all(self) -> None:
        """Empty, with a lock of its own: for a forked process, whose copy of the lock may be held for ever."""
        self._lock = Lock()
        self._chunks.clear()
        self._used.clear()
        self.bytes = 0

    def _remove(self, key: tuple[int, int]) -> None:
        if (old := self._chunks.pop(key, None)) is not None:
            self.bytes -= old.bytes


def size_from_environment() -> int:
    """Bytes of the cache, as MOCODEC_CACHE_MB says; the default if it is not set or no number."""
    try:
        return max(0, int(float(os.environ.get("MOCODEC_CACHE_MB", DEFAULT_MB)) * 1e6))
    except (ValueError, OverflowError):
        return DEFAULT_MB * 1_000_000


CACHE = ChunkCache(size_from_environment())
next_file = count().__next__
"""A number for each opened file."""
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=CACHE.forget_all)


Decode = Callable[[Encoded[Motion], slice], Motion]


def window(
    file: int, decode: Decode, encoded: Encoded[Motion], starts: Integers, frames: slice, frames_alone: bool = False
) -> Motion:
    """Frames [start, stop) of an open file, by way of the cache. Raises what `decode` raises.

    file: its number. decode: the codec's. starts (chunks + 1,): the first frame of each chunk, then the number of
    all frames. frames_alone: whether decoding some frames of a chunk is faster than the whole chunk.
    """
    start, stop = frames.start, frames.stop
    if start >= stop:
        return decode(encoded, frames)
    first, past = starts.searchsorted((start, stop - 1), side="right").tolist()
    first -= 1
    if frames_alone and CACHE.first_use(file, range(first, past)):
        return decode(encoded, frames)
    size = (starts[past] - starts[first]) * encoded.about.points * BYTES_PER_SAMPLE
    if past - first > MOST_CHUNKS or size > CACHE.most_bytes // 2:
        return decode(encoded, frames)
    edges = starts[first : past + 1].tolist()
    chunks = _chunks(file, decode, encoded, first, edges)
    inside = [slice(max(0, start - edge), stop - edge) for edge in edges[:-1]]
    positions = np.concatenate([c.positions[i] for c, i in zip(chunks, inside, strict=True)])
    turned = [c.rotations[i] for c, i in zip(chunks, inside, strict=True) if c.rotations is not None]
    return restore(encoded, positions, start, np.concatenate(turned) if turned else None, are_valid=True)


def _chunks(
    file: int, decode: Decode, encoded: Encoded[Motion], first: int, edges: Sequence[int]
) -> list[DecodedChunk]:
    """Whole chunks from number `first` on, decoded together where the cache does not have them.

    edges: the first frame of each, and the one behind the last.
    """
    found = [CACHE.get(file, first + i) for i in range(len(edges) - 1)]
    unknown = [i for i, chunk in enumerate(found) if chunk is None]
    if unknown:
        origin = edges[unknown[0]]
        motion = decode(encoded, slice(origin, edges[unknown[-1] + 1]))
        for i in unknown:
            found[i] = chunk = DecodedChunk.of(motion, slice(edges[i] - origin, edges[i + 1] - origin))
            CACHE.put(file, first + i, chunk)
    return [chunk for chunk in found if chunk is not None]
