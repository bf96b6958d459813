"""Context modelling: the table that codes each coefficient, from expected magnitudes and decoded neighbours.

    spreads, rate, chunk length, step ─expect─► log₂ of the expected magnitude of every coefficient
    expected magnitudes ─zone─► which coefficients are coded
    expected magnitudes, decoded neighbours ─tables─► the table of each coefficient, frequency by frequency

The coefficients of a chunk are (frequencies, rows). The magnitude of a row at one frequency is predicted as its spread,
times the ratio of its neighbours at lower frequencies to what was expected of them:

    expected · (α + Σ w |neighbour|) / (α + Σ w · expected neighbour)

All arithmetic is on integers: logarithms in 1/32 octave, magnitudes in 1/16.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ....typing import AnyInteger, Integers

OCTAVE = 32
BANDS_MHZ = (0, 200, 350, 500, 700, 1000, 1400, 2000, 2800, 4000, 5600, 8000, 11000, 16000, 22000, 32000, 45000, 60000)
"""Frequencies (mHz) at which the spread of each row is given; that of frequency 0 is given as its mean."""

CLASS_WIDTH, CLASS_LOWEST, CLASSES = 10, -260, 56
"""Tables are selected by the predicted magnitude, in classes of 10/32 octave from 2⁻⁸ on."""
SHAPES = 3
"""Each class has a table for frequency 0, one for the next three frequencies, and one for the rest."""

ALPHA = 10
"""α and the weights of neighbours, below, are sixteenths."""
NEAR, BELOW_3, OLDER, BESIDE, BLOCK = 13, 8, 6, 6, 3
"""Weights: the same row one and two frequencies below; three below; four to seven below; one row to either side, one
frequency below; and all of four rows to either side one below and of three rows to either side two below."""
DEPTH, BORDER = 7, 4
"""Farthest neighbour, in frequencies below and in rows to either side."""

SHAPE_STARTS = (0, 1, 4)
"""The first frequency of each shape."""
GROUPS = ((0, 1), (16, 2), (64, 4), (128, 8))
"""(first frequency, size): frequencies are coded in groups of this size, with the neighbours of the first of the group:
fewer steps, for less than 1 % of the bytes."""

_LOG = np.array([round(OCTAVE * math.log2(1 + i / 256)) for i in range(256)], np.int64)
_EXP = np.array([min(1 << 20, round(16 * 2 ** (i / OCTAVE))) for i in range(-512, 1024)], np.int64)


def log2(numbers: NDArray[np.integer]) -> Integers:
    """log₂ of integers ≥ 1 in 1/32 octave, the same on every machine."""
    return log2_of(numbers.astype(np.float64))


def log2_of(values: NDArray[np.float64]) -> Integers:
    """The same of positive floats."""
    mantissa, exponent = np.frexp(values)  # exact
    return (exponent.astype(np.int64) - 1) * OCTAVE + _LOG[((mantissa - 0.5) * 512).astype(np.int64)]


def exp2(logs: Integers) -> Integers:
    """Sixteen times 2^(log / 32), as an integer."""
    return _EXP[np.clip(logs, -512, 1023) + 512]


_BAND_LOGS = log2(np.array(BANDS_MHZ[1:]))
_NUMERATOR_LOGS = log2(np.arange(ALPHA, 1 << 16))
_CEILING = 300
"""Contexts clip magnitudes to this."""


def expect(spreads: Integers, means: Integers, frames: int, rate: float, step: int | Integers) -> Integers:
    """log₂ of the expected magnitude in steps, in 1/32 octave: (frames, rows).

    spreads (rows, bands): log₂ of the mean magnitude of the coefficients at each band, at 120 Hz, metres.
    means (rows,): the same of the mean over a chunk. step: log₂ of the step in metres, in 1/32 octave, of each row.
    """
    millihertz = round(rate * 1000)
    tall = np.zeros((frames, len(spreads)), np.int64)
    tall[0] = means + log2(np.array([frames])) // 2
    if frames > 1:
        k = np.arange(1, frames, dtype=np.int64)
        at, number = np.unique(log2(np.maximum(k * millihertz // (2 * frames), 1)), return_inverse=True)
        band = np.clip(np.searchsorted(_BAND_LOGS, at, side="right") - 1, 0, len(_BAND_LOGS) - 2)
        low, high = _BAND_LOGS[band], _BAND_LOGS[band + 1]
        along = np.clip(at, low, high) - low
        left, right = spreads[:, band + 1], spreads[:, band + 2]
        tall[1:] = (left + (right - left) * along // (high - low)).T[number]
        tall[1:] += (log2(np.array([max(millihertz, 1)])) - log2(np.array([120_000]))) // 2
    return tall - step


def zone(expected: Integers, threshold: int) -> Integers:
    """How many frequencies of each row are coded, (rows,): up to the last that is expected to reach the threshold."""
    reach = expected >= threshold
    return np.where(reach.any(axis=0), len(expected) - reach[::-1].argmax(axis=0), 0)


def base(expected: Integers) -> Integers:
    """What is known of a context in advance: log expected − log(α + Σ w · expected neighbour), (frequencies, rows)."""
    near = neighbourhood(bordered(np.minimum(exp2(expected), 16 * _CEILING)))
    return expected - log2(near // 16 + ALPHA)[groups(len(expected))[1]]


@lru_cache(maxsize=64)
def groups(frequencies: int) -> tuple[Integers, Integers]:
    """The first frequency of each group, (groups,), and the number of each frequency's group, (frequencies,)."""
    starts: list[int] = []
    for (first, size), (end, _) in zip(GROUPS, (*GROUPS[1:], (frequencies, 0)), strict=True):
        starts += range(first, min(end, frequencies), size)
    number = np.zeros(frequencies, np.int64)
    number[starts] = 1
    return np.array(starts, np.int64), np.cumsum(number) - 1


