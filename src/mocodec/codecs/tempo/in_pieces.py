"""A recording that does not fit into memory: coded block by block, with the model of a sample.

    sample ─► model, neighbours of the lattice engine, first step ─► shared bytes
    frames ─blocks of BLOCK_CHUNKS chunks─► prepare ─► chunk encoders ─► payloads that keep the target so far

`codec` does the same with the whole recording at once. Left out here: frames that repeat are coded like others, and
hou2014 is not tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...encoded import Chunk, about, most_chunk_frames
from ...errors import BadInput, Corrupt
from ...motion import Motion
from ...stages import lattice
from ...typing import Floats
from ..base import has_samples, require_usual_lengths, require_usual_rate, settings
from . import chunk, chunk_decoding, engine_choice, fallback, hard_bound, model_choice, steady, target
from .chunk import ChunkEncoder
from .codec import DEFAULT_MAX_ERROR, FALLBACK_MODEL, FROZEN_SHARE, LATTICE_CHUNKS, MOST_CHUNK_SECONDS, Tempo
from .engine_choice import LatticePlan
from .header import StreamHeader
from .models import Recording
from .pose import heading
from .preparation import Prepared, chunk_bounds, prepare
from .rotation_layer import payload
from .rotation_layer.encoder import BOUND_SHARE
from .rotation_layer.layer import unit_rotations
from .rotation_layer.streaming import StreamEncoder

BLOCK_CHUNKS = 16
"""Chunks that are coded together: enough to be fast, few enough to need little memory."""


class Piece(NamedTuple):
    """A run of frames, and the chunks that code it."""

    motion: Motion
    chunks: list[Chunk]


class PieceEncoder:
    """Codes a recording from front to back. `shared`, `about` and `settings` are those of its Encoded.

    sample: some frames of the recording, which need not follow each other; the model is fitted to them. cuts: frames of
    the sample, rising, at which other parts of the recording begin. frames: how many the recording has, if known; only
    `ratio` and `size` need it. Raises BadInput for settings that need the whole recording at once.
    """

    def __init__(self, codec: Tempo, sample: Motion, cuts: Sequence[int] = (), frames: int | None = None) -> None:
        _require_possible(codec, sample, frames)
        self.settings = settings(codec)
        if codec.mean_error is None and codec.ratio is None and codec.size is None:
            self.settings["max_error"] = codec.max_error or DEFAULT_MAX_ERROR
        self._codec, self._frames = codec, frames
        bound: float | None = self.settings.get("max_error")
        self._rotations = None
        if sample.rotations is not None and bound is not None:
            self._rotations = StreamEncoder(sample, bound, codec.shell)
            bound *= BOUND_SHARE
        self._bound = bound
        self.about = about(sample, has_rotations=self._rotations is not None)
        self._plan, self._steady = None, None
        self._earlier = hard_bound.Earlier()
        self._fit(replace(sample, rotations=None), list(cuts))
        self._waiting: list[Motion] = []
        self._start = 0

    def _fit(self, sample: Motion, cuts: list[int]) -> None:
        """The model, header and chunk length, by the sample."""
        codec = self._codec
        raw_bytes = (self._frames or len(sample)) * sample.points * 12
        step = target.first_step(self._bound, codec.mean_error, codec.size, codec.ratio, raw_bytes)
        if has_samples(sample):
            source = self._prepare(sample)
            self._plan = self._lattice_plan(sample, source, step)
            self._chunk_seconds = _chunk_seconds(codec, sample, self._plan)
            found = sorted({*cuts, *source.discontinuities(sample.rate)})
            bounds = chunk_bounds(len(sample), sample.rate, self._chunk_seconds, found)
            if self._plan is not None and self._plan.alone:
                choice = model_choice.without_model(sample)
            else:
                chunks = [source.smooth[a:b] for a, b in bounds]
                choice = model_choice.choose(Recording(chunks, sample, step), codec.model, codec.mean_error)
        else:
            source, bounds = None, []
            self._chunk_seconds = _chunk_seconds(codec, sample, None)
            choice = model_choice.without_model(sample)
        if not _is_readable(choice.header, sample[:0]):
            choice = model_choice.without_model(sample)
        header = choice.header
        if self._plan is not None:
            header = replace(header, neighbours=self._plan.neighbours.pack())
        self._model = header.read_model(self.about)  # the decoder's own, which keeps what chunks of a length share
        self.shared: tuple[bytes, ...] = (header.pack(),)
        self.shared += () if self._rotations is None else (self._rotations.shared,)
        self.chunk_frames = max(1, round(self._chunk_seconds * sample.rate))
        if self._bound is None:
            every = max(1, len(bounds) // BLOCK_CHUNKS)
            self._sampled = [ChunkEncoder.of(self._model, source, slice(*b)) for b in bounds[::every] if source]
            if codec.mean_error is not None:
                self._steady = steady.for_mean(self._sampled, codec.mean_error)
                self._sampled = []

    def limit(self, bytes_a_frame: float) -> None:
        """Under `ratio` or `size`: what payloads may take. Before the first frames. Raises CannotEncode."""
        self._steady = steady.for_size(self._sampled, bytes_a_frame)
        self._sampled = []

    def push(self, motion: Motion) -> list[Piece]:
        """The next frames of the recording; what they complete. Raises BadInput, CannotEncode."""
        if self._rotations is not None and (motion.rotations is None or motion.gaps.any()):
            what = "gaps" if motion.rotations is not None else "no rotations"
            raise BadInput(
                f"rotations are coded only of frames without gaps, and frames from {self._start + self._waits} on have "
                f"{what}; leave the rotations out"
            )
        self._waiting.append(motion)
        block = BLOCK_CHUNKS * self.chunk_frames
        pieces: list[Piece] = []
        while self._waits >= 2 * block:
            pieces.append(self._coded(self._take(block)))
        return pieces

    def finish(self) -> list[Piece]:
        """The last frames."""
        return [self._coded(self._take(self._waits))] if self._waits else []

    @property
    def _waits(self) -> int:
        return sum(map(len, self._waiting))

    def _take(self, frames: int) -> Motion:
        """The next frames of those that wait."""
        taken: list[Motion] = []
        while frames:
            first = self._waiting.pop(0)
            if len(first) > frames:
                self._waiting.insert(0, first[frames:])
                first = first[:frames]
            taken.append(first)
            frames -= len(first)
        return joined(taken)

    def _coded(self, motion: Motion) -> Piece:
        source = self._prepare(motion)
        cuts = source.discontinuities(motion.rate)
        bounds = chunk_bounds(len(motion), motion.rate, self._chunk_seconds, cuts)
        encoders = chunk.encoders(self._model, source, bounds)
        payloads = self._payloads(encoders)
        chunks = [Chunk(self._start + a, b - a, p) for (a, b), p in zip(bounds, payloads, strict=True)]
        if self._rotations is not None:
            chunks = self._with_rotations(self._rotations, motion, chunks)
        self._start += len(motion)
        return Piece(motion, chunks)

    def _payloads(self, encoders: list[ChunkEncoder]) -> list[bytes]:
        if self._steady is None:
            assert self._bound is not None
            step = target.step_for_bound(self._bound)
            for encoder in encoders:
                encoder.refill_gaps(step)
            return hard_bound.to_bound(encoders, self._bound, self._plan, earlier=self._earlier)
        for encoder in encoders:
            encoder.refill_gaps(self._steady.step)
        return self._steady.payloads(encoders)

    def _with_rotations(self, layer: StreamEncoder, motion: Motion, chunks: list[Chunk]) -> list[Chunk]:
        assert motion.rotations is not None
        turned = unit_rotations(motion.rotations, motion.names)
        coded: list[Chunk] = []
        for c, decoded in zip(chunks, chunk_decoding.decode(self._model, chunks), strict=True):
            here = slice(c.start - self._start, c.stop - self._start)
            part = layer.part(motion.positions[here], turned[here], heading.from_y_up(decoded, motion.up))
            coded.append(Chunk(c.start, c.frames, payload.join(part, c.payload)))
        return coded

    def _prepare(self, motion: Motion) -> Prepared:
        error = self._codec.mean_error or self._bound
        tolerance = error and FROZEN_SHARE * error
        bones, holds = motion.skeleton is not None, self._codec.mean_error is None
        source = prepare(motion.positions, motion.up, tolerance, bones, holds)
        if has_samples(motion):
            require_usual_lengths(self._codec, source.positions)
            require_usual_rate(self._codec, motion.rate)
        return source

    def _lattice_plan(self, sample: Motion, source: Prepared, step: int) -> LatticePlan | None:
        """As the codec's own plan, by the sample."""
        asked = self._codec.model == "lattice"
        if self._bound is None or not (asked or (self._codec.model == "auto" and lattice.is_fast())):
            return None
        if self._rotations is not None and not asked:
            return None  # errors of a lattice are uniform up to a bound: rotations would break theirs too often
        named = model_choice.known_by_name(Recording([], sample, 0))
        return engine_choice.plan(sample, source, self._bound, step, None, named, asked)


