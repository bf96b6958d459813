"""A mean error by other means than the transform: by the lattice engine, at means about the noise of the cameras; by
a hard bound, which implies it.

a chunk of the transform's stream ─lattice engine─► smaller? ── yes ─► all of it, under the bound whose mean error
                                                                       is at most the one asked for, and near it
"""

from __future__ import annotations

from collections.abc import Callable

from ... import metrics, progress
from ...encoded import Encoded
from ...motion import Motion
from .chunk import DIRECT, Payload
from .engine_choice import LEAST_SAVING
from .header import StreamHeader

MEAN_OF_BOUND = 0.62
"""Usual mean error under a bound: where the search for the bound begins."""
LEAST_SHARE, AIM = 0.97, 0.99
"""The search ends at a mean of at least this share of the one asked for, and aims at the other share."""
TRIES = 5
FEWEST_BITS = 0.3
"""Of a coordinate: the lattice is not tried where the transform takes less."""
PROMISING = 1.05
"""The whole recording is coded where a chunk takes at most this many times the transform's bytes."""

FEW_CHUNKS, UNUSUAL_SHARE = 2, 0.5
"""A mean error is also tried as a bound for up to so many chunks, or if more than this share of them is unusual."""

Encode = Callable[[Motion, float], Encoded[Motion]]
"""All of a motion by the lattice engine, under a bound (metres)."""
Decode = Callable[[Encoded[Motion]], Motion]


def on_lattice(
    encoded: Encoded[Motion], motion: Motion, mean_error: float, encode: Encode, decode: Decode
) -> Encoded[Motion]:
    """The encoding given, or the lattice engine's where that is smaller enough at the same mean error (metres)."""
    if 8 * encoded.payload_bytes < FEWEST_BITS * motion.positions.size:
        return encoded
    middle = encoded.chunks[len(encoded.chunks) // 2]
    part = motion[middle.start : middle.start + middle.frames]
    if part.gaps.all():
        return encoded
    bound = mean_error / MEAN_OF_BOUND
    shared = sum(map(len, encoded.shared)) / len(encoded.chunks)
    if encode(part, bound).payload_bytes > PROMISING * (len(middle.payload) + shared):
        return encoded
    for trial in range(TRIES):
        with progress.attempt(trial):
            rival = encode(motion, bound)
        mean = metrics.mean_distance(motion.positions, decode(rival).positions)
        if LEAST_SHARE <= mean / mean_error <= 1:
            return rival if rival.payload_bytes < (1 - LEAST_SAVING) * encoded.payload_bytes else encoded
        bound *= AIM * mean_error / max(mean, 0.1 * mean_error)
    return encoded


def may_exceed_bounded(encoded: Encoded[Motion]) -> bool:
    """Whether a stream at a mean error may be larger than one under this error as a bound.

    A bound costs about twice as much, except where chunks are direct or full of spikes, and on short recordings.
    """
    header = StreamHeader.unpack(encoded.shared, encoded.about.points)
    if header.neighbours is not None:
        return False
    if len(encoded.chunks) <= FEW_CHUNKS or header.millihertz is not None:
        return True
    if header.fallback is not None:
        return False
    payloads = [Payload.unpack(c.payload) for c in encoded.chunks]
    return sum(p.engine == DIRECT or p.step is not None for p in payloads) > UNUSUAL_SHARE * len(payloads)
