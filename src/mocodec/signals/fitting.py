"""The encoder's choice of predictors in a chunk: weighted least squares in floats, then taps rounded to integers.

short fit of each channel ─► local size of its residuals ─► weights
differences of all channels ─► for each, the earlier channels that explain it best (orthogonal matching pursuit)
own past, other channels ─► nested fits ─► the one of the shortest code
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..typing import Booleans, Floats, Integers
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
FIT_SAMPLES = 3072
"""Predictors are fitted to about so many samples of a chunk, in blocks that are spread over it."""
RIDGE = 1e-13
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


def choose(channels: Sequence[Channel | None]) -> list[Predictor | None]:
    """A predictor for each channel; None for the first sample of the chunk in place of a prediction."""
    present = [i for i, channel in enumerate(channels) if channel is not None and channel.kept.sum() >= MIN_SAMPLES]
    result: list[Predictor | None] = [None] * len(channels)
    if not present:
        return result
    differences = np.array([np.diff(c.samples, prepend=c.samples[:1]) for i in present if (c := channels[i])], float)
    depth = dict.fromkeys(present, 0)
    ranks = {i: channel.rank for i in present if (channel := channels[i])}
    for i in sorted(present, key=ranks.__getitem__):
        channel = channels[i]
        assert channel is not None
        earlier = [
            place
            for place, j in enumerate(present)
            if ranks[j] < ranks[i] and depth[j] < MAX_DEPTHS[not channel.is_counts]
        ]
        named = [present[place] for place in _pursuit(differences, present.index(i), earlier, channel.kept)]
        predictor = _fit(channel, [(j, other.samples) for j in named if (other := channels[j])])
        result[i] = predictor
        if predictor is not None and predictor.references:
            depth[i] = 1 + max(depth[j] for j, _ in predictor.references)
    return result


def code_bits(residuals: Integers | Floats) -> float:
    """About how many bits residuals take: their size varies slowly."""
    if not len(residuals):
        return 0.0
    starts = np.arange(0, len(residuals), BLOCK)
    means = np.add.reduceat(np.abs(residuals).astype(np.float64), starts)
    counts = np.diff(np.append(starts, len(residuals)))
    return float((counts * np.log2(means / counts + 0.3)).sum())


def _rows(count: int) -> Integers:
    """Samples to fit to: all, or blocks at equal distances."""
    blocks = -(-count // BLOCK)
    step = -(-blocks * BLOCK // FIT_SAMPLES)
    rows = (np.arange(0, blocks, step)[:, None] * BLOCK + np.arange(BLOCK)).ravel()
    return rows[rows < count]


def _pursuit(differences: Floats, target: int, candidates: list[int], kept: Booleans) -> list[int]:
    """The candidates (rows of differences) that explain the target best, one after the other, while each pays for its
    taps: linear relations between channels hold between their differences too."""
    usable = kept.copy()
    usable[1:] &= kept[:-1]
    rows = np.flatnonzero(usable)
    rows = rows[_rows(len(rows))]
    if not candidates or len(rows) < MIN_SAMPLES:
        return []
    weights = _weights(differences[target, rows])
    left = differences[target, rows] * weights
    others = differences[candidates][:, rows] * weights
    sizes = (others * others).sum(axis=1)
    start, floor = sizes.copy(), 1e-13 * float(left @ left)
    chosen: list[int] = []
    while len(chosen) < min(MOST_REFERENCES, len(candidates)):
        energy = float(left @ left)
        gains = np.where(sizes > 1e-9 * start, (others @ left) ** 2 / np.maximum(sizes, 1e-300), 0.0)
        best = int(gains.argmax())
        after = max(energy - gains[best], floor, 1e-300)
        if energy <= floor or len(kept) / 2 * np.log2(energy / after) < TAP_BITS * REFERENCE_TAPS:
            break
        chosen.append(candidates[best])
        direction = others[best] / np.sqrt(sizes[best])
        left = left - (left @ direction) * direction
        others -= np.outer(others @ direction, direction)
        sizes = (others * others).sum(axis=1)
    return chosen


def _fit(channel: Channel, others: Sequence[tuple[int, Integers]]) -> Predictor | None:
    """The predictor of the shortest code, None if the first sample predicts as well."""
    kept = channel.kept
    own = channel.samples if kept.all() else channel.samples[kept]
    first = own[0]
    count = len(own)
    rows = _rows(count)
    order = max(p for p in ORDERS if p <= max(1, count // 8))
    shifted = np.concatenate([np.zeros(order, np.int64), own - first])
    columns = [shifted[rows + order - i] for i in range(1, order + 1)]
    places = np.flatnonzero(kept)[rows]
    for _, samples in others:
        columns += [samples[np.maximum(places - j, 0)] - samples[0] for j in range(REFERENCE_TAPS)]
    matrix = np.empty((len(rows), len(columns) + 2))
    matrix[:, 0], matrix[:, -1] = 1, shifted[rows + order]
    for place, column in enumerate(columns, 1):
        matrix[:, place] = column
    start = [*range(min(FIRST_ORDER, order) + 1), matrix.shape[1] - 1]
    residuals = _residuals(matrix, start, _solve(_gram(matrix[:, start])))
    gram = _gram(matrix * _weights(residuals)[:, None])
    best, best_bits = None, code_bits(own - first)
    for subset in _subsets(order, len(others), count, gram):
        taken = [*subset, len(gram) - 1]
        taps = _solve(gram[np.ix_(taken, taken)])
        log_residual = code_bits(_residuals(matrix, taken, taps)) / len(rows)
        predictor = _rounded(taps, subset, order, others, int(first), log_residual, matrix)
        sums = prediction.known_sums(predictor, dict(others), kept)
        bits = code_bits(prediction.forward(own, predictor, sums)) + 8 * len(prediction.pack(predictor))
        if bits < best_bits:
            best, best_bits = predictor, bits
    return best


def _weights(residuals: Floats) -> Floats:
    """The inverse of the local size of residuals."""
    starts = np.arange(0, len(residuals), BLOCK)
    counts = np.diff(np.append(starts, len(residuals)))
    means = np.add.reduceat(np.abs(residuals), starts) / counts
    smooth = (np.concatenate([means[:1], means[:-1]]) + means + np.concatenate([means[1:], means[-1:]])) / 3
    return np.repeat(1.0 / (smooth + 0.3 + 1e-3 * means.mean()), counts)


def _gram(matrix: Floats) -> Floats:
    return matrix.T @ matrix


def _solve(gram: Floats) -> Floats:
    """Weights of all columns but the last, which they sum up to in least squares."""
    scale = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    normal = gram * scale[:, None] * scale
    size = len(normal) - 1
    weights = np.linalg.solve(normal[:-1, :-1] + RIDGE * np.eye(size), normal[:-1, -1])
    return weights * scale[:-1] / scale[-1]


def _residuals(matrix: Floats, columns: list[int], weights: Floats) -> Floats:
    return matrix[:, columns[-1]] - matrix[:, columns[:-1]] @ weights


def _subsets(order: int, others: int, count: int, gram: Floats) -> list[list[int]]:
    """Columns of the fits to try: the best order by its error in the Gram matrix, with and without other channels."""
    references = list(range(1 + order, 1 + order + REFERENCE_TAPS * others))
    subsets = []
    for extra in [references] if others else []:
        subsets.append(_best_order(order, extra, count, gram))
    subsets.append(_best_order(order, [], count, gram))
    return subsets


def _best_order(order: int, extra: list[int], count: int, gram: Floats) -> list[int]:
    best, best_bits = [0], np.inf
    for p in (p for p in (0, *ORDERS) if p <= order):
        subset = [*range(1 + p), *extra]
        rows = [*subset, len(gram) - 1]
        part = gram[np.ix_(rows, rows)]
        taps = _solve(part)
        error = max(part[-1, -1] - 2 * taps @ part[:-1, -1] + taps @ part[:-1, :-1] @ taps, 1e-12 * part[-1, -1], 1e-12)
        bits = count / 2 * np.log2(error) + TAP_BITS * p
        if bits < best_bits:
            best, best_bits = subset, bits
    return best


def _rounded(
    taps: Floats,
    subset: list[int],
    order: int,
    others: Sequence[tuple[int, Integers]],
    first: int,
    log_residual: float,
    matrix: Floats,
) -> Predictor:
    """Taps as integers, as fine as the size of the samples needs, and the bias for samples as they are."""
    largest = float(np.abs(matrix[:, subset[1:]]).max(initial=1.0))
    reach = max([abs(first), *(int(np.abs(samples).max()) for _, samples in others)]) + int(largest)
    most = MOST_SUM_BITS - reach.bit_length()
    shift = int(np.clip(np.ceil(np.log2(largest) - log_residual) + 3, 4, most))
    while True:
        whole = [round(float(tap) * 2.0**shift) for tap in taps]
        own = tuple(whole[1 : 1 + sum(1 <= column <= order for column in subset)])
        rest = whole[1 + len(own) :]
        references = tuple(
            (channel, tuple(rest[REFERENCE_TAPS * i :][:REFERENCE_TAPS]))
            for i, (channel, _) in enumerate(others if rest else ())
        )
        bias = whole[0] + (first << shift) - first * sum(own)
        for (_, samples), (_, weights) in zip(others, references, strict=False):
            bias -= int(samples[0]) * sum(weights)
        if shift <= 0 or max(map(abs, [bias >> 8, *whole[1:]])) < prediction.MAX_TAP:
            return Predictor(shift, bias, own, references)
        shift -= 1