def joined(motions: Sequence[Motion]) -> Motion:
    """Parts of a motion, one after the other, as one motion."""
    if len(motions) == 1:
        return motions[0]
    turned = [m.rotations for m in motions if m.rotations is not None]
    rotations: Floats | None = np.concatenate(turned) if len(turned) == len(motions) else None
    return replace(motions[0], positions=np.concatenate([m.positions for m in motions]), rotations=rotations)


def _is_readable(header: StreamHeader, like: Motion) -> bool:
    """Whether readers take the model: under a tiny bound its integers exceed what a header may have."""
    try:
        header.read_model(like)
    except Corrupt:
        return False
    return True


def _chunk_seconds(codec: Tempo, motion: Motion, plan: LatticePlan | None) -> float:
    """Length of chunks."""
    times = LATTICE_CHUNKS if plan is not None and plan.alone else 1.0
    asked = max(min(times * codec.chunk_seconds, MOST_CHUNK_SECONDS), fallback.LEAST_CHUNK_FRAMES / motion.rate)
    return min(asked, most_chunk_frames(motion.points) / 2 / motion.rate)


def _require_possible(codec: Tempo, sample: Motion, frames: int | None) -> None:
    """Raises BadInput for settings that need the whole recording at once."""
    has_size = codec.ratio is not None or codec.size is not None
    if has_size and not frames:
        raise BadInput("a ratio or size needs the number of frames of the recording: frames=")
    if codec.weights or codec.max_rotation is not None or codec.model == FALLBACK_MODEL:
        raise BadInput("weights, max_rotation and the model 'hou2014' need the whole recording at once: use encode")
    if sample.rotations is not None and (has_size or codec.mean_error is not None):
        raise BadInput("in pieces, rotations are kept under max_error only: leave them out, or use encode")
