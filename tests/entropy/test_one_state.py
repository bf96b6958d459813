"""One state: a table for each symbol, exact ends; and the tables of `models`."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

from mocodec import native
from mocodec.entropy import models, rans
from mocodec.entropy.coder import StateDecoder, StateEncoder, Tables
from mocodec.errors import Corrupt
from mocodec.testing import corruption

TABLES = Tables([[5, 1, 1, 0, 9], [1, 1], list(range(1, 400)), [0, 7, 0]])


def coded(calls: int = 40, width: int = 50, raw: int = 200) -> tuple[bytes, list, tuple]:
    """(bytes, calls of (table, symbols), (raw values, their bits))."""
    random = np.random.default_rng(7)
    encoder, made = StateEncoder(), []
    choices = [np.array([0, 1, 2, 4]), np.arange(2), np.arange(399), np.array([1])]
    for _ in range(calls):
        table = random.integers(0, 4, random.integers(1, width + 1))
        symbols = np.array([random.choice(choices[t]) for t in table])
        encoder.put(TABLES, table, symbols)
        made.append((table, symbols))
    bits = random.integers(0, 65, raw)
    values = np.array([int(random.integers(0, 1 << 62)) * 4 + 3 & (1 << int(b)) - 1 for b in bits], np.uint64)
    encoder.raw(values, bits)
    return encoder.finish(), made, (values, bits)


@pytest.mark.parametrize("raw", [0, 1, 200])
def test_comes_back_call_for_call(raw: int):
    data, calls, (values, bits) = coded(raw=raw)
    decoder = StateDecoder(data)
    for table, symbols in calls:
        assert np.array_equal(decoder.next(TABLES, table), symbols)
    assert np.array_equal(decoder.raw(bits), values)


def test_the_size_follows_from_the_tables():
    random = np.random.default_rng(8)
    weights = [600, 300, 90, 10]
    symbols = random.choice(4, 20_000, p=np.array(weights) / 1000)
    tables = Tables([weights])
    ideal = -np.log2(tables.frequency[symbols] / models.TOTAL).sum() / 8
    encoder = StateEncoder()
    for part in np.split(symbols, 20):
        encoder.put(tables, np.zeros(len(part), int), part)
    assert len(encoder.finish()) <= 1.001 * ideal + 2


def test_a_symbol_of_weight_zero_is_refused():
    with pytest.raises(ValueError, match="weight zero"):
        StateEncoder().put(TABLES, np.array([0]), np.array([3]))


def test_normalised_frequencies_sum_to_a_power_of_two():
    random = np.random.default_rng(9)
    for _ in range(50):
        weights = random.integers(0, 10 ** random.integers(1, 12), random.integers(2, 300)).tolist()
        weights[0] += 1
        frequency = rans.normalised(weights, models.PRECISION)
        assert sum(frequency) == models.TOTAL
        assert max(frequency) < models.TOTAL
        assert all(f > 0 for f, w in zip(frequency, weights, strict=True) if w)


def test_tokens_and_back():
    magnitudes = np.unique(np.concatenate([np.arange(3000), *([[2**k - 1, 2**k, 2**k + 1] for k in range(4, 63)])]))
    token = models.tokens(magnitudes)
    shift = models.mantissa_bits(token)
    for magnitude, t, s in zip(magnitudes.tolist(), token.tolist(), shift.tolist(), strict=True):
        assert models.token_floor(t) <= magnitude < models.token_floor(t) + (1 << s)
    assert token.max() < models.TOKENS


@pytest.mark.parametrize("shape", range(len(models.SHAPES)))
def test_laws_get_wider(shape: int):
    family = models.family(models.LAWS, shape)
    mean = [
        sum(f * models.token_floor(t) for t, f in enumerate(row)) for row in family.frequency.reshape(-1, family.width)
    ]
    assert mean[:-1] == sorted(mean[:-1])


def test_laws_are_the_same_for_ever():
    """Literal numbers, which no change of the arithmetic may alter: files depend on them."""
    family = models.family(models.LAWS, 0).frequency.reshape(models.LAWS + 1, -1)
    assert family[12, :6].tolist() == [15420, 947, 15, 2, 0, 0]
    assert models.family(models.LAWS, 1).frequency.reshape(models.LAWS + 1, -1)[30, :6].tolist() == [
        523,
        1036,
        1018,
        993,
        963,
        926,
    ]
    assert models.law_of_expectation(models.LAWS, 5, 0)[:160:16].tolist() == [5, 20, 23, 25, 26, 27, 28, 28, 29, 29]


def test_damaged_bytes_are_corrupt_or_decode():
    data, calls, (_, bits) = coded()
    for broken in corruption.damaged(data, 150):
        with contextlib.suppress(Corrupt):
            decoder = StateDecoder(broken)
            for table, _ in calls:
                decoder.next(TABLES, table)
            decoder.raw(bits)


def test_compiled_raw_bits_are_those_of_python() -> None:
    if native.kernel("entropy_raw") is None:
        pytest.skip("the compiled module is not built")
    random = np.random.default_rng(5)
    for count in (0, 1, 7, 8, 9, 500):
        bits = random.integers(0, 40, count)
        values = random.integers(0, 1 << 40, count) & (1 << bits) - 1
        encoder = StateEncoder()
        encoder.put(TABLES, np.array([0, 1]), np.array([4, 1]))
        encoder.raw(values, bits)
        data, found = encoder.finish(), []
        for context in (contextlib.nullcontext(), native.without()):
            with context:
                decoder = StateDecoder(data)
                decoder.next(TABLES, np.array([0, 1]))
                found.append(decoder.raw(bits).astype(np.int64))
        np.testing.assert_array_equal(found[0], values)
        np.testing.assert_array_equal(found[1], values)
