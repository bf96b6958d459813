"""Steps for a target: the payloads of all chunks at a mean error, or of a size. `hard_bound` has the third target.

to_mean     one step for all chunks, whose mean error is nearest to the target
to_size     one step for all chunks, the smallest whose bytes fit
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from ... import progress
from ...errors import CannotEncode
from ...stages import search
from . import chunk
from .chunk import ChunkEncoder, Draft, grid_size, grid_step
from .coding import coefficients, direct, quantise
from .coding.contexts import OCTAVE

Result = TypeVar("Result")

SMALLEST_STEP, LARGEST_STEP = 1 - coefficients.MAX_STEP, coefficients.MAX_STEP - 1
SAMPLED = 4
"""At most this many chunks are used for the first searches of a mean error."""
USUAL_STEP = 140
"""For people, step ≈ 140 · mean_error^1.5 (metres): more coefficients are zero in coarser steps."""
AIM, NEAR_SAMPLE, NEAR = -0.38, 1.5, 0.37
"""Excess of the mean error over the target, 1/32 octave: the search aims at −0.38 (0.8 % below the target), so that the
target holds; it ends within 1.5 of the aim among a sample of chunks, and within 0.37 among all."""
ACCEPTED = -1.2
"""Other values of λ are tried as well where the excess, 1/32 octave, is not between this (2.6 % below) and 0."""
LOWER_STEPS = 7
"""Where the best step exceeds the target, at most this many steps below it are tried."""
OTHER_SLOPES = tuple((change, share) for share in (0.8, 1.25, 0.6, 1.6, 0.4, 2.0) for change in (0, -1, 1, -2, 2))
"""Changes of the step, and shares of λ, that are tried then."""
CUBE_MEAN = 0.4803
"""Mean distance of the points of a cube from its centre, in sides."""
FINER_GRIDS = 64
"""A grid for a mean error is tried at most so much finer, 1/256 octave."""
USUAL_SLOPE, SLOPES = 0.75, (0.4, 1.0)
"""Rise of the logarithm of the error per logarithm of the step: at first, and its range."""
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


def to_mean(encoders: Sequence[ChunkEncoder], target: float) -> list[bytes]:
    """Payloads at a common step whose mean error is at most the target (metres), and near it.

    The step is searched among some of the chunks first; then all chunks are coded in it, and again where their mean
    differs.
    """

    def excess(of: Sequence[ChunkEncoder], step: int, slope: float = quantise.SLOPE) -> tuple[float, list[Draft]]:
        """How much too large the mean error is, 1/32 octave, and the drafts."""
        drafts = chunk.drafts_of_step(of, step, slope)
        error = sum(d.error for d in drafts) + sum(e.apart.rounding_error for e in of)
        error /= sum(e.samples for e in of)
        return _excess(error, target), drafts

    some = encoders[:: -(-len(encoders) // SAMPLED)]
    step = step_for_mean(target)
    if len(some) < len(encoders):
        step = int(_nearest(lambda s: excess(some, s), step, NEAR_SAMPLE)[0].setting)
    found, tried = _nearest(lambda s: excess(encoders, s), step, NEAR)
    best, over, drafts = int(found.setting), found.value + AIM, found.result
    if min(tried.values()) + AIM > 0:  # finer than the stored bases are exact
        return directly_to_mean(encoders, target)
    for lower in range(1, LOWER_STEPS + 1):
        if over <= 0:
            break
        over, drafts = excess(encoders, best - lower)
    for change, share in OTHER_SLOPES if over > -OCTAVE else ():
        if ACCEPTED <= over <= 0:
            break
        other, other_drafts = excess(encoders, best + change, share * quantise.SLOPE)
        if over < other <= 0 or (over > 0 and other < over):
            over, drafts = other, other_drafts
    if over > 0:
        return directly_to_mean(encoders, target)
    return chunk.pack(encoders, drafts)


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


def _nearest(
    excess: Callable[[int], tuple[float, Result]], step: int, near: float
) -> tuple[search.Trial[Result], dict[int, float]]:
    """The step whose excess is nearest to the aim."""

    def from_aim(at: int) -> tuple[float, Result]:
        over, result = excess(at)
        return over - AIM, result

    return search.nearest_root(
        progress.attempts(from_aim), step, SMALLEST_STEP, LARGEST_STEP, slope=USUAL_SLOPE, slopes=SLOPES, near=near
    )


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


def _excess(error: float, target: float) -> float:
    return OCTAVE * float(np.log2(max(error, 1e-12) / target))
