"""Predictions of the lattice engine, written from docs/payloads/tempo-lattice.md.

Floats are added one by one, from left to right: NumPy's and Python's sums round differently. NumPy is used element by
element only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

Array = np.ndarray

LIMIT = 2.0**40


def dot(a: Array, b: Array) -> Array:
    """Products along the first axis, added from left to right."""
    total = np.zeros_like(b[0])
    for left, right in zip(a, b, strict=True):
        total = total + left * right
    return total


def below_limit(first: Array, second: Array) -> Array:
    """Each coordinate of the first, where it is below 2^40; else of the second; else 0."""
    second = np.where(np.abs(second) < LIMIT, second, 0.0)
    return np.where(np.abs(first) < LIMIT, first, second)


@dataclass
class Level:
    """What a level keeps from point to point."""

    number: int
    half: int
    step: int
    frames: range
    weights: Array
    activity: int = 1024


@dataclass
class Learner:
    """Recursive least squares."""

    weights: Array
    covariance: Array = field(default_factory=lambda: np.eye(10) / 128)

    def learn(self, x: Array, error: float, forgetting: float) -> None:
        g = dot(x, self.covariance)
        power = forgetting
        for left, right in zip(g.tolist(), x.tolist(), strict=True):
            power += left * right
        if not 0.5 * forgetting <= power < 1e300:
            self.covariance = np.eye(10) / 128
            return
        s = g * (1 / power)
        self.weights = self.weights + s * error
        self.covariance = (self.covariance - s[:, None] * g) * (1 / forgetting)


def length(v: Array) -> float:
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def axes_along(u: Array) -> Array:
    """Rows u, v, w."""
    size = np.abs(u)
    k = (0 if size[0] < size[2] else 2) if size[0] < size[1] else (1 if size[1] < size[2] else 2)
    v = np.eye(3)[k] - u[k] * u
    v = v / length(v)
    return np.array([u, v, [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]])


def features(y: Array, others: list[Array], level: Level, t: int) -> tuple[Array, Array]:
    """Base (3,) and features (10, 3) of a sample that is inside."""
    half, x, frames = level.half, np.zeros((10, 3)), len(y)
    if level.number == 0:

        def bend(z: Array, s: int) -> Array:
            return z[s] - 2 * z[s - half] + z[s - 2 * half]

        for i in range(4):
            if t >= (i + 3) * half:
                x[i] = bend(y, t - (i + 1) * half)
        for q, other in enumerate(others):
            x[4 + 2 * q] = bend(other, t)
            if t + half < frames:
                x[5 + 2 * q] = bend(other, t + half)
        return 2 * y[t - half] - y[t - 2 * half], x

    def at(apart: int, otherwise: Array) -> Array:
        return y[t + apart * half] if 0 <= t + apart * half < frames else otherwise

    def bulge(z: Array, s: int) -> Array:
        return z[s] - (z[s - half] + z[s + half]) / 2 if half <= s < frames - half else np.zeros(3)

    l1, r1 = y[t - half], y[t + half]
    l3, r3 = at(-3, 2 * l1 - r1), at(3, 2 * r1 - l1)
    l5, r5 = at(-5, 2 * l3 - l1), at(5, 2 * r3 - r1)
    x[0] = (l3 - l1) - (r1 - r3)
    x[2] = (l5 - l3) - (r3 - r5)
    if t >= 2 * half:
        x[1] = y[t - 2 * half] - (l3 + l1) / 2
    if t >= 4 * half:
        x[3] = y[t - 4 * half] - (l3 + l5) / 2
    for q, other in enumerate(others):
        x[4 + 2 * q] = bulge(other, t)
        x[5 + 2 * q] = bulge(other, t - half) + bulge(other, t + half)
    return (l1 + r1) / 2, x


def beside_gaps_and_ends(y: Array, others: list[Array], gap: Array, level: Level, t: int) -> Array:
    half = level.half
    before, after = t >= half, level.number >= 1 and t + half < len(y)
    if not before and not after:
        base = others[0][t] if others else np.zeros(3)
    elif before and after and gap[t - half] == gap[t + half]:
        base = (y[t - half] + y[t + half]) / 2
    else:
        u = t - half if before and not (after and gap[t - half] and not gap[t + half]) else t + half
        base = y[u] + (others[0][t] - others[0][u]) if others else y[u]
    return np.where(np.abs(base) < LIMIT, base, 0.0)
