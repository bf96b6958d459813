"""Key frames: a trajectory stored at few frames, natural cubic splines between. Liu & McMillan 2006, section 3.4.

    trajectory ──keyframes──► Keyframes ──values there──► interpolate ──► every frame
    Keyframes ──splits──► one bit for each interval: was it halved? ──from_splits──► Keyframes
    values ──differences──► integers: how far each value is from the coarser levels' spline ──values──► values

Key frames are found by halving intervals, so they form levels: four evenly spaced frames, then middles of their
intervals, then middles of those. The levels store the places of key frames in about two bits each and predict values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .. import native
from ..errors import Corrupt
from ..typing import Booleans, Bytes, Floats, Integers
from . import quantise

Frames = Integers
"""Frame numbers."""
FIRST = 4
"""Key frames of the first level: both ends, and the frames at one third and two thirds of the run."""


@dataclass(frozen=True, eq=False)
class Keyframes:
    """Key frames of a run of `frames` frames, by level: each level halves some intervals of the levels before it.

    by_level (keys,): frame numbers in the order of the levels, in which values are stored. sizes (levels,): key frames
    of each level.
    """

    frames: int
    by_level: Frames
    sizes: Integers

    def __len__(self) -> int:
        return len(self.by_level)

    @property
    def levels(self) -> list[Frames]:
        """Frame numbers of each level."""
        return np.split(self.by_level, np.cumsum(self.sizes)[:-1])

    @cached_property
    def order(self) -> Integers:
        """The places in `by_level` that sort the frame numbers."""
        return np.argsort(self.by_level)


def evenly(frames: int) -> Frames:
    """The key frames of the first level."""
    return np.unique(np.rint(np.linspace(0, frames - 1, FIRST)).astype(np.int64))


def interpolate(keyframes: Frames, values: Floats, at: Frames) -> Floats:
    """The natural cubic spline through values (keys, k) at ascending key frames, at frames within: (at, k)."""
    if len(keyframes) < 2:
        return np.repeat(values, len(at), axis=0)
    if (kernel := native.kernel("spline_interpolate")) is not None:
        return kernel(keyframes, values, at)
    widths = np.diff(keyframes).astype(np.float64)[:, None]
    curvature = _curvature(widths, values)
    right = np.clip(np.searchsorted(keyframes, at, side="right"), 1, len(keyframes) - 1)
    left = right - 1
    width = widths[left]
    b = (at - keyframes[left])[:, None] / width
    a = 1.0 - b
    bend = width**2 / 6
    return (
        a * values[left] + b * values[right]
        + ((a * a * a - a) * bend) * curvature[left] + ((b * b * b - b) * bend) * curvature[right]
    )  # fmt: skip


def _curvature(widths: Floats, values: Floats) -> Floats:
    """Second derivatives of the natural spline at its knots, zero at both ends."""
    curvature = np.zeros_like(values)
    if len(values) > 2 and values.shape[1]:
        from scipy.linalg import get_lapack_funcs

        (ptsv,) = get_lapack_funcs(("ptsv",), dtype=np.float64)
        slopes = np.diff(values, axis=0) / widths
        diagonal = (widths[:-1] + widths[1:])[:, 0] / 3
        beside = widths[1:-1, 0] / 6 if len(diagonal) > 1 else np.zeros(1)
        curvature[1:-1] = ptsv(diagonal, beside, np.diff(slopes, axis=0))[2]
    return curvature


def keyframes(trajectory: Floats, tolerance: float) -> Keyframes:
    """Key frames (of frames, k) such that the spline through them is nowhere farther than `tolerance`, in the L2 norm.

    Starting from the first level, the middle of every interval with a frame that is too far off becomes a key frame,
    until there is no such frame.
    """
    frames = len(trajectory)
    if (kernel := native.kernel("spline_keyframes")) is not None:
        return Keyframes(frames, *kernel(trajectory, tolerance))
    at = np.arange(frames)
    keys = evenly(frames)
    while len(keys) < frames:
        off = interpolate(keys, trajectory[keys], at)
        off -= trajectory
        too_far = np.einsum("fk,fk->f", off, off) > tolerance**2
        too_far[keys] = False
        middles = (keys[:-1] + keys[1:])[np.add.reduceat(too_far, keys[:-1]) > 0] // 2
        if not len(middles):
            break
        keys = np.sort(np.concatenate([keys, middles]))
    chosen = np.zeros(frames, bool)
    chosen[keys] = True
    return _of_levels(frames, _halve(frames, lambda middles: chosen[middles]))


def _of_levels(frames: int, levels: Sequence[Frames]) -> Keyframes:
    return Keyframes(frames, np.concatenate(levels), np.array([len(level) for level in levels]))


def _halve(frames: int, ask: Callable[[Frames], Booleans]) -> tuple[Frames, ...]:
    """Levels of key frames: `ask` returns which of a level's intervals, given by their middles, are halved."""
    levels = [evenly(frames)]
    left, right = levels[0][:-1], levels[0][1:]
    while True:
        wide = right - left >= 2
        left, right = left[wide], right[wide]
        middles = (left + right) // 2
        halved = ask(middles)
        if not halved.any():
            return tuple(levels)
        left, middles, right = left[halved], middles[halved], right[halved]
        levels.append(middles)
        left, right = np.stack([left, middles], 1).ravel(), np.stack([middles, right], 1).ravel()


