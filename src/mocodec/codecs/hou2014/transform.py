"""The left transform B: an orthonormal basis across points, found from data and stored in few bytes (section IV-B, C).

    covariance ─fit─► Transform ─rounded to a noise─► Transform ─pack─► bytes ─unpack─► the same

Two forms on disk: each component only as finely as its variance deserves, or the paper's 16 bits an entry.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...motion import Floats
from ...stages import basis

Integers = NDArray[np.int64]

FINE_CHAIN, FINE_TREE, SIXTEEN_BITS = 0, 1, 2
"""Forms on disk: never change one. A fine entry is predicted from the point before, or from the joint's parent."""

SIXTEEN_BITS_STEP = 2.0**-15


@dataclass(frozen=True, eq=False)
class Transform:
    """B, (3 points, k), as found and as both ends use it.

    fitted, variances (k,): the eigenvectors and eigenvalues of C; known to the encoder only. matrix: orthonormal, as it
    comes out of the file. precision (k,): half-octaves; none for 16 bits an entry.
    """

    matrix: Floats
    precision: Integers | None
    fitted: Floats
    variances: Floats

    def __len__(self) -> int:
        return self.matrix.shape[1]

    def leading(self, components: int) -> Transform:
        """The first components only."""
        return Transform(
            self.matrix[:, :components],
            None if self.precision is None else self.precision[:components],
            self.fitted[:, :components],
            self.variances[:components],
        )

    def rounded(self, step: float) -> Transform:
        """Rounded so finely as coefficients in steps of `step` deserve: section VII's first open end."""
        precision = np.minimum.accumulate(basis.precisions(self.variances, step))
        return replace(self, matrix=basis.rounded(self.fitted, precision), precision=precision)

    def rounded_to_16_bits(self) -> Transform:
        """Rounded to 16 bits an entry: section IV-C."""
        entries = np.clip(np.rint(self.fitted / SIXTEEN_BITS_STEP), -(1 << 15), (1 << 15) - 1)
        return replace(self, matrix=entries * SIXTEEN_BITS_STEP, precision=None)

    def pack(self, parents: Sequence[int] | None) -> bytes:
        """Bytes. parents: each point's parent in the skeleton (−1: none), where there is one."""
        k = len(self)
        if self.precision is None:
            entries = np.rint(self.matrix / SIXTEEN_BITS_STEP).astype("<i2")
            return varint.write([SIXTEEN_BITS, k]) + entries.tobytes()
        drops = coder.pack(-np.diff(self.precision)[:, None])
        points = len(self.fitted) // 3
        first = int(self.precision[0]) if k else 0
        forms = [
            varint.write([form, k, first, len(drops)]) + drops + basis.pack(self.fitted, self.precision, alike)
            for form, alike in ((FINE_CHAIN, _before(points)), (FINE_TREE, _parents(parents)))
            if alike is not None
        ]
        return min(forms, key=len)


def fit(covariance: Floats, components: int | None = None) -> Transform:
    """The k eigenvectors of C, (3n, 3n), of the largest eigenvalues: Theorem 1."""
    vectors, variances = basis.fit(covariance, components)
    return Transform(vectors, None, vectors, variances)


def fit_rows(rows: Floats, components: int | None = None) -> Transform:
    """The same of C = rowsᵀ rows; rows are M_i D̃, transposed, of all clips."""
    vectors, variances = basis.fit_rows(rows, components)
    return Transform(vectors, None, vectors, variances)


def unpack(data: bytes, dimensions: int, parents: Sequence[int] | None) -> Transform:
    """The transform that `Transform.pack` stored. Raises Corrupt."""
    (form, k), at = varint.read(data, 2)
    if k > dimensions:
        raise Corrupt(f"a transform of {k} components for {dimensions} dimensions")
    if form == SIXTEEN_BITS:
        if len(data) - at != 2 * k * dimensions:
            raise Corrupt("a transform of the wrong size")
        matrix = np.frombuffer(data, "<i2", offset=at).reshape(dimensions, k) * SIXTEEN_BITS_STEP
        return Transform(matrix, None, matrix, np.zeros(k))
    alike = _before(dimensions // 3) if form == FINE_CHAIN else _parents(parents)
    if form > FINE_TREE or alike is None:
        raise Corrupt(f"a transform of unknown form {form}")
    (first, size), at = varint.read(data, 2, at)
    drops = coder.unpack(data[at : at + size], (max(k - 1, 0), 1))[:, 0]
    precision = first - np.cumsum(np.append(0, drops))[:k]
    if k and (precision.min() < 0 or precision.max() > basis.FINEST):
        raise Corrupt("a transform of impossible precision")
    matrix = basis.unpack(data[at + size :], dimensions, precision, alike)
    return Transform(matrix, precision, matrix, np.zeros(k))


def _before(points: int) -> Integers:
    """For each coordinate the same of the point before, −1 for the first point's."""
    alike = np.arange(3 * points) - 3
    return np.maximum(alike, -1)


def _parents(parents: Sequence[int] | None) -> Integers | None:
    """For each coordinate the same of the joint's parent, −1 for a root's."""
    if parents is None:
        return None
    rows = np.asarray(parents, np.int64)[:, None]
    return np.where(rows < 0, -1, 3 * rows + np.arange(3)).ravel()
