"""Samples that are held: frames that repeat the one before, as where a slower camera fills a faster file.

    motion ─► frames that say something, and how long each is held ─► coded as a motion of their own ─► chunks
    a chunk: how long its frames are held · the chunk of the motion without the others

Repeats cost next to nothing, and the steps that they make of smooth motion are not coded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from ...encoded import Chunk, Encoded, about, restore
from ...entropy import coder, varint
from ...errors import Corrupt
from ...motion import Motion

Integers = NDArray[np.int64]

KIND = 6
"""The first shared byte. Never change it."""
AT_MOST = 0.8
"""Where more of the frames than this say something, none is taken for held."""


def said(motion: Motion, seconds: float) -> NDArray[np.bool_] | None:
    """The frames that do not repeat the one before in every sample; one at least in so many seconds. None where hardly
    any does."""
    p = motion.positions
    if len(p) < 3:
        return None
    changed = np.ones(len(p), bool)
    changed[1:] = ~((p[1:] == p[:-1]) | (np.isnan(p[1:]) & np.isnan(p[:-1]))).all(axis=(1, 2))
    changed[:: max(1, round(seconds * motion.rate))] = True
    return changed if changed.mean() <= AT_MOST else None


def encode(motion: Motion, said_: NDArray[np.bool_], code: Callable[[Motion], Encoded[Motion]]) -> Encoded[Motion]:
    """The motion coded by way of the frames that say something. code: how a motion without repeats is coded."""
    starts = np.flatnonzero(said_)
    lengths = np.diff(starts, append=len(motion))
    millihertz = max(1, round(1000 * motion.rate * len(starts) / len(motion)))
    inner = code(replace(motion, positions=motion.positions[starts], rotations=None, rate=millihertz / 1000))
    edges = np.append(starts, len(motion)).tolist()
    chunks = [
        Chunk(edges[c.start], edges[c.stop] - edges[c.start], _pack(lengths[c.start : c.stop]) + c.payload)
        for c in inner.chunks
    ]
    shared = bytes([KIND]) + varint.write([millihertz]) + inner.shared[0]
    return replace(inner, about=about(motion), chunks=chunks, shared=(shared,))


def decode(encoded: Encoded[Motion], frames: slice | None, decode_inner: Callable[[Encoded[Motion]], Motion]) -> Motion:
    """The motion, or a slice of its frames. Raises Corrupt."""
    start, stop = encoded.range(frames)
    (millihertz,), at = varint.read(encoded.shared[0], 1, 1)
    if not 0 < millihertz < 1 << 40:
        raise Corrupt("tempo: held frames of no rate")
    covering = encoded.covering(start, stop)
    if not covering:
        return restore(encoded, np.empty((0, encoded.about.points, 3)), start)
    parts = [_unpack(c.payload, c.frames) for c in covering]
    stops = list(accumulate(len(lengths) for lengths, _ in parts))
    inner = replace(
        encoded,
        about=replace(encoded.about, rate=millihertz / 1000),
        chunks=[Chunk(b - len(n), len(n), rest) for b, (n, rest) in zip(stops, parts, strict=True)],
        shared=(encoded.shared[0][at:],),
    )
    which = np.repeat(np.arange(stops[-1]), np.concatenate([n for n, _ in parts]))
    first = covering[0].start
    which = which[start - first : stop - first]
    return restore(encoded, decode_inner(inner).positions[which], start)


def _pack(lengths: Integers) -> bytes:
    """How many frames there are, then 0 and the length of all but the last, or the size of the list of lengths."""
    if (lengths[:-1] == lengths[0]).all() and lengths[-1] <= lengths[0]:
        return varint.write([len(lengths), 0, int(lengths[0])])
    packed = coder.pack(lengths[:, None])
    return varint.write([len(lengths), len(packed)]) + packed


def _unpack(payload: bytes, frames: int) -> tuple[Integers, bytes]:
    """How long each frame of a chunk is held, and what follows. Raises Corrupt."""
    (count, size), at = varint.read(payload, 2)
    if not 0 < count <= frames or at + size > len(payload):
        raise Corrupt("tempo: held frames that do not fill their chunk")
    if size:
        lengths = coder.unpack(payload[at : at + size], (count, 1))[:, 0]
        at += size
    else:
        (each,), at = varint.read(payload, 1, at)
        lengths = np.full(count, min(each, frames + 1), np.int64)
        lengths[-1] = frames - int(lengths[:-1].sum())
    if lengths.min() < 1 or lengths.max() > frames or lengths.sum() != frames:
        raise Corrupt("tempo: held frames that do not fill their chunk")
    return lengths, payload[at:]
