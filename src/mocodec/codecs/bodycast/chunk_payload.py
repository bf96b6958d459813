"""The streams of a chunk as bytes.

absent bodies · raw frames · outliers · exact points · and for each body: poses, pictures
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...encoded import Chunk
from ...entropy import coder, varint
from ...errors import Corrupt
from ...typing import Booleans


class BodyStreams(NamedTuple):
    """The streams of one body in a chunk. pictures: packets of the changing surface, empty if it does not change; an
    empty first packet stands for the model's key picture.
    """

    poses: bytes
    pictures: tuple[bytes, ...]


class ChunkStreams(NamedTuple):
    """is_absent (frames, bodies): True where a body is not in a frame; and the coded streams of the chunk."""

    is_absent: Booleans
    raw_frames: bytes
    outliers: bytes
    exact_points: bytes
    bodies: tuple[BodyStreams, ...]


def pack_chunk(chunk: ChunkStreams) -> bytes:
    """Sizes of all streams, then the streams."""
    streams = [coder.pack(chunk.is_absent.astype(np.int64)), chunk.raw_frames, chunk.outliers, chunk.exact_points]
    sizes = [len(s) for s in streams]
    for body in chunk.bodies:
        sizes += [len(body.poses), len(body.pictures), *(len(p) for p in body.pictures)]
        streams += [body.poses, *body.pictures]
    return varint.write(sizes) + b"".join(streams)


def unpack_chunk(chunk: Chunk, bodies: int) -> ChunkStreams:
    """The inverse of `pack_chunk`. Raises Corrupt."""
    data = chunk.payload
    sizes, at = varint.read(data, 4)
    picture_counts = list[int]()
    for _ in range(bodies):
        (pose_bytes, count), at = varint.read(data, 2, at)
        if count > chunk.frames + 1:
            raise Corrupt(f"bodycast: a chunk of {chunk.frames} frames with {count} pictures")
        pictures, at = varint.read(data, count, at)
        picture_counts.append(count)
        sizes += [pose_bytes, *pictures]
    if at + sum(sizes) != len(data):
        raise Corrupt("bodycast: a chunk is damaged: its streams do not fill it")
    streams = _split(data, at, sizes)
    is_absent = coder.unpack(streams[0], (chunk.frames, bodies)) != 0
    body_streams, at = list[BodyStreams](), 4
    for count in picture_counts:
        body_streams.append(BodyStreams(streams[at], tuple(streams[at + 1 : at + 1 + count])))
        at += 1 + count
    return ChunkStreams(is_absent, streams[1], streams[2], streams[3], tuple(body_streams))


def _split(data: bytes, at: int, sizes: Sequence[int]) -> list[bytes]:
    result = list[bytes]()
    for size in sizes:
        result.append(data[at : at + size])
        at += size
    return result
