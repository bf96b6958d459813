"""Numbers of given widths as bits, and the alphabet of symbols with raw bits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocodec import native
from mocodec.entropy import bits, symbols
from mocodec.errors import Corrupt


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.integers(0, 2**32 - 1), st.integers(0, 300), st.sampled_from([1, 2, 8, 33, 64]))
def test_numbers_come_back(seed: int, count: int, most: int):
    random = np.random.default_rng(seed)
    widths = random.integers(0, most, count)
    values = random.integers(0, 1 << 63, count) & (np.int64(1) << widths) - 1
    stream = bits.pack(values, widths)
    assert len(stream) == widths.sum()
    assert np.array_equal(bits.unpack(stream, widths), values)
    with native.without():
        assert np.array_equal(bits.pack(values, widths), stream)
        assert np.array_equal(bits.unpack(stream, widths), values)


def test_highest_bit_first_and_missing_bits_are_zero():
    assert bits.pack(np.array([5, 0, 1]), np.array([3, 0, 2])).tolist() == [1, 0, 1, 0, 1]
    short, widths = np.array([1, 0], np.uint8), np.array([3, 2])
    assert bits.unpack(short, widths).tolist() == [4, 0]
    with native.without():
        assert bits.unpack(short, widths).tolist() == [4, 0]
    assert np.array_equal(bits.from_words(np.array([0x8001])), bits.pack(np.array([0x8001]), np.array([16])))


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.sampled_from([2, 8, 33, 64]))
def test_split_numbers_come_back(seed: int, count: int, most: int):
    random = np.random.default_rng(seed)
    widths = random.integers(0, most, count).astype(np.uint8)
    values = random.integers(0, 1 << 63, count).astype(np.uint64)
    stream = bits.pack_split(values, widths)
    assert len(stream) == widths.sum()
    numbers, taken = bits.unpack_split(np.concatenate([stream, np.ones(5, np.uint8)]), widths)
    assert taken == len(stream)
    assert np.array_equal(numbers, values & (np.uint64(1) << widths.astype(np.uint64)) - np.uint64(1))
    if most <= 32:
        assert np.array_equal(stream, bits.pack(numbers, widths))
    with pytest.raises(Corrupt):
        bits.unpack_split(stream, np.append(widths, np.uint8(1)))


@settings(deadline=None, derandomize=True, max_examples=100)
@given(
    st.lists(st.one_of(st.integers(-40, 40), st.integers(-symbols.LARGEST, symbols.LARGEST)), max_size=60),
    st.integers(0, 60),
)
def test_symbols_and_raw_bits_give_the_values_back(numbers: list[int], signed: int):
    values = np.array(numbers, np.int64)
    values[signed:] = np.abs(values[signed:])
    of = symbols.of_magnitudes(np.abs(values))
    raw = symbols.raw_bits(values, of, signed)
    assert len(raw) == symbols.raw_bit_count(of, signed)
    assert np.array_equal(symbols.values(of, raw, signed), values)


def test_the_alphabet_covers_every_magnitude_once():
    ends = symbols.SMALLEST + (1 << symbols.RAW_BITS)
    assert np.array_equal(ends[:-1], symbols.SMALLEST[1:])
    assert symbols.of_magnitudes(np.array([0, 10, 11, 12, 13, 1032, 1033])).tolist() == [0, 10, 11, 11, 12, 19, 20]
