"""The codec: the flow chart of figure 6, its inverse, and the searches that meet a target.

    encode    positions ─gaps─► clips ─► B ─► S_i = Bᵀ M_i D̃ ─quantise─► integers ─► entropy code
                                  ▲ step, k, l: by the paper's rules, or searched for a target
    decode    entropy code ─► integers ─► B S_i D̃ᵀ ─► corrections ─► gaps ─► positions

A chunk is a group of clips. It decodes from the shared bytes and its own payload.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from ... import encoded as encodeds
from ... import metrics, progress
from ...encoded import Chunk, Encoded, most_chunk_frames
from ...errors import BadInput, CannotEncode, Corrupt
from ...motion import Motion
from ...stages import bounded, frozen, gaps, lattice, quantise, search
from ...typing import Floats, Integers
from .. import base, rescue
from . import clip_segmentation, left_transform, parameters, quantised_motion, stream
from .quantised_motion import PreparedMotion, QuantisedMotion

SAMPLED_CHUNKS = 3
"""Chunks that the search under a bound encodes at each step: the best step is similar for all chunks."""

STEP_OF_MEAN, STEP_OF_BOUND = 5.0, 2.6
"""Where a search begins: typical steps as multiples of the mean error and of the bound."""

PROMISING_BITS = 1.1
"""A bound is tried in place of a mean error if its coefficients take up to this many times the bits."""

FIRST_MEAN_ERROR_M = 0.003
"""The mean error that a search for a ratio begins at."""

FARTHEST_RUNGS = 30 * quantise.LADDER
"""No rung that is tried is farther than this from the first: 30 octaves."""

FROZEN_SHARE = 1 / 8
"""Share of the target error that the rounding of a frozen position may take."""

STRIDES = (quantise.LADDER // 2, quantise.LADDER // 5)
"""Under a bound the step is searched in half octaves, then in fifths of an octave around the best."""

COARSE_RUNGS, COARSE_STRIDES = 5 * quantise.LADDER, (quantise.LADDER, quantise.LADDER // 2)
"""Where the lattice engine codes the corrections, a coarser step may be best: from where it is searched, and how."""
COARSE_PROMISING = 1.1
"""Coarser steps are searched if the first of them takes up to this many times the bytes of the best fine step."""


@dataclass(frozen=True)
class Hou2014:
    """Settings; lengths in metres. One target or none: `max_error`, `mean_error`, `ratio` (float32 over payload bytes).

    A setting that is None follows the paper's rule; with a target, encoding searches for its best value.
    `as_published` gives the paper's own coding of numbers.
    """

    name: ClassVar[str] = "hou2014"

    max_error: float | None = None
    mean_error: float | None = None
    ratio: float | None = None

    components: int | None = None  # k; None: 30, or with a target the number that costs least
    clip_frames: int | None = None  # L; None: 280, or with a target the length that costs least
    frequencies: int | None = None  # l; None: equation (12), or with a target all that have nonzero coefficients
    fraction_bits: int | None = None  # Q; None: equation (13)
    segmentation: str = "equal"  # or "adaptive": cut where the distribution of poses changes
    clips: int | None = None  # most clips of an adaptive segmentation; None: the number that costs least
    unit: float = parameters.UNIT_M  # unit of the quantiser
    compress_basis: bool = True  # store B at adaptive precision; False: 16 bits per entry
    centre: bool = True  # subtract the mean pose before the transform
    economy: float = 0.16  # RDO λ: squared error, in squared steps, that justifies one bit; 0: round to nearest
    masking: float = 0.0  # a clip's step is proportional to its mean speed to this power
    point_weights: Mapping[str, float] = field(default_factory=dict)  # weight of a point's squared error; default 1
    transforms: tuple[bytes, ...] = ()  # learned left transforms from `Hou2014Database`
    chunk_frames: int = 5000  # most frames of a chunk, unless a single clip is longer

    @classmethod
    def as_published(cls, **settings: Any) -> Hou2014:
        """Section IV-C: 16 bits per entry of B, no mean pose, rounding to nearest."""
        return cls(**{"compress_basis": False, "centre": False, "economy": 0.0, **settings})

    def encode(self, motion: Motion) -> Encoded[Motion]:
        """Raises CannotEncode if the target cannot be met, BadInput for invalid settings."""
        if not base.has_samples(motion):
            self._check(motion)
            return base.encode_gaps(self, motion, base.settings(replace(self, transforms=())))
        moving = split(self, motion).moving
        base.require_usual_lengths(self, moving)
        filled = gaps.fill(moving)[0]
        if self.mean_error is None:
            return self.encode_smoothed(motion, filled, by_engine=True)
        return self._encode_to_mean(motion, filled, self.mean_error)

    def _encode_to_mean(self, motion: Motion, filled: Floats, target: float) -> Encoded[Motion]:
        """At a mean error, or under this error as a bound where that is smaller, or the only way."""
        base.require_frames(motion)
        self._check(motion)
        encoder, encoded, failure = _MotionEncoder(self, motion, filled), None, None
        bounded = replace(self, mean_error=None, max_error=target)
        promising = True
        try:
            rung = encoder.rung_for_mean_error(target)
            encoded = encoder.encoded(rung)
            size = encoded.payload_bytes
            promising = encoder.bits_over(_first_rung(bounded), rung) < PROMISING_BITS
            promising = promising and bounded.estimate(motion, filled, limit=size)[0] < size
        except CannotEncode as error:
            failure = error
        if promising:
            try:
                rival = bounded.encode_smoothed(motion, filled)
            except CannotEncode:
                rival = None
            if rival is not None and (encoded is None or rival.payload_bytes < encoded.payload_bytes):
                encoded = replace(rival, settings=base.settings(replace(self, transforms=())))
        if encoded is None:
            assert failure is not None
            raise failure
        rescue.require_kept(motion, {"mean_error": target}, encoded, Hou2014.decode)
        return encoded

    def encode_smoothed(self, motion: Motion, smooth: Floats, by_engine: bool = False) -> Encoded[Motion]:
        """`encode`, where the transform codes `smooth` in place of the motion's positions.

        smooth (frames, points, 3): the positions with gaps filled. With `max_error`, outliers of single frames may be
        smoothed too, since corrections restore them. by_engine: the lattice engine may code corrections.
        """
        base.require_frames(motion)
        self._check(motion)
        encoder = _MotionEncoder(self, motion, smooth, by_engine)
        if self.max_error is not None:
            return encoder.for_max_error(self.max_error)
        if self.mean_error is not None:
            return encoder.encoded(encoder.rung_for_mean_error(self.mean_error))
        if self.ratio is not None:
            return encoder.for_ratio(self.ratio)
        return encoder.encoded(encoder.first_rung)

    @staticmethod
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

    @property
    def has_target(self) -> bool:
        """Whether encoding searches for the quantisation step."""
        return (self.max_error, self.mean_error, self.ratio) != (None, None, None)

    def estimate(
        self,
        motion: Motion,
        smooth: Floats,
        times: float = 1.0,
        chunks: int = SAMPLED_CHUNKS,
        limit: float = math.inf,
    ) -> tuple[float, float]:
        """Estimated payload bytes of `encode_smoothed`, and the mean error in metres, at the first step of the search.

        Costs one encoding of at most `chunks` chunks. With `max_error` the mean error is not measured, but NaN. times:
        factor for the size of the chunks, if `motion` is a part of the motion to estimate. limit: bytes beyond which
        the estimate may be too low. Raises as `encode`.
        """
        base.require_frames(motion)
        self._check(motion)
        encoder = _MotionEncoder(self, motion, smooth)
        rung = encoder.first_rung
        size = encoder.sampled_size(rung, times, chunks, limit)
        return size, math.nan if self.max_error is not None else encoder.mean_error(rung)

    def _check(self, motion: Motion) -> None:
        targets = {name: getattr(self, name) for name in ("max_error", "mean_error", "ratio")}
        given = {name: value for name, value in targets.items() if value is not None}
        if len(given) > 1:
            raise BadInput(f"hou2014 takes one target: give only one of {', '.join(given)}")
        for name, value in (given | {"unit": self.unit}).items():
            if not (math.isfinite(value) and value > 0):
                raise BadInput(f"hou2014: {name} must be positive and finite, not {value}")
        for name in ("components", "clip_frames", "frequencies", "clips", "chunk_frames"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise BadInput(f"hou2014: {name} must be at least 1, not {value}")
        if self.segmentation not in ("equal", "adaptive"):
            raise BadInput(f"hou2014: segmentation must be 'equal' or 'adaptive', not {self.segmentation!r}")
        unknown = [name for name in self.point_weights if name not in motion.names]
        if unknown:
            raise BadInput(f"hou2014: point_weights names points that the motion does not have: {', '.join(unknown)}")
        if any(not 1e-6 <= weight <= 1e6 for weight in self.point_weights.values()):
            raise BadInput("hou2014: point_weights must be between 1e-6 and 1e6")


class _MotionEncoder:
    """One motion, prepared for encoding at any quantisation step that a search tries.

    quantised(rung), encoded(rung): the motion at this step; cached.
    """

    def __init__(self, codec: Hou2014, motion: Motion, filled: Floats, by_engine: bool = False) -> None:
        self.codec, self.motion, self.apart = codec, motion, split(codec, motion)
        self.moving = self.apart.moving
        self.parents = None if motion.skeleton is None else motion.skeleton.parents
        self.chunk_frames = min(codec.chunk_frames, most_chunk_frames(motion.points))
        self.neighbours = lattice.neighbours(filled) if by_engine and codec.max_error and lattice.is_fast() else None
        self.prepared = self._prepare(filled)
        self.quantised: Callable[[int], QuantisedMotion] = lru_cache(1)(
            lambda rung: quantised_motion.quantise_motion(self.prepared, rung)
        )
        self.encoded: Callable[[int], Encoded[Motion]] = cache(self._encode)

    def _prepare(self, filled: Floats) -> PreparedMotion:
        """Segment into clips, choose each clip's step and frequencies, fit B."""
        codec, motion = self.codec, self.motion
        length = codec.clip_frames or (len(motion) if codec.has_target else parameters.CLIP_FRAMES)
        length = min(length, most_chunk_frames(motion.points))
        lengths = stream.equal_lengths(len(motion), length)
        prepared = PreparedMotion(
            points=motion.points,
            rows=filled.reshape(len(motion), -1),
            lengths=lengths,
            clip_frames=length,
            rung_offsets=np.zeros(len(lengths), np.int64),
            weight_rungs=_weight_rungs(codec.point_weights, motion.names),
            components=codec.components or (None if codec.has_target else parameters.COMPONENTS),
            unit=codec.unit,
            centre=codec.centre,
            compress_basis=codec.compress_basis,
            economy=codec.economy,
            max_error=codec.max_error,
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
        step = codec.unit * quantise.step(self.first_rung)
        curves = quantised_motion.component_curves(prepared, step)
        if codec.segmentation == "adaptive":
            length = 0
            lengths = clip_segmentation.adaptive_lengths(filled, curves, step, codec.clips, self.chunk_frames)
        else:
            length = clip_segmentation.best_equal_length(curves, step, self.chunk_frames)
            lengths = stream.equal_lengths(len(filled), length)
        return replace(prepared, lengths=lengths, clip_frames=length)

    @property
    def first_rung(self) -> int:
        """The step where a search begins."""
        return _first_rung(self.codec)

    def bits_over(self, rung: int, other: int) -> float:
        """How many times the bits of the coefficients at one step those at another are, estimated."""
        unit, step = self.codec.unit, quantise.step
        curves = quantised_motion.component_curves(self.prepared, unit * step(max(rung, other)))
        spectra = clip_segmentation.spectra_of_clips(curves, self.prepared.lengths)
        bits = [clip_segmentation.bits_of_spectra(spectra, unit * step(one)) for one in (rung, other)]
        return bits[0] / max(bits[1], 1.0)

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
            moving, prediction = self.moving[start:stop], stream.reconstruct(clips, header)
            corrections = bounded.pack(moving, prediction, header.max_error, self.neighbours)
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
        """The rung at which a share of what is allowed comes nearest to 1 from below."""
        found = search.closest_within(
            progress.attempts(lambda rung: (share(int(rung)), None)),
            self.first_rung,
            rising=rising,
            stride=_stride,
            farthest=FARTHEST_RUNGS,
        )
        return None if found is None else int(found.setting)

    def for_max_error(self, bound: float) -> Encoded[Motion]:
        """At the step where coefficients and corrections together are smallest. Checks the bound by decoding."""
        size = cache(progress.attempts(self.sampled_size, share=0.15))
        rung = search.minimum(size, self.first_rung, STRIDES, farthest=FARTHEST_RUNGS)
        first_coarse = self.first_rung + COARSE_RUNGS
        if self.neighbours is not None and size(first_coarse) < COARSE_PROMISING * size(rung):
            coarse = search.minimum(size, first_coarse, COARSE_STRIDES, farthest=FARTHEST_RUNGS)
            rung = min(rung, coarse, key=size)
        encoded = self.encoded(rung)
        decoded = Hou2014.decode(encoded).positions
        largest = np.nanmax(metrics.distances(self.motion.positions, decoded))
        if not largest <= bound:
            raise CannotEncode(
                f"hou2014 cannot keep max_error={bound:g} m on this motion, only {largest:g} m: ask for a larger bound"
            )
        return encoded


def split(codec: Hou2014, motion: Motion) -> frozen.Split:
    """The samples that the transform does not code: missing or frozen."""
    error = codec.max_error or codec.mean_error
    bones, holds = motion.skeleton is not None, codec.mean_error is None
    return frozen.split(motion.positions, error and FROZEN_SHARE * error, bones, holds)


def _first_rung(codec: Hou2014) -> int:
    """The step where a search begins; without a target 2^−Q units: section IV-C and equation (13)."""
    if not codec.has_target:
        bits = codec.fraction_bits
        k = codec.components or parameters.COMPONENTS
        return -quantise.LADDER * (parameters.fraction_bits(k) if bits is None else bits)
    if codec.max_error is not None:
        return quantise.rung(STEP_OF_BOUND * codec.max_error / codec.unit)
    return quantise.rung(STEP_OF_MEAN * (codec.mean_error or FIRST_MEAN_ERROR_M) / codec.unit)


def _stride(log: float) -> int:
    """Rungs to the next trial of a search, from the logarithm of value over limit; at most six octaves."""
    return max(1, min(round(abs(log) / math.log(2) * 1.4 * quantise.LADDER), 6 * quantise.LADDER))


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
