"""An orthonormal basis across points: found from a covariance, and stored as finely as its components deserve.

    covariance ─fit─► basis (dimensions, components), variances
    variances, noise ─precisions─► how finely to round each component
    basis, precision ─pack─► bytes ─unpack─► basis', orthonormal to the last bits of a float

A component of variance λ turns an error δ of one of its entries into an error of variance λδ² in every sample.
Coefficients rounded to steps of Δ, over T samples, spend their bits well when the entries are rounded to steps of
Δ/√(λT): one more bit then buys the same error wherever it is spent. A weak component costs a bit or two an entry,
where 16 were usual.

Orthogonality is used, not stored: each component is written in the coordinates that the Householder reflections of the
components before it leave free, which is one number fewer each time and makes any rounded basis exactly orthonormal.
Both ends must use the basis that comes out of `unpack`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..entropy import coder
from ..errors import Corrupt
from ..motion import Floats

Integers = NDArray[np.int64]

FINEST = 96
"""The largest precision: entries are multiples of 2^(−precision / 2), here of 2^−48."""

LANES = 8


def fit(covariance: Floats, components: int | None = None) -> tuple[Floats, Floats]:
    """The leading eigenvectors of a symmetric matrix, strongest first: (n, n) → (n, k) and their k eigenvalues.

    Theorem 1 of Hou 2014: no orthonormal n × k matrix B makes Tr(Bᵀ C B) larger. The sign of each column makes its
    largest entry positive, so that equal input gives equal bytes.
    """
    variances, vectors = np.linalg.eigh(covariance)
    vectors = vectors[:, ::-1][:, :components]
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0, keepdims=True), axis=0)
    return vectors * np.where(largest < 0, -1.0, 1.0), np.maximum(variances[::-1][:components], 0.0)


def precisions(variances: Floats, noise: float) -> Integers:
    """How finely to round each component, (k,): its entries are multiples of 2^(−precision / 2).

    variances: λ of each component's coefficients. noise: Δ/√T for coefficients in steps of Δ over T samples. Equal
    slopes of rate against distortion put entries at steps of noise/√λ.
    """
    finest = 2.0**-FINEST
    half_octaves = 2 * np.log2(np.maximum(np.sqrt(variances) / max(noise, finest), finest))
    return np.clip(np.rint(half_octaves), 0, FINEST).astype(np.int64)


def pack(basis: Floats, precision: Integers) -> bytes:
    """Bytes of an orthonormal basis (n, k), rounded to `precision` (k,). Neither n nor the precision is stored."""
    n, k = basis.shape
    rest = np.array(basis, np.float64)
    entries: list[Integers] = []
    for i in range(k):
        direction = rest[i:, i]
        if direction[0] > 0:
            direction = -direction
        entries.append(np.rint(direction * _scale(precision[i])).astype(np.int64))
        _reflect(rest[i:, i + 1 :], _mirror(entries[-1]))
    contexts = _contexts(n, precision)
    values = np.zeros(contexts.shape, np.int64)
    values.flat[: _count(n, k)] = np.concatenate([*entries, np.zeros(0, np.int64)])
    return coder.pack(values, contexts)


def unpack(data: bytes, dimensions: int, precision: Integers) -> Floats:
    """The basis (dimensions, components) that `pack` stored with this precision. Raises Corrupt."""
    n, k = dimensions, len(precision)
    if k > n:
        raise Corrupt(f"a basis of {k} components for {n} dimensions")
    contexts = _contexts(n, precision)
    values = coder.unpack(data, contexts.shape, contexts).ravel()
    mirrors: list[Floats] = []
    for i in range(k):
        start = _count(n, i)
        mirrors.append(_mirror(values[start : start + n - i]))
    basis = np.eye(n, k)
    for i in reversed(range(k)):
        _reflect(basis[i:, i:], mirrors[i])
    return basis


def _scale(precision: int) -> float:
    return 2.0 ** (int(precision) / 2)


def _count(n: int, k: int) -> int:
    """Entries of the first k components: n, n − 1, …"""
    return n * k - k * (k - 1) // 2


def _contexts(n: int, precision: Integers) -> Integers:
    """The expected size of each entry in half-octaves, (steps, LANES): 1/√(free coordinates) in units of the step."""
    free = np.maximum(n - np.arange(len(precision)), 1)
    size = np.maximum(precision - np.floor(np.log2(free)).astype(np.int64), -4) + 4
    by_entry = np.repeat(size, free)
    return np.append(by_entry, np.zeros(-len(by_entry) % LANES, np.int64)).reshape(-1, LANES)


def _mirror(entries: Integers) -> Floats:
    """The Householder vector u with (I − 2uuᵀ) e₁ = entries / |entries|.

    The first entry is never positive, so u never vanishes. Entries that all rounded to zero stand for −e₁.
    """
    u = entries.astype(np.float64)
    norm = float(np.sqrt(u @ u))
    if norm == 0 or u[0] > 0:
        u[:] = 0
        norm = 1.0
        u[0] = -1.0
    u /= norm
    u[0] -= 1
    return u / np.sqrt(u @ u)


def _reflect(columns: Floats, mirror: Floats) -> None:
    columns -= np.outer(2 * mirror, mirror @ columns)
