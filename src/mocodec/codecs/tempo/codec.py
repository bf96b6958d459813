"""Tempo: mocodec's own codec for named points, small at any error and true to its bound.

    positions ─gaps filled, y up, spikes out─► ─chunks of about 4 s─► ─model─► coefficients of each chunk
                   preparation                   chunk_bounds      model_choice, models
    coefficients ─quantise─► integers ─contexts─► rANS ─► bytes
                  target, coding.quantise      coding
    bytes ─decode─► samples too far off ─corrections─► bytes            the bound is kept here: hard_bound

A chunk decodes alone: the prior that ships with the package has the bases and the coder's statistics. Frames that
repeat are coded once (`repeats`); where hou2014 is smaller on the whole recording, it codes the chunks (`fallback`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ... import metrics, progress
from ...encoded import Chunk, Encoded, about, most_chunk_frames, restore
from ...errors import BadInput
from ...motion import Motion
from ...stages import lattice
from ...typing import Booleans, Floats
from .. import rescue
from ..base import decode_gaps, encode_gaps, has_samples, require_usual_lengths, require_usual_rate, settings
from ..lossless import Lossless
from . import chunk, chunk_decoding, engine_choice, fallback, hard_bound, mean_targets, model_choice, repeats, target
from .chunk import DIRECT, LATTICE, TRANSFORM, ChunkEncoder, Payload
from .engine_choice import LatticePlan
from .equal_slopes import to_mean
from .header import StreamHeader, pack_weights, with_weights
from .mean_targets import FALLBACK_MODEL, LATTICE_MODEL, Kinds
from .models import MODELS, WITH_STORED_BASIS, Recording
from .models.model import Model
from .preparation import Prepared, chunk_bounds, prepare
from .rotation_layer import layer
from .rotation_layer.chunk_layer import Promise
from .rotation_layer.encoder import Encoder as RotationEncoder

DEFAULT_MAX_ERROR = 0.005
TARGETS = ("max_error", "mean_error", "ratio", "size")
MODEL_NAMES = (model_choice.AUTO, model_choice.TRANSFORM, *MODELS, model_choice.DIRECT, LATTICE_MODEL, FALLBACK_MODEL)
MOST_CHUNK_SECONDS, LATTICE_CHUNKS = 10.0, 1.5
"""Chunks are longer by this where the lattice engine codes all: its predictions have to be learned in each."""
CHUNKS_SHARE, FALLBACK_SHARE, CHOICE_SHARE = 0.7, 0.9, 0.2
"""Progress when the chunks and the fallback are done; share of the choice of the model in that of the chunks."""
MEAN_SHARE = 0.95
"""An encoding by repeats or by the fallback must have at least this share of the mean error asked for."""
FROZEN_SHARE = 1 / 8
"""Share of the target error that the rounding of a frozen position may take."""


class _Coded(NamedTuple):
    """sample: chunks with coefficients of the model, None without one."""

    encoded: Encoded[Motion]
    sample: fallback.Sample | None


@dataclass(frozen=True)
class Tempo:
    """Settings. At most one target; without any, no point of any frame is moved by more than 5 mm.

    max_error, mean_error: metres. ratio: against float32 positions. size: bytes of payload. chunk_seconds: 0.5 to 10.
    weights: points that matter more, by name: with 4, a point is kept within a quarter of `max_error`.
    model: "auto" takes the smallest, "transform" the smallest of the models. Or one of "points-prior", "points-stored",
    "directions-prior", "directions-stored" (coordinates and statistics, see `models`), "lattice" (predictions within a
    hard bound), "direct" (a grid without a model) and "hou2014".

    Rotations of a skeleton's joints are kept too, unless the motion has gaps (`lost_rotations`). Errors are then those
    of joints and of three shell points, `shell` metres off each joint along the axes of its frame; none exceeds twelve
    times a mean error.
    max_rotation: degrees, beside any target; no rotation of a joint, against the world or its parent, is farther off.
    """

    name: ClassVar[str] = "tempo"
    decodes_frames_alone: ClassVar[bool] = True

    max_error: float | None = None
    mean_error: float | None = None
    ratio: float | None = None
    size: int | None = None
    chunk_seconds: float = 4.0
    weights: Mapping[str, float] | None = None
    model: str = model_choice.AUTO
    max_rotation: float | None = None
    shell: float = 0.03

    def __post_init__(self) -> None:
        targets = {t: getattr(self, t) for t in TARGETS if getattr(self, t) is not None}
        if len(targets) > 1:
            raise BadInput(f"tempo takes one target, not {' and '.join(targets)}")
        if any(not (np.isfinite(v) and v > 0) for v in targets.values()):
            raise BadInput(f"a target must be positive: {targets}")
        if not 0.5 <= self.chunk_seconds <= MOST_CHUNK_SECONDS:
            raise BadInput(f"chunk_seconds must lie between 0.5 and {MOST_CHUNK_SECONDS:g}")
        if self.weights and targets.keys() - {"max_error"}:
            raise BadInput("weights go with a hard bound: max_error")
        if self.weights and not all(1 <= w <= 1000 for w in self.weights.values()):
            raise BadInput("weights must lie between 1 and 1000")
        if self.model not in MODEL_NAMES:
            raise BadInput(f"tempo has no model {self.model!r}; it has: {', '.join(MODEL_NAMES)}")
        if self.model == LATTICE_MODEL and targets.keys() - {"max_error"}:
            raise BadInput("the model 'lattice' goes with a hard bound: max_error")
        if self.max_rotation is not None and not 0 < self.max_rotation <= 180:
            raise BadInput("max_rotation must lie between 0 and 180 degrees")
        if not 1e-4 <= self.shell <= 10:
            raise BadInput("shell must lie between 0.0001 and 10 metres")
        if self.weights and self.model == FALLBACK_MODEL:
            raise BadInput("hou2014 does not take weights")

    def encode(self, motion: Motion) -> Encoded[Motion]:
        """Raises CannotEncode where the target cannot be met, or the motion does not fit the model that is asked for.

        Where the models fail, direct coding is tried, then lossless coding; a note in `about.source` says so.
        """
        if not has_samples(motion):
            return encode_gaps(self, motion, self._stored_settings())
        stored = self._stored_settings()
        ways: list[rescue.Way] = [("with tempo's models", lambda: self._encode_any(motion))]
        if self._keeps_rotations(motion) and self.max_rotation is None:
            ways.append(("without its rotations", lambda: self.encode_smallest(replace(motion, rotations=None))))
        if self.model != model_choice.DIRECT:
            direct = replace(self, model=model_choice.DIRECT)
            encode = direct._encode_rotations if self._keeps_rotations(motion) else direct.encode_chunks
            ways.append(("directly", lambda: encode(motion)))
        if self.model == model_choice.AUTO and self.max_rotation is None:
            ways += [
                ("losslessly", lambda: Lossless(self.chunk_seconds).encode(motion)),
                ("losslessly in float64", lambda: Lossless(self.chunk_seconds, float64=True).encode(motion)),
            ]
        final = self.model != model_choice.AUTO or self._has_size
        encoded = rescue.first_kept(motion, stored, ways, Tempo.decode, final)
        targets = {name: value for name, value in stored.items() if name in TARGETS}
        return encoded if encoded.codec == self.name else replace(encoded, settings={**encoded.settings, **targets})

    def _encode_any(self, motion: Motion) -> Encoded[Motion]:
        """With rotations where they can be kept."""
        return self._encode_rotations(motion) if self._keeps_rotations(motion) else self.encode_smallest(motion)

    def _keeps_rotations(self, motion: Motion) -> bool:
        return motion.rotations is not None and self.lost_rotations(motion) is None

    def _encode_rotations(self, motion: Motion) -> Encoded[Motion]:
        weights = None if not self.weights else np.array([self.weights.get(name, 1.0) for name in motion.names])
        bound = None if self._has_size or self.mean_error else self.max_error or DEFAULT_MAX_ERROR
        turn = None if self.max_rotation is None else np.radians(self.max_rotation)
        encoder = RotationEncoder(motion, self.shell, Promise(bound, turn, weights))
        positions = replace(motion, rotations=None)
        # Errors of a lattice are uniform up to a bound: rotations then break their own bound too often.
        model = model_choice.TRANSFORM if self.model == model_choice.AUTO and not self._has_size else self.model
        bare = replace(self, max_rotation=None, max_error=None, mean_error=None, ratio=None, size=None, model=model)

        def inner(kind: str) -> Callable[[Any], Encoded[Motion]]:
            return lambda value: replace(bare, **{kind: value}).encode_smallest(positions)

        if self.mean_error is not None:
            encoded = encoder.to_mean(self.mean_error, inner("mean_error"), Tempo.decode)
        elif self._has_size:
            encoded = encoder.to_size(self._wanted_bytes(motion), inner("size"), Tempo.decode)
        else:
            encoded = encoder.to_bound(inner("max_error"), Tempo.decode)
        return replace(encoded, settings=self._stored_settings())

    @staticmethod
    def lost_rotations(motion: Motion) -> str | None:
        """Why the rotations of a motion are not kept, in words; None where they are."""
        return layer.lost_rotations(motion)

    def encode_smallest(self, motion: Motion) -> Encoded[Motion]:
        """The smallest by tempo's models or hou2014, with or without repeats; for a mean also at other targets."""
        encoded = self._with_or_without_repeats(motion)
        if self.mean_error is None:
            return encoded

        def encode(target: str, wanted: float, kinds: Kinds | None) -> Encoded[Motion]:
            found = replace(self, **{"mean_error": None, target: wanted})._with_or_without_repeats(motion, kinds)
            return replace(found, settings=self._stored_settings())

        return mean_targets.smallest(encoded, motion, self.mean_error, encode, decoded_mean_error)

    def _with_or_without_repeats(self, motion: Motion, kinds: Kinds | None = None) -> Encoded[Motion]:
        if (distinct := repeats.distinct_frames(motion, self.chunk_seconds)) is None:
            return self.encode_without_repeats(motion, kinds)
        with progress.attempt(0):
            encoded, mean = self._encode_distinct(motion, distinct)
        longest = max(chunk.frames for chunk in encoded.chunks)
        if longest <= most_chunk_frames(motion.points) and self._meets_target(encoded, motion, mean):
            return encoded
        with progress.attempt(1):
            return self.encode_without_repeats(motion)

    def encode_without_repeats(self, motion: Motion, kinds: Kinds | None = None) -> Encoded[Motion]:
        """All frames coded, whether they repeat or not. kinds: the only ones that "auto" tries, None for all."""
        if self.model == FALLBACK_MODEL:
            return fallback.encode(motion, self._stored_settings(), self._wanted_bytes(motion), self.chunk_seconds)
        if self.weights or self.model != model_choice.AUTO:
            return self.encode_chunks(motion)
        source, plan = self._prepare(motion, kinds)
        with progress.phase(0.0, CHUNKS_SHARE):
            encoded, sample = self._encode_prepared(motion, source, plan, kinds)
        if plan is not None and plan.certain:
            return encoded
        with progress.phase(CHUNKS_SHARE, FALLBACK_SHARE):
            promising = self._has_size or sample is None or fallback.is_promising(sample, self.first_step(motion))
            if promising and (kinds is None or FALLBACK_MODEL in kinds):
                encoded = self._or_fallback(encoded, motion, source)
        with progress.phase(FALLBACK_SHARE, 1.0):
            return self._or_lattice(encoded, motion) if kinds is None or LATTICE_MODEL in kinds else encoded

    def _or_lattice(self, encoded: Encoded[Motion], motion: Motion) -> Encoded[Motion]:
        if self.mean_error is None or not lattice.is_fast():
            return encoded

        def encode(part: Motion, bound: float) -> Encoded[Motion]:
            return replace(self, mean_error=None, max_error=bound, model=LATTICE_MODEL).encode_chunks(part)

        found = mean_targets.on_lattice(encoded, motion, self.mean_error, encode, Tempo.decode)
        return replace(found, settings=encoded.settings)

    def _or_fallback(self, encoded: Encoded[Motion], motion: Motion, source: Prepared) -> Encoded[Motion]:
        if self._has_size:
            size = self._wanted_bytes(motion)
            return fallback.nearer(encoded, motion, source, size, self.chunk_seconds, decoded_mean_error)
        kind = "max_error" if self.mean_error is None else "mean_error"
        smaller = fallback.smaller(encoded, motion, source, kind, encoded.settings[kind], self.chunk_seconds)
        if smaller is encoded or self.mean_error is None:
            return smaller
        # a mean below the target is welcome here, since the bytes are fewer
        return smaller if decoded_mean_error(smaller, motion) <= self.mean_error else encoded

    def encode_chunks(self, motion: Motion) -> Encoded[Motion]:
        """Without repeats and without the fallback: every chunk by the chosen model, or directly."""
        return self._encode_prepared(motion, *self._prepare(motion)).encoded

    def _prepare(self, motion: Motion, kinds: Kinds | None = None) -> tuple[Prepared, LatticePlan | None]:
        bones = motion.skeleton is not None
        source = prepare(motion.positions, motion.up, self._frozen_tolerance, bones, self.mean_error is None)
        require_usual_lengths(self, source.positions)
        require_usual_rate(self, motion.rate)
        return source, self._lattice_plan(motion, source, kinds)

    def _encode_prepared(
        self, motion: Motion, source: Prepared, plan: LatticePlan | None, kinds: Kinds | None = None
    ) -> _Coded:
        coded = self._encode_planned(motion, source, plan, kinds)
        if plan is None or plan.alone:
            return coded
        bounds = chunk_bounds(len(motion), motion.rate, self._seconds(motion, LATTICE_CHUNKS))
        bound = self.max_error or DEFAULT_MAX_ERROR
        if not engine_choice.may_be_smaller_alone(plan, coded.encoded, source, bounds, bound):
            return coded
        alone = self._encode_planned(motion, source, replace(plan, alone=True))
        return min(coded, alone, key=lambda c: c.encoded.payload_bytes)

    def _encode_planned(
        self, motion: Motion, source: Prepared, plan: LatticePlan | None, kinds: Kinds | None = None
    ) -> _Coded:
        """By the chosen model, by the lattice engine, or each chunk by the smaller."""
        if plan is not None and plan.alone:
            bounds = chunk_bounds(len(motion), motion.rate, self._seconds(motion, LATTICE_CHUNKS))
            choice = model_choice.without_model(motion)
        else:
            cuts = source.discontinuities(motion.rate)
            bounds = chunk_bounds(len(motion), motion.rate, self._seconds(motion), cuts)
            with progress.phase(0.0, CHOICE_SHARE):
                choice = self._choose_model(motion, [source.smooth[a:b] for a, b in bounds], kinds)
        header, model = choice.header, choice.model
        if self.weights:
            weights = pack_weights(motion.names, self.weights)
            header, model = replace(header, weights=weights), with_weights(model, weights)
        model_bytes = len(header.pack())
        encoders = chunk.encoders(model, source, bounds, choice.spectra)
        with progress.phase(CHOICE_SHARE, 1.0):
            payloads = self._to_target(encoders, motion, model_bytes, plan)
        engines = [Payload.unpack(p).engine for p in payloads]
        failures = [e.failure for e, n in zip(encoders, engines, strict=True) if e.failure is not None and n == DIRECT]
        if plan is not None and LATTICE in engines:
            header = replace(header, neighbours=plan.neighbours.pack())
        if TRANSFORM not in engines:
            header = StreamHeader(weights=header.weights, neighbours=header.neighbours)
        encoded = Encoded(
            self.name,
            about(motion),
            [Chunk(a, b - a, p) for (a, b), p in zip(bounds, payloads, strict=True)],
            shared=(header.pack(),),
            settings=self._stored_settings(),
        )
        sample = fallback.Sample.of(encoders, choice.header.model in WITH_STORED_BASIS)
        if not failures:
            return _Coded(encoded, sample)
        reason = rescue.in_words("with tempo's models", failures[0])
        noted = rescue.with_note(encoded, f"{reason}; {len(failures)} of {len(payloads)} chunks are coded directly")
        return _Coded(noted, sample)

    @staticmethod
    def decode(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
        """The motion, or a slice of its frames; also of a motion that `encode` coded losslessly. Raises Corrupt."""
        if encoded.codec == Lossless.name:
            return Lossless.decode(encoded, frames)
        if not encoded.shared:
            return decode_gaps(encoded, frames)
        if layer.has_rotations(encoded):
            return layer.decode(encoded, frames, Tempo.decode)
        header = StreamHeader.unpack(encoded.shared, encoded.about.points)
        if header.millihertz is not None:
            return repeats.decode(encoded, header, frames, Tempo.decode)
        if header.fallback is not None:
            return fallback.decode(encoded, header, frames)
        like = encoded.about
        model = header.read_model(like)
        start, stop = encoded.range(frames)
        positions = np.empty((stop - start, like.points, 3))
        are_finite = chunk_decoding.decode_into(model, encoded.covering(start, stop), positions, start, like.up)
        return restore(encoded, positions, start, are_valid=are_finite)

    def first_step(self, motion: Motion) -> int:
        """About the step that the target needs, log₂ in 1/32 octave."""
        bound = None if self._has_size or self.mean_error else self.max_error or DEFAULT_MAX_ERROR
        return target.first_step(bound, self.mean_error, self.size, self.ratio, motion.raw_bytes)

    @property
    def _frozen_tolerance(self) -> float | None:
        """Metres by which a frozen position may be rounded; None for the usual share of it."""
        error = None if self._has_size else self.mean_error or self.max_error or DEFAULT_MAX_ERROR
        return error and FROZEN_SHARE * error / max((self.weights or {}).values(), default=1.0)

    @property
    def _has_size(self) -> bool:
        return self.ratio is not None or self.size is not None

    def _wanted_bytes(self, motion: Motion) -> int:
        """The bytes that `size` or `ratio` asks for."""
        return self.size or int(motion.raw_bytes / (self.ratio or 1))

    def _encode_distinct(self, motion: Motion, distinct: Booleans) -> tuple[Encoded[Motion], float | None]:
        """With the mean error, metres, where that is the target."""
        mean = None
        if self.mean_error is not None:

            def encode(mean_error: float, part: Motion) -> Encoded[Motion]:
                return replace(self, mean_error=mean_error).encode_without_repeats(part)

            encoded, mean = repeats.encode_to_mean(motion, distinct, self.mean_error, encode, decoded_mean_error)
        elif self._has_size:
            size = max(1, self._wanted_bytes(motion) - repeats.bytes_of_runs(motion, self.chunk_seconds))
            encoded = repeats.encode(motion, distinct, replace(self, ratio=None, size=size).encode_without_repeats)
        else:
            encoded = repeats.encode(motion, distinct, self.encode_without_repeats)
        return replace(encoded, settings=self._stored_settings()), mean

    def _meets_target(self, encoded: Encoded[Motion], motion: Motion, mean: float | None = None) -> bool:
        """Whether an encoding by other means has the mean error, or the size, that was asked for.

        mean: its mean error, metres, where it is known.
        """
        if self.mean_error is not None:
            mean = decoded_mean_error(encoded, motion) if mean is None else mean
            return MEAN_SHARE <= mean / self.mean_error <= 1
        return not self._has_size or encoded.payload_bytes <= self._wanted_bytes(motion)

    def _choose_model(self, motion: Motion, chunks: list[Floats], kinds: Kinds | None) -> model_choice.Choice:
        recording = Recording(chunks, motion, self.first_step(motion))
        if self._has_size:
            return model_choice.choose_for_size(recording, self.model, self._wanted_bytes(motion))
        return model_choice.choose(recording, self.model, self.mean_error, kinds)

    def _lattice_plan(self, motion: Motion, source: Prepared, kinds: Kinds | None) -> LatticePlan | None:
        """How the lattice engine is used; None where it is not: without a hard bound, or for other models."""
        asked = self.model == LATTICE_MODEL
        if self._has_size or self.mean_error is not None or not (asked or self.model == model_choice.AUTO):
            return None
        if kinds is not None and LATTICE_MODEL not in kinds:
            return None
        if not (asked or lattice.is_fast()):
            return None
        weights = None
        if self.weights:
            without_rows = Model.without_rows(motion.names, motion.rate)
            weights = with_weights(without_rows, pack_weights(motion.names, self.weights)).weights
        alone = asked or (kinds is not None and not kinds & MODELS.keys())
        step, named = self.first_step(motion), model_choice.known_by_name(Recording([], motion, 0))
        return engine_choice.plan(motion, source, self.max_error or DEFAULT_MAX_ERROR, step, weights, named, alone)

    def _seconds(self, motion: Motion, times: float = 1.0) -> float:
        """Length of chunks: times longer than asked for, LEAST_CHUNK_FRAMES or more, within the limit of the format."""
        asked = max(min(times * self.chunk_seconds, MOST_CHUNK_SECONDS), fallback.LEAST_CHUNK_FRAMES / motion.rate)
        return min(asked, most_chunk_frames(motion.points) / 2 / motion.rate)

    def _to_target(
        self, encoders: list[ChunkEncoder], motion: Motion, header_bytes: int, plan: LatticePlan | None
    ) -> list[bytes]:
        for encoder in encoders:
            encoder.refill_gaps(self.first_step(motion))
        if self.mean_error is not None:
            return to_mean(encoders, self.mean_error)
        if self._has_size:
            return target.to_size(encoders, self._wanted_bytes(motion) - header_bytes)
        return hard_bound.to_bound(encoders, self.max_error or DEFAULT_MAX_ERROR, plan, header_bytes)

    def _stored_settings(self) -> dict[str, Any]:
        """The settings for the file."""
        stored = settings(self)
        if not stored.keys() & {"mean_error", "ratio", "size"}:
            stored["max_error"] = self.max_error or DEFAULT_MAX_ERROR
        return stored


def decoded_mean_error(encoded: Encoded[Motion], motion: Motion) -> float:
    """Mean distance, metres, between a motion and what a stream of it decodes to."""
    return metrics.mean_distance(motion.positions, Tempo.decode(encoded).positions)
