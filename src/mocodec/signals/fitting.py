"""The encoder's choice of predictors in a chunk: weighted least squares in floats, then taps rounded to integers.

short fit of each channel ─► local size of its residuals ─► weights
differences of all channels ─► for each, the earlier channels that explain it best (orthogonal matching pursuit)
own past, other channels ─► nested fits ─► the one of the shortest code

The compiled module chooses for all channels of a chunk in one call and gives the same bits: sums run from the first row
to the last (`_sum`), logarithms are `_log2`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import native
from ..typing import Booleans, Bytes, Floats, Integers
from . import prediction
from .prediction import REFERENCE_TAPS, Predictor

ORDERS = (1, 2, 4, 8, 16)
FIRST_ORDER = 8
MAX_DEPTHS = (3, 6)
"""How long a chain of references is at most, for channels of counts and for others: all that others refer to is then
free to be counts. NumPy restores the channels of one depth side by side."""
MOST_REFERENCES = 8
BLOCK = 32
TAP_BITS = 12.0
MIN_SAMPLES = 24
FIT_SAMPLES = 2048
"""Number of samples of a chunk that predictors are fitted to, about: blocks that are spread over it."""
PURSUIT_SAMPLES = 640
"""The same for the choice of other channels."""
RIDGE = 1e-13
LEAST_PIVOT = 1e-14
LOG2_CUBIC = (1.2556887796, -4.1961258395, 6.0966363124, -3.1560362794)
"""log₂ of mantissas from 0.5 to 1."""
GRAM_ROWS = 128
MOST_SUM_BITS = 58
"""Samples times taps stay below 2 to this power, so that sums do not wrap around."""


@dataclass(frozen=True, eq=False)
class Channel:
    """A channel in a chunk: integers of all samples (n,), as others refer to them; which are kept."""

    samples: Integers
    kept: Booleans
    rank: int
    """Predictors refer to channels of a lower rank only."""
    is_counts: bool = True


@dataclass(frozen=True, eq=False)
class Choice:
    """The predictor of a channel, None for the first sample of the chunk in its place, and what it leaves of the kept
    samples (n,)."""

    predictor: Predictor | None
    residuals: Integers


def choose(channels: Sequence[Channel | None], alone: bool = False) -> list[Choice | None]:
    """The choice for each channel.

    alone: predictors refer to no other channel.
    """
    result: list[Choice | None] = [None] * len(channels)
    numbers: list[int] = []
    present: list[Channel] = []
    for i, channel in enumerate(channels):
        if channel is not None and np.count_nonzero(channel.kept) >= MIN_SAMPLES:
            numbers.append(i)
            present.append(channel)
        elif channel is not None:
            own = channel.samples[channel.kept]
            result[i] = Choice(None, own - own[0])
    if not present:
        return result
    samples = np.array([channel.samples for channel in present])
    choose_all = native.kernel("signals_choose") or _choose_in_numpy
    kept = np.array([channel.kept for channel in present], np.uint8)
    ranks = np.array([channel.rank for channel in present], np.int64)
    are_counts = np.array([channel.is_counts for channel in present], np.uint8)
    chosen = choose_all(samples, kept, np.array(numbers, np.int64), ranks, are_counts, alone)
    for i, (predictor, residuals) in zip(numbers, chosen, strict=True):
        result[i] = Choice(None if predictor is None else Predictor(*predictor), residuals)
    return result


def _choose_in_numpy(
    samples: Integers, kept: Bytes, numbers: Integers, ranks: Integers, are_counts: Bytes, alone: bool
) -> list[tuple[tuple[Any, ...] | None, Integers]]:
    """Fields of the predictors, and residuals, of channels (channels, samples) with these numbers in the signal."""
    depth = [0] * len(samples)
    result: list[tuple[tuple[Any, ...] | None, Integers]] = [(None, samples[0])] * len(samples)
    for i in np.argsort(ranks, kind="stable").tolist():
        used = kept[i] != 0
        deepest = MAX_DEPTHS[not are_counts[i]]
        earlier = [j for j in range(len(samples)) if not alone and ranks[j] < ranks[i] and depth[j] < deepest]
        named = _pursuit(samples, i, earlier, used)
        predictor, left = _fit(samples[i], used, [int(numbers[j]) for j in named], samples[named])
        if predictor is not None and predictor.references:
            depth[i] = 1 + max(depth[j] for j in named)
        fields = predictor and (predictor.shift, predictor.bias, predictor.own, predictor.references)
        result[i] = fields, left
    return result


def _code_bits(sizes: Floats) -> float:
    """About how many bits residuals of these sizes (n,) take: their size varies slowly."""
    counts, sums = _blocks(sizes)
    return float(_sum(counts * _log2(sums / counts + 0.3)))


def _bits_of(residuals: Integers) -> float:
    return _code_bits(np.abs(residuals.astype(np.float64)))


def _blocks(values: Floats) -> tuple[Floats, Floats]:
    """How many values (n,) each block has, and their sums."""
    blocks = -(-len(values) // BLOCK)
    padded = np.zeros(blocks * BLOCK)
    padded[: len(values)] = values
    counts = np.full(blocks, float(BLOCK))
    counts[-1] -= blocks * BLOCK - len(values)
    return counts, _sum(padded.reshape(blocks, BLOCK).T)


def _sum(terms: Floats) -> Any:
    """The sum over the first axis, from its first to its last."""
    return np.add.accumulate(terms, axis=0)[-1]


def _log2(values: Floats) -> Floats:
    """Logarithms of positive numbers, within 0.002: a cubic of the mantissa."""
    mantissa, exponent = np.frexp(values)
    return ((LOG2_CUBIC[0] * mantissa + LOG2_CUBIC[1]) * mantissa + LOG2_CUBIC[2]) * mantissa + LOG2_CUBIC[3] + exponent


def _rows(count: int, most: int) -> Integers:
    """Indices of at most about `most` samples: all, or blocks at equal distances."""
    blocks = -(-count // BLOCK)
    step = -(-blocks * BLOCK // most)
    rows = (np.arange(0, blocks, step)[:, None] * BLOCK + np.arange(BLOCK)).ravel()
    return rows[rows < count]


def _pursuit(samples: Integers, target: int, candidates: list[int], kept: Booleans) -> list[int]:
    """The candidates (rows of samples) whose differences explain those of the target best, one after the other, while
    each pays for its taps: linear relations between channels hold between their differences too."""
    usable = kept.copy()
    usable[1:] &= kept[:-1]
    rows = np.flatnonzero(usable)
    rows = rows[_rows(len(rows), PURSUIT_SAMPLES)]
    if not candidates or len(rows) < MIN_SAMPLES:
        return []
    least = TAP_BITS * REFERENCE_TAPS / (len(kept) / 2)
    most = min(MOST_REFERENCES, len(candidates))
    return _orthogonal_pursuit(samples, target, candidates, rows, least, most)


def _orthogonal_pursuit(
    samples: Integers, target: int, candidates: list[int], rows: Integers, least: float, most: int
) -> list[int]:
    """`_pursuit` at these samples. least: by how many bits a sample a channel must shorten the target."""
    before = np.maximum(rows - 1, 0)
    left = (samples[target, rows] - samples[target, before]).astype(np.float64)
    others = (samples[candidates][:, rows] - samples[candidates][:, before]).T.astype(np.float64)
    weights = _weights(left)
    left, others = left * weights, others * weights[:, None]
    sizes = start = _sum(others * others)
    floor = 1e-13 * _sum(left * left)
    chosen: list[int] = []
    while len(chosen) < most:
        energy, products = _sum(left * left), _sum(others * left[:, None])
        gains = np.where(sizes > 1e-9 * start, products * products / np.maximum(sizes, 1e-300), 0.0)
        best = int(gains.argmax())
        after = max(energy - gains[best], floor, 1e-300)
        if energy <= floor or _log2(energy / after) < least:
            break
        chosen.append(candidates[best])
        direction = others[:, best] / np.sqrt(sizes[best])
        left = left - _sum(left * direction) * direction
        others = others - _sum(others * direction[:, None]) * direction[:, None]
        sizes = _sum(others * others)
    return chosen


@dataclass(frozen=True, eq=False)
class _Fit:
    """Taps of least squares: the bias, those of other channels or none, those of the own past.

    size_log2: of its residuals, bits a sample. largest: the largest number that a tap multiplies.
    """

    taps: Floats
    size_log2: float
    largest: float


def _fit(samples: Integers, kept: Booleans, numbers: list[int], others: Integers) -> tuple[Predictor | None, Integers]:
    """The predictor of the shortest code, None if the first sample predicts as well, and its residuals.

    others (channels, n), with these numbers.
    """
    own = samples if kept.all() else samples[kept]
    first = int(own[0])
    rows = _rows(len(own), FIT_SAMPLES)
    places = np.flatnonzero(kept)
    order = max(p for p in ORDERS if p <= max(1, len(own) // 8))
    best, left = None, own - first
    best_bits = _bits_of(left)
    for i, fitted in enumerate(_fits(own, places, others, rows, order)):
        named = list(zip(numbers, others, strict=True)) if i == 0 else []
        predictor = _rounded(fitted, named, first)
        sums = prediction.known_sums(predictor, dict(named), kept)
        residuals = prediction.forward(own, predictor, sums)
        bits = _bits_of(residuals) + 8 * len(prediction.pack(predictor))
        if bits < best_bits:
            best, best_bits, left = predictor, bits, residuals
    return best, left


def _fits(own: Integers, places: Integers, others: Integers, rows: Integers, order: int) -> list[_Fit]:
    """A fit of these rows, and if there are other channels one without them, each with the best order.

    own (n,): samples of the channel that are kept, their places in others (channels, m).
    """
    first, count = own[0], len(own)
    shifted = np.concatenate([np.zeros(order, np.int64), own - first])
    columns = [np.ones(len(rows), np.int64)]
    for samples in others:
        columns += [samples[np.maximum(places[rows] - j, 0)] - samples[0] for j in range(REFERENCE_TAPS)]
    columns += [shifted[rows + order - i] for i in range(order + 1) if i] + [shifted[rows + order]]
    matrix = np.array(columns).T.astype(np.float64)
    past = matrix[:, 1 + REFERENCE_TAPS * len(others) :]
    alone = np.concatenate([matrix[:, :1], past], axis=1)
    short = np.concatenate([alone[:, : 1 + min(FIRST_ORDER, order)], alone[:, -1:]], axis=1)
    taps = _taps(*_cholesky(_gram(short)), short.shape[1] - 1)
    weights = _weights(_residual(short, taps))[:, None]
    gram = _gram(matrix * weights)
    inside = np.r_[0, 1 + REFERENCE_TAPS * len(others) : len(gram)]
    result = []
    for columns_of, sums in ((matrix, gram), (alone, gram[np.ix_(inside, inside)]))[: 2 if len(others) else 1]:
        fixed = len(sums) - 1 - order
        lower, scale = _cholesky(sums)
        size = _best_size(lower, fixed, order, count)
        taps = _taps(lower, scale, size)
        used = np.concatenate([columns_of[:, :size], columns_of[:, -1:]], axis=1)
        largest = float(np.abs(used[:, 1:]).max(initial=1.0))
        result.append(_Fit(taps, _code_bits(np.abs(_residual(used, taps))) / len(rows), largest))
    return result


def _weights(residuals: Floats) -> Floats:
    """The inverse of the local size of residuals (n,)."""
    counts, sums = _blocks(np.abs(residuals))
    means = sums / counts
    smooth = (np.concatenate([means[:1], means[:-1]]) + means + np.concatenate([means[1:], means[-1:]])) / 3
    usual = _sum(means) / len(means)
    return np.repeat(1.0 / (smooth + 0.3 + 1e-3 * usual), BLOCK)[: len(residuals)]


def _gram(matrix: Floats) -> Floats:
    """Sums of products of columns."""
    size = matrix.shape[1]
    result = np.zeros((1, size * size))
    for start in range(0, len(matrix), GRAM_ROWS):
        rows = matrix[start : start + GRAM_ROWS]
        products = (rows[:, :, None] * rows[:, None, :]).reshape(len(rows), -1)
        result = _sum(np.concatenate([result, products]))[None]
    return result.reshape(size, size)


def _cholesky(gram: Floats) -> tuple[Floats, Floats]:
    """The lower triangle of a Gram matrix of columns scaled to size 1, with a ridge, and the scale of each column."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    left = gram * scale[:, None] * scale
    left[np.arange(len(left) - 1), np.arange(len(left) - 1)] += RIDGE
    lower = np.zeros_like(left)
    for k in range(len(left) - 1):
        lower[k:, k] = left[k:, k] / np.sqrt(np.maximum(left[k, k], LEAST_PIVOT))
        left[k + 1 :, k + 1 :] -= lower[k + 1 :, k, None] * lower[k + 1 :, k]
    return lower, scale


