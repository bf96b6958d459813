"""The whole of `hou2014` in place of tempo's chunks, where it is smaller.

    tempo's stream ─► its bytes ────────────────────┐
    one coding by hou2014 (one basis, one step) ────┴─► promising? ── yes ─► coded to the target ─► the smaller is kept

Calm, long or unusual motion pays for a basis of its own across points, with clips of up to ten seconds. The search
costs several codings of the whole motion, so one coding is tried first, and before it one of a stretch of a long
recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ... import metrics
from ...encoded import Encoded, most_chunk_frames
from ...errors import CannotEncode
from ...motion import Motion
from ...stages import dct
from ...typing import Floats
from ..hou2014 import Hou2014
from ..hou2014.motion_encoder import SAMPLED_CHUNKS, MotionEncoder
from .chunk import ChunkEncoder
from .coding.rows import HEADING, step_size
from .header import StreamHeader
from .pose import heading
from .preparation import Prepared

LONGEST_CHUNK, LONGEST_SECONDS, LEAST_CHUNK_FRAMES = 2.5, 10.0, 16
"""Chunks may be LONGEST_CHUNK times as long as asked for, up to LONGEST_SECONDS, and always LEAST_CHUNK_FRAMES."""

LONGEST_FRAMES = 60_000
"""Longer recordings are too varied for one basis, and the trial takes too long."""

MOST_POINTS = 2048
"""A basis across more points takes too long to fit."""

PROMISING_FREQUENCIES, PROMISING_BITS = 128, 0.82
"""hou2014 is not tried where a basis fitted to some chunks takes at least this share of tempo's bits: its basis serves
all chunks, and is stored."""

PROMISING_CHUNKS, PROMISING_POINTS = 4, 128
"""Number of chunks that the basis is fitted to. With more points the fit takes longer than the trial that it spares."""

PROMISING, PROMISING_BYTES = 1.06, 256
"""A first coding of at most PROMISING times tempo's bytes, plus PROMISING_BYTES, may still be smaller at its best step:
most bytes of still recordings are the basis, which a coarser step makes much smaller."""

SKETCH_HZ, SKETCH_SHARE = 15.0, 0.5
"""Before the first coding of many points there is a sketch, with a basis fitted to frequencies below SKETCH_HZ only,
since people hardly move faster, where these are at most SKETCH_SHARE of all."""

SKETCH_EXCEEDS, FEW_COMPONENTS, SKETCH_EXCEEDS_PER_SHARE = 1.01, 0.1, 0.4
"""The sketch takes up to SKETCH_EXCEEDS times the bytes of the first coding where its components are up to
FEW_COMPONENTS of its frequencies, and more in proportion where they are more: then there are components of noise."""

STRETCH_FRAMES = 1000
"""Length of the stretch of a long recording that is coded first. It looks better than the whole, since it is less
varied and the basis is counted once; if it is larger all the same, the whole is not promising."""

BYTES_SLOPE = 0.7
"""Fall of the logarithm of the bytes per logarithm of the mean error."""

MEAN_OF_BOUND = 0.5
"""Usual mean error under a bound: where the search for a mean by way of a bound begins."""

MEAN_WITHIN, MEAN_AIM, MEAN_TRIES = 0.03, 0.99, 7
"""The search for a mean ends within MEAN_WITHIN below it, aims at MEAN_AIM of it and codes at most MEAN_TRIES times."""


class Sample(NamedTuple):
    """Some chunks of a recording: positions (frames, points, 3), and coefficients (frames, rows) of tempo's model.

    own_basis: the model is a basis fitted to the recording.
    """

    positions: Sequence[Floats]
    spectra: Sequence[Floats]
    own_basis: bool

    @classmethod
    def of(cls, encoders: Sequence[ChunkEncoder], own_basis: bool) -> Sample | None:
        """None without a model."""
        some = encoders[:: -(-len(encoders) // PROMISING_CHUNKS)]
        spectra = [e.spectrum for e in some if e.spectrum is not None]
        return cls([e.smooth for e in some], spectra, own_basis) if len(spectra) == len(some) else None


def is_promising(sample: Sample, step: int) -> bool:
    """Whether a basis of the recording's own, fitted to the sample, takes clearly fewer bits than tempo's model.

    step: about the quantisation step, log₂ in 1/32 octave. Bits are Σ log₂(1 + (coefficient / step)²) over the lowest
    frequencies. Those of storing the basis are not counted. Two bases of the recording's own take about the same bits:
    their test is a coding by hou2014, whose clips may be longer.
    """
    if sample.own_basis or sample.positions[0].shape[1] > PROMISING_POINTS:
        return True
    ours, theirs, step_m = 0.0, list[Floats](), float(step_size(step))
    for positions, spectrum in zip(sample.positions, sample.spectra, strict=True):
        rows = dct.forward(positions.reshape(len(positions), -1), PROMISING_FREQUENCIES)
        ours += _bits(spectrum[1 : len(rows), HEADING + 1 :], step_m)
        theirs.append(rows[1:])
    lowest = np.concatenate(theirs)
    moments = lowest.T @ lowest
    if not np.isfinite(moments).all():
        return True
    _, basis = np.linalg.eigh(moments)
    return _bits(lowest @ basis, step_m) < PROMISING_BITS * ours


def _bits(coefficients: Floats, step_m: float) -> float:
    sizes = coefficients / step_m
    sizes *= sizes
    sizes += 1
    half = len(sizes) // 2
    pairs = sizes[:half] * sizes[half : 2 * half]  # logarithms are slow
    return float(np.log2(pairs).sum() + np.log2(sizes[2 * half :]).sum())


def smaller(
    encoded: Encoded[Motion], motion: Motion, source: Prepared, target: str, wanted: float, seconds: float
) -> Encoded[Motion]:
    """The encoding given, or hou2014's where that is smaller at the same target.

    source: the motion's positions; target: "max_error" or "mean_error", wanted: metres; seconds: length of chunks.
    """
    if len(motion) > LONGEST_FRAMES or motion.points > MOST_POINTS:
        return encoded
    best = encoded
    filled, smooth = _without_gaps_and_spikes(source, motion.up)
    stretch = _stretch(encoded)
    for codec in _candidates(motion, smooth is not filled, target, wanted, _longest_chunk(motion, seconds)):
        near = smooth if codec.max_error else filled
        try:
            if len(motion) > 2 * STRETCH_FRAMES:
                times = len(motion) / (stretch.stop - stretch.start)
                part = codec.prepared(motion[stretch], near[stretch])
                size = _estimate(part, best.payload_bytes, times, 1)
                if size > best.payload_bytes:
                    continue
            most = PROMISING * best.payload_bytes + PROMISING_BYTES
            if _has_sketch(motion):
                sketch = codec.prepared(motion, near, fitted_hz=SKETCH_HZ)
                limit = most * _sketch_exceeds(sketch)
                if _estimate(sketch, limit) > limit:
                    continue
            encoder = codec.prepared(motion, near)
            if _estimate(encoder, most) > most:
                continue
            if codec.max_error and target == "mean_error":
                rival = _to_mean(codec, motion, near, wanted)
            else:
                rival = encoder.to_target()
        except CannotEncode:
            continue
        if rival is not None and rival.payload_bytes + 1 < best.payload_bytes:
            best = _in_place_of(encoded, rival)
    return best


def nearer(
    encoded: Encoded[Motion],
    motion: Motion,
    source: Prepared,
    size: int,
    seconds: float,
    mean_error: Callable[[Encoded[Motion], Motion], float],
) -> Encoded[Motion]:
    """The encoding given, or hou2014's of at most `size` bytes where its mean error is smaller.

    mean_error: of a tempo stream against the motion, metres.
    """
    mean = mean_error(encoded, motion)
    if mean == 0 or smaller(encoded, motion, source, "mean_error", mean, seconds) is encoded:
        return encoded
    codec = Hou2014(chunk_frames=_longest_chunk(motion, seconds), ratio=motion.raw_bytes / max(size - 1, 1))
    try:
        rival = _in_place_of(encoded, codec.encode(motion))
    except CannotEncode:
        return encoded
    return rival if mean_error(rival, motion) < mean else encoded


def encode(motion: Motion, stored: dict[str, Any], size: int, seconds: float) -> Encoded[Motion]:
    """The motion coded by hou2014 to the target among tempo's settings. size: bytes, if that is the target.

    Raises CannotEncode.
    """
    wanted = {target: stored[target] for target in ("max_error", "mean_error") if target in stored}
    wanted = wanted or {"ratio": motion.raw_bytes / max(size - 1, 1)}
    encoded = Hou2014(chunk_frames=_longest_chunk(motion, seconds), **wanted).encode(motion)
    return replace(_in_place_of(encoded, encoded), codec="tempo", settings=stored)


def decode(encoded: Encoded[Motion], header: StreamHeader, frames: slice | None) -> Motion:
    """The motion, or a slice of its frames. Raises Corrupt."""
    return Hou2014.decode(replace(encoded, shared=(header.fallback or b"",)), frames)


def _in_place_of(encoded: Encoded[Motion], rival: Encoded[Motion]) -> Encoded[Motion]:
    """The rival's chunks and shared bytes, behind tempo's header."""
    return replace(encoded, chunks=rival.chunks, shared=(StreamHeader(fallback=rival.shared[0]).pack(),))


def _has_sketch(motion: Motion) -> bool:
    """Whether a basis for low frequencies is found much faster than one for all."""
    low = 2 * SKETCH_HZ / motion.rate
    return motion.points > PROMISING_POINTS and len(motion) <= dct.MATRIX_FRAMES and low < SKETCH_SHARE


def _sketch_exceeds(sketch: MotionEncoder) -> float:
    """How many times the bytes of the first coding a sketch takes at most."""
    components = sketch.quantised(sketch.codec.first_rung).header.components
    share = components / max(1, sketch.prepared.fitted_frequencies or 0)
    return SKETCH_EXCEEDS + SKETCH_EXCEEDS_PER_SHARE * max(0.0, share - FEW_COMPONENTS)


def _estimate(encoder: MotionEncoder, most: float, times: float = 1.0, chunks: int = SAMPLED_CHUNKS) -> float:
    """Estimate of the bytes of `times` as much motion at the codec's target, from a few coded chunks.

    most: bytes beyond which it need not be exact.
    """
    wanted = encoder.codec.mean_error
    size, mean = encoder.estimate(times, chunks, math.inf if wanted else most)
    return size * (mean / wanted) ** BYTES_SLOPE if wanted and mean > 0 else size


def _stretch(encoded: Encoded[Motion]) -> slice:
    """About `STRETCH_FRAMES` frames of whole chunks whose bytes a frame are nearest to those of the recording."""
    edges = np.array([0, *(c.start + c.frames for c in encoded.chunks)])
    sizes = np.cumsum([0, *(len(c.payload) for c in encoded.chunks)])
    stops = np.searchsorted(edges, np.minimum(edges[:-1] + STRETCH_FRAMES, edges[-1]))
    starts = np.arange(len(stops))[edges[stops] - edges[:-1] >= min(STRETCH_FRAMES, edges[-1])]
    stops = stops[starts]
    rates = (sizes[stops] - sizes[starts]) / (edges[stops] - edges[starts])
    usual = int(np.abs(rates - sizes[-1] / edges[-1]).argmin())
    return slice(int(edges[starts[usual]]), int(edges[stops[usual]]))


def _longest_chunk(motion: Motion, seconds: float) -> int:
    """Frames that a chunk may have."""
    wanted = max(round(min(LONGEST_CHUNK * seconds, LONGEST_SECONDS) * motion.rate), LEAST_CHUNK_FRAMES)
    return max(1, min(wanted, most_chunk_frames(motion.points)))


def _without_gaps_and_spikes(source: Prepared, up: str) -> tuple[Floats, Floats]:
    """Positions with gaps filled, and without spikes too: the same array where there are none."""
    filled = heading.from_y_up(source.positions, up)
    return filled, heading.from_y_up(source.smooth, up) if source.spikes.any() else filled


def _candidates(motion: Motion, has_spikes: bool, target: str, wanted: float, longest: int) -> list[Hou2014]:
    """Settings to try: for a mean also a bound, which suits recordings full of gaps and spikes better."""
    tried: list[dict[str, Any]] = [{target: wanted}]
    if target == "mean_error" and (has_spikes or motion.gaps.any()):
        tried.append({"max_error": wanted / MEAN_OF_BOUND})
    return [Hou2014(chunk_frames=longest, **one) for one in tried]


def _to_mean(codec: Hou2014, motion: Motion, smooth: Floats, wanted: float) -> Encoded[Motion] | None:
    """Coded under the bound whose mean error is the one wanted, or None if the search does not converge."""
    bound = codec.max_error or wanted
    for _ in range(MEAN_TRIES):
        encoded = replace(codec, max_error=bound).prepared(motion, smooth).to_target()
        mean = metrics.mean_distance(motion.positions, Hou2014.decode(encoded).positions)
        if 1 - MEAN_WITHIN <= mean / wanted <= 1:
            return encoded
        # the stored bound is a float32: last bits of a mean differ between NumPy and the compiled module
        bound = float(np.float32(bound * MEAN_AIM * wanted / max(mean, 0.1 * wanted)))
    return None
