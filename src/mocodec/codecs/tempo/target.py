"""Approximate steps for a target; and the payloads of all chunks within a size, or coded directly at a mean error.

`equal_slopes` has the mean error by the transform, `hard_bound` the bound.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ... import progress
from ...errors import CannotEncode
from ...stages import search
from . import chunk
from .chunk import ChunkEncoder, grid_size, grid_step
from .coding import coefficients, direct
from .coding.contexts import OCTAVE

SMALLEST_STEP, LARGEST_STEP = 1 - coefficients.MAX_STEP, coefficients.MAX_STEP - 1
USUAL_STEP = 140
"""For people, step ≈ 140 · mean_error^1.5 (metres): more coefficients are zero in coarser steps."""
CUBE_MEAN = 0.4803
"""Mean distance of the points of a cube from its centre, in sides."""
FINER_GRIDS = 64
"""How much finer grids are tried for a mean error, at most, 1/256 octave."""
LARGEST_INTEGER = 2.0**40
"""The finest step is the largest sample divided by this, whatever the size asked for."""
COARSE_STEP = round(np.log2(0.004) * OCTAVE)
"""The search for a size begins at this step, 4 mm."""


def first_step(
    max_error: float | None, mean_error: float | None, size: float | None, ratio: float | None, raw_bytes: int
) -> int:
    """About the step (log₂ in 1/32 octave) that a target needs: near enough to round a basis by."""
    if mean_error is not None:
        return _log(3 * mean_error)
    if max_error is not None:
        return step_for_bound(max_error)
    return _log(3e-5 * (ratio or raw_bytes / (size or 1)))


def step_for_bound(bound: float) -> int:
    """About the step that a bound (metres) needs, log₂ in 1/32 octave."""
    return _log(2.2 * bound)


def step_for_mean(mean_error: float) -> int:
    """About the step that a mean error (metres) of people needs, log₂ in 1/32 octave."""
    return _log(USUAL_STEP * mean_error**1.5)


def _log(size: float) -> int:
    return round(np.log2(size) * OCTAVE)


def directly_to_mean(encoders: Sequence[ChunkEncoder], target: float) -> list[bytes]:
    """Payloads of the direct engine in the coarsest grid tried whose mean error is at most the target (metres)."""
    samples = sum(e.samples for e in encoders)
    apart = sum(e.apart.rounding_error for e in encoders)
    grid = grid_step(target / CUBE_MEAN)
    for finer in range(FINER_GRIDS):
        size = grid_size(grid - finer)
        errors = (e.errors(np.asarray(direct.quantise(e.positions, size) * size, np.float64)) for e in encoders)
        if sum(float(each.sum()) for each in errors) + apart <= target * samples:
            return [e.directly(grid - finer) for e in encoders]
    return [e.directly(grid - FINER_GRIDS) for e in encoders]


def to_size(encoders: Sequence[ChunkEncoder], size: float) -> list[bytes]:
    """Payloads at the smallest common step whose bytes are within the size. Raises CannotEncode."""
    tried: dict[int, list[bytes]] = {}

    def fits(coarseness: int) -> bool:
        payloads = chunk.pack(encoders, chunk.drafts_of_step(encoders, -coarseness))
        if sum(map(len, payloads)) > size:
            return False
        tried.clear()  # only the finest is needed again
        tried[-coarseness] = payloads
        return True

    finest = finest_step(encoders)
    step = search.largest_true(
        progress.attempts(fits, share=0.2),
        -max(finest, COARSE_STEP),
        -LARGEST_STEP,
        -finest,
    )
    if step is None:
        raise CannotEncode(f"even the coarsest step takes more than {size:.0f} bytes")
    return tried[-step]


def finest_step(encoders: Sequence[ChunkEncoder]) -> int:
    """The finest step (log₂ in 1/32 octave) whose integers a chunk holds for all samples of these."""
    samples = [np.abs(e.positions if e.spectrum is None else e.spectrum).max(initial=0.0) for e in encoders]
    return max(SMALLEST_STEP, int(np.ceil(OCTAVE * np.log2(max([*samples, 1e-9]) / LARGEST_INTEGER))))
