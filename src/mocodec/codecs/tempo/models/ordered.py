"""Linear algebra in a fixed order of operations: the same bits on every machine.

Spreads, which the entropy coder depends on, are computed from floats. A library's product of matrices may sum in an
order of its own, so everything that leads to spreads uses these functions instead. They take rows, (rows, columns).
"""

from __future__ import annotations

import numpy as np

from .... import native
from ....typing import Floats, Integers

ROUNDS = 1
"""Power iterations that bring directions nearer to the principal ones."""
FAINTEST_SHARE = 1e-10
"""Directions with less than this share of the strongest one's energy are left out."""
_FRACTIONS = np.array([round(2 ** (i / 32) * (1 << 20)) / (1 << 20) for i in range(32)])


def square_of_exp2(logs: Integers) -> Floats:
    """4^log of logarithms in 1/32 octave, from a table."""
    twice = 2 * logs
    return np.ldexp(_FRACTIONS[twice & 31], twice >> 5)


def matmul(a: Floats, b: Floats) -> Floats:
    if (kernel := native.kernel("ordered_matmul")) is not None:
        return kernel(a, b)
    out = np.zeros((len(a), b.shape[1]))
    for column, row in zip(a.T, b, strict=True):
        out += column[:, None] * row
    return out


def sum_first_axis(a: Floats) -> Floats:
    """The sum along the first axis, pairwise."""
    while len(a) > 1:
        half = len(a) // 2
        first = a[:half] + a[half : 2 * half]
        if len(a) % 2:
            first[0] = first[0] + a[-1]
        a = first
    return a[0] if len(a) else np.zeros(a.shape[1:])


def length(v: Floats) -> Floats:
    """Length of a vector (3,)."""
    return np.sqrt((v[0] * v[0] + v[1] * v[1]) + v[2] * v[2])


def unit(v: Floats) -> Floats:
    return v / length(v)


def cross(a: Floats, b: Floats) -> Floats:
    """Cross product of vectors (…, 3)."""
    return np.stack([a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=-1)


def principal_directions(rows: Floats, most: int) -> Floats:
    """Orthonormal directions (k ≤ most, columns) of rows, about the principal ones, strongest first."""
    found = orthonormal(rows, most)
    for _ in range(ROUNDS):
        if len(found):
            found = orthonormal(matmul(matmul(found, rows.T.copy()), rows), most)
    return found


def orthonormal(rows: Floats, most: int, shortest: float = 1e-30) -> Floats:
    """Gram–Schmidt with pivoting, the longest remaining row first; rows of less squared length than `shortest`, and
    those fainter than `FAINTEST_SHARE`, are dropped."""
    if (kernel := native.kernel("ordered_orthonormal")) is not None:
        return kernel(rows, most, shortest, FAINTEST_SHARE)
    left = rows.T.copy()
    size = sum_first_axis(left**2)
    floor = max(shortest, float(size.max(initial=0.0)) * FAINTEST_SHARE)
    out = np.zeros((left.shape[0], min(most, len(rows))))
    for count in range(out.shape[1]):
        longest = int(size.argmax())
        if size[longest] < floor:
            return out[:, :count].T.copy()
        direction = left[:, longest] / np.sqrt(size[longest])
        direction = direction - sum_first_axis((out[:, :count] * sum_first_axis(out[:, :count] * direction[:, None])).T)
        unit_ = direction / np.sqrt(sum_first_axis(direction**2))
        out[:, count] = unit_
        left -= unit_[:, None] * sum_first_axis(left * unit_[:, None])
        size = sum_first_axis(left**2)
        size[longest] = 0.0
    return out.T.copy()


def cholesky(a: Floats) -> Floats:
    """The lower triangular L with L Lᵀ = a."""
    left, out = a.copy(), np.zeros_like(a)
    for i in range(len(left)):
        out[i:, i] = left[i:, i] / np.sqrt(left[i, i])
        left[i:, i:] -= out[i:, i, None] * out[i:, i]
    return out


def times_inverse(rows: Floats, lower: Floats) -> Floats:
    """rows · lower⁻¹, for a lower triangular matrix."""
    out = rows.copy()
    for i in range(len(lower) - 1, -1, -1):
        out[:, i] /= lower[i, i]
        out[:, :i] -= out[:, i, None] * lower[i, :i]
    return out
