"""The lattice engine of tempo, written from docs/payloads/tempo-lattice.md."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .integers import Bytes, integers
from .tempo_lattice_points import Coder, lattice_point, log
from .tempo_lattice_prediction import (
    Array,
    Learner,
    Level,
    axes_along,
    below_limit,
    beside_gaps_and_ends,
    dot,
    features,
    length,
)

# --- shared bytes


def neighbours_of(blob: bytes, points: int) -> list[list[int]]:
    """The neighbours of each point, its partner first."""
    return [[p - apart for apart in row if apart] for p, row in enumerate(integers(blob, points, 3))]


def sequence_of(neighbours: list[list[int]]) -> list[int]:
    placed: list[int] = []
    while len(placed) < len(neighbours):
        ready = [p for p, known in enumerate(neighbours) if p not in placed and all(q in placed for q in known)]
        assert ready, "the neighbours form a circle"
        placed += ready
    return placed


# --- samples


@dataclass
class Point:
    """What is decoded of a point in a chunk."""

    y: Array
    gap: Array
    activity: list[int]
    radial: list[int]
    d: float = 0.0
    m: float = 0.0


class Row:
    """The samples of a level of a point, one after the other."""

    def __init__(self, point: Point, others: list[Point], level: Level) -> None:
        self.point, self.others, self.level = point, others, level
        self.learner, self.slow = Learner(level.weights), level.activity
        self.a, self.b = 0.001, 0.0

    def is_inside(self, t: int) -> bool:
        half, gap = self.level.half, self.point.gap
        side = t - 2 * half if self.level.number == 0 else t + half
        return bool(t >= half and 0 <= side < len(gap) and not (gap[t] or gap[t - half] or gap[side]))

    def contexts(self, t: int, c: int) -> list[int]:
        own, others, level, step = self.point.activity, self.others, self.level, self.level.step
        before = own[t - step] if t >= step else self.slow // 256
        before2 = own[t - 2 * step] if t >= 2 * step else before
        beside = [other.activity[t] for other in others] or [before]
        beside += beside[-1:] * (3 - len(beside))
        after = others[0].activity[t + step] if others and t + step < len(own) else beside[0]
        around = 2 * before
        if level.number:
            around = own[t - level.half] + own[t + level.half if t + level.half < len(own) else t - level.half]
        recent = 2 * before + before2
        mean, outer = log(self.slow // 16), log(8 * around)
        near = log(8 * (beside[0] + beside[1]) + 4 * (beside[2] + after))
        everything = 2 * (self.slow // 16) + 10 * recent + 8 * (2 * beside[0] + beside[1] + beside[2])
        return [
            24 * c + mean,
            200 + 24 * log(8 * recent) + near,
            1000 + 24 * (24 * c + near) + mean,
            8000 + 24 * (24 * c + outer) + near,
            14000 + 24 * c + log(everything // 4),
        ]

    def decode(self, coder: Coder, t: int, is_first: bool) -> None:
        point, inside = self.point, self.is_inside(t)
        y, gap, step, others = point.y, point.gap, self.level.step, [other.y for other in self.others]
        if gap[t]:
            y[t] = beside_gaps_and_ends(y, others, gap, self.level, t)
            point.activity[t] = point.activity[t - step] if t >= step else 0
            return
        if inside:
            base, x = features(y, others, self.level, t)
            linear = below_limit(base + dot(self.learner.weights, x), base)
        else:
            base, x = beside_gaps_and_ends(y, others, gap, self.level, t), np.zeros((10, 3))
            linear = base
        prediction, axes, e, rho = linear, np.eye(3), 0.0, 0
        if others and inside and point.m > 0 and (apart := length(linear - others[0][t])) > 8:
            axes = axes_along((linear - others[0][t]) / apart)
            e = point.d / point.m - apart
            prediction = linear + min(1.0, max(0.0, self.b / self.a)) * e * axes[0]
            rho = 1 + log(16 * sum(point.radial[t - k * step] for k in (1, 2) if t >= k * step))
        c = 6 if is_first else min(self.level.number, 5) if inside else 7
        z = lattice_point(coder, c, self.contexts(t, c), rho)
        y[t] = prediction + dot(np.array(z, float), axes)
        point.activity[t], point.radial[t] = min(4000, sum(map(abs, z))), min(4000, abs(z[0]))
        if others:
            point.d = 0.995 * point.d + length(y[t] - others[0][t])
            point.m = 0.995 * point.m + 1
        if rho:
            self.a = 0.98 * self.a + e * e
            self.b = 0.98 * self.b + e * float(dot(y[t] - linear, axes[0]))
        if inside:
            self.slow += (256 * point.activity[t] - self.slow) >> 4
            for axis, forgetting in enumerate((0.999, 1.0, 1.0)):
                error = y[t, axis] - base[axis] - dot(self.learner.weights, x[:, axis])
                self.learner.learn(x[:, axis], float(error), forgetting)

    def end(self) -> None:
        self.level.weights = (self.level.weights + self.learner.weights) / 2
        self.level.activity = (7 * self.level.activity + 3 * self.slow) // 10


def decode(data: bytes, gaps: Array, neighbours: list[list[int]]) -> Array:
    """Positions (frames, points, 3) in half steps. gaps (frames, points)."""
    part = Bytes(data)
    kind = part.take(1)[0]
    s, spikes = kind & 127, part.blob() if kind & 128 else b""
    frames = len(gaps)
    levels = [Level(0, 2**s, 2**s, range(0, frames, 2**s), np.zeros(10))]
    for number in range(1, s + 1):
        half = 2 ** (s - number)
        levels.append(Level(number, half, 2 * half, range(half, frames, 2 * half), -0.0625 * np.eye(10)[0]))
    coder = Coder(part.rest())
    points = [Point(np.zeros((frames, 3)), gap, [0] * frames, [0] * frames) for gap in gaps.T]
    sequence = sequence_of(neighbours)
    for p in sequence:
        for level in levels:
            row = Row(points[p], [points[q] for q in neighbours[p]], level)
            for t in level.frames:
                row.decode(coder, t, is_first=p == sequence[0] and t == 0)
            row.end()
    coder.end()
    positions = np.stack([point.y for point in points], axis=1)
    if spikes:
        part, at = Bytes(spikes), 0
        count = part.varint()
        for apart, *vector in integers(part.rest(), count, 4):
            at += apart
            positions[divmod(at, len(points))] += vector
    return positions
