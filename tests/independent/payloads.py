"""Payloads of hou2014, liu2006 and lossless, written from docs/payloads/; only NumPy's arithmetic is used.

Each decoder takes the shared blobs, the chunks as (frames, payload), the number of points, and what else it needs
of the header; it gives positions (frames, points, 3) in metres, NaN in gaps.
"""

from __future__ import annotations

import math
import struct
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from . import tempo_lattice
from .integers import Bytes, bits_of, integers

Array = np.ndarray
Chunks = list[tuple[int, bytes]]


def array(data: bytes, steps: int, lanes: int) -> Array:
    return np.array(integers(data, steps, lanes), np.int64).reshape(steps, lanes)


# --- docs/payloads/index.md


def gaps_only(chunks: Chunks, points: int) -> Array:
    """A stream without shared blobs."""
    assert not any(payload for _, payload in chunks)
    return np.full((sum(frames for frames, _ in chunks), points, 3), math.nan)


# --- docs/payloads/stages.md


def step(rung: int) -> float:
    return 2.0 ** (rung / 64)


def gap_mask(data: bytes, frames: int, points: int) -> Array:
    """(frames, points), true where a sample is missing."""
    flat = np.zeros(frames * points, bool)
    if data:
        part = Bytes(data)
        number = part.varint()
        at = 0
        for present, missing in integers(part.rest(), number // 2, 2):
            flat[at + present : at + present + missing] = True
            at += present + missing
        if not number % 2:
            return flat.reshape(points, frames).T
    return flat.reshape(frames, points)


def apart_mask(data: bytes, frames: int, points: int) -> Array:
    """(frames, points), true where a sample is missing or in a frozen run."""
    if data[:1] != b"\0":
        return gap_mask(data, frames, points)
    part = Bytes(data)
    _, mask_size, count, run_size = (part.varint() for _ in range(4))
    out = gap_mask(part.take(mask_size), frames, points)
    at = 0
    for wait, longer, _ in integers(part.take(run_size), count, 3):
        point, frame = divmod(at + wait, frames)
        out[frame : frame + longer + 1, point] = True
        at += wait + longer + 1
    return out


def restored(data: bytes, positions: Array) -> Array:
    """Positions with NaN in gaps and the values of frozen runs."""
    frames, points, _ = positions.shape
    out = positions.copy()
    if data[:1] != b"\0":
        out[gap_mask(data, frames, points)] = np.nan
        return out
    part = Bytes(data)
    _, mask_size, count, run_size = (part.varint() for _ in range(4))
    out[gap_mask(part.take(mask_size), frames, points)] = np.nan
    runs = integers(part.take(run_size), count, 3)
    rows = integers(part.rest(), max(which for _, _, which in runs), 24)
    values = [struct.unpack("<3d", bytes(row)) for row in rows]
    before = out.copy()
    at = 0
    for wait, longer, which in runs:
        point, frame = divmod(at + wait, frames)
        stop = frame + longer + 1
        assert stop <= frames
        assert which or frame
        out[frame:stop, point] = values[which - 1] if which else before[frame - 1, point]
        at += wait + longer + 1
    return out


def corrected(data: bytes, positions: Array, bound: float, gaps: bytes) -> Array:
    if not data:
        return positions
    frames, points, _ = positions.shape
    inner_bound = bound - min(1e-9, bound / 1000)
    if data[0] == 2:
        part = Bytes(data[1:])
        neighbours = tempo_lattice.neighbours_of(part.blob(), points)
        samples = tempo_lattice.decode(part.rest(), apart_mask(gaps, frames, points), neighbours)
        return positions + samples * (2 / math.sqrt(5) * (1 - 1e-9) * inner_bound)
    spacing = 2 / math.sqrt(3) * inner_bound
    if data[0] == 1:
        return positions + array(data[1:], frames, 3 * points).reshape(positions.shape) * spacing
    assert data[0] == 0
    part = Bytes(data[1:])
    count, size_of_waits, size_of_lengths = part.varint(), part.varint(), part.varint()
    apart = bits_of(part.take(-(-count // 8)))[:count]
    waits = iter(integers(part.take(size_of_waits), sum(apart), 1))
    lengths = integers(part.take(size_of_lengths), count, 1)
    track = np.zeros((points * frames, 3))
    at = 0
    for waiting, (length,), value in zip(apart, lengths, array(part.rest(), count, 3), strict=True):
        at += next(waits)[0] + 1 if waiting else 0
        track[at : at + length + 1] = value
        at += length + 1
    return positions + track.reshape(points, frames, 3).transpose(1, 0, 2) * spacing


def basis(data: bytes, dimensions: int, components: int, alike: list[int]) -> Array:
    """(dimensions, components), orthonormal. alike: for each dimension an earlier one, or −1."""
    part = Bytes(data)
    leading = part.varint()
    entries = array(part.rest(), dimensions, components)
    for row, other in enumerate(alike):
        if other >= 0:
            entries[row, :leading] += entries[other, :leading]
    result = np.eye(dimensions, components)
    for i in reversed(range(components)):
        u = entries[i:, i].astype(float)
        if not u.any() or u[0] > 0:
            u[:] = 0
            u[0] = -1
        u /= math.sqrt(u @ u)
        u[0] -= 1
        u /= math.sqrt(u @ u)
        result[i:, i:] -= 2 * np.outer(u, u @ result[i:, i:])
    return result


def spline(keys: list[int], values: Array, at: list[int]) -> Array:
    """The natural cubic spline through values (keys, k) at ascending key frames."""
    if len(keys) < 2:
        return np.repeat(values, len(at), axis=0)
    n, h = len(keys), np.diff(keys).astype(float)
    matrix, right = np.eye(n), np.zeros_like(values)
    for i in range(1, n - 1):
        matrix[i, i - 1 : i + 2] = h[i - 1] / 6, (h[i - 1] + h[i]) / 3, h[i] / 6
        right[i] = (values[i + 1] - values[i]) / h[i] - (values[i] - values[i - 1]) / h[i - 1]
    m = np.linalg.solve(matrix, right)
    rows = []
    for t in at:
        i = max(j for j in range(n - 1) if keys[j] <= t or j == 0)
        b = (t - keys[i]) / h[i]
        a = 1 - b
        bend = h[i] ** 2 / 6
        rows.append(a * values[i] + b * values[i + 1] + (a**3 - a) * bend * m[i] + (b**3 - b) * bend * m[i + 1])
    return np.array(rows).reshape(len(at), values.shape[1])


def key_frames(bits: list[int], frames: int) -> tuple[list[list[int]], list[int]]:
    """Levels of key frames, and the bits that are left."""
    first = sorted({round(i * (frames - 1) / 3) for i in range(4)})
    levels, intervals = [first], list(pairwise(first))
    while True:
        intervals = [(a, b) for a, b in intervals if b - a >= 2]
        asked, bits = bits[: len(intervals)], bits[len(intervals) :]
        halved = [(a, (a + b) // 2, b) for (a, b), bit in zip(intervals, asked, strict=True) if bit]
        if not halved:
            return levels, bits
        levels.append([middle for _, middle, _ in halved])
        intervals = [pair for a, m, b in halved for pair in ((a, m), (m, b))]


class Track(NamedTuple):
    keys: list[int]  # ascending
    values: Array

    def at(self, frames: list[int]) -> Array:
        return spline(self.keys, self.values, frames)


def track(levels: list[list[int]], numbers: Array, step: float) -> Track:
    """Key frames in order and their values, from numbers in the order of levels."""
    values = np.cumsum(numbers[: len(levels[0])] * step, axis=0)
    keys = list(levels[0])
    for level in levels[1:]:
        order = np.argsort(keys)
        predicted = spline([keys[i] for i in order], values[order], level)
        more = predicted + numbers[len(keys) : len(keys) + len(level)] * step
        keys, values = keys + level, np.concatenate([values, more])
    order = np.argsort(keys)
    return Track([keys[i] for i in order], values[order])


# --- docs/payloads/hou2014.md


def hou2014(shared: list[bytes], chunks: Chunks, points: int, parents: list[int] | None) -> Array:
    head = Bytes(shared[0])
    flags, components, rung = head.varint(), head.varint(), head.folded()
    clip_frames = 0 if flags & 32 else head.varint()
    unit = head.float64() if flags & 8 else 0.01
    bound = head.float64() if flags & 4 else None
    weights = array(head.blob(), points, 1)[:, 0] if flags & 2 else np.zeros(points)
    mean = np.zeros((points, 3))
    if flags & 1:
        mean_rung = head.folded()
        mean = array(head.blob(), points, 3) * (unit * step(mean_rung))
    transforms = shared[1:] if flags & 64 else [head.rest()]
    matrices = [hou2014_transform(t, points, parents)[:, :components] for t in transforms]
    parts = []
    for frames, payload in chunks:
        part = Bytes(payload)
        full, last = divmod(frames, clip_frames or 1)
        lengths = [clip_frames] * full + [last] * (last > 0) if clip_frames else [
            part.varint() for _ in range(part.varint())
        ]  # fmt: skip
        n, longest, band = len(lengths), max(lengths), part.varint()
        offsets = array(part.blob(), n, 1)[:, 0] if flags & 16 else np.zeros(n)
        choice = array(part.blob(), n, 1)[:, 0] if len(matrices) > 1 else np.zeros(n, int)
        rows = [(f * longest // L, i, f) for i, L in enumerate(lengths) for f in range(-(-band * L // longest))]
        coded = array(part.blob(), len(rows), components)
        spectra = [np.zeros((L, components)) for L in lengths]
        for (_, i, f), row in zip(sorted(rows), coded, strict=True):
            spectra[i][f] = row * (unit * step(rung + offsets[i]))
        positions = np.concatenate([
            inverse_dct(spectrum) @ matrices[j].T for spectrum, j in zip(spectra, choice, strict=True)
        ]).reshape(frames, points, 3)  # fmt: skip
        positions = positions / 2.0 ** (weights / 64)[:, None] + mean
        apart = part.blob()
        if bound is not None:
            positions = corrected(part.rest(), positions, bound, apart)
        parts.append(restored(apart, positions))
    return np.concatenate(parts)


def hou2014_transform(data: bytes, points: int, parents: list[int] | None) -> Array:
    part = Bytes(data)
    form, k = part.varint(), part.varint()
    if form == 2:
        return np.frombuffer(part.rest(), "<i2").reshape(3 * points, k) / 2**15
    part.varint()  # the first component's precision
    part.blob()  # by how much precision falls from each component to the next
    before = [p - 1 for p in range(points)] if form == 0 else parents
    assert before is not None
    return basis(part.rest(), 3 * points, k, [3 * p + c if p >= 0 else -1 for p in before for c in range(3)])


def inverse_dct(spectrum: Array) -> Array:
    n = len(spectrum)
    t, f = np.arange(n)[:, None], np.arange(n)
    cosines = np.sqrt(np.where(f == 0, 1, 2) / n) * np.cos(np.pi * (t + 0.5) * f / n)
    return cosines @ spectrum


# --- docs/payloads/liu2006.md

TRIPLE = np.array([[1, 1, 1], [0, -1, 1], [-2, 1, 1]]) / np.sqrt([[3], [2], [6]])


class Segment(NamedTuple):
    start: int
    stop: int
    before: int
    after: int
    markers: Track
    groups: list[tuple[Array, Array, Track]]  # mean, basis, track

    def poses(self, group: int, frame: int) -> Array:
        mean, matrix, projections = self.groups[group]
        return projections.at([frame - self.start + self.before])[0] @ matrix.T + mean


def liu2006(shared: list[bytes], chunks: Chunks, points: int, up: str) -> Array:
    head = Bytes(shared[0])
    blend = head.varint()
    normalisation = [head.varint() for _ in range(head.varint())]
    feet = [head.varint() for _ in range(head.varint())]
    others = [p for p in range(points) if p not in normalisation + feet]
    groups = [group for group in (feet, others) if group]
    rest = head.rest()
    bound = struct.unpack("<d", rest)[0] if rest else None
    segments, gaps, residuals, start = [], [], [], 0
    for frames, payload in chunks:
        segment, gap, residual = liu2006_segment(payload, start, frames, len(normalisation), groups)
        segments.append(segment)
        gaps.append(gap)
        residuals.append(residual)
        start += frames
    parts = []
    for i, segment in enumerate(segments):
        frames = segment.stop - segment.start
        positions = np.zeros((frames, points, 3))
        markers = segment.markers.at(list(range(frames))).reshape(frames, -1, 3)
        if len(normalisation) == 3:
            markers = np.einsum("ji,tjc->tic", TRIPLE, markers)
        positions[:, normalisation] = markers
        for t in range(frames):
            for g, columns in enumerate(groups):
                pose = blended(segments, i, g, segment.start + t, blend).reshape(-1, 3)
                positions[t, columns] = out_of_body(pose, markers[t], "xyz".index(up))
        if bound is not None:
            positions = corrected(residuals[i], positions, bound, gaps[i])
        positions = restored(gaps[i], positions)
        parts.append(positions)
    return np.concatenate(parts)


def liu2006_segment(
    payload: bytes, start: int, frames: int, normalisation: int, groups: list[list[int]]
) -> tuple[Segment, bytes, bytes]:
    part = Bytes(payload)
    sizes = [part.varint() for _ in range(5 + 2 * len(groups))]
    sections = [*(part.take(size) for size in sizes), part.rest()]
    head, bits = Bytes(sections[0]), bits_of(sections[1])
    before, after, rung = head.varint(), head.varint(), head.folded()
    levels, bits = key_frames(bits, frames)
    keys = sum(map(len, levels))
    markers = track(levels, array(sections[2], keys, 3 * normalisation), step(rung))
    means = array(sections[3], sum(map(len, groups)), 3)
    models = []
    for g, columns in enumerate(groups):
        m = len(columns)
        rung, k = head.folded(), head.varint()
        for _ in range(k):
            head.varint()  # precision
        levels, bits = key_frames(bits, before + frames + after)
        keys = sum(map(len, levels))
        own, means = means[:m], means[m:]
        alike = [-1] * 3
        for p in range(1, m):
            apart = ((own[:p] - own[p]) ** 2).sum(axis=1)
            alike += [3 * int(apart.argmin()) + c for c in range(3)]
        matrix = basis(sections[4 + 2 * g], 3 * m, k, alike)
        mean = own.ravel() * (step(rung) / math.sqrt(keys))
        models.append((mean, matrix, track(levels, array(sections[5 + 2 * g], keys, k), step(rung))))
    return Segment(start, start + frames, before, after, markers, models), sections[-2], sections[-1]


def blended(segments: list[Segment], i: int, group: int, frame: int, blend: int) -> Array:
    low = max(frame - blend // 2, segments[0].start)
    high = min(frame + blend // 2 + 1, segments[-1].stop)
    own = segments[i].poses(group, frame)
    pose = own.copy()
    for other in segments[max(i - 1, 0) : i] + segments[i + 1 : i + 2]:
        if other.start - other.before <= frame < other.stop + other.after:
            inside = max(0, min(high, other.stop) - max(low, other.start))
            pose += inside / (high - low) * (other.poses(group, frame) - own)
    return pose


def out_of_body(pose: Array, markers: Array, vertical: int) -> Array:
    a, b = (vertical + 1) % 3, (vertical + 2) % 3
    across = markers[2] - markers[1]
    length = math.hypot(across[a], across[b])
    cosine, sine = (across[a] / length, across[b] / length) if length > 1e-6 else (1.0, 0.0)
    turned = pose.copy()
    turned[:, a] = cosine * pose[:, a] - sine * pose[:, b]
    turned[:, b] = cosine * pose[:, b] + sine * pose[:, a]
    return turned + markers[0]


# --- docs/payloads/lossless.md


def lossless(shared: list[bytes], chunks: Chunks, points: int) -> Array:
    form, unit, steps, *taps, scale, _ = struct.unpack("<Bdd7ibI", shared[0])
    parts = []
    for frames, payload in chunks:
        (size,) = struct.unpack_from("<I", payload)
        if form == 2:
            positions = float64_positions(integers(payload[4 + size :], frames, 12 * points), points)
            parts.append(restored(payload[4 : 4 + size], positions))
            continue
        residual = integers(payload[4 + size :], frames, 3 * points)
        values = np.zeros((frames, 3 * points))
        for channel in range(3 * points):
            past: list[int] = []
            for t in range(frames):
                rank = residual[t][channel] + (lossless_prediction(past, taps, form, scale) if t else 0)
                rank = min(max(rank, -(2**37)), 2**37)
                level = lossless_level(rank, form, scale)
                past = [level, *past[:7]] if t else [level] * 8
                values[t, channel] = rank / steps if form else float_of(rank)
        parts.append(restored(payload[4 : 4 + size], (values * unit).reshape(frames, points, 3)))
    return np.concatenate(parts)


def float64_positions(words: list[list[int]], points: int) -> Array:
    bits, ranks = [], [0] * (3 * points)
    for row in words:
        for channel in range(3 * points):
            z = sum(
                word << shift for word, shift in zip(row[4 * channel : 4 * channel + 4], (48, 32, 16, 0), strict=True)
            )
            ranks[channel] = (ranks[channel] + ((z >> 1) ^ -(z & 1))) % 2**64
        bits += [rank ^ 0x7FFFFFFFFFFFFFFF if rank >> 63 else rank for rank in ranks]
    return np.array(bits, np.uint64).view(np.float64).reshape(-1, points, 3)


def lossless_prediction(past: list[int], taps: list[int], form: int, scale: int) -> int:
    drift = sum(tap * (level - past[0]) for tap, level in zip(taps, past[1:], strict=True))
    level = min(max(past[0] + (drift + 2**13 >> 14), -(2**40)), 2**40)
    if form == 1:
        return level
    with np.errstate(over="ignore"):
        return rank_of(float(np.float32(math.ldexp(level, -scale))))


def lossless_level(rank: int, form: int, scale: int) -> int:
    if form == 1:
        return min(max(rank, -(2**36)), 2**36)
    return min(max(round(math.ldexp(float_of(rank), scale)), -(2**40)), 2**40)


def float_of(rank: int) -> float:
    bits = rank ^ 0x7FFFFFFF if rank < 0 else rank
    return struct.unpack("<f", struct.pack("<I", bits & 0xFFFFFFFF))[0]


def rank_of(value: float) -> int:
    (bits,) = struct.unpack("<i", struct.pack("<f", value))
    return bits ^ 0x7FFFFFFF if bits < 0 else bits
