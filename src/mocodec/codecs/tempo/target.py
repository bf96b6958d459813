"""Steps for a target: the payloads of all chunks within a bound, at a mean error, or of a size.

to_bound    a step for each chunk; every chunk is decoded and checked
to_mean     one step for all chunks, whose mean error is nearest to the target
to_size     one step for all chunks, the smallest whose bytes fit
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from ...encoded import Chunk
from ...errors import CannotEncode
from . import chunk
from .chunk import BATCH, ChunkEncoder, Draft, grid_step
from .coding import coefficients, direct, quantise
from .coding.contexts import OCTAVE
from .coding.rows import step_size

FIRST_OFFSET = 28
"""Under a bound, the first step tried is this many 1/32 octaves above it."""
OFFSETS = (0, -10, 10)
"""Steps tried for a chunk under a bound, 1/32 octave relative to the chunk before."""
SEARCH_EVERY = 3
"""One chunk in this many tries them; the others take the step of the chunk before."""
SMALLEST_STEP, LARGEST_STEP = 1 - coefficients.MAX_STEP, coefficients.MAX_STEP - 1
SAMPLED = 4
"""At most this many chunks are used for the first searches of a mean error."""
USUAL_STEP = 140
"""The step for people's mean error, both in metres, is about this times its power of 1.5: more coefficients are zero in
coarser steps."""
MEAN_OF_RMS = 0.81
"""Mean distance relative to the root mean square: 0.92 if all errors had the same distribution."""
NEAR_SAMPLE, NEAREST = 1.5, 0.43
"""Excess of the mean error, 1/32 octave, at which the search among a sample, and among all chunks, ends."""
ACCEPTED = 0.6
"""Excess, 1/32 octave (1.3 %), beyond which other weights of error and bits are tried as well."""
OTHER_SLOPES = tuple((change, share) for share in (0.8, 1.25, 0.6, 1.6, 0.4, 2.0) for change in (0, -1, 1, -2, 2))
"""Changes of the step, and shares of λ, that are tried then."""
CUBE_MEAN = 0.4803
"""Mean distance of the points of a cube from its centre, in sides."""
USUAL_SLOPE, SLOPES = 0.75, (0.4, 1.0)
"""Octaves of error an octave of step: at first, and the range."""
LARGEST_INTEGER = 2.0**40
"""Whatever the size, steps are no smaller than the largest sample by this."""
COARSE_STEP_M = 0.004
"""The search for a size begins at this step."""


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


def _log(size: float) -> int:
    return round(np.log2(size) * OCTAVE)


def to_bound(encoders: Sequence[ChunkEncoder], bound: float) -> list[bytes]:
    """Payloads that decode to within the bound (metres) at every sample.

    All are decoded and checked; one that exceeds the bound is replaced by the direct engine's, which never does.
    """
    payloads: list[bytes] = []
    offset = FIRST_OFFSET
    for first in range(0, len(encoders), BATCH):
        batch, drafts = encoders[first : first + BATCH], list[Draft]()
        for number, encoder in enumerate(batch):
            changes = OFFSETS if number % SEARCH_EVERY == 0 else (0,)
            draft, offset = encoder.within_bound(bound, offset, changes)
            drafts.append(draft)
        packed = chunk.pack(batch, drafts)
        coded = [e.smaller_of_engines(b, bound) for e, b in zip(batch, packed, strict=True)]
        listed = [Chunk(0, e.frames, b) for e, b in zip(batch, coded, strict=True)]
        for i, (encoder, decoded) in enumerate(zip(batch, chunk.decode(batch[0].model, listed), strict=True)):
            missing = np.isnan(decoded[..., 0])
            if (missing != encoder.gap_mask).any() or not encoder.errors(decoded).max() <= bound:
                coded[i] = encoder.directly(grid_step(direct.cell(bound)))
        payloads += coded
    return payloads


def to_mean(encoders: Sequence[ChunkEncoder], target: float) -> list[bytes]:
    """Payloads at the common step whose mean error (metres) is nearest to the target.

    The step is searched among some of the chunks first, by the error of their coefficients alone; then all chunks are
    coded in it, and again where their mean differs.
    """

    def excess(of: Sequence[ChunkEncoder], step: int, slope: float = quantise.SLOPE) -> tuple[float, list[Draft]]:
        """How much too large the mean error is, 1/32 octave, and the drafts."""
        drafts = [e.draft(step, slope) for e in of]
        error = sum(d.error for d in drafts) / sum(int((~e.gap_mask).sum()) for e in of)
        return _excess(error, target), drafts

    def estimate(step: int) -> tuple[float, None]:
        squared = sum(e.bits_and_error(step)[1] for e in some) / sum(e.gap_mask.size for e in some)
        return _excess(MEAN_OF_RMS * float(np.sqrt(squared) * step_size(step)), target), None

    some = encoders[:: -(-len(encoders) // SAMPLED)]
    step = _log(USUAL_STEP * target**1.5)
    if encoders[0].spectrum is not None:
        step = _search(estimate, step, NEAR_SAMPLE).best
    if len(some) < len(encoders):
        step = _search(lambda s: excess(some, s), step, NEAR_SAMPLE).best
    found = _search(lambda s: excess(encoders, s), step, NEAREST)
    if min(found.values.values()) > ACCEPTED:  # finer than the stored bases are exact
        return [e.directly(grid_step(target / CUBE_MEAN)) for e in encoders]
    miss, drafts = found.values[found.best], found.result
    for change, share in OTHER_SLOPES if abs(miss) < OCTAVE else ():
        if abs(miss) <= ACCEPTED:
            break
        other_miss, other = excess(encoders, found.best + change, share * quantise.SLOPE)
        if abs(other_miss) < abs(miss):
            miss, drafts = other_miss, other
    return chunk.pack(encoders, drafts)


def to_size(encoders: Sequence[ChunkEncoder], size: float) -> list[bytes]:
    """Payloads at the smallest common step whose bytes are within the size. Raises CannotEncode."""
    tried: dict[int, list[bytes]] = {}

    def at(step: int) -> list[bytes]:
        if step not in tried:
            tried.clear()  # only the last is needed again
            tried[step] = chunk.pack(encoders, [e.draft(step) for e in encoders])
        return tried[step]

    samples = [np.abs(e.positions if e.spectrum is None else e.spectrum).max(initial=0.0) for e in encoders]
    finest = int(np.ceil(OCTAVE * np.log2(max(*samples, 1e-9) / LARGEST_INTEGER)))
    start = max(finest, _log(COARSE_STEP_M))
    step = _smallest_step(lambda s: s >= finest and sum(map(len, at(s))) <= size, start)
    result = at(step)
    if sum(map(len, result)) > size:
        raise CannotEncode(f"even the coarsest step takes more than {size:.0f} bytes")
    return result


def _excess(error: float, target: float) -> float:
    return OCTAVE * float(np.log2(max(error, 1e-12) / target))


T = TypeVar("T")


class _Found(NamedTuple, Generic[T]):
    """values: the excess at every step tried; best: the step with the smallest; result: of it."""

    values: dict[int, float]
    best: int
    result: T


def _search(excess: Callable[[int], tuple[float, T]], step: int, near: float) -> _Found[T]:
    """The step whose excess is nearest to zero, or the first within `near`: false position from the first step."""
    values: dict[int, float] = {}
    best, result = step, None
    for _ in range(12):
        step = int(np.clip(step, SMALLEST_STEP, LARGEST_STEP))
        if step in values:
            break
        values[step], found = excess(step)
        if abs(values[step]) <= min(map(abs, values.values())):
            best, result = step, found
        if abs(values[step]) < near:
            break
        step = _next_step(values)
    return _Found(values, best, result)  # type: ignore[arg-type]


def _next_step(values: dict[int, float]) -> int:
    """Where the excess (1/32 octave) should vanish: between two steps tried, or along the usual slope."""
    below = [s for s in values if values[s] <= 0]
    above = [s for s in values if values[s] > 0]
    if below and above:
        a, b = max(below), min(above)
        if b - a <= 1:
            return a
        between = round(a - values[a] * (b - a) / (values[b] - values[a]))
        return min(max(between, a + 1), b - 1)
    last, *before = sorted(values, reverse=bool(below))
    slope = USUAL_SLOPE
    if before:
        slope = float(np.clip((values[last] - values[before[0]]) / (last - before[0]), *SLOPES))
    change = -values[last] / slope
    return last + (int(np.ceil(change)) if change >= 0 else int(np.floor(change)))


def _smallest_step(holds: Callable[[int], bool], start: int) -> int:
    """The smallest step for which this holds, if it holds for all larger ones: galloping, then bisection."""
    width, low, high = 16, None, None  # it fails at low and holds at high
    at = start
    while (low is None or high is None) and abs(at) < coefficients.MAX_STEP:
        if holds(at):
            high, at = at, at - width
        else:
            low, at = at, at + width
        width = min(2 * width, 512)
    low = at if low is None else low
    high = at if high is None else high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return int(np.clip(high, SMALLEST_STEP, LARGEST_STEP))
