"""Missing markers that a file parks at exactly (0, 0, 0): gaps of the motion, and zeros again when written."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import BadInput
from ..motion import Motion, Signal
from ..typing import Booleans, Floats

GAP_OPTIONS = ("zeros", "keep")
"""zeros: samples at exactly (0, 0, 0) are gaps, unless the marker moves near the origin; keep: they are positions."""

NEAR_ORIGIN_M = 0.05
"""A run of exact zeros next to a sample within this distance of the origin is part of a trajectory through it."""


def zeros_are_gaps(option: str | None) -> bool:
    """Whether samples at exactly (0, 0, 0) are gaps: the option `gaps` of readers. Raises BadInput."""
    if option not in (None, *GAP_OPTIONS):
        raise BadInput(f"gaps is one of {', '.join(GAP_OPTIONS)}, not {option!r:.40}")
    return option != "keep"


def parked_at_origin(positions: Floats, gap: Booleans, is_part: bool = False) -> Booleans:
    """(frames, points): samples at exactly (0, 0, 0) that stand for missing markers, as some programs write them.

    positions (frames, points, 3) in metres; gap: samples known to be missing. A run of zeros between samples near the
    origin is kept: there the marker passes through it. So are zeros if no sample is anywhere else, unless the positions
    are a part of a recording (is_part).
    """
    parked = (positions == 0).all(axis=2) & ~gap
    if not parked.any() or (not is_part and (parked | gap).all()):
        return np.zeros_like(parked)
    for point in np.flatnonzero(parked.any(axis=0)):
        known = np.flatnonzero(~gap[:, point] & ~parked[:, point])
        if not len(known):
            continue
        is_near = np.linalg.norm(positions[known, point], axis=1) < NEAR_ORIGIN_M
        frames = np.flatnonzero(parked[:, point])
        after = np.searchsorted(known, frames)
        before_is_near = (after > 0) & is_near[np.maximum(after - 1, 0)]
        after_is_near = (after < len(known)) & is_near[np.minimum(after, len(known) - 1)]
        parked[frames[before_is_near | after_is_near], point] = False
    return parked


def store_parked(
    parked: Booleans, gap: Booleans, rate: float, source: dict[str, Any], extras: dict[str, Any], notes: list[str]
) -> None:
    """Remember which gaps were zeros, so that `parked_of` can tell the writer; gap: the other gaps."""
    count = int(parked.sum())
    if not count:
        return
    notes.append(
        f"{count} samples at exactly (0, 0, 0) are gaps (--gaps keep takes them as positions); a file that is written "
        "has the zeros again"
    )
    if gap.any():
        extras["zero_samples"] = Signal(parked.astype(np.uint8), rate)
    else:
        source["gaps"] = "zeros"


def parked_of(motion: Motion) -> Booleans:
    """(frames, points): gaps of the motion that were exact zeros in the source."""
    signal = motion.extras.get("zero_samples")
    if isinstance(signal, Signal) and signal.values.shape == motion.gaps.shape:
        return motion.gaps & (signal.values != 0)
    return motion.gaps if motion.source.get("gaps") == "zeros" else np.zeros_like(motion.gaps)
