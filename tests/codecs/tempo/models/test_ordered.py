"""Linear algebra in a fixed order: the compiled module has the bits of NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.tempo.models import ordered
from mocodec.typing import Floats


def rows_of(count: int, dimensions: int, rank: int | None = None) -> Floats:
    random = np.random.default_rng(count + 100 * dimensions)
    if rank is None:
        return random.normal(size=(count, dimensions)) * 2.0 ** -np.arange(count)[:, None]
    return random.normal(size=(count, rank)) @ random.normal(size=(rank, dimensions))


CASES = [rows_of(5, 9), rows_of(9, 5), rows_of(1, 7), rows_of(12, 12, 4), np.zeros((3, 4)), np.zeros((0, 4))]


@pytest.mark.skipif(not native.available(), reason="the compiled module is not built")
@pytest.mark.parametrize("rows", CASES)
def test_compiled_directions_have_the_bits_of_numpy(rows: Floats) -> None:
    for most in (1, 3, 20):
        found = ordered.orthonormal(rows, most), ordered.principal_directions(rows, most)
        with native.without():
            expected = ordered.orthonormal(rows, most), ordered.principal_directions(rows, most)
        for ours, theirs in zip(found, expected, strict=True):
            assert ours.shape == theirs.shape
            assert ours.tobytes() == theirs.tobytes()


@pytest.mark.skipif(not native.available(), reason="the compiled module is not built")
@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (7, 3), (4, 33), (0, 2)])
def test_compiled_product_has_the_bits_of_numpy(rows: int, columns: int) -> None:
    random = np.random.default_rng(rows)
    a, b = random.normal(size=(rows, 11)), random.normal(size=(11, columns))
    found = ordered.matmul(a, b)
    with native.without():
        assert found.tobytes() == ordered.matmul(a, b).tobytes()
    np.testing.assert_allclose(found, a @ b, atol=1e-12)


@pytest.mark.parametrize("rows", CASES)
def test_directions_are_orthonormal_and_span_the_rows(rows: Floats) -> None:
    found = ordered.orthonormal(rows, 20)
    np.testing.assert_allclose(found @ found.T, np.eye(len(found)), atol=1e-9)
    np.testing.assert_allclose(rows @ found.T @ found, rows, atol=1e-4)
