"""An orthonormal basis across points: found from a covariance, and stored as finely as its components deserve.

    covariance ─fit─► basis (dimensions, components), variances
    variances, noise ─precisions─► how finely to round each component
    basis, precision ─pack─► bytes ─unpack─► basis', orthonormal to the last bits of a float

A component of variance λ turns an error δ of one of its entries into an error of variance λδ² in every sample. For
coefficients with a quantisation step Δ over T samples, the best step of the entries is Δ/√(λT): one more bit then buys
the same error in entries and coefficients. A weak component takes one or two bits an entry instead of the usual 16.

Orthogonality is not stored but follows: each component is written in the coordinates that the Householder reflections
of the components before it leave free. Each takes one number fewer than the one before, and any rounded basis is
exactly orthonormal. Encoder and decoder must both use the basis that `unpack` returns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .. import native
from ..entropy import coder, varint
from ..errors import CannotEncode, Corrupt
from ..typing import Floats, Integers

FINEST = 96
"""The largest precision: entries are multiples of 2^(−precision / 2), here of 2^−48."""
ZERO = 1e-9
"""Entries of orthonormal columns that are smaller may be zeros with rounding errors."""
FREE_STEPS = 1 << 28
STEPS_PER_BYTE = 1 << 14
"""Decoding a basis (n, k) takes n k² steps. A stored basis may take FREE_STEPS, and STEPS_PER_BYTE for each byte."""


def fit(covariance: Floats, components: int | None = None) -> tuple[Floats, Floats]:
    """The leading eigenvectors of a symmetric matrix, strongest first: (n, n) → (n, k) and their k eigenvalues.

    Theorem 1 of Hou 2014: no orthonormal n × k matrix B makes Tr(Bᵀ C B) larger. The sign of each column makes its
    largest entry positive, so that equal input gives equal bytes.
    """
    variances, vectors = np.linalg.eigh(covariance)
    return _signed(vectors[:, ::-1][:, :components]), np.maximum(variances[::-1][:components], 0.0)


def fit_rows(rows: Floats, components: int | None = None) -> tuple[Floats, Floats]:
    """`fit` of rowsᵀ rows, (samples, n) → (n, k), without that matrix where samples are fewer than dimensions."""
    if len(rows) >= rows.shape[1]:
        return fit(rows.T @ rows, components)
    found = principal_of_rows(rows)
    return found.vectors(components), found.variances[:components]


class Principal(NamedTuple):
    """variances (k,), strongest first; vectors: the first `count` of their directions (n, count), all for None."""

    variances: Floats
    vectors: Callable[[int | None], Floats]


def principal_of_rows(rows: Floats) -> Principal:
    """Eigenvectors of rowsᵀ rows. rows: (samples, n), with fewer samples than dimensions."""
    variances, weights = np.linalg.eigh(rows @ rows.T)
    real = variances > np.finfo(float).eps * len(rows) * max(float(variances[-1]), 0.0)
    variances, weights = variances[real][::-1], weights[:, real][:, ::-1]

    def vectors(count: int | None) -> Floats:
        return _signed(rows.T @ weights[:, :count] / np.sqrt(variances[:count]))

    return Principal(variances, vectors)


def completed(basis: Floats, components: int | None = None, excluded: Floats | None = None) -> Floats:
    """Orthonormal columns (n, k), k ≤ n, followed by more orthonormal columns, (n, components); all n by default.

    excluded (n, m): orthonormal columns, orthogonal to the basis, that none of the new columns has a part in; there are
    then n − m columns at most. The new columns are those of the identity that the Householder reflections of the given
    ones leave. They depend on sums of floats, so no entropy coder may depend on them. A first entry of 0 is common in
    rounded bases, and rounding gives it either sign. All machines must agree: within ZERO it counts as negative in the
    first column and as positive in the others, as in the first files.
    """
    known = basis if excluded is None else np.concatenate([basis, excluded], axis=1)
    return Completion.of(known).rows_after(basis)[:components].T


@dataclass(frozen=True, eq=False)
class Completion:
    """Orthonormal columns and those that complete them, as a product of few columns.

    The product of the reflections takes the first columns of the identity to known · signs. As known is orthonormal,
    the reflections follow from the elimination of known − signs, and only the signs need them one by one:
    missing = the other columns of the identity + moved · across.

    moved (n, k): the known columns less their signs on the diagonal. signs (k,). across (k, n − k).
    """

    moved: Floats
    signs: Floats
    across: Floats

    @classmethod
    def of(cls, known: Floats) -> Completion:
        """The completion of orthonormal columns (n, k)."""
        moved = np.array(known, np.float64)
        count = moved.shape[1]
        signs = _signs_of_reflections(moved[:count])
        moved[np.arange(count), np.arange(count)] -= signs
        return cls(moved, signs, signs[:, None] * np.linalg.solve(moved[:count].T, moved[count:].T))

    @property
    def count(self) -> int:
        """Number of known columns."""
        return len(self.signs)

    def rows_after(self, first: Floats) -> Floats:
        """Some columns (n, m), then those that complete the known ones, one a row: (m + n − k, n)."""
        whole = np.empty((first.shape[1] + len(self.moved) - self.count, len(self.moved)))
        whole[: first.shape[1]] = first.T
        missing = whole[first.shape[1] :]
        np.matmul(self.across.T, self.moved.T, out=missing)
        missing[np.arange(len(missing)), np.arange(self.count, len(self.moved))] += 1.0
        return whole

    def components(self, rows: Floats, out: Floats) -> None:
        """rows (m, n) times all columns, the known ones first, into `out` (m, n): fewer steps than by `completed` where
        these are few."""
        moved = rows @ self.moved
        np.matmul(moved, self.across, out=out[:, self.count :])
        out[:, self.count :] += rows[:, self.count :]
        np.multiply(rows[:, : self.count], self.signs, out=out[:, : self.count])
        out[:, : self.count] += moved


def _signs_of_reflections(corner: Floats) -> Floats:
    """The sign (k,) that reflections give each diagonal entry, from the first rows (k, k) of orthonormal columns."""
    if (kernel := native.kernel("basis_signs")) is not None:
        return kernel(corner, ZERO)
    left, count = corner.copy(), len(corner)
    signs = np.empty(count)
    for i in range(count):
        signs[i] = -1.0 if left[i, i] > (-ZERO if i else ZERO) else 1.0
        left[i + 1 :, i] /= left[i, i] - signs[i]
        left[i + 1 :, i + 1 :] -= np.outer(left[i + 1 :, i], left[i, i + 1 :])
    return signs


def precisions(variances: Floats, noise: float) -> Integers:
    """How finely to round each component, (k,): its entries are multiples of 2^(−precision / 2).

    variances: λ of each component's coefficients. noise: Δ/√T for coefficients in steps of Δ over T samples. Equal
    slopes of rate against distortion put entries at steps of noise/√λ.
    """
    finest = 2.0**-FINEST
    half_octaves = 2 * np.log2(np.maximum(np.sqrt(variances) / max(noise, finest), finest))
    return np.clip(np.rint(half_octaves), 0, FINEST).astype(np.int64)


def rounded(basis: Floats, precision: Integers) -> Floats:
    """The basis that `unpack` will give for this one, without the bytes between."""
    return _compose(_decompose(basis, precision), len(basis))


def pack(basis: Floats, precision: Integers, alike: Integers | None = None) -> bytes:
    """Bytes of an orthonormal basis (n, k), rounded to `precision` (k,). Neither n nor the precision is stored.

    alike: as `pack_each` takes them.
    """
    return pack_each(basis, precision, [alike])[0]


def pack_rounded(basis: Floats, precision: Integers, alike: Integers | None = None) -> tuple[bytes, Floats]:
    """`pack`, and what `unpack` makes of it."""
    entries = _decompose(basis, precision)
    return _pack_entries(entries, alike), _compose(entries, len(basis))


def pack_each(basis: Floats, precision: Integers, alikes: Sequence[Integers | None]) -> list[bytes]:
    """`pack` with each of several predictions of dimensions.

    alike (n,): for each dimension an earlier one that moves much the same (the same axis of the point next to it on the
    body), or −1. Leading components are stored as differences between them, for as many components as this saves bytes.
    """
    entries = _decompose(basis, precision)
    return [_pack_entries(entries, alike) for alike in alikes]


def _pack_entries(entries: Integers, alike: Integers | None) -> bytes:
    differences = _differences(entries, alike)
    sizes = np.log2(1 + np.abs(np.stack([entries, differences]))).sum(axis=1)
    saved = np.cumsum(np.append(0, sizes[0] - sizes[1]))
    leading = int(saved.argmax()) if alike is not None else 0
    values = np.concatenate([differences[:, :leading], entries[:, leading:]], axis=1)
    packed = varint.write([leading]) + coder.pack(values)
    n, k = entries.shape
    if not _is_affordable(n, k, len(packed)):
        raise CannotEncode(f"a basis of {k} components for {n} dimensions is too large to decode")
    return packed


def _is_affordable(n: int, k: int, stored: int) -> bool:
    """Whether the n k² steps of `_compose` are in proportion to the bytes that are stored."""
    return n * k * k <= FREE_STEPS + STEPS_PER_BYTE * stored


def unpack(data: bytes, dimensions: int, precision: Integers, alike: Integers | None = None) -> Floats:
    """The basis (dimensions, components) that `pack` stored with this precision. Raises Corrupt."""
    n, k = dimensions, len(precision)
    if k > n:
        raise Corrupt(f"a basis of {k} components for {n} dimensions")
    (leading,), at = varint.read(data, 1)
    if not _is_affordable(n, k, len(data)):
        raise Corrupt(f"a basis of {k} components for {n} dimensions in {len(data)} bytes")
    if leading > (0 if alike is None else k):
        raise Corrupt("a basis with differences between dimensions that are not there")
    values = coder.unpack(data[at:], (n, k))
    if alike is not None:
        _sum_differences(values, alike, leading)
    return _compose(values, n)


def _decompose(basis: Floats, precision: Integers) -> Integers:
    """Rounded entries, (n, k), zero above the diagonal; column i is in the coordinates that i reflections leave."""
    n, k = basis.shape
    scales = np.array([2.0 ** (int(p) / 2) for p in precision])
    if (kernel := native.kernel("basis_decompose")) is not None:
        return kernel(basis, scales)
    rest = np.array(basis, np.float64)
    entries = np.zeros((n, k), np.int64)
    for i in range(k):
        direction = rest[i:, i]
        if direction[0] > 0:
            direction = -direction
        entries[i:, i] = np.rint(direction * scales[i])
        _reflect(rest[i:, i + 1 :], _mirror(entries[i:, i]))
    return entries


def _compose(entries: Integers, n: int) -> Floats:
    """The orthonormal basis of rounded entries."""
    if (kernel := native.kernel("basis_compose")) is not None:
        return kernel(entries)
    k = entries.shape[1]
    basis = np.eye(n, k)
    for i in reversed(range(k)):
        _reflect(basis[i:, i:], _mirror(entries[i:, i]))
    return basis


def _differences(entries: Integers, alike: Integers | None) -> Integers:
    """Entries less those of the dimension alike."""
    if alike is None:
        return entries
    return entries - np.where((alike >= 0)[:, None], entries[alike], 0)


def _sum_differences(values: Integers, alike: Integers, leading: int) -> None:
    """Undo `_differences` of the leading columns, in place."""
    if (kernel := native.kernel("basis_sum_differences")) is not None:
        return kernel(values, alike, leading)
    for row in np.flatnonzero(alike >= 0):
        values[row, :leading] += values[alike[row], :leading]


def _signed(vectors: Floats) -> Floats:
    """With the largest entry of each column positive."""
    if not vectors.size:
        return vectors
    largest = vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])]
    return vectors * np.where(largest < 0, -1.0, 1.0)


def _mirror(entries: Integers) -> Floats:
    """The Householder vector u with (I − 2uuᵀ) e₁ = entries / |entries|.

    The first entry is never positive, so u never vanishes. Entries that all rounded to zero stand for −e₁.
    """
    u = entries.astype(np.float64)
    norm = float(np.sqrt(_in_order(u * u)))
    if norm == 0 or u[0] > 0:
        u[:] = 0
        norm = 1.0
        u[0] = -1.0
    u /= norm
    u[0] -= 1
    return u / np.sqrt(_in_order(u * u))


def _in_order(terms: Floats) -> Any:
    """The sum along the first axis from its first term to its last, as the compiled module adds."""
    return np.cumsum(terms, axis=0)[-1]


def _reflect(columns: Floats, mirror: Floats) -> None:
    """Apply I − 2uuᵀ to the columns, in place."""
    if columns.shape[1]:
        columns -= (2 * mirror)[:, None] * _in_order(mirror[:, None] * columns)
