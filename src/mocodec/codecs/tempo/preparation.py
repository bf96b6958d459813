"""Positions before they are coded: gaps and frozen samples filled, y up, spikes found and interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from ...stages import frozen, gaps
from ...typing import Booleans, Floats
from .pose import heading, leaps


@dataclass(frozen=True, eq=False)
class Prepared:
    """positions (frames, points, 3), y up, filled; smooth: without spikes. apart: missing and frozen samples, y up.

    spikes (frames, points): mask.
    """

    positions: Floats
    smooth: Floats
    apart: frozen.Split
    spikes: Booleans


def prepare(
    positions: Floats, up: str, tolerance: float | None = None, bones: bool = False, holds: bool = True
) -> Prepared:
    """Of positions (frames, points, 3), metres, NaN in gaps; the rest as in `frozen.split`."""
    apart = frozen.split(heading.to_y_up(positions, up), tolerance, bones, holds)
    filled, mask = gaps.fill(apart.moving)
    spikes = leaps.spikes(filled) & ~mask
    return Prepared(filled, leaps.without_spikes(filled, spikes), apart, spikes)


def chunk_bounds(frames: int, rate: float, seconds: float, cuts: list[int] | None = None) -> list[tuple[int, int]]:
    """Start and stop of chunks: equal ones of about `seconds` between the cuts (frames, rising)."""
    edges = [0]
    for stop in (*(cuts or ()), frames):
        start = edges[-1]
        count = min(max(1, round((stop - start) / (rate * seconds))), stop - start)
        edges += [start + (stop - start) * i // count for i in range(1, count + 1)]
    return list(pairwise(edges))