def bordered(magnitudes: AnyInteger) -> AnyInteger:
    """Magnitudes (frequencies, …, rows) with zeros below, 4 to either side, and one more at the left."""
    shape = (magnitudes.shape[0] + DEPTH, *magnitudes.shape[1:-1], magnitudes.shape[-1] + 2 * BORDER + 1)
    out = np.zeros(shape, magnitudes.dtype)
    out[DEPTH:, ..., BORDER + 1 : -BORDER] = magnitudes
    return out


def neighbourhood(magnitudes: Integers) -> Integers:
    """Σ w |neighbour| of each group of frequencies: bordered (frequencies + 7, …, rows + 9) → (groups, …, rows)."""
    starts = groups(len(magnitudes) - DEPTH)[0]
    inner = magnitudes[..., BORDER + 1 : -BORDER]
    older = inner[starts]
    for below in (1, 2, 3):
        older += inner[starts + below]
    return around(magnitudes[starts + 6], magnitudes[starts + 5], inner[starts + 4], older)


def around(below: AnyInteger, below_2: AnyInteger, below_3: AnyInteger, older: AnyInteger) -> Integers:
    """Σ w |neighbour| from bordered magnitudes (…, rows + 9) one and two frequencies below, and plain ones (…, rows)
    three below and summed over four to seven below."""
    left, right = np.cumsum(below, axis=-1), np.cumsum(below_2, axis=-1)
    total = left[..., 9:] - left[..., :-9]
    total += right[..., 8:-1]
    total -= right[..., 1:-8]
    total *= BLOCK
    total += (below + below_2)[..., 5:-4] * NEAR
    total += (below[..., 4:-5] + below[..., 6:-3]) * BESIDE
    total += below_3 * BELOW_3
    total += older * OLDER
    return total


@lru_cache(maxsize=8)
def weights(rows: int) -> NDArray[np.float32]:
    """`neighbourhood` as one matrix product, (frequencies below, lowest first, · rows, rows).

    Its sums are small integers, which floats represent exactly in any order of summation.
    """
    out = np.zeros((DEPTH, rows, rows), np.float32)
    apart = np.abs(np.arange(rows)[:, None] - np.arange(rows))
    out[:4] = OLDER * (apart == 0)
    out[4] = BELOW_3 * (apart == 0)
    out[5] = NEAR * (apart == 0) + BLOCK * (apart < BORDER)
    out[6] = NEAR * (apart == 0) + BESIDE * (apart == 1) + BLOCK * (apart <= BORDER)
    return out.reshape(DEPTH * rows, rows)


def tables(base_here: AnyInteger, neighbours: Integers, shape: int) -> Integers:
    """The table of each coefficient, from its `base` and the weighted sum of its neighbours."""
    logs = _NUMERATOR_LOGS.take(neighbours, mode="clip")
    logs = logs + base_here
    logs -= _FIRST_CLASS
    out = _CLASS_OF.take(logs, mode="clip")
    out += shape * CLASSES
    return out


_FIRST_CLASS = CLASS_LOWEST - CLASS_WIDTH
_CLASS_OF = (np.arange(CLASS_WIDTH * (CLASSES + 2)) // CLASS_WIDTH - 1).clip(0, CLASSES - 1)
"""The class of a logarithm, from `_FIRST_CLASS` on, clipped to the first and last class."""


def ceiling(magnitudes: Integers) -> Integers:
    return np.minimum(magnitudes, _CEILING)


def all_tables(base_: Integers, magnitudes: Integers) -> Integers:
    """The tables of all coefficients of a chunk, (frequencies, rows), given all magnitudes: for the encoder."""
    logs = _NUMERATOR_LOGS.take(neighbourhood(bordered(ceiling(magnitudes))), mode="clip")
    logs = logs[groups(len(base_))[1]]
    logs += base_
    logs -= _FIRST_CLASS
    out = _CLASS_OF.take(logs, mode="clip")
    out += shapes(len(base_))[:, None] * CLASSES
    return out


@lru_cache(maxsize=64)
def lookup(frequencies: int) -> tuple[Integers, Integers, int, Integers, Integers]:
    """Constants of this module for the compiled one, for a number of frequencies."""
    starts = groups(frequencies)[0]
    return _NUMERATOR_LOGS, _CLASS_OF, _FIRST_CLASS, starts, shapes(frequencies) * CLASSES


def constants() -> tuple[Integers, Integers, int, Integers]:
    """Constants of this module for whole chunks in the compiled one."""
    return _NUMERATOR_LOGS, _CLASS_OF, _FIRST_CLASS, _EXP


def shapes(frequencies: int) -> Integers:
    """The shape of each frequency's tables, (frequencies,)."""
    return np.searchsorted(SHAPE_STARTS, np.arange(frequencies), side="right") - 1
