"""Prediction residuals to bytes: an adaptive coder whose tables start from the shape of noise.

    running mean of |residual| ─► shift, context        the lowest `shift` bits are noise: raw bits
    residual >> shift ─► high symbol (16), low symbol (4) ─► adaptive tables ─► rANS        beyond: exp-Golomb

A lane is one channel in one chunk, with tables and a rANS state of its own, so that each decodes alone. Without the
compiled module the lanes are coded side by side, one NumPy step for each sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..entropy import bits
from ..errors import Corrupt
from ..typing import Bytes, Integers

HIGH, LOW, HALF = 16, 4, 32
PRECISION = 15
TOTAL = 1 << PRECISION
LOWEST = 1 << 16
LIMIT = 1 << 30
"""Residuals are at most this large: samples and predictions are at most half of it."""
FIRST_SCALED = 40
"""Contexts below it are for residuals without raw bits, a quarter of an octave of the mean each; four are for others.
"""
START_CODES = 144
MAX_ZEROS = 30
FAST, SLOW = 3, 6
"""The running means forget by 1/8 and 1/64 a sample."""
SLOWER_AFTER = 64
"""Number of symbols after which tables adapt by 1/256 a symbol; before, by 1/128."""
FLOORS = {HIGH: 8, LOW: 64}
"""The least frequency of a symbol in adapted tables, about."""

LAPLACE_RATIOS = (
    4573838, 5439200, 6468266, 7691993, 9147178, 10877562, 12935125, 15381618, 18290375, 21748431, 25858997, 30744324,
    36548971, 43443481, 51628370, 61338276, 72845899, 86465080, 102551931, 121502222, 143742407, 169710610, 199823242,
    234423295, 273709299, 317650931, 365908108, 417781359, 472223425, 527927414, 583477535, 637520997, 688912581,
    736800150, 780645965, 820198935, 855439933, 886519378, 913699382, 937306231, 855439933, 886519378, 913699382,
    937306231,
)  # fmt: skip
"""For each context r of weights r^|n|, in 2⁻³⁰: the mean of |n| is that of the context."""
GAUSS_RATIOS = (
    4613223, 5495011, 6547384, 7804202, 9306403, 11103649, 13256393, 15838550, 18940956, 22675908, 27183213, 32638363,
    39263747, 47344299, 57249682, 69466238, 84643508, 103662136, 127730906, 158514644, 198259823, 249760273,
    315713281, 396880430, 489891009, 587616103, 682175220, 767414854, 839878221, 898658249, 944636163, 979624314,
    1005711054, 1024872094, 1038794196, 1048831035, 1056026493, 1061164391, 1064822681, 1067422205, 1056026493,
    1061164391, 1064822681, 1067422205,
)  # fmt: skip
"""For each context g of weights g^(n²), in 2⁻³⁰."""


@dataclass(frozen=True, eq=False)
class Lane:
    """A coded lane: the first value of the running means, the final rANS state, 16-bit words, packed raw bits."""

    start: int
    state: int
    words: NDArray[np.uint16]
    raw: Bytes


@cache
def tables() -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Starts of the high symbols (44, 16) and of the low symbols (44, 16, 4) in each context, before any sample."""
    high, low = [], []
    for laplace, gauss in zip(LAPLACE_RATIOS, GAUSS_RATIOS, strict=True):
        sides = [_side(laplace, 0), _side(gauss, 1)]
        masses = [sum((side[abs(n)] << 30) // (2 * sum(side) - side[0]) for side in sides) for n in range(-HALF, HALF)]
        groups = [masses[at : at + LOW] for at in range(0, 2 * HALF, LOW)]
        high.append(_starts([sum(group) for group in groups]))
        low.append([_starts(group) for group in groups])
    return np.array(high, np.int16), np.array(low, np.int16)


def _side(ratio: int, order: int) -> list[int]:
    """Weights of 0, 1, … 32: ratio^n, or with order 1 ratio^(n²), in 2⁻³⁰, at least 2⁻³⁰."""
    weights, factor = [1 << 30], ratio
    for _ in range(HALF):
        weights.append(max(1, weights[-1] * factor >> 30))
        factor = factor * ratio * ratio >> 60 if order else factor
    return weights


def _starts(masses: list[int]) -> list[int]:
    """Starts of the symbols, with at least the floor for each."""
    size, total = len(masses), max(1, sum(masses))
    floor = FLOORS[size]
    shares = [TOTAL * sum(masses[:i]) // total for i in range(size)]
    return [min(TOTAL - (size - i) * floor, max(i * floor, share)) for i, share in enumerate(shares)]


def start_code(residuals: Integers) -> int:
    """The byte for the first value of the running means: from the first residuals."""
    mean = max(4, int(np.abs(residuals[:32]).mean() * 256) if len(residuals) else 0)
    octave = mean.bit_length() - 3
    return min(START_CODES - 1, 4 * octave + (mean >> octave) - 4)


def start_of(code: int) -> int:
    """The first value of the running means: a quarter of an octave for each code."""
    return (4 + (code & 3)) << (code >> 2)


def encode(lanes: Sequence[Integers]) -> list[Lane]:
    """Lanes of residuals (n,), each at most 2³⁰ in size."""
    if (kernel := native.kernel("signals_encode")) is not None:
        high, low = tables()
        return [Lane(*kernel(lane, high, low)) for lane in lanes]
    return _encode_side_by_side(lanes, [start_code(lane) for lane in lanes]) if lanes else []


def decode(lanes: Sequence[Lane], counts: Sequence[int]) -> list[Integers]:
    """The inverse of `encode`. counts: residuals of each lane. Raises Corrupt for bytes that do not hold as many."""
    high, low = tables()
    if (kernel := native.kernel("signals_decode")) is not None:
        fields = [
            (count, start_of(lane.start), lane.state, lane.words, lane.raw)
            for lane, count in zip(lanes, counts, strict=True)
        ]
        result = kernel(fields, high, low)
        if result is None:
            raise Corrupt(NOT_A_LANE)
        return result
    return _decode_side_by_side(lanes, counts) if lanes else []


NOT_A_LANE = "coded samples do not end where they should"


class _Models:
    """The tables and running means of lanes side by side; the lanes that are left are always the first."""

    def __init__(self, starts: Integers) -> None:
        count = len(starts)
        high, low = tables()
        self.high = np.repeat(high[None].astype(np.int64), count, axis=0)
        self.low = np.repeat(low[None].astype(np.int64), count, axis=0)
        self.seen_high = np.zeros(self.high.shape[:2], np.int64)
        self.seen_low = np.zeros(self.low.shape[:3], np.int64)
        self.fast, self.slow = starts.copy(), starts.copy()

    def context(self, n: int) -> tuple[Integers, Integers]:
        """Shift and context of the next residual of the first n lanes."""
        mean = self.fast[:n] + self.slow[:n]
        place = np.frexp(mean.astype(np.float64))[1].astype(np.int64) - 1  # exact: means are below 2⁵³
        level = 4 * place + (mean >> (place - 2) & 3) - 36
        shift = np.maximum(0, (level >> 2) - 2)
        return shift, np.where(shift > 0, FIRST_SCALED + (level & 3), np.maximum(0, level + 28))

    def observe(self, residuals: Integers) -> None:
        n = len(residuals)
        size = np.minimum(np.abs(residuals), LIMIT) << 8
        for mean, speed in ((self.fast, FAST), (self.slow, SLOW)):
            mean[:n] = np.maximum(2, mean[:n] + ((size - mean[:n]) >> speed))


def _adapt(starts: Integers, seen: Integers, at: tuple[Integers, ...], symbol: Integers) -> None:
    """Move the tables at these places towards their symbols."""
    rows = starts[at]
    size = rows.shape[1]
    place, floor = np.arange(size), FLOORS[size]
    target = np.where(place <= symbol[:, None], place * floor, TOTAL - (size - place) * floor)
    rate = 7 + (seen[at] >> 6)
    rows[:, 1:] += ((target - rows) >> rate[:, None])[:, 1:]
    starts[at] = rows
    seen[at] = np.minimum(SLOWER_AFTER, seen[at] + 1)


def _interval(rows: Integers, symbol: Integers) -> tuple[Integers, Integers]:
    """Frequency and start of a symbol in each row."""
    ends = np.concatenate([rows[:, 1:], np.full((len(rows), 1), TOTAL)], axis=1)
    start = np.take_along_axis(rows, symbol[:, None], 1)[:, 0].astype(np.int64)
    return np.take_along_axis(ends, symbol[:, None], 1)[:, 0] - start, start


def _encode_side_by_side(lanes: Sequence[Integers], starts: Sequence[int]) -> list[Lane]:
    """`encode` in NumPy: all lanes at a time, longest first."""
    order = np.argsort([-len(lane) for lane in lanes], kind="stable")
    counts = np.array([len(lanes[i]) for i in order], np.int64)
    steps = int(counts.max(initial=0))
    padded = np.zeros((steps, len(lanes)), np.int64)
    for column, i in enumerate(order):
        padded[: counts[column], column] = lanes[i]
    models = _Models(np.array([start_of(starts[i]) for i in order], np.int64))
    frequency, start = np.full((steps, 2, len(lanes)), TOTAL), np.zeros((steps, 2, len(lanes)), np.int64)
    raw, widths = np.zeros((steps, 2, len(lanes)), np.int64), np.zeros((steps, 2, len(lanes)), np.int64)
    for t in range(steps):
        n = int((counts > t).sum())
        lane, residual = np.arange(n), padded[t, :n]
        shift, context = models.context(n)
        place = (residual >> shift) + HALF
        high = np.where(place < LOW, 0, np.where(place >= 2 * HALF - LOW, HIGH - 1, place >> 2))
        frequency[t, 0, :n], start[t, 0, :n] = _interval(models.high[lane, context], high)
        _adapt(models.high, models.seen_high, (lane, context), high)
        inside = np.flatnonzero((high > 0) & (high < HIGH - 1))
        at, low = (inside, context[inside], high[inside]), place[inside] & 3
        frequency[t, 1, inside], start[t, 1, inside] = _interval(models.low[at], low)
        _adapt(models.low, models.seen_low, at, low)
        beyond = np.where(high == 0, LOW - place, place - (2 * HALF - LOW) + 1)
        is_beyond = (high == 0) | (high == HIGH - 1)
        raw[t, 0, :n] = np.where(is_beyond, beyond, 0)
        widths[t, 0, :n] = np.where(is_beyond, 2 * np.frexp(np.maximum(beyond, 1).astype(np.float64))[1] - 1, 0)
        raw[t, 1, :n], widths[t, 1, :n] = residual & ((1 << shift) - 1), shift
        models.observe(residual)
    states, words = _push(frequency.reshape(2 * steps, -1), start.reshape(2 * steps, -1))
    result: list[Lane | None] = [None] * len(lanes)
    for column, i in enumerate(order):
        stream = bits.pack(raw[:, :, column].ravel(), widths[:, :, column].ravel())
        result[i] = Lane(starts[i], int(states[column]), words[column], np.packbits(stream))
    return [lane for lane in result if lane is not None]


def _push(frequency: Integers, start: Integers) -> tuple[Integers, list[NDArray[np.uint16]]]:
    """rANS of (symbols, lanes), last symbol first: final states, and each lane's words in the decoder's order."""
    state = np.full(frequency.shape[1], LOWEST, np.int64)
    words: list[list[int]] = [[] for _ in range(frequency.shape[1])]
    for f, c in zip(frequency[::-1], start[::-1], strict=True):
        full = np.flatnonzero(state >= f << 17)
        for lane in full:
            words[lane].append(int(state[lane]) & 0xFFFF)
        state[full] >>= 16
        state = (state // f << PRECISION) + state % f + c
    return state, [np.array(lane[::-1], np.uint16) for lane in words]


class _BitReaders:
    """A place in the raw bits of each lane; bits past the end are 0."""

    def __init__(self, streams: Sequence[Bytes]) -> None:
        width = max((len(stream) for stream in streams), default=0) + 16
        self.bytes = np.zeros((len(streams), width), np.uint64)
        for row, stream in zip(self.bytes, streams, strict=True):
            row[: len(stream)] = stream
        self.at = np.zeros(len(streams), np.int64)

    def get(self, lanes: Integers, widths: Integers) -> Integers:
        """The next `widths` bits (at most 32) of these lanes."""
        first = np.minimum(self.at[lanes] >> 3, self.bytes.shape[1] - 8)
        window = np.zeros(len(lanes), np.uint64)
        for i in range(8):
            window = window << np.uint64(8) | self.bytes[lanes, first + i]
        skip = (self.at[lanes] & 7).astype(np.uint64)
        self.at[lanes] += widths
        drop = np.minimum(63, 64 - widths).astype(np.uint64)
        return np.where(widths > 0, (window << skip >> drop).astype(np.int64), 0)


def _decode_side_by_side(lanes: Sequence[Lane], counts: Sequence[int]) -> list[Integers]:
    """`decode` in NumPy: all lanes at a time, longest first."""
    order = np.argsort([-count for count in counts], kind="stable")
    length = np.array([counts[i] for i in order], np.int64)
    steps = int(length.max(initial=0))
    out = np.zeros((steps, len(lanes)), np.int64)
    models = _Models(np.array([start_of(lanes[i].start) for i in order], np.int64))
    state = np.array([lanes[i].state for i in order], np.int64)
    words = _padded([lanes[i].words for i in order])
    used, readers = np.zeros(len(lanes), np.int64), _BitReaders([lanes[i].raw for i in order])

    def pop(at: Integers, frequency: Integers, start: Integers) -> None:
        x = frequency * (state[at] >> PRECISION) + (state[at] & (TOTAL - 1)) - start
        short = x < LOWEST
        x[short] = x[short] << 16 | words[at[short], np.minimum(used[at[short]], words.shape[1] - 1)]
        used[at[short]] += 1
        state[at] = x

    for t in range(steps):
        n = int((length > t).sum())
        lane = np.arange(n)
        shift, context = models.context(n)
        rows = models.high[lane, context]
        high = (rows[:, 1:] <= (state[:n] & (TOTAL - 1))[:, None]).sum(axis=1)
        pop(lane, *_interval(rows, high))
        _adapt(models.high, models.seen_high, (lane, context), high)
        inside = np.flatnonzero((high > 0) & (high < HIGH - 1))
        at = (inside, context[inside], high[inside])
        rows = models.low[at]
        low = (rows[:, 1:] <= (state[inside] & (TOTAL - 1))[:, None]).sum(axis=1)
        pop(inside, *_interval(rows, low))
        _adapt(models.low, models.seen_low, at, low)
        value = np.zeros(n, np.int64)
        value[inside] = (high[inside] << 2 | low) - HALF
        outside = np.flatnonzero((high == 0) | (high == HIGH - 1))
        if len(outside):
            beyond = _golomb(readers, outside)
            value[outside] = np.where(high[outside] == 0, LOW - HALF - beyond, beyond - 1 + HALF - LOW)
        residual = (value << shift) + readers.get(lane, shift)
        out[t, :n] = residual
        models.observe(residual)
    ends = np.array([(len(lanes[i].words), len(lanes[i].raw)) for i in order], np.int64).reshape(-1, 2)
    if not ((state == LOWEST) & (used == ends[:, 0]) & ((readers.at + 7) // 8 == ends[:, 1])).all():
        raise Corrupt(NOT_A_LANE)
    result = [np.zeros(0, np.int64)] * len(lanes)
    for column, i in enumerate(order):
        result[i] = out[: counts[i], column].copy()
    return result


def _golomb(readers: _BitReaders, lanes: Integers) -> Integers:
    """Numbers ≥ 1 in exponential Golomb code of order 0. Raises Corrupt for more than 31 bits."""
    zeros, left = np.zeros(len(lanes), np.int64), np.arange(len(lanes))
    while len(left):
        bit = readers.get(lanes[left], np.ones(len(left), np.int64))
        left = left[bit == 0]
        zeros[left] += 1
        if zeros.max() > MAX_ZEROS:
            raise Corrupt(NOT_A_LANE)
    return (1 << zeros) | readers.get(lanes, zeros)


def _padded(rows: Sequence[NDArray[np.uint16]]) -> Integers:
    """Rows of different lengths as one array, zeros after each."""
    result = np.zeros((len(rows), max(map(len, rows), default=0) + 1), np.int64)
    for row, values in zip(result, rows, strict=True):
        row[: len(values)] = values
    return result
