"""The parts of a chunk as bytes: poses, raw frames, images of residual maps."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

from ...encoded import Chunk
from ...entropy import coder, varint
from ...errors import Corrupt
from ...typing import Integers
from .pose_stream import pose_width


class ChunkParts(NamedTuple):
    """poses (frames, 1 + 3 + 3 links): 1 for a raw frame, then the integers of `pose_stream`. raw_frames: frames that
    show no body, as `pack_raw_frames` stores them. images: as `map_images` makes them, empty without residuals.
    """

    poses: Integers
    raw_frames: bytes
    images: Sequence[bytes]


def pack_chunk(parts: ChunkParts) -> bytes:
    """Sizes, then the parts."""
    poses = coder.pack(parts.poses)
    sizes = varint.write([len(poses), len(parts.raw_frames), len(parts.images), *map(len, parts.images)])
    return b"".join([sizes, poses, parts.raw_frames, *parts.images])


def unpack_chunk(chunk: Chunk, links: int) -> ChunkParts:
    """The inverse of `pack_chunk`. Raises Corrupt."""
    (pose_bytes, raw_bytes, image_count), at = varint.read(chunk.payload, 3)
    if image_count > 2 * chunk.frames:
        raise Corrupt(f"lien2006: a chunk of {chunk.frames} frames with {image_count} images")
    image_sizes, at = varint.read(chunk.payload, image_count, at)
    bounds = [at, *(at + end for end in itertools.accumulate([pose_bytes, raw_bytes, *image_sizes]))]
    if bounds[-1] > len(chunk.payload):
        raise Corrupt("lien2006: a chunk is cut off")
    poses, raw_frames, *images = (chunk.payload[i:j] for i, j in itertools.pairwise(bounds))
    return ChunkParts(coder.unpack(poses, (chunk.frames, 1 + pose_width(links))), raw_frames, images)
