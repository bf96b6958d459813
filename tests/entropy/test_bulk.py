"""Many states: diagonals of segments, laws for the inner loops, damage."""

from __future__ import annotations

import contextlib
import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocodec import native
from mocodec.entropy import bulk, coder, models
from mocodec.entropy.layout import Layout
from mocodec.entropy.neighbours import MIXTURES, WITHOUT_HINTS
from mocodec.errors import Corrupt
from mocodec.testing import corruption

SHAPES = [(1, 1), (1, 9), (9, 1), (200, 1), (3, 700), (120, 93), (93, 120), (300, 64), (300, 65), (65, 65), (1000, 131)]


@pytest.mark.parametrize("shape", SHAPES)
def test_diagonals_visit_every_place_once(shape: tuple[int, int]):
    layout = Layout(shape)
    plain = np.arange(1, 1 + shape[0] * shape[1]).reshape(shape)
    flat = layout.skewed(plain, np.int64)
    assert np.array_equal(layout.unskewed(flat, np.int64), plain)
    seen = np.concatenate([flat[begin:end] for _, begin, end in layout.diagonals()])
    assert np.array_equal(np.sort(seen[seen > 0]), plain.ravel())
    assert len(seen) - plain.size < layout.lanes * layout.segments * layout.pieces  # what pads the last piece


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("mixture", range(WITHOUT_HINTS))
def test_any_shape_and_mixture_comes_back(shape: tuple[int, int], mixture: int):
    random = np.random.default_rng(mixture)
    values = np.rint(random.laplace(size=shape) * 2.0 ** random.uniform(0, 9, shape[1])).astype(np.int64)
    mixing = bulk.Mixing(MIXTURES[mixture], models.law_of_expectation(models.LAWS, 20, 0))
    laws = bulk.laws(models.LAWS, mixture % 2)
    for bits in (100.0, 1e9):
        data = bulk.pack(models.tokens(np.abs(values)), values, mixing, laws, None, bits)
        assert np.array_equal(bulk.unpack(data, shape, mixing, laws, None), values)


@pytest.mark.parametrize(("count", "shape"), [(models.LAWS, 0), (models.LAWS, 1), (models.LAWS_LARGE, 0)])
def test_slots_and_codes_agree(count: int, shape: int):
    laws = bulk.laws(count, shape)
    assert laws.slots.shape == ((count + 1) << bulk.PRECISION,)
    law = np.repeat(np.arange(count + 1), bulk.TOTAL)
    symbol, frequency, inside = laws.slots & 255, laws.slots >> 20, laws.slots >> 8 & bulk.TOTAL - 1
    escaped = symbol == bulk.ESCAPE
    token = np.where(escaped, laws.last[law], symbol)
    code = laws.code[law * 256 + token]
    assert np.array_equal(code >= bulk.ESCAPE_FLAG, escaped)
    code &= bulk.ESCAPE_FLAG - np.uint32(1)
    assert np.array_equal(code >> bulk.PRECISION, frequency)
    assert np.array_equal((code & bulk.TOTAL - 1) + inside, np.tile(np.arange(bulk.TOTAL), count + 1))


def test_laws_are_the_same_for_ever():
    """Literal numbers, which no change of the arithmetic may alter: files depend on them."""
    code = bulk.laws(models.LAWS, 0).code.reshape(-1, 256) & bulk.ESCAPE_FLAG - np.uint32(1)
    assert (code[12, :4] >> bulk.PRECISION).tolist() == [3853, 237, 4, 2]
    assert (code[30, :6] >> bulk.PRECISION).tolist() == [198, 367, 329, 296, 267, 241]


def loud(steps: int, lanes: int) -> np.ndarray:
    random = np.random.default_rng(5)
    return np.rint(random.laplace(size=(steps, lanes)) * 2.0 ** random.uniform(0, 5, lanes)).astype(np.int64)


