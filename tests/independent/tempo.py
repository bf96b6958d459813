"""tempo, written from docs/payloads/tempo.md and tempo-models.md; only NumPy's arithmetic is used.

The prior's files are read as data. `decode` takes the shared blob, the chunks as (frames, payload) and what it needs of
the header; it gives positions (frames, points, 3) in metres, NaN in gaps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from . import payloads, tempo_lattice
from .integers import Bytes, bits_of, integers, number_of
from .ordered import BAND, log2
from .payloads import Array, Chunks, apart_mask, restored
from .tempo_models import read_model
from .tempo_statistics import Model, Prior, Recording, prior

# --- docs/payloads/tempo.md: logarithms

EXP = np.array([min(2**20, round(16 * 2 ** (i / 32))) for i in range(-512, 1024)])


def exp2(x: Array) -> Array:
    return EXP[np.clip(x, -512, 1023) + 512]


def step_size(log: int) -> float:
    return 2.0 ** (log / 32)


# --- shared bytes and payloads


def decode(shared: bytes, chunks: Chunks, like: Recording, priors: Callable[[str], Prior] = prior) -> Array:
    head, points = Bytes(shared), len(like.names)
    flags = head.take(1)[0]
    runs = None
    if flags & 32:
        like = like._replace(rate=head.varint() / 1000)
        lengths = [run_lengths(payload, frames) for frames, payload in chunks]
        chunks = [(len(run), rest) for run, rest in lengths]
        runs = np.concatenate([run for run, _ in lengths])
    weights = np.ones(points)
    if flags & 8:
        weights = 2.0 ** (np.frombuffer(head.take(points), np.uint8) / 16)
    neighbours = tempo_lattice.neighbours_of(head.blob(), points) if flags & 64 else []
    if flags & 16:
        positions = payloads.hou2014([head.rest()], chunks, points, like.parents)
    else:
        known = None if flags & 4 else priors(head.take(4).hex())
        model = None if known is None else read_model(flags & 3, head.rest(), known, like)
        parts = [chunk(payload, frames, model, like, weights, neighbours) for frames, payload in chunks]
        positions = np.concatenate(parts)
    return positions if runs is None else np.repeat(positions, runs, axis=0)


def run_lengths(payload: bytes, frames: int) -> tuple[list[int], bytes]:
    part = Bytes(payload)
    count, size = part.varint(), part.varint()
    if size:
        lengths = [length for (length,) in integers(part.take(size), count, 1)]
    else:
        lengths = [part.varint()] * (count - 1)
        lengths.append(frames - sum(lengths))
    assert sum(lengths) == frames
    return lengths, part.rest()


def chunk(
    payload: bytes, frames: int, model: Model | None, like: Recording, weights: Array, neighbours: list[list[int]]
) -> Array:
    part, points = Bytes(payload), len(like.names)
    flags = part.take(1)[0]
    gaps = part.blob() if flags & 8 else b""
    grid = 2.0 ** (part.folded() / 256) if flags & 4 else 0.0
    if flags & 1:
        positions = direct(part.rest(), frames, points) * grid / weights[:, None]
    elif flags & 2:
        apart = apart_mask(gaps, frames, points)
        positions = tempo_lattice.decode(part.rest(), apart, neighbours) * grid / weights[:, None]
    else:
        assert model is not None
        values, step, lists = coefficients(part, frames, model, like)
        positions = synthesise(values, step, frames, model, like)
        correct(positions, lists, grid, weights)
    return restored(gaps, positions)[..., {"y": [0, 1, 2], "z": [2, 0, 1], "x": [1, 2, 0]}[like.up]]


# --- coefficients

LANES = (1, 2, 4, 8, 12, 16, 24, 32)
RAW_BITS = [0] * 11 + list(range(1, 10)) + [48]
SMALLEST = list(range(11)) + [11 + 2**j - 2 for j in range(1, 11)]


def heading_step(frames: int) -> int:
    return -213 + int(log2(frames)) // 2


def expected_magnitudes(model: Model, frames: int, millihertz: int, step: int) -> Array:
    out = np.zeros((frames, len(model.spreads)), np.int64)
    steps = np.full(len(model.spreads), step)
    steps[0] = heading_step(frames)
    out[0] = model.means + log2(frames) // 2
    band_logs = [0, *(int(log2(f)) for f in BAND[1:])]
    for k in range(1, frames):
        t = int(log2(max(k * millihertz // (2 * frames), 1)))
        b = max([b for b in range(1, 17) if band_logs[b] <= t], default=1)
        low, high = band_logs[b], band_logs[b + 1]
        u = min(max(t, low), high) - low
        left, right = model.spreads[:, b], model.spreads[:, b + 1]
        out[k] = left + (right - left) * u // (high - low)
    out[1:] += (int(log2(max(millihertz, 1))) - int(log2(120_000))) // 2
    return out - steps


def groups_of(frequencies: int) -> list[range]:
    out, k = [], 0
    while k < frequencies:
        size = 1 if k < 16 else 2 if k < 64 else 4 if k < 128 else 8
        out.append(range(k, min(k + size, frequencies)))
        k += size
    return out


def neighbours(magnitudes: Array, k: int) -> Array:
    """N of every row, for a group that begins at frequency k."""
    rows = magnitudes.shape[1]
    padded = np.zeros((8, rows + 8), np.int64)
    for below in range(1, min(k, 7) + 1):
        padded[below, 4 : rows + 4] = magnitudes[k - below]
    near = padded[:, 4 : rows + 4]
    out = 13 * (near[1] + near[2]) + 8 * near[3] + 6 * (near[4] + near[5] + near[6] + near[7])
    out += 6 * (padded[1, 3 : rows + 3] + padded[1, 5 : rows + 5])
    for apart in range(-4, 5):
        out += 3 * padded[1, 4 + apart : rows + 4 + apart]
        if abs(apart) < 4:
            out += 3 * padded[2, 4 + apart : rows + 4 + apart]
    return out


class Lanes:
    """The states of a chunk, which share its words."""

    def __init__(self, states: list[int], words: bytes, tables: Array) -> None:
        self.states, self.words, self.at = states, words, 0
        self.ends = np.cumsum(tables, axis=1)
        self.tables = tables

    def symbol(self, lane: int, table: int) -> int:
        x = self.states[lane]
        slot = x % 4096
        found = int(np.searchsorted(self.ends[table], slot, side="right"))
        frequency = int(self.tables[table, found])
        x = frequency * (x >> 12) + slot - (int(self.ends[table, found]) - frequency)
        if x < 2**16:
            x = x << 16 | int.from_bytes(self.words[self.at : self.at + 2], "little")
            self.at += 2
        self.states[lane] = x
        return found


def coefficients(part: Bytes, frames: int, model: Model, like: Recording) -> tuple[Array, int, Array]:
    """Integers (frequencies, rows), step, and lists (5, n)."""
    first, step = part.varint(), part.varint() - 2048
    lanes = LANES[first & 7]
    folded = first >> 4
    threshold = -((folded + 1) // 2) if folded % 2 else folded // 2
    corrections, classes = 0, [0] * 5
    if first & 8:
        corrections, classes = part.varint(), [part.varint() for _ in range(5)]
    expected = expected_magnitudes(model, frames, round(like.rate * 1000), step)
    rows = expected.shape[1]
    coded = [max((k + 1 for k in range(frames) if expected[k, r] >= 16 * threshold), default=0) for r in range(rows)]
    frequencies = max(coded)
    values = np.zeros((frequencies, rows), np.int64)
    lists = np.zeros((5, corrections), np.int64)
    if not frequencies and not corrections:
        assert not part.rest()
        return values, step, lists
    states, rest = read_states(part.rest(), lanes)
    stream = Lanes(states, rest, model.tables)
    places, symbols = coefficient_symbols(stream, expected[:frequencies], coded, lanes)
    listed = [stream.symbol(i % lanes, 112 + classes[i // corrections]) for i in range(5 * corrections)]
    assert all(x >> 16 == 1 for x in stream.states), "the stream does not end where it should"
    raw = [x >> i & 1 for x in stream.states for i in reversed(range(16))] + bits_of(rest[stream.at :])
    magnitudes, raw = with_raw_bits(symbols, raw)
    signs = iter(raw)
    for (k, r), magnitude in zip(places, magnitudes, strict=True):
        values[k, r] = -magnitude if magnitude and next(signs) else magnitude
    magnitudes, raw = with_raw_bits(listed, list(signs))
    signs = iter(raw)
    for i, magnitude in enumerate(magnitudes):
        negative = i < 3 * corrections and magnitude and next(signs)
        lists[i // corrections, i % corrections] = -magnitude if negative else magnitude
    left = list(signs)
    assert not any(left)
    assert len(left) < 8 or len(left) <= 16 * lanes, "bytes are left over"
    return values, step, lists


def read_states(data: bytes, lanes: int) -> tuple[list[int], bytes]:
    bits, at, states = bits_of(data[: 5 * lanes]), 4 * lanes, []
    for lane in range(lanes):
        size = number_of(bits[4 * lane : 4 * lane + 4]) + 16
        states.append(1 << size | number_of(bits[at : at + size]))
        at += size
    return states, data[-(-at // 8) :]


def coefficient_symbols(
    stream: Lanes, expected: Array, coded: list[int], lanes: int
) -> tuple[list[tuple[int, int]], list[int]]:
    """Place (frequency, row) and symbol of each coded coefficient, in order."""
    before = np.minimum(exp2(expected), 4800)
    magnitudes = np.zeros_like(expected)
    places, symbols = [], []
    for group in groups_of(len(expected)):
        k = group[0]
        base = expected[group] - log2(neighbours(before, k) // 16 + 10)
        now = log2(10 + np.minimum(neighbours(magnitudes, k), 65525))
        chosen = np.clip((now + base + 260) // 10, 0, 55) + 56 * (0 if k == 0 else 1 if k < 4 else 2)
        here = [(f, r) for f in group for r in range(len(coded)) if f < coded[r]]
        for i, (f, r) in enumerate(here):
            symbols.append(stream.symbol(i % lanes, int(chosen[f - k, r])))
            places.append((f, r))
            magnitudes[f, r] = min(300, SMALLEST[symbols[-1]])
    return places, symbols


def with_raw_bits(symbols: list[int], raw: list[int]) -> tuple[list[int], list[int]]:
    """Magnitudes, and the raw bits that are left."""
    out, at = [], 0
    for symbol in symbols:
        out.append(SMALLEST[symbol] + number_of(raw[at : at + RAW_BITS[symbol]]))
        at += RAW_BITS[symbol]
    return out, raw[at:]


# --- decoding


@cache
def cosines(frames: int) -> Array:
    t, f = np.arange(frames)[:, None], np.arange(frames)
    return np.sqrt(np.where(f == 0, 1, 2) / frames) * np.cos(np.pi * (t + 0.5) * f / frames)


def synthesise(values: Array, step: int, frames: int, model: Model, like: Recording) -> Array:
    c = values.astype(float)
    c[:, 4:] -= 0.05 * np.sign(values[:, 4:])
    c[:, 0] *= step_size(heading_step(frames))
    c[:, 1:] *= step_size(step)
    millihertz = round(like.rate * 1000)
    edges = [0, *(min(frames, -(-2 * frames * e // millihertz)) for e in (700, 2000, 5000)), frames]
    y = np.zeros((len(c), 4 + model.bases[0].shape[1]))
    y[:, :4] = c[:, :4]
    for b, basis in enumerate(model.bases):
        y[edges[b] : edges[b + 1], 4:] = c[edges[b] : edges[b + 1], 4:] @ basis
    curves = cosines(frames)[:, : len(y)] @ y
    pose = model.pose(curves[:, 4:])
    cosine, sine = np.cos(curves[:, :1]), np.sin(curves[:, :1])
    x, up, z = pose[..., 0], pose[..., 1], pose[..., 2]
    turned = np.stack([x * cosine + z * sine, up, z * cosine - x * sine], axis=-1)
    return turned + curves[:, None, 1:4] / math.sqrt(len(like.names))


def correct(positions: Array, lists: Array, grid: float, weights: Array) -> None:
    frames, at = len(positions), 0
    for x, y, z, apart, more in lists.T:
        at, length = at + apart, more + 1
        point, frame = divmod(at, frames)
        assert frame + length <= frames
        wave = np.sin(np.pi * np.arange(1, length + 1) / (length + 1)) * grid / weights[point]
        positions[frame : frame + length, point] += wave[:, None] * np.array([x, y, z])
        at += length


class Level(NamedTuple):
    number: int
    frames: list[int]
    distance: int


def levels(frames: int) -> list[Level]:
    s = 1
    while s < frames - 1:
        s *= 2
    out = [Level(0, [0], 0)]
    if frames > 1:
        out.append(Level(1, [frames - 1], 0))
    while s > 1:
        s //= 2
        out.append(Level(len(out), list(range(s, frames - 1, 2 * s)), s))
    return out


def direct(data: bytes, frames: int, points: int) -> Array:
    return direct_columns(data, frames, 3 * points).reshape(frames, points, 3)


def direct_columns(data: bytes, frames: int, columns: int) -> Array:
    order = levels(frames)
    contexts = [level.number for level in order for _ in level.frames]
    residuals = iter(np.array(integers(data, frames, columns, contexts), np.int64).reshape(frames, -1))
    v, last = np.zeros((frames, columns), np.int64), frames - 1
    for level, at, d in order:
        for t in at:
            if level < 2:
                predicted = v[0] * level
            elif t >= 3 * d and t + 3 * d <= last:
                predicted = (9 * (v[t - d] + v[t + d]) - v[t - 3 * d] - v[t + 3 * d] + 8) >> 4
            else:
                predicted = (v[t - d] + v[min(t + d, last)] + 1) >> 1
            v[t] = predicted + next(residuals)
    return v.astype(float)


__all__ = ["Recording", "decode"]
