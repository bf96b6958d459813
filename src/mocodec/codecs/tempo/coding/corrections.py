"""Corrections keep the bound: samples that the transform leaves too far off are moved back, a few integers each.

    positions − decoded, bound ─find─► corrections ─numbers─► integers for the coder
    integers ─from_numbers─► corrections ─apply─► positions within the bound

An error exceeds the bound for some frames in a row, so one correction moves a point over a run of frames, by a vector
times half a sine wave. Where that does not suffice, each frame gets a correction of its own, which always suffices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ....errors import CannotEncode, Corrupt
from ....typing import Booleans, Floats, Integers
from .direct import LARGEST

FIELDS = 5
"""Integers of a correction: x, y, z of its vector, samples between it and the one before, and its frames less one."""


class Corrections(NamedTuple):
    """start (n,): point · frames + frame, rising; length (n,): frames; by (n, 3): the vector, in steps."""

    start: Integers
    length: Integers
    by: Integers


def find(error: Floats, bound: float, step: float) -> Corrections:
    """Corrections of errors (frames, points, 3) beyond the bound, in steps small enough to bring any error within it.

    Raises CannotEncode for errors too large to count in steps.
    """
    by_axis = np.ascontiguousarray(error.T)
    beyond = (by_axis * by_axis).sum(axis=0) > bound * bound
    start, length = _runs(beyond)
    flat = by_axis.reshape(3, -1).T
    if not (np.abs(flat[beyond.ravel()]) < LARGEST * step).all():
        raise CannotEncode("the motion is too large for so small an error")
    samples, of, weight = _samples(start, length)
    here = flat[samples]
    heads = np.cumsum(length) - length
    if len(start):
        fitted = np.add.reduceat(here * weight[:, None], heads, axis=0)
        fitted /= np.add.reduceat(weight**2, heads)[:, None]
    else:
        fitted = np.zeros((0, 3))
    by = np.rint(fitted / step).astype(np.int64)
    left = here - by[of] * (weight[:, None] * step)
    bad = np.einsum("sc,sc->s", left, left) > bound * bound
    failed = np.bincount(of, bad, minlength=len(start)) > 0
    single = samples[failed[of] & beyond.ravel()[samples]]
    starts = np.concatenate([start[~failed], single])
    order = np.argsort(starts, kind="stable")
    return Corrections(
        starts[order],
        np.concatenate([length[~failed], np.ones(len(single), np.int64)])[order],
        np.concatenate([by[~failed], np.rint(flat[single] / step).astype(np.int64)])[order],
    )


def _runs(beyond: Booleans) -> tuple[Integers, Integers]:
    """Starts and lengths of the runs of True in each row of (points, frames), as indices into the flat array."""
    frames = beyond.shape[1]
    edges = np.diff(np.pad(beyond.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    point, first = np.nonzero(edges == 1)
    _, last = np.nonzero(edges == -1)
    return point * frames + first, last - first


def _samples(start: Integers, length: Integers) -> tuple[Integers, Integers, Floats]:
    """Samples of all corrections in turn: index in the flat array, number of the correction, weight."""
    of = np.repeat(np.arange(len(start)), length)
    within = np.arange(len(of)) - np.repeat(np.cumsum(length) - length, length)
    return start[of] + within, of, np.sin(np.pi * (within + 1) / (length[of] + 1))


def apply(positions: Floats, corrections: Corrections, step: float, weights: Floats | None = None) -> None:
    """Add the corrections to positions (frames, points, 3), in place. weights (points,): by which a step is divided."""
    samples, of, weight = _samples(corrections.start, corrections.length)
    frames = len(positions)
    point = samples // frames
    if weights is not None:
        weight = weight / weights[point]
    positions[samples % frames, point] += corrections.by[of] * (weight[:, None] * step)


def numbers(corrections: Corrections) -> Integers:
    """The corrections as integers, (5, n): the first three rows of either sign, the others never negative."""
    ends = np.concatenate([[0], corrections.start + corrections.length])
    return np.stack([*corrections.by.T, corrections.start - ends[:-1], corrections.length - 1])


def from_numbers(numbers_: Integers, frames: int, points: int) -> Corrections:
    """The corrections of `numbers`. Raises Corrupt where they do not fit the chunk."""
    gaps, lengths = numbers_[3], numbers_[4] + 1
    if (gaps > frames * points).any() or (lengths > frames).any():
        raise Corrupt("tempo: a correction beyond the last sample")
    start = np.cumsum(gaps + lengths) - lengths
    if len(start) and (start[-1] + lengths[-1] > frames * points or (start % frames + lengths > frames).any()):
        raise Corrupt("tempo: a correction beyond the last sample")
    return Corrections(start, lengths, numbers_[:3].T)
