"""Which engine codes the chunks of a recording within a hard bound: transform, lattice, or each where it is smaller.

    a short sample ─lattice, some strides─► bytes ──┐
    the same ─transform with a basis of its own─────┴─► lattice alone · both · transform alone

The sample decides before a model is fitted, since fitting takes longest where the transform is not used.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ...encoded import Encoded
from ...errors import Corrupt
from ...motion import Motion
from ...stages import lattice
from ...typing import Floats
from .chunk import LATTICE, ChunkEncoder, Payload, grid_size, grid_step
from .coding.contexts import OCTAVE
from .models import Recording, directions, points
from .models.model import Model
from .models.stored_basis import MOST_DIMENSIONS
from .preparation import Prepared

SAMPLED = 30_000
"""Number of samples that are coded on trial; the limits below are in frames."""
FEWEST_FRAMES, MOST_FRAMES = 64, 240
ALONE, ALONE_PER_OCTAVE = 0.9, 0.06
"""The lattice is used alone where it takes less than this share of a transform fitted to the sample. The share rises
with log₂ of frames over frames sampled, since a short sample is less varied than the recording."""
SAMPLE_OFFSET = 28
"""The step of the transform that these shares refer to, in 1/32 octaves above the bound."""
CERTAIN = 0.68
"""Below this share, which rises likewise, the lattice is so much smaller that hou2014 is not tried either."""
MANY_POINTS = 256
"""With more points, hou2014 is not tried where the lattice is used alone: its basis takes seconds to fit. It is used
alone only where it is smaller in the sample, whose few frames say little about the recording."""
WIDER = 2 * OCTAVE
"""How much wider the step is in which points of constant distance may be joints, since rounding moves joints."""
LEAST_SAVING = 0.05
"""The lattice codes a chunk, or all chunks at a mean error, where it saves at least this share of the bytes, since
the transform decodes some four times faster."""
HOPELESS = 1.25
"""The lattice engine is not tried where it took more than this many times the bytes in the last chunks tried."""
TRIED_EVERY = 5
"""The lattice engine is tried for one chunk in this many at least."""
FEWEST_TRIED, MEMORY = 2, 0.5
"""Both are tried for FEWEST_TRIED chunks first, since one may be still. MEMORY is the weight of a chunk in the next."""
REMEMBERED, FEWEST_FAILED, USEFUL_SAVING = 32, 4, 0.03
"""Number of trials of the lattice engine that are remembered from block to block. A trial that saves less than
USEFUL_SAVING fails. Another one is ruled out if FEWEST_FAILED at lower estimates failed, and all at higher ones."""
LEAST_BITS = 0.38
"""Bits of a coordinate of a body: joints and known points move smoothly, so that the lattice is smaller only where the
transform takes at least as many bits for a chunk."""

UNLIKELY, UNLIKELY_OF_POINTS = 1.05, 2.5
"""Largest ratio of the estimated bytes of the lattice engine to those of the transform at which the engine is tried.
That of joints hardly ever exceeds the bytes by more than a tenth; that of points that move alike, by up to twice."""


@dataclass(frozen=True, eq=False)
class LatticePlan:
    """How the lattice engine is used. alone: no chunk needs a model; certain: nor is hou2014 tried.

    choose: the neighbours of the points and the stride (`lattice.encode`), found by the first call.
    least_bits: of a coordinate; the engine is not tried for chunks that take the transform less. rivals: it is tried
    for the whole recording beside a model too.
    """

    choose: Callable[[], tuple[lattice.Neighbours, int]]
    alone: bool = False
    certain: bool = False
    least_bits: float = 0.0
    rivals: bool = False

    @property
    def neighbours(self) -> lattice.Neighbours:
        return self.choose()[0]

    @property
    def stride(self) -> int:
        return self.choose()[1]

    @property
    def unlikely(self) -> float:
        """Largest ratio of the estimate to the bytes of the transform at which the engine is tried."""
        return UNLIKELY if self.least_bits else UNLIKELY_OF_POINTS


def plan(
    motion: Motion, source: Prepared, bound: float, step: int, weights: Floats | None, named: bool, alone: bool = False
) -> LatticePlan:
    """How to use the lattice engine within a bound (metres).

    step: of the transform, log₂ in 1/32 octave; named: the prior knows the points, so that its models are cheap to fit.
    alone: no other engine is asked for.
    The sample does not decide for these, nor for points that may be joints of a body: models of directions, or the
    prior's, may be far smaller than the sample's basis.
    """
    frames = int(np.clip(SAMPLED // max(1, motion.points), FEWEST_FRAMES, MOST_FRAMES))
    first = max(0, (len(motion) - frames) // 2)
    some = slice(first, min(len(motion), first + frames))

    def sampled_on_lattice(most_bytes: float = np.inf) -> tuple[lattice.Neighbours, int, int]:
        found = lattice.neighbours(source.smooth)
        positions = source.smooth[some] if weights is None else source.smooth[some] * weights[:, None]
        size = grid_size(grid_step(lattice.half_step(bound)))
        return found, *lattice.best_stride(positions / size, source.apart.apart[some], found, most_bytes)

    @cache
    def chosen() -> tuple[lattice.Neighbours, int]:
        return sampled_on_lattice()[:2]

    if alone:
        return LatticePlan(chosen, alone=True)
    if named or weights is not None or motion.skeleton is not None:
        return LatticePlan(chosen, least_bits=LEAST_BITS if weights is None else 0.0)
    if directions.form_a_tree(source.smooth[some], step + WIDER):
        return LatticePlan(chosen, least_bits=LEAST_BITS, rivals=True)
    transform = _transform_bytes(motion, source, some, bound, step)
    sampled = some.stop - some.start
    rise = ALONE_PER_OCTAVE * np.log2(len(motion) / sampled)
    limit = ALONE + rise if motion.points <= MANY_POINTS else min(ALONE + rise, 1.0)
    found, stride, cost = sampled_on_lattice(limit * transform)
    alone = bool(cost < limit * transform)
    certain = sampled >= FEWEST_FRAMES and bool(cost < (CERTAIN + rise) * transform)
    certain = certain or (alone and motion.points > MANY_POINTS)
    return LatticePlan(lambda: (found, stride), alone, certain)


def _transform_bytes(motion: Motion, source: Prepared, some: slice, bound: float, step: int) -> float:
    """Bytes of some frames by a transform with their own basis, counted in proportion to the frames; infinite for
    more points than a stored basis has."""
    if 3 * motion.points > MOST_DIMENSIONS:
        return np.inf
    sample = Recording([source.smooth[some]], replace(motion, positions=motion.positions[:0], rotations=None), step)
    if sample.frames < 2:
        return 0.0
    try:
        fitted = points.stored_points(sample, step)
        model = fitted.model(sample.like)
    except Corrupt:  # numbers that a decoder would refuse
        return np.inf
    draft = ChunkEncoder.of(model, source, some).within_bound(bound, SAMPLE_OFFSET)
    return draft.bits / 8 + len(fitted.pack()) * sample.frames / len(motion)


def may_be_smaller_alone(
    plan: LatticePlan, encoded: Encoded[Motion], source: Prepared, bounds: Sequence[tuple[int, int]], bound: float
) -> bool:
    """Whether the lattice engine alone, without a model, may be smaller than an encoding in which chunks may use it.

    bounds: start and stop of its chunks, which are longer; of bodies that are not known by name, one is coded on trial.
    """
    if {Payload.unpack(c.payload).engine for c in encoded.chunks} == {LATTICE}:
        return len(encoded.chunks) > 1
    if not plan.rivals or 8 * encoded.payload_bytes < plan.least_bits * source.positions.size:
        return False
    start, stop = bounds[len(bounds) // 2]
    like = encoded.about
    encoder = ChunkEncoder.of(Model.without_rows(like.names, like.rate), source, slice(start, stop))
    most_bytes = (1 - LEAST_SAVING) * (stop - start) / len(source.positions) * encoded.payload_bytes
    found = encoder.on_lattice(bound, plan.neighbours, plan.stride, most_bytes)
    return found is not None and found.bytes < most_bytes


class EngineTrials:
    """Whether the lattice engine is tried for the next chunk, from what both engines took in the chunks before."""

    def __init__(self) -> None:
        self._chunks, self._transform_bytes, self._lattice_bytes = 0, 0.0, 0.0
        """Number of chunks for which both were tried, and fading sums of their bytes."""

    def tries_lattice(self, number: int) -> bool:
        """For chunk `number`."""
        every = number % TRIED_EVERY == 0 or self._chunks < FEWEST_TRIED
        return every or self._lattice_bytes < HOPELESS * self._transform_bytes

    def learn(self, transform_bytes: float, lattice_bytes: float) -> None:
        """What both took in a chunk."""
        self._chunks += 1
        self._transform_bytes = MEMORY * self._transform_bytes + transform_bytes
        self._lattice_bytes = MEMORY * self._lattice_bytes + lattice_bytes


class Outcomes:
    """Trials of the lattice engine in the blocks of a recording: whether another one is likely to be as useless.

    The bytes of the engine over its estimate differ between recordings and bounds, by half or more, but not between
    chunks of one recording that have about the same estimate.
    """

    def __init__(self) -> None:
        self._tried = deque[tuple[float, bool]](maxlen=REMEMBERED)
        """For each trial the estimate over the transform's bytes, and whether it failed."""
        self._ruled_out = 0

    def rule_out(self, estimate: float) -> bool:
        """Whether the next chunk is not tried. estimate: over the transform's bytes.

        One in TRIED_EVERY of the chunks that are ruled out is tried nevertheless, since the motion may have changed.
        """
        lower = sum(failed for tried, failed in self._tried if tried <= estimate)
        if lower < FEWEST_FAILED or not all(failed for tried, failed in self._tried if tried >= estimate):
            return False
        self._ruled_out += 1
        return self._ruled_out % TRIED_EVERY != 0

    def learn(self, estimate: float, lattice: float) -> None:
        """The outcome of a trial: estimate and bytes of the engine over the transform's bytes."""
        self._tried.append((estimate, lattice > 1 - USEFUL_SAVING))
