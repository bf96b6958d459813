"""The bytes of a run of frames.

who is there · stray frames · strangers · exact points · and of each body: poses, pictures
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...encoded import Chunk
from ...entropy import coder, varint
from ...errors import Corrupt


class Play(NamedTuple):
    """One body's part in a chunk: its poses and the packets of its moving surface; the first of those is empty where it
    is the model's key.
    """

    poses: bytes
    pictures: tuple[bytes, ...]


class Parts(NamedTuple):
    """absent (frames, bodies): who is not there; and the streams of a chunk."""

    absent: NDArray[np.bool_]
    strays: bytes
    foreign: bytes
    exact: bytes
    plays: tuple[Play, ...]


def pack(parts: Parts) -> bytes:
    streams = [coder.pack(parts.absent.astype(np.int64)), parts.strays, parts.foreign, parts.exact]
    sizes = [len(s) for s in streams]
    for play in parts.plays:
        sizes += [len(play.poses), len(play.pictures), *(len(p) for p in play.pictures)]
        streams += [play.poses, *play.pictures]
    return varint.write(sizes) + b"".join(streams)


def unpack(chunk: Chunk, bodies: int) -> Parts:
    """Raises Corrupt."""
    data = chunk.payload
    sizes, at = varint.read(data, 4)
    counts = list[int]()
    for _ in range(bodies):
        (poses, count), at = varint.read(data, 2, at)
        if count > chunk.frames + 1:
            raise Corrupt("bodycast: a chunk is damaged")
        pictures, at = varint.read(data, count, at)
        counts.append(count)
        sizes += [poses, *pictures]
    if at + sum(sizes) != len(data):
        raise Corrupt("bodycast: a chunk is damaged")
    streams = _cut(data, at, sizes)
    absent = coder.unpack(streams[0], (chunk.frames, bodies)) != 0
    plays, at = list[Play](), 4
    for count in counts:
        plays.append(Play(streams[at], tuple(streams[at + 1 : at + 1 + count])))
        at += 1 + count
    return Parts(absent, streams[1], streams[2], streams[3], tuple(plays))


def _cut(data: bytes, at: int, sizes: Sequence[int]) -> list[bytes]:
    result = list[bytes]()
    for size in sizes:
        result.append(data[at : at + size])
        at += size
    return result
