"""Missing markers that a file parks at exactly (0, 0, 0): gaps of the motion, and zeros again when written."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..motion import Motion, Signal
from ..typing import Booleans, Floats
from .scratch import Columns

GAP_OPTIONS = ("zeros", "keep")
"""zeros: samples at exactly (0, 0, 0) are gaps, unless the marker moves near the origin; keep: they are positions."""

NEAR_ORIGIN_M = 0.05
"""A run of exact zeros next to a sample within this distance of the origin is part of a trajectory through it."""
ZERO, KNOWN, NEAR = 1, 2, 4
"""Bits of a sample: at exactly (0, 0, 0); somewhere else; near the origin."""


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
    zero = (positions == 0).all(axis=2) & ~gap
    if not zero.any() or (not is_part and (zero | gap).all()):
        return np.zeros_like(zero)
    for point in np.flatnonzero(zero.any(axis=0)):
        known = ~gap[:, point] & ~zero[:, point]
        near = known & is_near_origin(positions[:, point])
        zero[:, point] = parked_point(zero[:, point], known, near)
    return zero


def is_near_origin(positions: Floats) -> Booleans:
    """Whether positions (…, 3) lie near the origin, where zeros beside them belong to the trajectory; False for NaN."""
    with np.errstate(over="ignore"):
        return np.linalg.norm(positions, axis=-1) < NEAR_ORIGIN_M


def parked_point(zero: Booleans, known: Booleans, near: Booleans) -> Booleans:
    """Which samples of one point stand for a missing marker.

    zero (frames,): samples at exactly (0, 0, 0); known: other samples that are no gaps; near: those near the origin.
    """
    others, frames = np.flatnonzero(known), np.flatnonzero(zero)
    if not len(others):
        return zero
    is_near = near[others]
    after = np.searchsorted(others, frames)
    before_is_near = (after > 0) & is_near[np.maximum(after - 1, 0)]
    after_is_near = (after < len(others)) & is_near[np.minimum(after, len(others) - 1)]
    parked = zero.copy()
    parked[frames[before_is_near | after_is_near]] = False
    return parked


def places(positions: Floats, gap: Booleans) -> NDArray[np.uint8]:
    """(frames, points): where samples are, as ZERO, KNOWN and NEAR, for `parked_columns`; 0 for gaps."""
    zero = (positions == 0).all(axis=2) & ~gap
    known = ~gap & ~zero
    return (ZERO * zero + KNOWN * known + NEAR * (known & is_near_origin(positions))).astype(np.uint8)


def parked_columns(samples: Columns) -> NDArray[np.uint8] | None:
    """As `parked_at_origin`, of recordings that do not fit into memory, by their `places`; None without any."""
    points = samples.values.T
    if not any((point & KNOWN).any() for point in points):
        return None
    parked, found = Columns(samples.rows, samples.shape, np.uint8), False
    for number, point in enumerate(points):
        zero = (point & ZERO) > 0
        if zero.any():
            here = parked_point(zero, (point & KNOWN) > 0, (point & NEAR) > 0)
            parked.put(number, here.astype(np.uint8))
            found |= bool(here.any())
    return parked.values if found else None


def store_parked(
    parked: NDArray[Any], others: bool, rate: float, source: dict[str, Any], extras: dict[str, Any], notes: list[str]
) -> None:
    """Remember which gaps were zeros, so that `parked_of` can tell the writer.

    parked (frames, points): booleans, also as bytes; others: whether there are gaps that were no zeros.
    """
    count = int(np.count_nonzero(parked))
    if not count:
        return
    notes.append(
        f"{count} samples at exactly (0, 0, 0) are gaps (--gaps keep takes them as positions); a file that is written "
        "has the zeros again"
    )
    if others:
        extras["zero_samples"] = Signal(parked.view(np.uint8), rate)
    else:
        source["gaps"] = "zeros"


def parked_of(motion: Motion) -> Booleans:
    """(frames, points): gaps of the motion that were exact zeros in the source."""
    signal = motion.extras.get("zero_samples")
    if isinstance(signal, Signal) and signal.values.shape == motion.gaps.shape:
        return motion.gaps & (signal.values != 0)
    return motion.gaps if motion.source.get("gaps") == "zeros" else np.zeros_like(motion.gaps)
