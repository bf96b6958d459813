"""Interleaved lanes: several chunks side by side, each with words of its own, and raw bits in the states."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocodec.entropy import lanes, rans
from mocodec.errors import Corrupt

TABLES = lanes.StaticTables.of(
    np.array([rans.normalised(w, lanes.PRECISION) for w in ([900, 50, 20, 1], [1, 1, 1, 1], [0, 0, 0, 5])])
)


def chunk(random: np.random.Generator, width: int, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Symbols and tables (steps, lanes), and raw bits of the lanes."""
    table = random.choice([0, 1], (steps, width))
    symbols = np.where(table == 0, random.choice(4, table.shape, p=[0.9, 0.06, 0.03, 0.01]), random.integers(0, 4))
    return symbols, table, random.integers(0, 1 << 16, width)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.lists(st.sampled_from([1, 2, 8]), min_size=1, max_size=4), st.integers(0, 50))
def test_symbols_and_raw_bits_come_back(seed: int, widths: list[int], steps: int):
    random = np.random.default_rng(seed)
    chunks = [chunk(random, width, steps) for width in widths]
    streams = lanes.encode([c[:2] for c in chunks], TABLES, [c[2] for c in chunks])
    decoder = lanes.LaneDecoder([s for s, _ in streams], [w for _, w in streams], TABLES)
    padded = np.full((steps, len(widths), max(widths)), TABLES.idle)
    for j, (_, table, _) in enumerate(chunks):
        padded[:, j, : widths[j]] = table
    found = [TABLES.symbols.take(decoder.next(step << lanes.PRECISION)) for step in padded]
    used, states = decoder.finish()
    for j, (symbols, _, bits) in enumerate(chunks):
        assert all(np.array_equal(f[j, : widths[j]], s) for f, s in zip(found, symbols, strict=True))
        own = states[j][: widths[j]]
        assert np.array_equal(lanes.bits_from_final_states(own, used[j], len(streams[j][1])), bits)


def test_states_that_no_encoder_started_from_are_corrupt():
    for states, used in ((np.array([rans.LOW - 1]), 0), (np.array([1 << 17]), 0), (np.array([rans.LOW]), 2)):
        with pytest.raises(Corrupt):
            lanes.bits_from_final_states(states, used, 1)


def test_the_idle_table_changes_nothing():
    symbols, table = np.zeros((5, 2), np.int64), np.full((5, 2), TABLES.idle)
    ((states, words),) = lanes.encode([(symbols, table)], TABLES, [np.array([7, 9])])
    assert states.tolist() == [rans.LOW + 7, rans.LOW + 9]
    assert len(words) == 0


def test_cost_in_bits():
    assert TABLES.cost[1].tolist() == [2.0] * 4
    assert TABLES.cost[2, 0] == lanes.UNCODABLE_BITS


@pytest.mark.parametrize("dtype", [np.int64, np.uint32])
def test_pop_undoes_push(dtype: type):
    random = np.random.default_rng(0)
    frequency = np.array(rans.normalised([5, 1, 90, 300], 12))
    start = np.cumsum(frequency) - frequency
    states = random.integers(rans.LOW, 1 << 32, 500).astype(dtype)
    before, symbol = states.copy(), random.integers(0, 4, 500)
    full, words = rans.push(states, frequency[symbol].astype(dtype), start[symbol].astype(dtype), 12)
    assert (states >= rans.LOW).all()
    assert words.max() < rans.LOW
    slot = states & 4095
    assert np.array_equal(np.searchsorted(np.cumsum(frequency), slot, side="right"), symbol)
    rans.pop(states, frequency[symbol].astype(dtype), (slot - start[symbol]).astype(dtype), 12)
    states[full] = states[full] << 16 | words
    assert np.array_equal(states, before)
