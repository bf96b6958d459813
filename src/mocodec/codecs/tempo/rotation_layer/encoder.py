"""Coding a motion with rotations to a target: steps of positions and side values, and corrections.

mean_error      positions at a share of it, then the coarsest side values that keep the mean of joints and shell points;
                corrections where one of them is farther off than WORST times the mean
max_error       positions at a share of it, then side values per chunk; corrections, finer steps or direct coding for
                what is beyond the bound
ratio, size     positions in a share of the bytes, then the finest side values that fit
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .... import progress
from ....encoded import Chunk, Encoded, about
from ....errors import CannotEncode
from ....motion import Motion
from ....stages import search
from ....typing import Floats
from ..chunk import BOUND_SLOPE, grid_step
from ..coding.contexts import OCTAVE
from ..models import prior
from . import choose, layer, payload, record, shell, side
from .chunk_layer import GRIDS, ChunkLayer, Draft, Original, Promise
from .payload import Layer

MEAN_SHARE, BOUND_SHARE, SIZE_SHARE = 0.94, 0.66, 0.9
"""Shares of the allowed mean error, bound and bytes that the inner stream gets at first."""
FLOOR = 0.985
"""With exact side values, at most this share of the mean error may be used up by positions."""
INNER_TRIES = 5
WORTH_SHARING, LESS = 0.2, 0.85
"""Where rotations take a larger part of positions' bytes than WORTH_SHARING, positions get LESS of the error too."""
SEARCHED_FRAMES, FULL_TRIES = 1000, 4
"""The search for a step measures about 1,000 frames, and again where all frames have another mean."""
NEAR, ALIKE = 0.99, 0.003
"""A mean error from this share of the target on ends the search for a step; a difference of means that counts."""
MEAN_STEP, BOUND_STEP, RATIO_STEP = 6.0, 2.0, 2e-4
"""The first step of side values: times the mean error, times the bound, and times the ratio in metres."""
COARSEST, FINEST = 8 * OCTAVE, -40 * OCTAVE
WORST = 12.0
"""Under a mean error, largest ratio of the error of a joint or shell point to the mean."""


