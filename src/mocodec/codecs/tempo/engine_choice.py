"""Which engine codes the chunks of a recording within a hard bound: transform, lattice, or each where it is smaller.

    a short sample ─lattice, some strides─► bytes ──┐
    the same ─transform with a basis of its own─────┴─► lattice alone · both · transform alone

The sample decides before a model is fitted, since fitting takes longest where the transform is not used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import Corrupt
from ...motion import Motion
from ...stages import lattice
from ...typing import Floats
from .chunk import FIRST_OFFSET, ChunkEncoder, grid_size, grid_step
from .models import Recording, points
from .models.stored_basis import MOST_DIMENSIONS
from .preparation import Prepared

SAMPLED = 30_000
"""Number of samples that are coded on trial; the limits below are in frames."""
FEWEST_FRAMES, MOST_FRAMES = 64, 240
ALONE, ALONE_PER_OCTAVE = 0.9, 0.06
"""The lattice is used alone where it takes less than this share of a transform fitted to the sample. The share rises
with log₂ of frames over frames sampled, since a short sample is less varied than the recording."""
CERTAIN = 0.68
"""Below this share, which rises likewise, the lattice is so much smaller that hou2014 is not tried either."""
MANY_POINTS = 256
"""Of more points, it is enough that the lattice is used alone, since hou2014's basis takes a second or more to fit."""
LEAST_SAVING = 0.05
"""The lattice codes a chunk, or all chunks at a mean error, where it saves at least this share of the bytes, since
the transform decodes some four times faster."""
HOPELESS = 1.25
"""A chunk's other engine is not tried where it took more than this many times the bytes in the last chunks tried."""
TRIED_EVERY = 5
"""Both engines are tried for one chunk in this many at least."""
FEWEST_TRIED, MEMORY = 2, 0.5
"""Both are tried for this many chunks first, since one may be still; a chunk counts so much less in the next."""


@dataclass(frozen=True)
class LatticePlan:
    """neighbours of the points; stride: see `lattice.encode`; alone: no chunk needs a model; certain: nor hou2014."""

    neighbours: lattice.Neighbours
    stride: int
    alone: bool
    certain: bool = False


def plan(motion: Motion, source: Prepared, bound: float, step: int, weights: Floats | None, named: bool) -> LatticePlan:
    """How to use the lattice engine within a bound (metres).

    step: of the transform, log₂ in 1/32 octave; named: the prior knows the points, so that its models are cheap to fit.
    The sample does not decide for these, nor for skeletons: models of directions may be far smaller than its basis.
    """
    found = lattice.neighbours(source.smooth)
    frames = int(np.clip(SAMPLED // max(1, motion.points), FEWEST_FRAMES, MOST_FRAMES))
    first = max(0, (len(motion) - frames) // 2)
    some = slice(first, min(len(motion), first + frames))
    positions = source.smooth[some]
    if weights is not None:
        positions = positions * weights[:, None]
    size = grid_size(grid_step(lattice.half_step(bound)))
    stride, cost = lattice.best_stride([positions / size], [source.apart.apart[some]], found)
    if named or weights is not None or motion.skeleton is not None:
        return LatticePlan(found, stride, alone=False)
    transform = _transform_bytes(motion, source, some, bound, step)
    rise = ALONE_PER_OCTAVE * np.log2(len(motion) / len(positions))
    alone = bool(cost < (ALONE + rise) * transform)
    certain = len(positions) >= FEWEST_FRAMES and bool(cost < (CERTAIN + rise) * transform)
    return LatticePlan(found, stride, alone, certain or (alone and motion.points > MANY_POINTS))


def _transform_bytes(motion: Motion, source: Prepared, some: slice, bound: float, step: int) -> float:
    """Of some frames, by a transform with their own basis, which is counted in proportion to the frames; infinite for
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
    draft, _ = ChunkEncoder.of(model, source, some).within_bound(bound, FIRST_OFFSET, (0,))
    return draft.bits / 8 + len(fitted.pack()) * sample.frames / len(motion)


class EngineTrials:
    """Which engines are tried for the next chunk, from what the chunks before took."""

    def __init__(self, has_transform: bool, has_lattice: bool) -> None:
        self._both = has_transform and has_lattice
        self._has_transform, self._has_lattice = has_transform, has_lattice
        self._chunks, self._transform_bytes, self._lattice_bytes = 0, 0.0, 0.0
        """Of the chunks for which both were tried: their number, and bytes that fade."""

    def tried(self, number: int) -> tuple[bool, bool]:
        """Whether the transform and the lattice are tried for chunk `number`."""
        every = not self._both or number % TRIED_EVERY == 0 or self._chunks < FEWEST_TRIED
        return (
            self._has_transform and (every or self._transform_bytes < HOPELESS * self._lattice_bytes),
            self._has_lattice and (every or self._lattice_bytes < HOPELESS * self._transform_bytes),
        )

    def learn(self, transform_bytes: float, lattice_bytes: float) -> None:
        """What both took in a chunk."""
        self._chunks += 1
        self._transform_bytes = MEMORY * self._transform_bytes + transform_bytes
        self._lattice_bytes = MEMORY * self._lattice_bytes + lattice_bytes
