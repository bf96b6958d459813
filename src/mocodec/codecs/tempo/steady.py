"""A step that stays nearly the same over a long recording, and keeps a mean error or a size at every block's end.

    spent so far, allowed so far ─► budget of the block ─► the steady step, or the nearest that keeps the budget

One step for all chunks is nearly best; `equal_slopes` spends a mean error better, where all chunks are known. What
quiet blocks leave is given to later ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...errors import CannotEncode
from . import chunk, target
from .chunk import ChunkEncoder
from .coding.contexts import OCTAVE

MOST_OF_BLOCK = 2.0
"""Largest ratio of the cost of a block to its own share of the allowed cost."""
AIM = 0.99
"""Share of the allowed cost that the first step aims at; after a block the step changes while less is spent."""
SLOWLY = 2
"""The steady step changes by at most this much after a block, 1/32 octave."""
TRIES, SAMPLE_TRIES = 12, 8
MEAN_SLOPE, SIZE_SLOPE = 0.75, 0.7
"""Rise of the logarithm of the error, and fall of that of the bytes, per logarithm of the step."""

Coded = tuple[float, Callable[[], list[bytes]]]
"""What chunks cost in a step, and what makes their payloads."""
Cost = Callable[[Sequence[ChunkEncoder], int], Coded]
Units = Callable[[Sequence[ChunkEncoder]], int]


class SteadyStep:
    """allowed: cost per unit. step: log₂ in 1/32 octave. way: −1 where finer steps cost less, 1 where coarser do."""

    def __init__(self, cost: Cost, units: Units, allowed: float, step: int, way: int, slope: float) -> None:
        self._cost, self._count, self._allowed = cost, units, allowed
        self.step, self._way, self._slope = step, way, slope
        self._spent, self._units = 0.0, 0

    def settle(self, sample: Sequence[ChunkEncoder]) -> None:
        """Search the step at which a sample costs what is allowed."""
        budget = AIM * self._allowed * self._count(sample)
        finest = target.finest_step(sample)
        for _ in range(SAMPLE_TRIES if budget > 0 else 0):
            over = _excess(self._cost(sample, self.step)[0], budget)
            change = self._way * round(over / self._slope)
            if not change:
                break
            self.step = _in_range(self.step + change, finest)

    def payloads(self, encoders: Sequence[ChunkEncoder]) -> list[bytes] | None:
        """Payloads of the next block within what is allowed so far; None if no step tried keeps to it."""
        units = self._count(encoders)
        left = self._allowed * (self._units + units) - self._spent
        budget = min(left, MOST_OF_BLOCK * self._allowed * units)
        finest = target.finest_step(encoders)
        step = _in_range(self.step, finest)
        for _ in range(TRIES):
            cost, make = self._cost(encoders, step)
            over = _excess(cost, budget) if cost > 0 else -1.0
            if over <= 0:
                break
            step = _in_range(step + self._way * int(np.ceil(over / self._slope)), finest)
        else:
            return None
        self._spent, self._units = self._spent + cost, self._units + units
        if step != self.step:
            self.step += self._way * min(SLOWLY, abs(step - self.step))
        elif self._spent < AIM * self._allowed * self._units:
            self.step = _in_range(self.step - self._way * SLOWLY, finest)
        return make()


class SteadyMean(SteadyStep):
    """Keeps a mean error; blocks that no step keeps within it are coded directly."""

    def payloads(self, encoders: Sequence[ChunkEncoder]) -> list[bytes]:
        return super().payloads(encoders) or target.directly_to_mean(encoders, self._allowed)


class SteadySize(SteadyStep):
    """Keeps a size. Raises CannotEncode where the coarsest step is too large."""

    def payloads(self, encoders: Sequence[ChunkEncoder]) -> list[bytes]:
        found = super().payloads(encoders)
        if found is None:
            raise CannotEncode(f"even the coarsest step takes more than {self._allowed:.3g} bytes a frame")
        return found


def for_mean(sample: Sequence[ChunkEncoder], mean_error: float) -> SteadyMean:
    """A mean error (metres) at a step that suits the sample."""
    found = SteadyMean(_error, _samples, mean_error, target.step_for_mean(mean_error), -1, MEAN_SLOPE)
    found.settle(sample)
    return found


def for_size(sample: Sequence[ChunkEncoder], bytes_a_frame: float) -> SteadySize:
    """A target in bytes a frame, from a step that suits the sample. Raises CannotEncode for less than a byte in all."""
    if bytes_a_frame <= 0:
        raise CannotEncode("the header alone takes more bytes than are asked for")
    found = SteadySize(_bytes, _frames, bytes_a_frame, target.COARSE_STEP, 1, SIZE_SLOPE)
    found.settle(sample)
    return found


def _error(encoders: Sequence[ChunkEncoder], step: int) -> Coded:
    drafts = chunk.drafts_of_step(encoders, step)
    error = sum(d.error for d in drafts) + sum(e.apart.rounding_error for e in encoders)
    return error, lambda: chunk.pack(encoders, drafts)


def _samples(encoders: Sequence[ChunkEncoder]) -> int:
    return sum(e.samples for e in encoders)


def _bytes(encoders: Sequence[ChunkEncoder], step: int) -> Coded:
    payloads = chunk.pack(encoders, chunk.drafts_of_step(encoders, step))
    return sum(map(len, payloads)), lambda: payloads


def _frames(encoders: Sequence[ChunkEncoder]) -> int:
    return sum(e.frames for e in encoders)


def _excess(cost: float, budget: float) -> float:
    """The ratio of a cost to a budget in 1/32 octave."""
    return OCTAVE * float(np.log2(max(cost, 1e-12) / max(budget, 1e-12)))


def _in_range(step: int, finest: int) -> int:
    return int(np.clip(step, finest, target.LARGEST_STEP))
