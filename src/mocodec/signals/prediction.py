"""Linear prediction in integers: a sample from its channel's past and from channels that are decoded before it.

    prediction[t] = (bias + Σᵢ own[i] · x[t − 1 − i] + Σ_channels Σⱼ taps[j] · y[t − j]) >> shift
    residual[t] = x[t] − prediction[t]

Before its first sample a channel has the value of the first. Sums wrap around at 64 bits, as in C and NumPy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .. import native
from ..entropy.varint import signed as zigzag
from ..entropy.varint import write
from ..fields.cursor import Cursor
from ..typing import Booleans, Integers

MAX_PREDICTION = 1 << 29
REFERENCE_TAPS = 3
"""The current sample of another channel and the two before."""
MAX_ORDER, MAX_REFERENCES, MAX_SHIFT, MAX_TAP = 32, 16, 48, 1 << 52


@dataclass(frozen=True)
class Predictor:
    """Taps as integers, in 2^−shift. references: the number of another channel, and its taps."""

    shift: int
    bias: int
    own: tuple[int, ...] = ()
    references: tuple[tuple[int, tuple[int, ...]], ...] = ()


def pack(predictor: Predictor) -> bytes:
    """shift, order, number of references; the references' channels; then bias and all taps."""
    numbers = [predictor.bias, *predictor.own, *(tap for _, taps in predictor.references for tap in taps)]
    head = bytes([predictor.shift, len(predictor.own), len(predictor.references)])
    return head + write([channel for channel, _ in predictor.references]) + write([zigzag(n) for n in numbers])


def unpack(cursor: Cursor, channels: int) -> Predictor:
    """The inverse of `pack`; channels: how many the signal has. Raises Corrupt."""
    shift, order, count = cursor.take(3)
    if shift > MAX_SHIFT or order > MAX_ORDER or count > MAX_REFERENCES:
        raise cursor.corrupt("a predictor is out of range")
    named = [cursor.varint() for _ in range(count)]
    if any(channel >= channels for channel in named):
        raise cursor.corrupt("a predictor refers to a channel that does not exist")
    numbers = [cursor.signed() for _ in range(1 + order + REFERENCE_TAPS * count)]
    if any(abs(number) > MAX_TAP for number in numbers[1:]):
        raise cursor.corrupt("a predictor is out of range")
    taps = [tuple(numbers[1 + order + REFERENCE_TAPS * i :][:REFERENCE_TAPS]) for i in range(count)]
    return Predictor(shift, numbers[0], tuple(numbers[1 : 1 + order]), tuple(zip(named, taps, strict=True)))


def known_sums(predictor: Predictor, others: Mapping[int, Integers], kept: Booleans) -> Integers:
    """The part of the sums that does not depend on the channel itself, for the samples that are kept.

    others: samples (n,) of the channels that the predictor refers to. kept (n,).
    """
    sums = np.full(len(kept), predictor.bias + (1 << predictor.shift >> 1), np.int64)
    for channel, taps in predictor.references:
        _add_taps(sums, others[channel], taps, 0)
    return sums if kept.all() else sums[kept]


def forward(samples: Integers, predictor: Predictor, sums: Integers) -> Integers:
    """Residuals of samples (n,); sums: from `known_sums`."""
    total = sums.copy()
    _add_taps(total, samples, predictor.own, 1)
    return samples - _prediction(total, predictor.shift)


def inverse(lanes: Sequence[tuple[Integers, Integers, int]], predictors: Sequence[Predictor]) -> list[Integers]:
    """Samples of lanes that do not depend on each other, from residuals, known sums and first sample of each."""
    if (kernel := native.kernel("signals_restore")) is not None:
        return [
            kernel(residuals, sums, np.array(predictor.own, np.int64), predictor.shift, first)
            for (residuals, sums, first), predictor in zip(lanes, predictors, strict=True)
        ]
    return _inverse_side_by_side(lanes, predictors)


def _inverse_side_by_side(
    lanes: Sequence[tuple[Integers, Integers, int]], predictors: Sequence[Predictor]
) -> list[Integers]:
    """`inverse` in NumPy: all lanes at a time."""
    order = max((len(predictor.own) for predictor in predictors), default=0)
    steps = max((len(residuals) for residuals, _, _ in lanes), default=0)
    taps = np.zeros((len(lanes), order), np.int64)
    past = np.zeros((len(lanes), order + steps), np.int64)
    residual, known = np.zeros((2, len(lanes), steps), np.int64)
    for row, ((residuals, sums, first), predictor) in enumerate(zip(lanes, predictors, strict=True)):
        taps[row, order - len(predictor.own) :] = predictor.own[::-1]
        past[row, :order] = first
        residual[row, : len(residuals)], known[row, : len(sums)] = residuals, sums
    shift = np.array([predictor.shift for predictor in predictors], np.int64)
    for t in range(steps):
        total = known[:, t] + (taps * past[:, t : t + order]).sum(axis=1)
        past[:, order + t] = residual[:, t] + _prediction(total, shift)
    return [past[row, order : order + len(lane[0])].copy() for row, lane in enumerate(lanes)]


def _prediction(sums: Integers, shift: int | Integers) -> Integers:
    return np.clip(sums >> shift, -MAX_PREDICTION, MAX_PREDICTION)


def _add_taps(sums: Integers, samples: Integers, taps: Sequence[int], delay: int) -> None:
    """Add taps[i] · samples[t − delay − i] to sums[t]; the first sample stands before the first."""
    if not len(samples) or not taps:
        return
    if (kernel := native.kernel("signals_add_taps")) is not None:
        kernel(sums, samples, np.array(taps, np.int64), delay)
        return
    for i, tap in enumerate(taps, delay):
        sums += tap * np.concatenate([np.full(min(i, len(samples)), samples[0]), samples[: max(0, len(samples) - i)]])
