"""A transform made for the recording at hand, where it is smaller than what the prior gives.

    tempo's stream ─► its bytes ──────────────────┐
    one coding in the motion's own basis ─────────┴─► promising? ── yes ─► coded to the target ─► the smaller is kept

Calm, long or unusual motion pays for a basis of its own, and then the whole of `hou2014` (clips of up to ten seconds,
one basis, corrections under a bound) stands in for tempo's chunks, behind tempo's first shared byte. The search costs
several codings of the whole motion, so one is looked at first, and before it one of a stretch where the motion is long.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ... import metrics
from ...encoded import Encoded
from ...errors import CannotEncode
from ...motion import Floats, Motion
from ...stages import gaps
from ..hou2014 import Hou2014
from ..hou2014.codec import SAMPLED_CHUNKS
from . import body, jumps

KIND = 3
"""The first shared byte. Never change it."""

LONGEST_CHUNK = 2.5
"""Chunks may be this many times as long as asked for, though not beyond ten seconds."""

LONGEST_FRAMES = 60_000
"""Beyond, a recording is too varied for one basis, and the trial too large."""

PROMISING = 1.06
"""A first coding this much larger than tempo's may still come out smaller at its best step."""

LOOK_FRAMES = 1000
"""Of a long recording a stretch is looked at before the whole, and looks better than that: it is less varied, and the
basis is counted once. What is larger there is not promising."""

SLOPE = 0.7
"""About how many octaves of bytes an octave of mean error costs."""

MEAN_OF_BOUND = 0.5
"""A bound's usual mean error: where the search for a mean by way of a bound begins."""

MEAN_WITHIN = 0.015
MEAN_TRIES = 7


def smaller(encoded: Encoded[Motion], motion: Motion, target: str, wanted: float, seconds: float) -> Encoded[Motion]:
    """The encoding given, or one with the motion's own transform where that is smaller at the same target.

    target: "max_error" or "mean_error", metres; seconds: how long chunks are to be.
    """
    if len(motion) > LONGEST_FRAMES:
        return encoded
    best = encoded
    filled, smooth = without_leaps(motion)
    look = stretch(encoded)
    for codec in candidates(motion, smooth is not filled, target, wanted, longest_chunk(motion, seconds)):
        near = smooth if codec.max_error else filled
        try:
            if len(motion) > 2 * LOOK_FRAMES:
                size = estimate(codec, motion[look], near[look], len(motion) / (look.stop - look.start), 1)
                if size > best.payload_bytes:
                    continue
            if estimate(codec, motion, near) > PROMISING * best.payload_bytes:
                continue
            if codec.max_error and target == "mean_error":
                rival = to_mean(codec, motion, near, wanted)
            else:
                rival = codec.encode_smoothed(motion, near)
        except CannotEncode:
            continue
        if rival is not None and rival.payload_bytes + 1 < best.payload_bytes:
            best = taken(encoded, rival)
    return best


def estimate(codec: Hou2014, motion: Motion, near: Floats, times: float = 1.0, chunks: int = SAMPLED_CHUNKS) -> float:
    """About how many bytes so many times as much motion takes at the codec's target; at most so many are coded."""
    size, mean = codec.estimate(motion, near, times, chunks)
    return size * (mean / codec.mean_error) ** SLOPE if codec.mean_error and mean > 0 else size


def stretch(encoded: Encoded[Motion]) -> slice:
    """About `LOOK_FRAMES` frames of whole chunks whose bytes a frame are most like those of the recording."""
    edges = np.array([0, *(c.start + c.frames for c in encoded.chunks)])
    sizes = np.cumsum([0, *(len(c.payload) for c in encoded.chunks)])
    stops = np.searchsorted(edges, np.minimum(edges[:-1] + LOOK_FRAMES, edges[-1]))
    starts = np.arange(len(stops))[edges[stops] - edges[:-1] >= min(LOOK_FRAMES, edges[-1])]
    stops = stops[starts]
    rates = (sizes[stops] - sizes[starts]) / (edges[stops] - edges[starts])
    usual = int(np.abs(rates - sizes[-1] / edges[-1]).argmin())
    return slice(int(edges[starts[usual]]), int(edges[stops[usual]]))


def closer(encoded: Encoded[Motion], motion: Motion, size: int, seconds: float) -> Encoded[Motion]:
    """The encoding given, or one of no more bytes with the motion's own transform where that is nearer on average."""
    mean = mean_error(encoded, motion)
    if mean == 0 or smaller(encoded, motion, "mean_error", mean, seconds) is encoded:
        return encoded
    codec = Hou2014(chunk_frames=longest_chunk(motion, seconds), ratio=motion.raw_bytes / max(size - 1, 1))
    try:
        rival = taken(encoded, codec.encode(motion))
    except CannotEncode:
        return encoded
    return rival if mean_error(rival, motion) < mean else encoded


def mean_error(encoded: Encoded[Motion], motion: Motion) -> float:
    from .tempo import Tempo

    return metrics.mean_distance(motion.positions, Tempo.decode(encoded).positions)


def longest_chunk(motion: Motion, seconds: float) -> int:
    """Frames that a chunk may have."""
    return max(1, round(min(LONGEST_CHUNK * seconds, 10.0) * motion.rate))


def taken(encoded: Encoded[Motion], rival: Encoded[Motion]) -> Encoded[Motion]:
    """The rival's chunks and head in place of those of tempo."""
    return replace(encoded, chunks=rival.chunks, shared=(bytes([KIND]) + rival.shared[0],))


def without_leaps(motion: Motion) -> tuple[Floats, Floats]:
    """Positions without gaps, and without leaps of single frames too: the same array where there are none."""
    filled, mask = gaps.fill(motion.positions)
    level = body.level(filled, motion.up)
    spikes = jumps.spikes(level) & ~mask
    if not spikes.any():
        return filled, filled
    return filled, body.unlevel(jumps.bridged(level, spikes), motion.up)


def candidates(motion: Motion, leaps: bool, target: str, wanted: float, longest: int) -> list[Hou2014]:
    """What is tried: for a mean also a bound, which suits recordings full of gaps and leaps better."""
    tried: list[dict[str, Any]] = [{target: wanted}]
    if target == "mean_error" and (leaps or motion.gaps.any()):
        tried.append({"max_error": wanted / MEAN_OF_BOUND})
    return [Hou2014(chunk_frames=longest, **one) for one in tried]


def to_mean(codec: Hou2014, motion: Motion, smooth: Floats, wanted: float) -> Encoded[Motion] | None:
    """Coded under the bound whose mean error is the one wanted; none where the search does not arrive."""
    bound = codec.max_error or wanted
    for _ in range(MEAN_TRIES):
        encoded = replace(codec, max_error=bound).encode_smoothed(motion, smooth)
        mean = metrics.mean_distance(motion.positions, Hou2014.decode(encoded).positions)
        if abs(mean / wanted - 1) <= MEAN_WITHIN:
            return encoded
        bound *= wanted / max(mean, 0.1 * wanted)
    return None


def decode(encoded: Encoded[Motion], frames: slice | None) -> Motion:
    """The motion, or a slice of its frames. Raises Corrupt."""
    return Hou2014.decode(replace(encoded, shared=(encoded.shared[0][1:],)), frames)
