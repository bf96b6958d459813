"""Gaps: filled before a codec sees the motion, and restored exactly after decoding.

    positions with NaN ──fill──► filled positions, mask ──pack──► bytes
    filled positions, mask ◄──unpack── bytes         apply ──► positions with NaN

A mask is stored as the lengths of its runs, present and missing in turn, point after point or frame after frame,
whichever takes fewer bytes: the first suits occluded markers, the second frames that are missing as a whole.
"""

from __future__ import annotations

import numpy as np

from ..entropy import coder, varint
from ..errors import Corrupt
from ..typing import Booleans, Floats, Integers

Mask = Booleans
"""(frames, points): True for a missing sample."""

MAX_SPEED_FRAMES = 40
"""The speed at the edge of a gap is extrapolated over at most this many frames."""


def fill(positions: Floats) -> tuple[Floats, Mask]:
    """Positions (frames, points, 3) with every gap filled, and the mask (frames, points) of missing samples.

    A gap inside the motion is filled with the cubic that has the positions and speeds of its two edges; a gap at
    either end repeats the nearest sample. A point without any sample gets the mean of the others, or zero where there
    are none.
    """
    mask = np.isnan(positions[..., 0])
    if not mask.any():
        return positions, mask
    filled = positions.copy()
    frames = np.arange(len(positions))
    present = ~mask
    for point in np.flatnonzero(mask.any(axis=0) & present.any(axis=0)):
        known, missing = frames[present[:, point]], frames[mask[:, point]]
        with np.errstate(over="ignore", invalid="ignore"):
            filled[missing, point] = np.nan_to_num(_bridge(known, positions[known, point], missing))
    empty = mask.all(axis=0)
    if empty.any():
        rest = filled[:, ~empty]
        with np.errstate(over="ignore", invalid="ignore"):
            filled[:, empty] = np.nan_to_num(rest.mean(axis=(0, 1))) if rest.size else 0.0
    return filled, mask


def _bridge(known: Integers, samples: Floats, missing: Integers) -> Floats:
    """Values at the missing frames from the samples (known frames, 3)."""
    after = np.searchsorted(known, missing)
    left, right = np.clip(after - 1, 0, len(known) - 1), np.clip(after, 0, len(known) - 1)
    a, b = samples[left], samples[right]
    span = np.maximum(known[right] - known[left], 1)[:, None]
    s = np.where(left == right, 0, missing - known[left])[:, None] / span
    reach = np.minimum(span, MAX_SPEED_FRAMES)
    leaving, arriving = _speed(known, samples, left, -1) * reach, -_speed(known, samples, right, 1) * reach
    rising = 3 * s**2 - 2 * s**3
    return a + rising * (b - a) + (s**3 - 2 * s**2 + s) * leaving + (s**3 - s**2) * arriving


def _speed(known: Integers, samples: Floats, at: Integers, way: int) -> Floats:
    """Speed per frame at the samples `at`, from the two before them (way −1) or after them (way 1): the smaller of the
    two differences, zero where these have different signs or a gap between them."""
    one, two = np.clip(at + way, 0, len(known) - 1), np.clip(at + 2 * way, 0, len(known) - 1)
    last, before = samples[at] - samples[one], samples[one] - samples[two]
    steady = (np.abs(known[two] - known[at]) == 2)[:, None] & (np.sign(last) * np.sign(before) > 0)
    return np.where(steady, np.where(np.abs(last) < np.abs(before), last, before), 0.0)


def apply(positions: Floats, mask: Mask) -> Floats:
    """The positions (frames, points, 3) with NaN where the mask (frames, points) is True."""
    if not mask.any():
        return positions
    return np.where(mask[..., None], np.nan, positions)


def pack(mask: Mask) -> bytes:
    """The bytes of a mask (frames, points); b"" where nothing is missing."""
    if not mask.any():
        return b""
    return min((_pack_runs(mask.T, 0), _pack_runs(mask, 1)), key=len)


def unpack(data: bytes, shape: tuple[int, int]) -> Mask:
    """The mask of this shape (frames, points) from its bytes. Raises Corrupt."""
    frames, points = shape
    if not data:
        return np.zeros((frames, points), bool)
    (number,), size = varint.read(data, 1)
    count, by_frame = number >> 1, number & 1
    if not 0 < count <= frames * points:
        raise Corrupt("more gaps than samples")
    runs = coder.unpack(data[size:], (count, 2)).ravel()
    if runs.min() < 0 or (runs[1:] == 0).any() or runs.max() > frames * points or runs.sum() > frames * points:
        raise Corrupt("gaps that are longer than the motion")
    edges = np.zeros(frames * points + 1, np.int8)
    edges[np.cumsum(runs)] = np.tile(np.array([1, -1], np.int8), count)
    flat = np.cumsum(edges[:-1], dtype=np.int8).astype(bool)
    return flat.reshape(frames, points) if by_frame else flat.reshape(points, frames).T.copy()


def _pack_runs(mask: Mask, by_frame: int) -> bytes:
    """The number of gaps, and for each the number of present samples before it and of missing ones, row after row."""
    flat = np.concatenate([[False], mask.ravel(), [False]])
    runs = np.diff(np.flatnonzero(flat[1:] != flat[:-1]), prepend=0).reshape(-1, 2)
    return varint.write([len(runs) << 1 | by_frame]) + coder.pack(runs)
