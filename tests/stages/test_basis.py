"""Bases: Theorem 1, rounding by each component's variance, orthonormal for any bytes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocodec import native
from mocodec.errors import Corrupt
from mocodec.stages import basis
from mocodec.testing import corruption


def covariance(dimensions: int = 24, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    mixed = rng.normal(size=(200, dimensions)) * np.exp(-np.arange(dimensions) / 3)
    rows = mixed @ np.linalg.qr(rng.normal(size=(dimensions, dimensions)))[0]
    return rows.T @ rows


def before(dimensions: int) -> np.ndarray:
    return np.maximum(np.arange(dimensions) - 3, -1)


def test_no_other_basis_has_more_energy():
    c = covariance()
    found, energies = basis.fit(c, 5)
    assert np.isclose(np.trace(found.T @ c @ found), energies.sum())
    rng = np.random.default_rng(1)
    for _ in range(20):
        other = np.linalg.qr(rng.normal(size=(24, 5)))[0]
        assert np.trace(other.T @ c @ other) < energies.sum()
    assert (np.take_along_axis(found, np.abs(found).argmax(axis=0)[None], 0) > 0).all()


@pytest.mark.parametrize("samples", [10, 40])
def test_fewer_and_more_rows_than_dimensions(samples: int):
    rows = np.random.default_rng(3).normal(size=(samples, 20)) * np.exp(-np.arange(20) / 4)
    whole, energies = basis.fit(rows.T @ rows, 6)
    found, same = basis.fit_rows(rows, 6)
    assert np.allclose(found, whole, atol=1e-9)
    assert np.allclose(same, energies)
    assert basis.fit_rows(np.zeros((3, 5)))[0].shape == (5, 0)


@pytest.mark.parametrize("alike", [None, before(24)], ids=["plain", "differences"])
def test_the_rounded_basis_comes_back_orthonormal(alike: np.ndarray | None):
    found, energies = basis.fit(covariance())
    sizes = []
    for noise in (10.0, 0.3, 0.01):
        precision = basis.precisions(energies, noise)
        data = basis.pack(found, precision, alike)
        back = basis.unpack(data, 24, precision, alike)
        assert np.array_equal(back, basis.rounded(found, precision))
        assert np.abs(back.T @ back - np.eye(24)).max() < 1e-13
        sizes.append(len(data))
    assert sizes == sorted(sizes)


def test_strong_components_are_rounded_finest_and_the_error_is_within_the_plan():
    c = covariance()
    found, energies = basis.fit(c)
    noise = 0.05
    precision = basis.precisions(energies, noise)
    assert (np.diff(precision) <= 0).all()
    back = basis.rounded(found, precision)
    lost = [np.trace(c) - np.trace(back[:, :k].T @ c @ back[:, :k]) - energies[k:].sum() for k in range(1, 20)]
    assert max(lost) < 24 * 20 * noise**2


def test_leading_columns_are_the_rounding_of_fewer():
    found, energies = basis.fit(covariance())
    precision = basis.precisions(energies, 0.1)
    assert np.allclose(basis.rounded(found, precision)[:, :7], basis.rounded(found[:, :7], precision[:7]), atol=1e-15)


def test_differences_take_fewer_bytes_where_points_move_alike():
    rng = np.random.default_rng(2)
    shared = np.repeat(rng.normal(size=(1, 10)), 8, axis=0) + 0.1 * rng.normal(size=(8, 10))
    rows = rng.normal(size=(300, 10)) @ shared.T
    found, energies = basis.fit(np.kron(rows.T @ rows, np.eye(3)), 9)
    precision = basis.precisions(energies, 0.1)
    assert len(basis.pack(found, precision, before(24))) < len(basis.pack(found, precision))


@pytest.mark.parametrize("components", [0, 1, 5, 24])
def test_completed_to_all_dimensions(components: int):
    found = basis.fit(covariance(), components)[0]
    whole = basis.completed(found)
    assert np.array_equal(whole[:, :components], found)
    assert np.abs(whole.T @ whole - np.eye(24)).max() < 1e-13
    assert basis.completed(found, 12).shape == (24, 12)


def test_completed_without_excluded_directions():
    whole = basis.fit(covariance())[0]
    found, excluded = whole[:, :6], whole[:, 20:23]
    more = basis.completed(found, 21, excluded)
    assert more.shape == (24, 21)
    assert np.abs(more.T @ more - np.eye(21)).max() < 1e-13
    assert np.abs(more.T @ excluded).max() < 1e-13


def test_completed_does_not_depend_on_rounding():
    """A column whose first free entry is 0: rounding gives it a sign."""
    found = np.linalg.qr(np.random.default_rng(2).normal(size=(9, 3)))[0]
    found[:, 1] = 0
    found[4, 1] = 1
    found[4, [0, 2]] = 0
    found = np.linalg.qr(found)[0]
    whole = [basis.completed(np.where(found == 0, noise, found)) for noise in (0.0, 1e-16, -1e-16, -3e-15)]
    for other in whole[1:]:
        np.testing.assert_allclose(other, whole[0], rtol=0, atol=1e-12)


def test_completed_from_axes():
    whole = basis.completed(np.eye(5)[:, [2, 0]])
    assert np.abs(whole.T @ whole - np.eye(5)).max() < 1e-15


@pytest.mark.parametrize("components", [0, 1, 7, 24])
def test_components_along_the_completed_basis(components: int):
    found = basis.fit(covariance(), components)[0]
    rows = np.random.default_rng(5).normal(size=(6, 24))
    along = np.empty(rows.shape)
    basis.Completion.of(found).components(rows, along)
    np.testing.assert_allclose(along, rows @ basis.completed(found), rtol=0, atol=1e-12)


def test_no_components():
    empty = np.zeros((6, 0))
    none = np.zeros(0, np.int64)
    assert basis.unpack(basis.pack(empty, none), 6, none).shape == (6, 0)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.binary(max_size=40))
def test_any_bytes_are_a_basis_or_corrupt(data: bytes):
    precision = np.full(3, 12)
    try:
        back = basis.unpack(data, 9, precision, before(9))
    except Corrupt:
        return
    assert np.abs(back.T @ back - np.eye(3)).max() < 1e-12


def test_damaged_bytes_are_a_basis_or_corrupt():
    found, energies = basis.fit(covariance(), 6)
    precision = basis.precisions(energies, 0.1)
    for bad in corruption.damaged(basis.pack(found, precision), 60, seed=0):
        try:
            back = basis.unpack(bad, 24, precision)
        except Corrupt:
            continue
        assert back.shape == (24, 6)


def test_the_compiled_basis_is_numpys_to_rounding() -> None:
    if native.kernel("basis_compose") is None:
        pytest.skip("the compiled module is not built")
    random = np.random.default_rng(3)
    for n, k in ((1, 1), (3, 2), (93, 40), (60, 60)):
        entries = random.integers(-1000, 1000, (n, k))
        entries[np.triu_indices(n, 1, k)] = 0
        entries[:, k // 2] = 0
        compiled = basis._compose(entries, n)
        with native.without():
            np.testing.assert_allclose(compiled, basis._compose(entries, n), rtol=0, atol=1e-12)
        np.testing.assert_allclose(compiled.T @ compiled, np.eye(k), atol=1e-12)


@pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")
def test_compiled_bases_have_the_same_bytes() -> None:
    vectors, variances = basis.fit(covariance(24, 3), 17)
    precision = np.minimum.accumulate(basis.precisions(variances, 0.05))
    data = basis.pack(vectors, precision, before(24))
    rounded = basis.unpack(data, 24, precision, before(24))
    with native.without():
        assert basis.pack(vectors, precision, before(24)) == data
        np.testing.assert_array_equal(basis.unpack(data, 24, precision, before(24)), rounded)


@pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")
def test_compiled_signs_of_reflections_are_numpys() -> None:
    random = np.random.default_rng(6)
    for n, k in ((1, 1), (9, 4), (40, 40)):
        corner = np.linalg.qr(random.normal(size=(n, n)))[0][:k, :k]
        corner[0, 0] = 1e-12
        signs = basis._signs_of_reflections(corner)
        with native.without():
            np.testing.assert_array_equal(signs, basis._signs_of_reflections(corner))
