"""The method: figure 6 of the paper, and back; and the searches that meet a target.

    encode    positions ─gaps─► clips ─► B ─► S_i = Bᵀ M_i D̃ ─quantise─► integers ─► entropy code
                                  ▲ step, k, l: the paper's rules, or searched for a target ─┘
    decode    entropy code ─► integers ─► B S_i D̃ᵀ ─► corrections ─► gaps ─► positions

A chunk is a number of clips. It needs nothing but itself and the shared bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ... import encoded as encodeds
from ... import metrics, progress
from ...encoded import Chunk, Encoded
from ...errors import BadInput, CannotEncode, Corrupt
from ...motion import Floats, Motion
from ...stages import bounded, gaps, quantise
from .. import base
from . import clips as clipping
from . import drafts, parameters, search, stream, transform
from .drafts import Draft, Material

Integers = NDArray[np.int64]

SAMPLED_CHUNKS = 3
"""Chunks that the search under a bound looks at: the best step is much the same for all."""

STEP_OF_MEAN, STEP_OF_BOUND = 5.0, 2.6
"""Where searches begin: the steps for a mean error and for a bound, in these lengths, that are usual."""


@dataclass(frozen=True)
class Hou2014:
    """Settings; where none is given, the paper's, and under a target the best that is found. Lengths in metres.

    A target is one of `max_error`, `mean_error`, `ratio` (float32 over payload bytes). `as_published` gives the paper's
    own coding of numbers.
    """

    name: ClassVar[str] = "hou2014"

    max_error: float | None = None
    mean_error: float | None = None
    ratio: float | None = None

    components: int | None = None  # k; 30, or under a target as many as pay
    clip_frames: int | None = None  # L; 280, or under a target the best
    frequencies: int | None = None  # l; by (12), or under a target all that are not zero
    fraction_bits: int | None = None  # Q; by (13)
    segmentation: str = "equal"  # or "adaptive": where the distribution of poses changes
    clips: int | None = None  # of an adaptive segmentation, at most; the best number where none is given
    unit: float = parameters.UNIT_M  # of the quantiser, metres
    compress_basis: bool = True  # each component as finely as its variance deserves; False: 16 bits an entry
    centre: bool = True  # code around the mean pose
    economy: float = 0.16  # what a bit is worth, in squared steps; 0: round to nearest
    masking: float = 0.0  # how much coarser fast clips are: step in proportion to speed to this power
    point_weights: Mapping[str, float] = field(
        default_factory=dict
    )  # how much an error of a point counts; 1 unless named
    transforms: tuple[bytes, ...] = ()  # learned elsewhere: `Hou2014Database`
    chunk_frames: int = 5000  # clips are coded together up to about so many frames

    @classmethod
    def as_published(cls, **settings: Any) -> Hou2014:
        """With 16 bits for each entry of B, no mean pose and rounding to nearest: section IV-C."""
        return cls(**{"compress_basis": False, "centre": False, "economy": 0.0, **settings})

    def encode(self, motion: Motion) -> Encoded[Motion]:
        """Raises CannotEncode, and BadInput for settings that cannot be."""
        return self.encode_near(motion, gaps.fill(motion.positions)[0])

    def encode_near(self, motion: Motion, smooth: Floats) -> Encoded[Motion]:
        """`encode`, with positions for the transform that are the motion's own but for gaps.

        smooth (frames, points, 3): without gaps; under a bound without leaps of single frames too, which corrections
        put back.
        """
        base.require_frames(motion)
        self._check(motion)
        coding = _Coding(self, motion, smooth, motion.gaps)
        if self.max_error is not None:
            return coding.for_max_error(self.max_error)
        if self.mean_error is not None:
            return coding.for_mean_error(self.mean_error)
        if self.ratio is not None:
            return coding.for_ratio(self.ratio)
        return coding.encoded(coding.first_rung)

    @staticmethod
    def decode(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
        """Raises Corrupt."""
        start, stop = encoded.range(frames)
        head = _head(encoded)
        parts: list[Floats] = [np.zeros((0, head.points, 3))]
        for chunk in progress.over(encoded.covering(start, stop)):
            positions = stream.unpack_payload(chunk.payload, chunk.frames, head)
            parts.append(positions[max(0, start - chunk.start) : stop - chunk.start])
        return encodeds.restore(encoded, np.concatenate(parts), start)

    @property
    def has_target(self) -> bool:
        """Whether the step is searched for."""
        return (self.max_error, self.mean_error, self.ratio) != (None, None, None)

    def estimate(
        self, motion: Motion, smooth: Floats, times: float = 1.0, chunks: int = SAMPLED_CHUNKS
    ) -> tuple[float, float]:
        """About how many payload bytes `encode_near` takes, and at which mean error (m), at the first step of a search.

        What `mean_error` or `max_error` is going to cost, for the price of one coding; under a bound the mean error is
        not looked at, and nan. times: how often there is as much motion to code in the same basis. chunks: at most so
        many are coded. Raises as `encode`.
        """
        base.require_frames(motion)
        self._check(motion)
        coding = _Coding(self, motion, smooth, motion.gaps)
        rung = coding.first_rung
        size = coding.sampled_size(rung, times, chunks)
        return size, math.nan if self.max_error is not None else coding.mean_error(rung)

    def _check(self, motion: Motion) -> None:
        targets = {name: getattr(self, name) for name in ("max_error", "mean_error", "ratio")}
        given = {name: value for name, value in targets.items() if value is not None}
        if len(given) > 1:
            raise BadInput(f"hou2014 takes one target at a time, not {' and '.join(given)}")
        for name, value in (given | {"unit": self.unit}).items():
            if not (math.isfinite(value) and value > 0):
                raise BadInput(f"{name} must be positive, not {value}")
        for name in ("components", "clip_frames", "frequencies", "clips", "chunk_frames"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise BadInput(f"{name} must be at least 1, not {value}")
        if self.segmentation not in ("equal", "adaptive"):
            raise BadInput(f"segmentation is 'equal' or 'adaptive', not {self.segmentation!r}")
        unknown = [name for name in self.point_weights if name not in motion.names]
        if unknown:
            raise BadInput(f"point_weights names points that are not there: {', '.join(unknown)}")
        if any(not 1e-6 <= weight <= 1e6 for weight in self.point_weights.values()):
            raise BadInput("point_weights must be from a millionth to a million")


class _Coding:
    """One motion on its way: what it becomes at the steps that a search asks for."""

    def __init__(self, codec: Hou2014, motion: Motion, filled: Floats, mask: NDArray[np.bool_]) -> None:
        self.codec, self.motion, self.mask = codec, motion, mask
        self.parents = None if motion.skeleton is None else motion.skeleton.parents
        length = codec.clip_frames or (len(motion) if codec.has_target else parameters.CLIP_FRAMES)
        lengths = stream.equal_lengths(len(motion), length)
        material = Material(
            points=motion.points,
            rows=filled.reshape(len(motion), -1),
            lengths=lengths,
            clip_frames=length,
            offsets=np.zeros(len(lengths), np.int64),
            weight_rungs=_weight_rungs(codec.point_weights, motion.names),
            components=codec.components or (None if codec.has_target else parameters.COMPONENTS),
            unit=codec.unit,
            centre=codec.centre,
            compress_basis=codec.compress_basis,
            economy=codec.economy,
            max_error=codec.max_error,
            given=_given(codec.transforms, motion.points),
        )
        if codec.segmentation == "adaptive" or (codec.has_target and not codec.clip_frames):
            material = self._well_cut(drafts.fitted(material), filled)
        offsets = clipping.offsets(filled, motion.rate, material.lengths, codec.masking)
        material = replace(material, offsets=offsets, frequencies=self._frequencies(material))
        if material.fitted is None or material.frequencies is not None:
            material = drafts.fitted(material)
        self.material = material
        self.draft: Callable[[int], Draft] = lru_cache(1)(lambda rung: drafts.draft(self.material, rung))
        self.encoded: Callable[[int], Encoded[Motion]] = cache(self._encoded)

    def _frequencies(self, material: Material) -> Integers | None:
        """l_i: as set, by (12), or without a limit under a target."""
        if self.codec.frequencies is not None:
            return np.minimum(self.codec.frequencies, material.lengths)
        if self.codec.has_target or material.components is None:
            return None
        return np.array([parameters.frequencies(material.components, int(length)) for length in material.lengths])

    def _well_cut(self, material: Material, filled: Floats) -> Material:
        """With clips of the length, or adaptive ones of the number, that costs the fewest bits."""
        codec = self.codec
        step = codec.unit * quantise.step(self.first_rung)
        curves = drafts.curves(material, step)
        if codec.segmentation == "adaptive":
            lengths, length = clipping.adaptive(filled, curves, step, codec.clips, codec.chunk_frames), 0
        else:
            length = clipping.best_equal_length(curves, step, codec.chunk_frames)
            lengths = stream.equal_lengths(len(filled), length)
        return replace(material, lengths=lengths, clip_frames=length)

    @property
    def first_rung(self) -> int:
        """Where a search begins; without a target, Q bits for the fractional part: section IV-C and (13)."""
        codec = self.codec
        if not codec.has_target:
            bits = codec.fraction_bits
            k = codec.components or parameters.COMPONENTS
            return -quantise.LADDER * (parameters.fraction_bits(k) if bits is None else bits)
        if codec.max_error is not None:
            return quantise.rung(STEP_OF_BOUND * codec.max_error / codec.unit)
        return quantise.rung(STEP_OF_MEAN * (codec.mean_error or 0.003) / codec.unit)

    def mean_error(self, rung: int) -> float:
        draft = self.draft(rung)
        return metrics.mean_distance(self.motion.positions, stream.reconstruct(draft.clips, draft.head))

    def _encoded(self, rung: int) -> Encoded[Motion]:
        """Everything, corrections too where there is a bound."""
        draft = self.draft(rung)
        parts = clipping.chunked(draft.clips, self.codec.chunk_frames)
        stops = np.cumsum([clips.lengths.sum() for clips in parts]).tolist()
        chunks: list[Chunk] = []
        for clips, (start, stop) in zip(parts, pairwise([0, *stops]), strict=True):
            chunks.append(Chunk(start, stop - start, self._payload(clips, draft.head, start, stop)))
        return Encoded(
            codec=self.codec.name,
            about=encodeds.about(self.motion),
            chunks=tuple(chunks),
            shared=(draft.head.pack(self.parents), *self.codec.transforms),
            settings=base.settings(replace(self.codec, transforms=())),
        )

    def _payload(self, clips: stream.Clips, head: stream.Head, start: int, stop: int) -> bytes:
        """The bytes of one chunk, frames [start, stop)."""
        corrections = b""
        if head.max_error is not None:
            original, prediction = self.motion.positions[start:stop], stream.reconstruct(clips, head)
            corrections = bounded.pack(original, prediction, head.max_error)
        packed = stream.pack_clips(clips, head)
        return stream.pack_payload(packed, gaps.pack(self.mask[start:stop]), corrections)

    def sampled_size(self, rung: int, times: float = 1.0, chunks: int = SAMPLED_CHUNKS) -> float:
        """Bytes, from a few chunks of a long motion; infinite where it cannot be coded at this step.

        times: how often the chunks are counted.
        """
        try:
            draft = self.draft(rung)
            parts = clipping.chunked(draft.clips, self.codec.chunk_frames)
            starts = np.cumsum([0, *(clips.lengths.sum() for clips in parts)]).tolist()
            some = range(0, len(parts), -(-len(parts) // chunks))
            sizes = [len(self._payload(parts[i], draft.head, starts[i], starts[i + 1])) for i in some]
            return len(draft.head.pack(self.parents)) + times * sum(sizes) * len(parts) / len(sizes)
        except CannotEncode:
            return math.inf

    def for_mean_error(self, target: float) -> Encoded[Motion]:
        """The coarsest step whose mean error is within the target."""
        rung = search.largest_within(self.mean_error, target, self.first_rung)
        if rung is None:
            raise CannotEncode(f"hou2014 does not reach a mean error of {target:g} m on this motion")
        return self.encoded(rung)

    def for_ratio(self, target: float) -> Encoded[Motion]:
        """The finest step whose ratio is not below the target."""
        raw = self.motion.raw_bytes
        rung = search.smallest_within(lambda rung: self.encoded(rung).payload_bytes, raw / target, self.first_rung)
        if rung is None:
            raise CannotEncode(f"hou2014 does not reach a ratio of {target:g} on this motion")
        return self.encoded(rung)

    def for_max_error(self, bound: float) -> Encoded[Motion]:
        """The step at which coefficients and corrections together are smallest; decoded and checked."""
        encoded = self.encoded(search.smallest(self.sampled_size, self.first_rung))
        decoded = Hou2014.decode(encoded).positions
        furthest = np.nanmax(metrics.distances(self.motion.positions, decoded))
        if not furthest <= bound:
            raise CannotEncode(f"hou2014 does not keep {bound:g} m on this motion, but {furthest:g} m")
        return encoded


def _head(encoded: Encoded[Motion]) -> stream.Head:
    skeleton = encoded.about.skeleton
    return stream.unpack_head(encoded.shared, encoded.about.points, None if skeleton is None else skeleton.parents)


def _given(blobs: tuple[bytes, ...], points: int) -> tuple[transform.Transform, ...]:
    try:
        return tuple(transform.unpack(blob, 3 * points, None) for blob in blobs)
    except Corrupt as problem:
        raise BadInput(f"the transforms are not for motions of {points} points: {problem}") from None


def _weight_rungs(weights: Mapping[str, float], names: tuple[str, ...]) -> Integers | None:
    """Rungs of the square roots: rows are multiplied so that squared errors count by weight."""
    if not weights:
        return None
    logs = np.log2([weights.get(name, 1.0) for name in names])
    return np.rint(quantise.LADDER / 2 * logs).astype(np.int64)
