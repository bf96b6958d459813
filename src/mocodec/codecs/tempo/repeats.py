"""Frames that repeat the one before, as where a slower camera fills a faster file.

    motion ─► distinct frames, and how often each is repeated ─► coded as a motion of their own ─► chunks
    a chunk: run lengths · the chunk of the distinct frames

Repeats cost next to nothing, and the steps that they make of smooth motion are not coded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import accumulate

import numpy as np

from ...encoded import Chunk, Encoded, about, restore
from ...entropy import coder, varint
from ...errors import Corrupt
from ...motion import Motion
from ...typing import Booleans, Floats, Integers
from .header import StreamHeader

MOST_DISTINCT = 0.8
"""Where more of the frames than this share are distinct, all are coded."""
RUN_BYTES = 8
"""Bytes that a chunk's run lengths take at most, if they are regular."""
TRIES = 3
"""How often the mean error of distinct frames is lowered, until the mean over all frames is at most the target."""
_OVERRUN = "tempo: run lengths that do not fill their chunk"


def distinct_frames(motion: Motion, seconds: float) -> Booleans | None:
    """Mask (frames,) of the frames that differ from the one before in some sample, and of one frame every `seconds`.

    None where too few frames repeat to make it worthwhile.
    """
    p = motion.positions
    if len(p) < 3:
        return None
    if len(p) - np.count_nonzero(_same(p[:, :1])) > MOST_DISTINCT * len(p):
        return None  # one point tells
    changed = np.ones(len(p), bool)
    changed[1:] = ~_same(p)
    changed[:: max(1, round(seconds * motion.rate))] = True
    return changed if changed.mean() <= MOST_DISTINCT else None


def _same(positions: Floats) -> Booleans:
    """Which frames but the first of positions (frames, points, 3) have the samples of the frame before."""
    after, before = positions[1:], positions[:-1]
    return ((after == before) | (np.isnan(after) & np.isnan(before))).all(axis=(1, 2))


def encode(motion: Motion, distinct: Booleans, encode_distinct: Callable[[Motion], Encoded[Motion]]) -> Encoded[Motion]:
    """The motion, by way of its distinct frames and a function that codes a motion of these."""
    starts = np.flatnonzero(distinct)
    lengths = np.diff(starts, append=len(motion))
    millihertz = max(1, round(1000 * motion.rate * len(starts) / len(motion)))
    inner = encode_distinct(replace(motion, positions=motion.positions[starts], rotations=None, rate=millihertz / 1000))
    edges = np.append(starts, len(motion)).tolist()
    chunks = [
        Chunk(edges[c.start], edges[c.stop] - edges[c.start], _pack(lengths[c.start : c.stop]) + c.payload)
        for c in inner.chunks
    ]
    header = replace(StreamHeader.unpack(inner.shared, motion.points), millihertz=millihertz)
    return replace(inner, about=about(motion), chunks=chunks, shared=(header.pack(),))


def bytes_of_runs(motion: Motion, chunk_seconds: float) -> int:
    """About the bytes that the run lengths of all chunks take."""
    return RUN_BYTES * (2 + int(motion.seconds / chunk_seconds))


def encode_to_mean(
    motion: Motion,
    distinct: Booleans,
    target: float,
    encode_distinct: Callable[[float, Motion], Encoded[Motion]],
    mean_error: Callable[[Encoded[Motion], Motion], float],
) -> tuple[Encoded[Motion], float]:
    """`encode` to a mean error over all frames, metres, and that mean: distinct frames have another than all frames.

    encode_distinct: codes a motion to a mean error. mean_error: that of an encoded motion.
    """
    encoded = encode(motion, distinct, partial(encode_distinct, target))
    mean, wanted = mean_error(encoded, motion), target
    for _ in range(TRIES):
        if mean <= target:
            break
        wanted *= target / mean
        encoded = encode(motion, distinct, partial(encode_distinct, wanted))
        mean = mean_error(encoded, motion)
    return encoded, mean


def decode(
    encoded: Encoded[Motion],
    header: StreamHeader,
    frames: slice | None,
    decode_distinct: Callable[[Encoded[Motion]], Motion],
) -> Motion:
    """The motion, or a slice of its frames. Raises Corrupt."""
    assert header.millihertz is not None
    start, stop = encoded.range(frames)
    covering = encoded.covering(start, stop)
    if not covering:
        return restore(encoded, np.empty((0, encoded.about.points, 3)), start)
    parts = [_unpack(c.payload, c.frames) for c in covering]
    stops = list(accumulate(len(lengths) for lengths, _ in parts))
    inner = replace(
        encoded,
        about=replace(encoded.about, rate=header.millihertz / 1000),
        chunks=[Chunk(b - len(n), len(n), rest) for b, (n, rest) in zip(stops, parts, strict=True)],
        shared=(replace(header, millihertz=None).pack(),),
    )
    which = np.repeat(np.arange(stops[-1]), np.concatenate([n for n, _ in parts]))
    first = covering[0].start
    which = which[start - first : stop - first]
    return restore(encoded, decode_distinct(inner).positions[which], start)


def _pack(lengths: Integers) -> bytes:
    """Number of frames; then 0 and the length of all runs but the last, or the size in bytes of the coded lengths."""
    if (lengths[:-1] == lengths[0]).all() and lengths[-1] <= lengths[0]:
        return varint.write([len(lengths), 0, int(lengths[0])])
    packed = coder.pack(lengths[:, None])
    return varint.write([len(lengths), len(packed)]) + packed


def _unpack(payload: bytes, frames: int) -> tuple[Integers, bytes]:
    """Run length of each distinct frame of a chunk, and the bytes that follow. Raises Corrupt."""
    (count, size), at = varint.read(payload, 2)
    if not 0 < count <= frames or at + size > len(payload):
        raise Corrupt(_OVERRUN)
    if size:
        lengths = coder.unpack(payload[at : at + size], (count, 1))[:, 0]
        at += size
    else:
        (each,), at = varint.read(payload, 1, at)
        lengths = np.full(count, min(each, frames + 1), np.int64)
        lengths[-1] = frames - int(lengths[:-1].sum())
    if lengths.min() < 1 or lengths.max() > frames or lengths.sum() != frames:
        raise Corrupt(_OVERRUN)
    return lengths, payload[at:]
