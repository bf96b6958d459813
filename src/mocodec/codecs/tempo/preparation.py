"""Positions before they are coded: gaps filled, y up, spikes found and interpolated."""

from __future__ import annotations

from dataclasses import dataclass

from ...stages import gaps
from ...typing import Booleans, Floats
from .pose import heading, leaps


@dataclass(frozen=True, eq=False)
class Prepared:
    """positions (frames, points, 3), y up, gaps filled; smooth: without spikes; masks (frames, points)."""

    positions: Floats
    smooth: Floats
    gap_mask: Booleans
    spikes: Booleans


def prepare(positions: Floats, up: str) -> Prepared:
    """Of positions (frames, points, 3), metres, NaN in gaps."""
    filled, gap_mask = gaps.fill(positions)
    upright = heading.to_y_up(filled, up)
    spikes = leaps.spikes(upright) & ~gap_mask
    return Prepared(upright, leaps.without_spikes(upright, spikes), gap_mask, spikes)
