"""A mean error by other means than the transform: by the lattice engine, at means about the noise of the cameras; by
a hard bound, which implies it.

a chunk of the transform's stream ─lattice engine─► smaller? ── yes ─► all of it, under the bound whose mean error
                                                                       is at most the one asked for, and near it
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

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
"""Bits of a coordinate: the lattice is not tried where the transform takes fewer."""
PROMISING = 1.05
"""The whole recording is coded where a chunk takes at most this many times the transform's bytes."""

FEW_CHUNKS, UNUSUAL_SHARE = 2, 0.5
"""A mean error is also tried as a bound for up to FEW_CHUNKS chunks, or if a larger share than this is unusual."""

SHORT_FRAMES, SHORT_SAMPLES = 16, 2048
"""Recordings up to these lengths are tried at other targets too: few settings come near the mean. Other targets try the
kinds of model and engine alone that were smallest at the mean error and under it as a bound."""
BOUND_RATIO, WIDEST_BOUND = 2**0.5, 8.0
"""Bounds that are tried: ratio of each to the one before, and of the largest to the mean error asked for."""
SMALLER_MEANS = (0.5, 0.25)
"""Means that are tried, of the one asked for: a file for half of a target is then never smaller than one for it."""

Encode = Callable[[Motion, float], Encoded[Motion]]
"""All of a motion by the lattice engine, under a bound (metres)."""
Decode = Callable[[Encoded[Motion]], Motion]
FALLBACK_MODEL, LATTICE_MODEL = "hou2014", "lattice"
Kinds = frozenset[str]
"""Types of model (`models.MODELS`), FALLBACK_MODEL, LATTICE_MODEL: what a stream consists of."""
EncodeAt = Callable[[str, float, Kinds | None], Encoded[Motion]]
"""All of a motion at "mean_error" or "max_error", metres, by these kinds alone, or by any (None)."""
MeanError = Callable[[Encoded[Motion], Motion], float]
"""Mean error of an encoding of a motion, metres."""


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


def smallest(
    encoded: Encoded[Motion], motion: Motion, mean_error: float, encode: EncodeAt, measure: MeanError
) -> Encoded[Motion]:
    """The smallest of the encoding given, one under the mean error (metres) as a bound if that may be smaller and, of a
    short recording, those at smaller means and under wider bounds whose mean error is at most the one asked for."""
    is_short = len(motion) <= SHORT_FRAMES and len(motion) * motion.points <= SHORT_SAMPLES
    if not is_short and not may_exceed_bounded(encoded):
        return encoded
    found = [encoded, encode("max_error", mean_error, None)]
    if is_short:
        kinds = _kinds(found[0]) | _kinds(found[1])
        found += _at_other_targets(motion, mean_error, kinds, encode, measure)
    return min(found, key=lambda each: each.payload_bytes)


def _kinds(encoded: Encoded[Motion]) -> Kinds:
    header = StreamHeader.unpack(encoded.shared, encoded.about.points)
    beside = {FALLBACK_MODEL: header.fallback, LATTICE_MODEL: header.neighbours}
    return Kinds(
        {name for name, part in beside.items() if part is not None} | ({header.model} if header.model else set())
    )


def _at_other_targets(
    motion: Motion, mean_error: float, kinds: Kinds, encode: EncodeAt, measure: MeanError
) -> Iterator[Encoded[Motion]]:
    """Encodings by these kinds whose mean error is at most the one asked for (metres)."""
    for share in SMALLER_MEANS:
        yield encode("mean_error", share * mean_error, kinds)
    bound = BOUND_RATIO
    while bound <= WIDEST_BOUND:
        wider = encode("max_error", bound * mean_error, kinds)
        if not measure(wider, motion) <= mean_error:
            break
        yield wider
        bound *= BOUND_RATIO
