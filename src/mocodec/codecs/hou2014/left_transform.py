"""The left transform B: an orthonormal basis across points, fitted to data and stored (section IV-B and IV-C).

    covariance ─fit─► LeftTransform ─rounded─► LeftTransform ─pack─► bytes ─unpack─► LeftTransform

Two kinds of storage: adaptive precision, where the rounding of each component depends on its variance, or the paper's
16 bits per entry.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...entropy import coder, varint
from ...errors import Corrupt
from ...stages import basis
from ...typing import Floats, Integers

FINE_CHAIN, FINE_TREE, SIXTEEN_BITS = 0, 1, 2
"""Storage forms on disk: never change a number.

Both FINE forms have adaptive precision. They predict an entry from the previous point (CHAIN) or from the parent joint
(TREE).
"""

SIXTEEN_BITS_STEP = 2.0**-15


@dataclass(frozen=True, eq=False)
class LeftTransform:
    """B, (3 points, k): the exact eigenvectors, and the rounded matrix that encoder and decoder use.

    fitted, variances (k,): eigenvectors and eigenvalues of C, known to the encoder only. matrix: the orthonormal matrix
    that the decoder gets. precision (k,): entries of a component are multiples of 2^(−precision / 2); None for 16 bits
    per entry.
    """

    matrix: Floats
    precision: Integers | None
    fitted: Floats
    variances: Floats

    def __len__(self) -> int:
        return self.matrix.shape[1]

    def leading(self, components: int) -> LeftTransform:
        """The first `components` components only."""
        return LeftTransform(
            self.matrix[:, :components],
            None if self.precision is None else self.precision[:components],
            self.fitted[:, :components],
            self.variances[:components],
        )

    def rounded(self, step: float) -> LeftTransform:
        """Rounded to adaptive precision for coefficients with this quantisation step. Section VII, future work 1."""
        precision = np.minimum.accumulate(basis.precisions(self.variances, step))
        return replace(self, matrix=basis.rounded(self.fitted, precision), precision=precision)

    def rounded_to_16_bits(self) -> LeftTransform:
        """Rounded to 16 bits per entry: section IV-C."""
        entries = np.clip(np.rint(self.fitted / SIXTEEN_BITS_STEP), -(1 << 15), (1 << 15) - 1)
        return replace(self, matrix=entries * SIXTEEN_BITS_STEP, precision=None)

    def pack(self, parents: Sequence[int] | None) -> bytes:
        """The shortest of the possible forms. parents: parent of each point in the skeleton (−1: none), if any."""
        k = len(self)
        if self.precision is None:
            entries = np.rint(self.matrix / SIXTEEN_BITS_STEP).astype("<i2")
            return varint.write([SIXTEEN_BITS, k]) + entries.tobytes()
        drops = coder.pack(-np.diff(self.precision)[:, None])
        points = len(self.fitted) // 3
        first = int(self.precision[0]) if k else 0
        predictors = {FINE_CHAIN: _previous_point(points), FINE_TREE: _parent_joint(parents)}
        possible = {form: alike for form, alike in predictors.items() if alike is not None}
        packed = basis.pack_each(self.fitted, self.precision, list(possible.values()))
        forms = [
            varint.write([form, k, first, len(drops)]) + drops + entries
            for form, entries in zip(possible, packed, strict=True)
        ]
        return min(forms, key=len)


def fit(covariance: Floats, components: int | None = None) -> LeftTransform:
    """The k eigenvectors of C, (3n, 3n), with the largest eigenvalues: Theorem 1."""
    vectors, variances = basis.fit(covariance, components)
    return LeftTransform(vectors, None, vectors, variances)


def fit_rows(rows: Floats, components: int | None = None) -> LeftTransform:
    """`fit` for C = rowsᵀ rows, where rows (samples, 3n) are the transposed M_i D̃ of all clips."""
    vectors, variances = basis.fit_rows(rows, components)
    return LeftTransform(vectors, None, vectors, variances)


def unpack(data: bytes, dimensions: int, parents: Sequence[int] | None) -> LeftTransform:
    """Inverse of `LeftTransform.pack`. dimensions: 3 × points. Raises Corrupt."""
    (form, k), at = varint.read(data, 2)
    if k > dimensions:
        raise Corrupt(f"hou2014: a left transform has {k} components, more than its {dimensions} dimensions")
    if form == SIXTEEN_BITS:
        expected = 2 * k * dimensions
        if len(data) - at != expected:
            raise Corrupt(f"hou2014: a left transform has {len(data) - at} bytes of entries, not {expected}")
        matrix = np.frombuffer(data, "<i2", offset=at).reshape(dimensions, k) * SIXTEEN_BITS_STEP
        return LeftTransform(matrix, None, matrix, np.zeros(k))
    predictors = _previous_point(dimensions // 3) if form == FINE_CHAIN else _parent_joint(parents)
    if form > FINE_TREE:
        raise Corrupt(f"hou2014: a left transform has the unknown form {form}")
    if predictors is None:
        raise Corrupt("hou2014: a left transform is predicted along a skeleton, but the file has no skeleton")
    (first, size), at = varint.read(data, 2, at)
    drops = coder.unpack(data[at : at + size], (max(k - 1, 0), 1))[:, 0]
    precision = first - np.cumsum(np.append(0, drops))[:k]
    if k and (precision.min() < 0 or precision.max() > basis.FINEST):
        raise Corrupt(f"hou2014: a left transform has a precision outside 0 to {basis.FINEST}")
    matrix = basis.unpack(data[at + size :], dimensions, precision, predictors)
    return LeftTransform(matrix, precision, matrix, np.zeros(k))


def _previous_point(points: int) -> Integers:
    """Row that predicts each row of B: the same coordinate of the previous point, −1 for the first point."""
    predictors = np.arange(3 * points) - 3
    return np.maximum(predictors, -1)


def _parent_joint(parents: Sequence[int] | None) -> Integers | None:
    """Row that predicts each row of B: the same coordinate of the parent joint, −1 for a root. None without parents."""
    if parents is None:
        return None
    rows = np.asarray(parents, np.int64)[:, None]
    return np.where(rows < 0, -1, 3 * rows + np.arange(3)).ravel()