class Encoder:
    """Codes a motion with rotations, given a function that codes positions to a target of their own."""

    def __init__(self, motion: Motion, reach_m: float, promise: Promise) -> None:
        assert motion.skeleton is not None
        assert motion.rotations is not None
        self.motion, self.promise, self.reach_m = motion, promise, reach_m
        local = layer.unit_rotations(motion.rotations, motion.names)
        skeleton = record.rounded(motion.skeleton)
        own_frame = motion.source.get("format") == "amc"
        self.rules = choose.choose(skeleton, own_frame, motion.positions, local)
        self.values = choose.side_values(self.rules, motion.positions, local)
        self.original = Original(motion.positions, local, shell.world_rotations(skeleton, local))
        self.factor = side.coordinates(self.rules, reach_m)

    def to_mean(self, target: float, inner: Callable[[float], Encoded[Motion]], decode: Decode) -> Encoded[Motion]:
        """inner(mean error) codes the positions."""
        share, best = MEAN_SHARE, None
        encoded, coded = None, None
        for attempt in range(INNER_TRIES):
            with progress.attempt(attempt):
                encoded = inner(share * target)
            coded = self._chunks(encoded, decode, MEAN_STEP * target)
            floor = self._mean(coded, [c.exact() for c in coded.chunks]) / target
            if floor > FLOOR or (not self.rules.side_values and floor < NEAR):
                share *= 0.995 * FLOOR / floor
                continue
            drafts = self._step_for_mean(coded, target)
            if drafts is not None:
                made = self._capped(encoded, coded, drafts, target)
                if best is not None and made.payload_bytes >= best.payload_bytes:
                    return best
                best = made
                if made.payload_bytes < (1 + WORTH_SHARING) * encoded.payload_bytes:
                    return best
            share *= LESS
        if best is not None:
            return best
        assert encoded is not None
        assert coded is not None
        return self._directly_to_mean(encoded, coded, target)

    def _step_for_mean(self, coded: Coded, target: float) -> list[Draft] | None:
        """Drafts in the coarsest step that keeps the mean error: searched for among some of the frames, whose mean is
        then scaled to that of all frames."""
        if not self.rules.side_values:
            return [c.exact() for c in coded.chunks]
        every = max(1, len(self.motion) // SEARCHED_FRAMES)
        sampled: dict[int, float] = {}
        scale, step, best = 1.0, coded.step, None

        def measure(step: float) -> tuple[float, None]:
            if (step := int(step)) not in sampled:
                sampled[step] = self._mean(coded, [c.draft(step) for c in coded.chunks], every) / target
            return scale * sampled[step], None

        for _ in range(FULL_TRIES):
            found = search.closest_within(
                measure, step, rising=True, stride=_stride, farthest=12 * OCTAVE, near=NEAR, tries=9
            )
            if found is None:
                break
            step = int(found.setting)
            drafts = [c.draft(step) for c in coded.chunks]
            mean = found.value if every == 1 else self._mean(coded, drafts) / target
            best = drafts if mean <= 1 else best
            if mean <= 1 and (every == 1 or mean >= NEAR or mean > found.value - ALIKE):
                break
            scale *= mean / found.value
        return best

    def to_bound(self, inner: Callable[[float], Encoded[Motion]], decode: Decode) -> Encoded[Motion]:
        """inner(max error) codes the positions."""
        bound = self.promise.max_error
        assert bound is not None
        encoded = inner(BOUND_SHARE * bound)
        coded = self._chunks(encoded, decode, BOUND_STEP * bound)
        return self._finished(encoded, coded, [c.draft(coded.step, BOUND_SLOPE) for c in coded.chunks])

    def to_size(self, size: int, inner: Callable[[int], Encoded[Motion]], decode: Decode) -> Encoded[Motion]:
        """inner(bytes) codes the positions. Raises CannotEncode."""
        share = SIZE_SHARE
        for attempt in range(INNER_TRIES):
            with progress.attempt(attempt):
                encoded = inner(max(1, int(share * size)))
            coded = self._chunks(encoded, decode, RATIO_STEP * self.motion.raw_bytes / size)
            found: dict[int, Encoded[Motion]] = {}

            def fits(coarseness: int, encoded: Encoded[Motion] = encoded, coded: Coded = coded,
                     found: dict[int, Encoded[Motion]] = found) -> bool:  # fmt: skip
                drafts = [c.draft(-coarseness) for c in coded.chunks]
                made = self._finished(encoded, coded, drafts)
                if made.payload_bytes <= size:
                    found.clear()
                    found[-coarseness] = made
                    return True
                return False

            step = search.largest_true(fits, -coded.step, -COARSEST, -FINEST, stride=16)
            if step is not None:
                return found[-step]
            share *= 0.75
        raise CannotEncode(f"even the coarsest rotations take more than {size} bytes")

    def _chunks(self, encoded: Encoded[Motion], decode: Decode, step_m: float) -> Coded:
        """The chunks of an inner stream, with side values in about this step, metres."""
        decoded = decode(encoded).positions
        step = round(np.log2(step_m) * OCTAVE)
        bounds = [(c.start, c.stop) for c in encoded.chunks]
        values = [choose.chunk_values(self.rules, self.values[a:b]) for a, b in bounds]
        of, shared = self.fitted(values, step)
        made = [
            ChunkLayer(of, self.original.between(a, b), v, decoded[a:b])
            for (a, b), v in zip(bounds, values, strict=True)
        ]
        return Coded(of, shared, step, made)

    def fitted(self, values: Sequence[Floats], step: int) -> tuple[Layer, bytes]:
        """The layer for chunks of side values (frames, n) in about this step, and its shared bytes."""
        known, rate = prior.for_points(), self.motion.rate
        stored = side.fit(values, self.factor, known, rate, step) if self.rules.side_values else None
        shared = record.pack(self.rules, self.reach_m, record.pack_statistics(stored, known))
        return Layer(self.rules, self.reach_m, side.SideModel.of(stored, known, self.rules, self.factor, rate)), shared

    def _mean(self, coded: Coded, drafts: Sequence[Draft], every: int = 1) -> float:
        """Mean distance of joints and shell points, or of joints alone if that is larger, metres, over every
        `every`-th frame."""
        sampled = [c.sampled_errors(d, every) for c, d in zip(coded.chunks, drafts, strict=True)]
        joints, count = sum(float(e.joints.sum()) for e in sampled), sum(e.joints.size for e in sampled)
        return max(sum(e.total for e in sampled) / 4, joints) / count

    def _finished(self, encoded: Encoded[Motion], coded: Coded, drafts: Sequence[Draft]) -> Encoded[Motion]:
        """The stream of drafts, with chunks mended that break a promise."""
        parts = payload.pack_transforms(coded.layer, [(d.numbers, d.grid) for d in drafts])
        if self.promise.is_hard:
            for i, (chunk, draft) in enumerate(zip(coded.chunks, drafts, strict=True)):
                if chunk.broken(*chunk.solved(draft), self.promise).any():
                    step = coded.step if draft.numbers is None else draft.numbers.step
                    parts[i] = chunk.mended(step, self.promise)
        return _joined(self.motion, encoded, coded, parts)

    def _capped(
        self, encoded: Encoded[Motion], coded: Coded, drafts: Sequence[Draft], target: float
    ) -> Encoded[Motion]:
        """The stream of drafts that have a mean error, with chunks mended where single samples are far off."""
        promise = self.promise._replace(max_error=WORST * target)
        parts = payload.pack_transforms(coded.layer, [(d.numbers, d.grid) for d in drafts])
        for i, (chunk, draft) in enumerate(zip(coded.chunks, drafts, strict=True)):
            if chunk.broken(*chunk.solved(draft), promise).any():
                parts[i] = chunk.capped(draft, promise)
        return _joined(self.motion, encoded, coded, parts)

    def _directly_to_mean(self, encoded: Encoded[Motion], coded: Coded, target: float) -> Encoded[Motion]:
        """Every rotation on a grid, so fine that the mean error is kept. Raises CannotEncode."""
        for finer in range(GRIDS):
            grid = grid_step(target / 2.0 ** (finer / 2))
            parts = [
                payload.pack_direct(coded.layer, c.original.local, c.original.positions, grid) for c in coded.chunks
            ]
            decoded = [
                payload.unpack_direct(coded.layer, Chunk(0, c.frames, p))
                for c, p in zip(coded.chunks, parts, strict=True)
            ]
            total = sum(c.errors(*d).total for c, d in zip(coded.chunks, decoded, strict=True))
            promise = self.promise._replace(max_error=WORST * target)
            broken = any(c.broken(*d, promise).any() for c, d in zip(coded.chunks, decoded, strict=True))
            if total <= target * 4 * self.motion.positions[..., 0].size and not broken:
                return _joined(self.motion, encoded, coded, parts)
        raise CannotEncode("the positions of this motion do not follow from its skeleton and rotations so exactly")


def _stride(logarithm: float) -> int:
    """How many 1/32 octaves of the step change the mean error by this logarithm, or more."""
    return max(24, round(64 * abs(logarithm)))


Decode = Callable[[Encoded[Motion]], Motion]


class Coded(NamedTuple):
    """An inner stream's chunks with what they share; shared: the layer's bytes; step: of side values, at first."""

    layer: Layer
    shared: bytes
    step: int
    chunks: list[ChunkLayer]


def _joined(motion: Motion, encoded: Encoded[Motion], coded: Coded, parts: Sequence[bytes]) -> Encoded[Motion]:
    """The inner stream with the layer's parts in front of its payloads."""
    chunks = [
        Chunk(c.start, c.frames, payload.join(part, c.payload)) for c, part in zip(encoded.chunks, parts, strict=True)
    ]
    return replace(
        encoded, about=about(motion, has_rotations=True), chunks=chunks, shared=(*encoded.shared, coded.shared)
    )
