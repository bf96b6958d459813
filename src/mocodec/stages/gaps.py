"""Gaps: taken out before a codec sees the motion, put back exactly where they were.

    positions with NaN ──fill──► positions without, mask ──pack──► bytes
    positions without, mask ◄──unpack── bytes         apply ──► positions with NaN

A mask is stored as the lengths of the runs, present and missing in turn, of the points that have any gap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..entropy import coder
from ..errors import Corrupt
from ..motion import Floats

Mask = NDArray[np.bool_]


def fill(positions: Floats) -> tuple[Floats, Mask]:
    """Positions (frames, points, 3) with every gap filled, and the mask (frames, points) of what was missing.

    Inside, a gap is bridged by the cubic that leaves and arrives at the velocity of its two edges, held back where
    that would overshoot; at either end the nearest sample is held. A point missing throughout gets the mean of the
    others, one that costs little, or zero where there is nothing at all.
    """
    mask = np.isnan(positions[..., 0])
    if not mask.any():
        return positions, mask
    filled = positions.copy()
    frames = np.arange(len(positions))
    present = ~mask
    for point in np.flatnonzero(mask.any(axis=0) & present.any(axis=0)):
        known, missing = frames[present[:, point]], frames[mask[:, point]]
        filled[missing, point] = _bridge(known, positions[known, point], missing)
    empty = mask.all(axis=0)
    if empty.any():
        rest = filled[:, ~empty]
        filled[:, empty] = rest.mean(axis=(0, 1)) if rest.size else 0.0
    return filled, mask


def _bridge(known: NDArray[np.intp], samples: Floats, missing: NDArray[np.intp]) -> Floats:
    """Values at the missing frames from the samples (known frames, 3)."""
    after = np.searchsorted(known, missing)
    left, right = np.clip(after - 1, 0, len(known) - 1), np.clip(after, 0, len(known) - 1)
    a, b = samples[left], samples[right]
    span = np.maximum(known[right] - known[left], 1)[:, None]
    s = np.where(left == right, 0, missing - known[left])[:, None] / span
    line = b - a
    before, beyond = np.maximum(left - 1, 0), np.minimum(right + 1, len(known) - 1)
    limit = 3 * np.abs(line)
    leaving = np.where((known[left] - known[before] == 1)[:, None], (a - samples[before]) * span, line)
    arriving = np.where((known[beyond] - known[right] == 1)[:, None], (samples[beyond] - b) * span, line)
    leaving, arriving = np.clip(leaving, -limit, limit), np.clip(arriving, -limit, limit)
    rising = 3 * s**2 - 2 * s**3
    return a + rising * line + (s**3 - 2 * s**2 + s) * leaving + (s**3 - s**2) * arriving


def apply(positions: Floats, mask: Mask) -> Floats:
    """The positions (frames, points, 3) with NaN where the mask (frames, points) says so."""
    if not mask.any():
        return positions
    return np.where(mask[..., None], np.nan, positions)


def pack(mask: Mask) -> bytes:
    """A mask (frames, points) as bytes; b"" where nothing is missing."""
    if not mask.any():
        return b""
    frames, points = mask.shape
    some = mask.any(axis=0)
    columns = mask[:, some].T
    edges = np.ones((columns.shape[0], frames + 1), bool)  # one row per point: a run starts where its edge is set
    edges[:, 0] = columns[:, 0]
    edges[:, 1:frames] = columns[:, 1:] != columns[:, :-1]
    edges[:, frames] = False
    counts = edges.sum(axis=1)
    starts = np.nonzero(edges)[1]
    numbers = np.concatenate([np.diff(np.flatnonzero(some), prepend=-1) - 1, counts - 1, starts])
    head = np.array([int(some.sum())], np.int64)
    return coder.pack(np.concatenate([head, numbers])[:, None]) + len(numbers).to_bytes(4, "little")


def unpack(data: bytes, shape: tuple[int, int]) -> Mask:
    """The mask of this shape from its bytes. Raises Corrupt."""
    frames, points = shape
    mask = np.zeros((frames, points), bool)
    if not data:
        return mask
    length = int.from_bytes(data[-4:], "little")
    if len(data) < 5 or length > frames * points + 2 * points:
        raise Corrupt("gaps: more runs than the frames can hold")
    numbers = coder.unpack(data[:-4], (length + 1, 1))[:, 0]
    n = int(numbers[0])
    if not 0 < n <= points or len(numbers) < 1 + 2 * n or np.abs(numbers).max() > frames * points:
        raise Corrupt("gaps: more points than the motion has")
    columns = np.cumsum(numbers[1 : n + 1] + 1) - 1
    counts = numbers[n + 1 : 2 * n + 1] + 1
    starts = numbers[2 * n + 1 :]
    if (columns < 0).any() or columns.max() >= points or len(np.unique(columns)) < n:
        raise Corrupt("gaps: a point that the motion does not have")
    if (counts < 1).any() or counts.sum() != len(starts) or (starts < 0).any() or (starts >= frames).any():
        raise Corrupt("gaps: a run that starts outside the frames")
    edges = np.zeros((n, frames), np.int8)
    edges[np.repeat(np.arange(n), counts), starts] = 1
    mask[:, columns] = (np.cumsum(edges, axis=1) % 2 == 1).T
    return mask
