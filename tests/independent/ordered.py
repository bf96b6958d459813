"""Logarithms and ordered arithmetic of tempo, written from docs/payloads/tempo.md and tempo-models.md."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .payloads import Array

BAND = (0, 200, 350, 500, 700, 1000, 1400, 2000, 2800, 4000, 5600, 8000, 11000, 16000, 22000, 32000, 45000, 60000)
BANDS = (range(5), range(5, 8), range(8, 10), range(10, 18))
LOG = np.array([round(32 * math.log2(1 + i / 256)) for i in range(256)])


def log2(v: Any) -> Array:
    half, exponent = np.frexp(np.asarray(v, np.float64))
    return 32 * (exponent.astype(np.int64) - 1) + LOG[np.floor((2 * half - 1) * 256).astype(np.int64)]


def ordered_sum(a: Array) -> Array:
    """Along the first axis."""
    while len(a) > 1:
        half = len(a) // 2
        new = a[:half] + a[half : 2 * half]
        if len(a) % 2:
            new[0] = new[0] + a[-1]
        a = new
    return a[0] if len(a) else np.zeros(a.shape[1:])


def product(a: Array, b: Array) -> Array:
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[1]):
        out = out + a[:, i, None] * b[i]
    return out


def length(v: Array) -> Array:
    return np.sqrt((v[0] * v[0] + v[1] * v[1]) + v[2] * v[2])


def unit(v: Array) -> Array:
    return v / length(v)


def cross(a: Array, b: Array) -> Array:
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


FRACTION = np.array([round(2 ** (i / 32) * 2**20) / 2**20 for i in range(32)])


def square(x: Array) -> Array:
    return np.ldexp(FRACTION[(2 * x) % 32], 2 * x >> 5)


def orthonormal(rows: Array, most: int, shortest: float) -> Array:
    rows = rows.copy()
    size = ordered_sum(rows.T**2)
    floor = max(shortest, size.max() * 1e-10)
    found: list[Array] = []
    for _ in range(min(most, len(rows))):
        i = int(size.argmax())
        if size[i] < floor:
            break
        v = rows[i] / np.sqrt(size[i])
        before = np.array(found).reshape(-1, len(v))
        part = ordered_sum((before * v).T)
        v = v - ordered_sum(before * part[:, None])
        u = v / np.sqrt(ordered_sum(v**2))
        found.append(u)
        rows = rows - u * ordered_sum((rows * u).T)[:, None]
        size = ordered_sum(rows.T**2)
        size[i] = 0
    return np.array(found).reshape(-1, rows.shape[1])


def principal(rows: Array, most: int) -> Array:
    found = orthonormal(rows, most, 1e-30)
    return orthonormal(product(product(found, rows.T), rows), most, 1e-30) if len(found) else found


def cholesky(a: Array) -> Array:
    a, lower = a.copy(), np.zeros_like(a)
    for i in range(len(a)):
        lower[i:, i] = a[i:, i] / np.sqrt(a[i, i])
        a[i:, i:] = a[i:, i:] - lower[i:, i, None] * lower[i:, i]
    return lower


def divide(rows: Array, lower: Array) -> Array:
    rows = rows.copy()
    for i in reversed(range(len(lower))):
        rows[:, i] = rows[:, i] / lower[i, i]
        for j in range(i):
            rows[:, j] = rows[:, j] - rows[:, i] * lower[i, j]
    return rows


def complete(rows: Array, excluded: Array | None = None) -> Array:
    q = (rows if excluded is None else np.concatenate([rows, excluded])).T.copy()
    n, count = q.shape
    mirrors = []
    for i in range(count):
        u = q[i:, i].copy()
        u[0] += 1 if u[0] > (-1e-9 if i else 1e-9) else -1
        u /= math.sqrt(u @ u)
        mirrors.append(u)
        q[i:] -= 2 * np.outer(u, u @ q[i:])
    more = np.eye(n)[:, count:]
    for i in reversed(range(count)):
        more[i:] -= 2 * np.outer(mirrors[i], mirrors[i] @ more[i:])
    return np.concatenate([rows, more.T])
