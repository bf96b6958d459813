"""Positions before they are coded: gaps and frozen samples filled, y up, spikes found and interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ... import native, parallel
from ...stages import frozen, gaps
from ...typing import Booleans, Floats
from .pose import heading, leaps


@dataclass(frozen=True, eq=False)
class Prepared:
    """positions (frames, points, 3), y up, filled; smooth: without spikes. apart: missing and frozen samples, y up.

    spikes (frames, points): mask. leaps: whether any step between two frames is long enough for a discontinuity.
    """

    positions: Floats
    smooth: Floats
    apart: frozen.Split
    spikes: Booleans
    leaps: bool = True

    def discontinuities(self, rate: float) -> list[int]:
        """First frames, rising, after a discontinuity."""
        return leaps.discontinuities(self.smooth, rate) if self.leaps else []


def prepare(
    positions: Floats, up: str, tolerance: float | None = None, bones: bool = False, holds: bool = True
) -> Prepared:
    """Prepare positions (frames, points, 3), metres, NaN in gaps, for coding; the rest as in `frozen.split`."""
    missing = repeats = spike = leap = True
    if (kernel := native.kernel("screen_positions")) is not None:

        def screen(some: slice) -> tuple[bool, bool, bool, bool]:
            # with the frames before and after, to which they are compared
            beside = positions[max(0, some.start - 1) : some.stop + 1]
            return kernel(beside, leaps.SMALLEST_LEAP_M, leaps.LEAP_FACTOR)

        screened = list(parallel.over(screen, parallel.blocks(len(positions))))
        missing, repeats, spike, leap = map(any, zip(*screened, strict=True))
    turned = heading.to_y_up(positions, up)
    if missing or repeats:
        apart = frozen.split(turned, tolerance, bones, holds)
        filled, mask = gaps.fill(apart.moving)
        changed = bool(mask.any())
    else:
        mask, changed = np.zeros(turned.shape[:2], bool), False
        filled = np.ascontiguousarray(turned)
        apart = frozen.Split(filled, mask, mask, mask, tolerance, holds)
    spikes = leaps.spikes(filled) & ~mask if spike or changed else np.zeros_like(mask)
    return Prepared(filled, leaps.without_spikes(filled, spikes), apart, spikes, leap or changed)


def chunk_bounds(frames: int, rate: float, seconds: float, cuts: list[int] | None = None) -> list[tuple[int, int]]:
    """Start and stop of chunks: equal ones of about `seconds` between the cuts (frames, rising)."""
    edges = [0]
    for stop in (*(cuts or ()), frames):
        start = edges[-1]
        count = min(max(1, round((stop - start) / (rate * seconds))), stop - start)
        edges += [start + (stop - start) * i // count for i in range(1, count + 1)]
    return list(pairwise(edges))