def _taps(lower: Floats, scale: Floats, size: int) -> Floats:
    """Weights of the first `size` columns, which sum up to the last column in least squares."""
    taps = lower[-1, :size].copy()
    for k in reversed(range(size)):
        taps[k] = taps[k] / lower[k, k]
        taps[:k] -= lower[k, :k] * taps[k]
    return taps * scale[:size] / scale[-1]


def _best_size(lower: Floats, fixed: int, order: int, count: int) -> int:
    """How many columns to use: the first `fixed` ones, and as many of the own past as pay for their taps."""
    best, least = fixed, np.inf
    error = 1.0
    for size in range(fixed + order + 1):
        p = size - fixed
        if p in (0, *ORDERS):
            bits = count / 2 * float(_log2(np.array([max(error, 1e-12)]))[0]) + TAP_BITS * p
            if bits < least:
                best, least = size, bits
        if size < fixed + order:
            error -= float(lower[-1, size]) * float(lower[-1, size])
    return best


def _residual(matrix: Floats, taps: Floats) -> Floats:
    """The last column minus its prediction from the others by the taps."""
    return matrix[:, -1] - _sum((matrix[:, :-1] * taps).T)


def _rounded(fit: _Fit, others: Sequence[tuple[int, Integers]], first: int) -> Predictor:
    """Taps as integers, as fine as the size of the samples needs, and the bias for samples as they are.

    others: number and samples of each other channel.
    """
    reach = max([abs(first), *(int(np.abs(samples).max()) for _, samples in others)]) + int(fit.largest)
    most = MOST_SUM_BITS - reach.bit_length()
    wanted = np.ceil(_log2(np.array([fit.largest]))[0] - fit.size_log2) + 3
    shift = int(min(max(wanted, 4), most))
    while True:
        whole = [round(tap * 2.0**shift) for tap in fit.taps.tolist()]
        split = 1 + REFERENCE_TAPS * len(others)
        own = tuple(whole[split:])
        references = tuple(
            (channel, tuple(whole[1 + REFERENCE_TAPS * i :][:REFERENCE_TAPS])) for i, (channel, _) in enumerate(others)
        )
        bias = whole[0] + (first << shift) - first * sum(own)
        for (_, samples), (_, weights) in zip(others, references, strict=True):
            bias -= int(samples[0]) * sum(weights)
        if shift <= 0 or max(map(abs, [bias >> 8, *whole[1:]])) < prediction.MAX_TAP:
            return Predictor(shift, bias, own, references)
        shift -= 1
