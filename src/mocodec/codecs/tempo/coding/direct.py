"""Direct coding, for what no transform suits: samples on a grid, each predicted from its neighbours in time.

    positions ──round to a grid──► integers ──interpolate, coarse to fine──► residuals ──► bytes

The grid's cells lie within the bound, so the bound holds without search, whatever the motion. A frame between two known
ones is predicted by the cubic through the four nearest, as in SZ3 (Zhao et al. 2021), but in integers.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .... import native
from ....entropy import coder
from ....errors import CannotEncode
from ....typing import Floats, Integers

LARGEST = 1 << 50


def cell(bound: float) -> float:
    """The side of a cube whose corners are within the bound of its middle, with room for rounding."""
    return bound * 2 / 3**0.5 * (1 - 1e-9)


def quantise(positions: Floats, step: float) -> Integers:
    """Positions in steps, (frames, points, 3), rounded. Raises CannotEncode where they are too large."""
    scaled = positions / step
    if not (np.abs(scaled) < LARGEST).all():
        raise CannotEncode(
            f"positions of up to {np.abs(positions).max():.3g} m cannot be held in steps of {step:.3g} m"
        )
    return np.rint(scaled).astype(np.int64)


def pack(values: Integers) -> bytes:
    """Integers (frames, coordinates) as bytes."""
    order, level = _order(len(values))
    return coder.pack(_residuals(values)[order], contexts=np.repeat(level[:, None], values.shape[1], axis=1))


def unpack(data: bytes, shape: tuple[int, int]) -> Integers:
    """The integers (frames, coordinates) of `pack`. Raises Corrupt."""
    order, level = _order(shape[0])
    residuals = np.empty(shape, np.int64)
    residuals[order] = coder.unpack(data, shape, contexts=np.repeat(level[:, None], shape[1], axis=1))
    values = residuals
    for _, middle, around in _levels(shape[0]):
        values[middle] += _predict(values, middle, around)
    return values


def estimate(positions: Floats, step: float, every: int = 1) -> float:
    """Estimate of the bytes of `pack` for positions (frames, points, 3) in steps of `step` metres.

    It is made from the mean residual of each coordinate of one point in `every`. Raises CannotEncode where residuals
    are too large.
    """
    frames, points = positions.shape[:2]
    sums = None
    if (kernel := native.kernel("direct_residuals")) is not None:
        sums = kernel(positions, step, every, LARGEST)
    if sums is None:
        sums = np.abs(_residuals(quantise(positions[:, ::every], step).reshape(frames, -1))[1:]).sum(axis=0)
    size = sums / max(1, frames - 1)
    some = frames * np.log2(1 + 2.5 * size).sum() / 8 + 4 * len(size)
    return float(some * 3 * points / len(size))


def _residuals(values: Integers) -> Integers:
    out = values.copy()
    for _, middle, around in _levels(len(values)):
        out[middle] -= _predict(values, middle, around)
    return out


def _order(frames: int) -> tuple[Integers, Integers]:
    """Frames in the order of prediction, and the level of each."""
    parts = [(level, middle) for level, middle, _ in _levels(frames)]
    return np.concatenate([m for _, m in parts]), np.concatenate([np.full(len(m), level) for level, m in parts])


def _levels(frames: int) -> Iterator[tuple[int, Integers, int]]:
    """Level, the frames that it adds, and the distance of their known neighbours (0: none)."""
    stride = 1
    while stride < frames - 1:
        stride *= 2
    yield 0, np.zeros(1, np.int64), 0
    level = 1
    if frames > 1:
        yield level, np.array([min(stride, frames - 1)]), stride
    while stride > 1:
        stride //= 2
        level += 1
        middle = np.arange(stride, frames, 2 * stride)
        middle = middle[middle < frames - 1] if stride > 1 or frames > 2 else middle
        middle = middle[middle != frames - 1]
        if len(middle):
            yield level, middle, stride


def _predict(values: Integers, middle: Integers, around: int) -> Integers:
    """Prediction of the `middle` frames from the known ones that are `around` and 3 · `around` frames away."""
    if around == 0:
        return np.zeros((1, values.shape[1]), np.int64)
    if len(middle) == 1 and middle[0] + around >= len(values) and middle[0] in (len(values) - 1,):
        return values[:1]
    last = len(values) - 1
    before, after = values[middle - around], values[np.minimum(middle + around, last)]
    line = before + after
    has_cubic = (middle >= 3 * around) & (middle + 3 * around <= last)
    outer = values[np.maximum(middle - 3 * around, 0)] + values[np.minimum(middle + 3 * around, last)]
    return np.where(has_cubic[:, None], (9 * line - outer + 8) >> 4, (line + 1) >> 1)
