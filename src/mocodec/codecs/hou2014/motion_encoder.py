"""Encoding of one motion at any quantisation step, and the searches for the step that meets a target.

filled positions ─► clips, frequencies, B ─► integers at a step ─► chunks, corrections within a bound
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, lru_cache
from itertools import pairwise

import numpy as np

from ... import encoded as encodeds
from ... import metrics, progress
from ...encoded import Chunk, Encoded, most_chunk_frames
from ...errors import BadInput, CannotEncode, Corrupt
from ...motion import Motion
from ...stages import bounded, frozen, lattice, quantise, search
from ...typing import Floats, Integers
from .. import base
from . import clip_segmentation, decoding, left_transform, parameters, quantised_motion, stream
from .quantised_motion import PreparedMotion, QuantisedMotion, Rows
from .settings import Settings

SAMPLED_CHUNKS = 3
"""Chunks that the search under a bound encodes at each step: the best step is similar for all chunks."""

SAMPLED_FREQUENCIES, CLEAR_BITS, UNCLEAR = 8, 1000.0, 0.08
"""Bits at two steps are compared by one frequency in this many, unless these frequencies take fewer bits, or the ratio
of both is this near to the limit."""

FARTHEST_RUNGS = 30 * quantise.LADDER
"""No rung that is tried is farther than this from the first: 30 octaves."""

STRIDES = (quantise.LADDER // 2, quantise.LADDER // 5)
"""Under a bound the step is searched in half octaves, then in fifths of an octave around the best."""

COARSE_RUNGS, COARSE_STRIDES = 5 * quantise.LADDER, (quantise.LADDER, quantise.LADDER // 2)
"""Where the lattice engine codes the corrections, a coarser step may be best: from where it is searched, and how."""
COARSE_PROMISING = 1.1
"""Coarser steps are searched if the first of them takes up to this many times the bytes of the best fine step."""


class MotionEncoder:
    """One motion, prepared for encoding at any quantisation step that a search tries.

    quantised(rung), encoded(rung): the motion at this step; cached. fitted_hz: B is fitted to frequencies below it,
    which is faster and enough for `estimate`; None for all frequencies.
    """

    def __init__(
        self,
        codec: Settings,
        motion: Motion,
        filled: Floats,
        apart: frozen.Split,
        by_engine: bool = False,
        fitted_hz: float | None = None,
    ) -> None:
        self.codec, self.motion, self.apart = codec, motion, apart
        self.moving = self.apart.moving
        self.parents = None if motion.skeleton is None else motion.skeleton.parents
        self.chunk_frames = min(codec.chunk_frames, most_chunk_frames(motion.points))
        self.neighbours = lattice.neighbours(filled) if by_engine and codec.max_error and lattice.is_fast() else None
        self.prepared = self._prepare(filled, fitted_hz)
        self.quantised: Callable[[int], QuantisedMotion] = lru_cache(1)(
            lambda rung: quantised_motion.quantise_motion(self.prepared, rung)
        )
        self.encoded: Callable[[int], Encoded[Motion]] = cache(self._encode)

    def _prepare(self, filled: Floats, fitted_hz: float | None) -> PreparedMotion:
        """Segment into clips, choose each clip's step and frequencies, fit B."""
        codec, motion = self.codec, self.motion
        length = codec.clip_frames or (len(motion) if codec.has_target else parameters.CLIP_FRAMES)
        length = min(length, most_chunk_frames(motion.points))
        lengths = stream.equal_lengths(len(motion), length)
        weights = _weight_rungs(codec.point_weights, motion.names)
        prepared = PreparedMotion(
            points=motion.points,
            rows=Rows(
                filled.reshape(len(motion), -1), None if weights is None else stream.row_weights(weights, motion.points)
            ),
            lengths=lengths,
            clip_frames=length,
            rung_offsets=np.zeros(len(lengths), np.int64),
            weight_rungs=weights,
            components=codec.components or (None if codec.has_target else parameters.COMPONENTS),
            unit=codec.unit,
            centre=codec.centre,
            compress_basis=codec.compress_basis,
            economy=codec.economy,
            max_error=codec.max_error,
            fitted_frequencies=None if fitted_hz is None else math.ceil(2 * len(motion) * fitted_hz / motion.rate),
            learned=_unpack_learned(codec.transforms, motion.points),
        )
        if codec.segmentation == "adaptive" or (codec.has_target and not codec.clip_frames):
            prepared = self._segment(quantised_motion.with_fitted_transform(prepared), filled)
        rung_offsets = clip_segmentation.speed_rung_offsets(filled, motion.rate, prepared.lengths, codec.masking)
        prepared = replace(prepared, rung_offsets=rung_offsets, frequencies=self._frequencies(prepared))
        if prepared.fitted is None or prepared.frequencies is not None:
            prepared = quantised_motion.with_fitted_transform(prepared)
        return prepared

    def _frequencies(self, prepared: PreparedMotion) -> Integers | None:
        """l_i: the setting, or equation (12), or with a target no limit."""
        if self.codec.frequencies is not None:
            return np.minimum(self.codec.frequencies, prepared.lengths)
        if self.codec.has_target or prepared.components is None:
            return None
        return np.array([parameters.frequencies(prepared.components, int(length)) for length in prepared.lengths])

    def _segment(self, prepared: PreparedMotion, filled: Floats) -> PreparedMotion:
        """With the clip lengths that cost the fewest estimated bits at the first step of the search."""
        codec = self.codec
        step = codec.unit * quantise.step(self.codec.first_rung)
        curves = quantised_motion.component_curves(prepared, step)
        if codec.segmentation == "adaptive":
            length = 0
            lengths = clip_segmentation.adaptive_lengths(filled, curves, step, codec.clips, self.chunk_frames)
        else:
            length = clip_segmentation.best_equal_length(curves, step, self.chunk_frames)
            lengths = stream.equal_lengths(len(filled), length)
        return replace(prepared, lengths=lengths, clip_frames=length)

    def to_target(self) -> Encoded[Motion]:
        """Encoded to the codec's target. Raises CannotEncode."""
        codec = self.codec
        if codec.max_error is not None:
            return self.for_max_error(codec.max_error)
        if codec.mean_error is not None:
            return self.encoded(self.rung_for_mean_error(codec.mean_error))
        if codec.ratio is not None:
            return self.for_ratio(codec.ratio)
        return self.encoded(codec.first_rung)

    def estimate(
        self, times: float = 1.0, chunks: int = SAMPLED_CHUNKS, limit: float = math.inf
    ) -> tuple[float, float]:
        """Estimated payload bytes of `to_target`, and the mean error in metres, at the first step of the search.

        Costs one encoding of at most `chunks` chunks. With `max_error` the mean error is not measured, but NaN. times:
        factor for the size of the chunks, if the motion is a part of the motion to estimate. limit: bytes beyond which
        the estimate may be too low. Raises CannotEncode.
        """
        rung = self.codec.first_rung
        size = self.sampled_size(rung, times, chunks, limit)
        return size, math.nan if self.codec.max_error is not None else self.mean_error(rung)

    def takes_few_bits(self, rung: int, other: int, most: float) -> bool:
        """Whether the coefficients at one step take less than `most` times the bits of those at another, estimated."""
        bits, allowed = self._bits_at(rung, other, SAMPLED_FREQUENCIES)
        if allowed < CLEAR_BITS or abs(bits / allowed - most) < UNCLEAR:
            bits, allowed = self._bits_at(rung, other)
        return bits < most * max(allowed, 1.0)

    def _bits_at(self, rung: int, other: int, every: int = 1) -> tuple[float, float]:
        """Estimated bits of the coefficients at two steps. every: distance of the frequencies that are counted."""
        unit, step = self.codec.unit, quantise.step
        spectra = quantised_motion.component_spectra(self.prepared, unit * step(max(rung, other)), every)
        at_one, at_other = (clip_segmentation.bits_of_spectra(spectra, unit * step(one)) for one in (rung, other))
        return at_one, at_other

    def mean_error(self, rung: int) -> float:
        """Mean distance in metres between the motion and its reconstruction at this step."""
        quantised = self.quantised(rung)
        return self.apart.mean_error(stream.reconstruct(quantised.clips, quantised.header))

    def _encode(self, rung: int) -> Encoded[Motion]:
        """The encoded motion at this step, with corrections if there is a bound."""
        quantised = self.quantised(rung)
        groups = clip_segmentation.group_into_chunks(quantised.clips, self.chunk_frames)
        stops = np.cumsum([clips.lengths.sum() for clips in groups]).tolist()
        chunks: list[Chunk] = []
        for clips, (start, stop) in zip(groups, pairwise([0, *stops]), strict=True):
            chunks.append(Chunk(start, stop - start, self._payload(clips, quantised.header, start, stop)))
        return Encoded(
            codec=self.codec.name,
            about=encodeds.about(self.motion),
            chunks=tuple(chunks),
            shared=(quantised.header.pack(self.parents), *self.codec.transforms),
            settings=base.settings(replace(self.codec, transforms=())),
        )

    def _payload(
        self,
        clips: stream.QuantisedClips,
        header: stream.SharedHeader,
        start: int,
        stop: int,
        packed: bytes | None = None,
    ) -> bytes:
        """The payload of one chunk, frames [start, stop). packed: its clips, if they are packed."""
        corrections = b""
        if header.max_error is not None:
            prediction = stream.reconstruct_by_numpy(clips, header)  # bytes are the same with the compiled module
            corrections = bounded.pack(self.moving[start:stop], prediction, header.max_error, self.neighbours)
        packed = stream.pack_clips(clips, header) if packed is None else packed
        return stream.pack_payload(packed, self.apart[start:stop].pack(), corrections)

    def sampled_size(
        self, rung: int, times: float = 1.0, chunks: int = SAMPLED_CHUNKS, limit: float = math.inf
    ) -> float:
        """Estimated payload bytes at this step, from at most `chunks` chunks; infinite if it is too small to code.

        times: factor for the size of the chunks. Where coefficients alone exceed the limit, they alone are counted.
        """
        try:
            quantised = self.quantised(rung)
            groups = clip_segmentation.group_into_chunks(quantised.clips, self.chunk_frames)
            starts = np.cumsum([0, *(clips.lengths.sum() for clips in groups)]).tolist()
            sampled = range(0, len(groups), -(-len(groups) // chunks))
            packed = [stream.pack_clips(groups[i], quantised.header) for i in sampled]
            shared, scale = len(quantised.header.pack(self.parents)), times * len(groups) / len(packed)
            if (least := shared + scale * sum(map(len, packed))) > limit:
                return least
            payloads = [
                self._payload(groups[i], quantised.header, starts[i], starts[i + 1], clips)
                for i, clips in zip(sampled, packed, strict=True)
            ]
            return shared + scale * sum(map(len, payloads))
        except CannotEncode:
            return math.inf

    def rung_for_mean_error(self, target: float) -> int:
        """The largest step whose mean error is within the target. Raises CannotEncode."""
        found = self._closest_within(lambda rung: self.mean_error(rung) / target, rising=True)
        if found is None:
            raise CannotEncode(f"hou2014 cannot reach mean_error={target:g} m on this motion: ask for a larger error")
        return found

    def for_ratio(self, target: float) -> Encoded[Motion]:
        """At the smallest step whose ratio is at least the target."""
        allowed = self.motion.raw_bytes / target
        found = self._closest_within(lambda rung: self.encoded(rung).payload_bytes / allowed, rising=False)
        if found is None:
            raise CannotEncode(f"hou2014 cannot reach ratio={target:g} on this motion: ask for a lower ratio")
        return self.encoded(found)

    def _closest_within(self, share: Callable[[int], float], rising: bool) -> int | None:
        """The rung whose share of the allowed error is nearest to 1 from below."""
        found = search.closest_within(
            progress.attempts(lambda rung: (share(int(rung)), None)),
            self.codec.first_rung,
            rising=rising,
            stride=_stride,
            farthest=FARTHEST_RUNGS,
        )
        return None if found is None else int(found.setting)

    def for_max_error(self, bound: float) -> Encoded[Motion]:
        """At the step where coefficients and corrections together are smallest. Checks the bound by decoding."""
        size = cache(progress.attempts(self.sampled_size, share=0.15))
        rung = search.minimum(size, self.codec.first_rung, STRIDES, farthest=FARTHEST_RUNGS)
        first_coarse = self.codec.first_rung + COARSE_RUNGS
        if self.neighbours is not None and size(first_coarse) < COARSE_PROMISING * size(rung):
            coarse = search.minimum(size, first_coarse, COARSE_STRIDES, farthest=FARTHEST_RUNGS)
            rung = min(rung, coarse, key=size)
        encoded = self.encoded(rung)
        decoded = decoding.decode(encoded).positions
        largest = np.nanmax(metrics.distances(self.motion.positions, decoded))
        if not largest <= bound:
            raise CannotEncode(
                f"hou2014 cannot keep max_error={bound:g} m on this motion, only {largest:g} m: ask for a larger bound"
            )
        return encoded


def _stride(log: float) -> int:
    """Rungs to the next trial of a search, from the logarithm of value over limit; at most six octaves."""
    return max(1, min(round(abs(log) / math.log(2) * 1.4 * quantise.LADDER), 6 * quantise.LADDER))


def _unpack_learned(blobs: tuple[bytes, ...], points: int) -> tuple[left_transform.LeftTransform, ...]:
    """The learned left transforms in the codec's settings. Raises BadInput."""
    try:
        return tuple(left_transform.unpack(blob, 3 * points, None) for blob in blobs)
    except Corrupt as error:
        raise BadInput(f"hou2014: transforms were not learned from motions of {points} points: {error}") from None


def _weight_rungs(weights: Mapping[str, float], names: tuple[str, ...]) -> Integers | None:
    """Rungs of √weight for each point, (points,): scaling rows by √weight weights squared errors."""
    if not weights:
        return None
    logs = np.log2([weights.get(name, 1.0) for name in names])
    return np.rint(quantise.LADDER / 2 * logs).astype(np.int64)