def test_the_stream_is_the_same_for_ever():
    """The digest of one stream, which no change of layout or arithmetic may alter: files depend on it."""
    mixed = np.arange(200 * 70, dtype=np.int64).reshape(200, 70) * 2_654_435_761 % (1 << 32)
    values = ((mixed >> 20) % 61 - 30) >> (mixed & 7)
    values[::37, ::11] <<= 40
    mixing = bulk.Mixing(MIXTURES[4], models.law_of_expectation(models.LAWS_LARGE, 20, 0))
    laws = bulk.laws(models.LAWS_LARGE, 1)
    data = bulk.pack(models.tokens(np.abs(values)), values, mixing, laws, None, 30_000.0)
    assert np.array_equal(bulk.unpack(data, values.shape, mixing, laws, None), values)
    assert hashlib.sha256(data).hexdigest()[:16] == "0af7ba39b03c18e0"


def test_values_that_the_counted_sample_misses_come_back():
    for at in (0, 777, 12_345, 59_999):
        values = np.zeros((60_000, 4), np.int64)
        values[at - 700 if at else 0 : at + 3000] = loud(60_000, 4)[at - 700 if at else 0 : at + 3000]
        values[at, 2] = 1 << 62
        data = coder.pack(values)
        assert data[1] == 0
        assert np.array_equal(coder.unpack(data, values.shape), values)


def test_damage_raises_or_gives_integers():
    values = loud(100, 90)
    data = coder.pack(values)
    assert data[1] == 0  # many states
    assert np.array_equal(coder.unpack(data, values.shape), values)
    bad = [*corruption.prefixes(data, every=1 + len(data) // 60), *corruption.damaged(data, 60)]
    bad += [broken for _, broken in corruption.flips(data, every=1 + len(data) // 60)]
    bad += [bytes([*data[:k], b, *data[k + 1 :]]) for k in range(8) for b in (0, 1, 3, 15, 127, 255)]
    for broken in bad:
        with contextlib.suppress(Corrupt):
            assert coder.unpack(broken, values.shape).shape == values.shape
    for wrong in (data[:-1], data[:-2], data + b"\x07", data + b"\x07\x07"):
        with pytest.raises(Corrupt):
            coder.unpack(wrong, values.shape)


@settings(deadline=None, derandomize=True, max_examples=200)
@given(st.integers(1, 3), st.binary(min_size=3, max_size=60), st.integers(1, 40), st.integers(1, 300))
def test_any_bytes_raise_or_give_integers(first: int, data: bytes, steps: int, lanes: int):
    with contextlib.suppress(Corrupt):
        assert coder.unpack(bytes([first, 0]) + data, (steps, lanes)).shape == (steps, lanes)


@pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")
@pytest.mark.parametrize("shape", [(3000, 1), (500, 7), (129, 40), (40, 500), (257, 93), (1, 4000)])
@pytest.mark.parametrize("mixture", range(len(MIXTURES)))
@pytest.mark.parametrize("hinted", [False, True])
def test_the_compiled_module_decodes_alike(shape: tuple[int, int], mixture: int, hinted: bool):
    random = np.random.default_rng(mixture)
    size = 40.0 if mixture % 2 else 0.7
    values = random.laplace(scale=size, size=shape).round().astype(np.int64)
    values[random.integers(shape[0]), random.integers(shape[1])] = 5000  # an escape
    token = models.tokens(np.abs(values))
    hints = models.tokens(np.abs(values) // 2) if hinted else None
    mixing = bulk.Mixing(MIXTURES[mixture], models.law_of_expectation(models.LAWS, 20, 0))
    table = bulk.laws(models.LAWS, 0)
    data = bulk.pack(token, values, mixing, table, hints, 4.0 * values.size)
    with native.without():
        expected = bulk.unpack(data, shape, mixing, table, hints)
    np.testing.assert_array_equal(expected, values)
    np.testing.assert_array_equal(bulk.unpack(data, shape, mixing, table, hints), values)
    for cut in (len(data) // 3, len(data) // 2, len(data) - 1):
        outcomes = []
        for context in (native.without(), contextlib.nullcontext()):
            with context:
                try:
                    outcomes.append(bulk.unpack(data[:cut], shape, mixing, table, hints).tobytes())
                except Corrupt as error:
                    outcomes.append(str(error))
        assert outcomes[0] == outcomes[1]