def splits(keys: Keyframes) -> Bytes:
    """One bit for each interval that could have been halved, level by level."""
    if (kernel := native.kernel("spline_splits")) is not None:
        return kernel(keys.by_level, keys.frames)
    chosen = np.zeros(keys.frames, bool)
    chosen[keys.by_level] = True
    asked: list[Frames] = []

    def ask(middles: Frames) -> Booleans:
        asked.append(middles)
        return chosen[middles]

    _halve(keys.frames, ask)
    return chosen[np.concatenate(asked)].astype(np.uint8)


def from_splits(bits: Bytes, frames: int) -> tuple[Keyframes, int]:
    """The key frames of a run of `frames` frames, and how many bits they took. Raises Corrupt for too few bits."""
    kernel = native.kernel("spline_from_splits")
    if kernel is not None and (found := kernel(bits, frames)) is not None:
        by_level, sizes, used = found
        return Keyframes(frames, by_level, sizes), used
    used = 0

    def ask(middles: Frames) -> Booleans:
        nonlocal used
        answer = bits[used : used + len(middles)]
        if len(answer) < len(middles):
            raise Corrupt(f"key frames of {frames} frames: their bits end too early")
        used += len(middles)
        return answer.astype(bool)

    return _of_levels(frames, _halve(frames, ask)), used


def differences(keys: Keyframes, wanted: Floats, step: float) -> tuple[Integers, Floats]:
    """Integers (keys, k) for values (keys, k), both by level, and the values that the integers give back.

    A value of the first level is stored as its difference from the one before it, later values as differences from the
    spline through all decoded values of the levels before. Errors do not add up: none is more than half a step.
    """
    kernel = native.kernel("spline_differences")
    if kernel is not None and (found := kernel(keys.by_level, keys.sizes, wanted, step)) is not None:
        return found
    numbers = np.zeros(wanted.shape, np.int64)

    def predicted(start: int, stop: int, prediction: Floats) -> Floats:
        numbers[start:stop] = quantise.forward(wanted[start:stop] - prediction, step)
        return prediction + quantise.inverse(numbers[start:stop], step)

    return numbers, _descend(keys, wanted.shape[1], predicted)


def values(keys: Keyframes, numbers: Integers, step: float) -> Floats:
    """The values (keys, k), by level, of `differences`."""
    if (kernel := native.kernel("spline_values")) is not None:
        return kernel(keys.by_level, keys.sizes, numbers, step)
    return _descend(keys, numbers.shape[1], lambda a, b, prediction: prediction + quantise.inverse(numbers[a:b], step))


def _descend(keys: Keyframes, k: int, decode: Callable[[int, int, Floats], Floats]) -> Floats:
    """Values level by level: `decode(start, stop, prediction)` gives those at [start, stop) of the order by level."""
    known = np.zeros((len(keys), k))
    frames = keys.by_level
    first, *levels = keys.levels
    stop = len(first)
    for i in range(stop):
        known[i : i + 1] = decode(i, i + 1, known[max(i - 1, 0)][None])
    for level in levels:
        start, stop = stop, stop + len(level)
        order = np.argsort(frames[:start])
        prediction = interpolate(frames[:start][order], known[:start][order], level)
        known[start:stop] = decode(start, stop, prediction)
    return known


def through(keys: Keyframes, by_level: Floats) -> Floats:
    """Every frame of the run, (frames, k), from the values at its key frames, by level."""
    return interpolate(keys.by_level[keys.order], by_level[keys.order], np.arange(keys.frames))
