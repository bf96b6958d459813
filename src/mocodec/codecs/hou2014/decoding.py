"""Decoding: the inverse of figure 6.

entropy code ─► integers ─► B S_i D̃ᵀ ─► corrections ─► gaps ─► positions
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ... import encoded as encodeds
from ... import progress
from ...encoded import Chunk, Encoded
from ...motion import Motion
from ...typing import Floats, Integers
from .. import base
from . import stream


def decode(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
    """The motion, or a slice of its frames. Raises Corrupt."""
    if not encoded.shared:
        return base.decode_gaps(encoded, frames)
    start, stop = encoded.range(frames)
    header = _read_header(encoded)
    parts = list[Floats]()
    for chunk in progress.over(encoded.covering(start, stop)):
        positions = stream.unpack_payload(chunk.payload, chunk.frames, header)
        parts.append(positions[max(0, start - chunk.start) : stop - chunk.start])
    if len(parts) != 1:
        parts = [np.concatenate([np.zeros((0, header.points, 3)), *parts])]
    return encodeds.restore(encoded, parts[0], start)


def _read_header(encoded: Encoded[Motion]) -> stream.SharedHeader:
    skeleton = encoded.about.skeleton
    return stream.unpack_header(encoded.shared, encoded.about.points, None if skeleton is None else skeleton.parents)


def clip_starts(encoded: Encoded[Motion]) -> Callable[[Chunk], Integers]:
    """A function from a chunk to the first frames of its clips, (N,). It raises Corrupt, as does this one."""
    header = _read_header(encoded)

    def of_chunk(chunk: Chunk) -> Integers:
        lengths, _ = stream.unpack_lengths(chunk.payload, 0, chunk.frames, header)
        return chunk.start + np.cumsum(lengths) - lengths

    return of_chunk
