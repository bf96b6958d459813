"""pack and unpack: any integers come back, in few bytes; damaged bytes are Corrupt or integers."""

from __future__ import annotations

import contextlib
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocodec import native
from mocodec.entropy import coder
from mocodec.errors import Corrupt
from mocodec.testing import corruption

LIMIT = 1 << 62


def back(values: np.ndarray, contexts: np.ndarray | None = None) -> int:
    """The number of bytes, after a check that the values come back."""
    data = coder.pack(values, contexts)
    result = coder.unpack(data, values.shape, contexts)
    assert result.dtype == np.int64
    assert np.array_equal(result, values)
    assert coder.pack(values, contexts) == data
    return len(data)


def decaying(steps: int, lanes: int, seed: int = 0) -> np.ndarray:
    """Like quantised coefficients: large at first and in the first lanes, then mostly zero."""
    size = 300 / (1 + np.arange(steps)[:, None]) / (1 + 0.5 * np.arange(lanes))
    return np.rint(np.random.default_rng(seed).laplace(size=(steps, lanes)) * size).astype(np.int64)


def laplace_entropy(scale: float) -> float:
    """The entropy of one rounded sample, bits."""
    edges = (np.arange(int(60 * scale + 60)) + 0.5) / scale
    tail = np.exp(-edges)
    p = np.concatenate([[1 - tail[0]], np.repeat((tail[:-1] - tail[1:]) / 2, 2)])
    p = p[p > 0]
    return float(-(p * np.log2(p)).sum())


@settings(deadline=None, derandomize=True, max_examples=150)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 40),
    st.integers(1, 20),
    st.sampled_from([0.05, 0.5, 4, 300, 1e6, 1e12, 1e18]),
    st.booleans(),
    st.integers(0, 2),
)
def test_comes_back(seed: int, steps: int, lanes: int, scale: float, with_contexts: bool, sums: int):
    random = np.random.default_rng(seed)
    values = (random.laplace(size=(steps, lanes)) * scale * 2.0 ** random.normal(size=lanes)).clip(-LIMIT, LIMIT)
    values = values.astype(np.int64)
    for _ in range(sums if scale < 1e12 else 0):
        values = np.cumsum(values, axis=0)
    back(values, np.abs(values + random.integers(-2, 3, values.shape)) if with_contexts else None)


@pytest.mark.parametrize(
    "shape", [(9000, 1), (1, 9000), (4000, 3), (3, 4000), (130, 130), (700, 93), (93, 700), (129, 63), (8001, 1)]
)
@pytest.mark.parametrize("scale", [0.02, 2, 1e9])
def test_many_lanes_come_back(shape: tuple[int, int], scale: float):
    random = np.random.default_rng(1)
    values = np.rint(random.laplace(size=shape) * scale).astype(np.int64)
    back(values)
    back(values, np.abs(values) // 2)


def test_extremes_come_back():
    back(np.array([[LIMIT, -LIMIT, 0, 1, -1]]))
    back(np.full((50, 4), -LIMIT))
    back(np.where(np.eye(100, dtype=bool), LIMIT, 0))
    with pytest.raises(ValueError, match="2\\^62"):
        coder.pack(np.array([[LIMIT + 1]]))


def test_zeros_take_no_bytes():
    for shape in [(0, 5), (5, 0), (0, 0), (1, 1), (400, 93)]:
        assert coder.pack(np.zeros(shape, np.int64)) == b""
        assert coder.unpack(b"", shape).shape == shape
    with pytest.raises(Corrupt):
        coder.unpack(b"\x01", (0, 4))


def test_other_integer_types():
    for dtype in (np.int8, np.uint8, np.int16, np.int32, np.uint32):
        values = np.arange(60).reshape(20, 3).astype(dtype)
        assert np.array_equal(coder.unpack(coder.pack(values), (20, 3)), values)


def test_short_arrays_take_few_bytes():
    assert back(np.array([[1]])) <= 4
    assert back(np.array([[5], [-3]])) <= 5
    values = np.rint(np.random.default_rng(0).laplace(size=(100, 1))).astype(np.int64)
    assert back(values) <= 100 * laplace_entropy(1.0) / 8 + 5


@pytest.mark.parametrize("scale", [0.3, 1, 4, 30])
def test_near_the_entropy_of_noise(scale: float):
    """Laplace noise of unknown scale: within 3 % of the entropy of its own histogram, all bytes included."""
    values = np.rint(np.random.default_rng(2).laplace(size=(500, 30)) * scale).astype(np.int64)
    counts = np.unique(values, return_counts=True)[1]
    entropy = -(counts * np.log2(counts / counts.sum())).sum() / 8
    assert back(values) <= 1.03 * entropy + 8


def test_uneven_lanes_take_no_more_bytes_than_each_alone():
    scales = 2.0 ** np.arange(-3, 7)
    values = np.rint(np.random.default_rng(3).laplace(size=(400, 10)) * scales).astype(np.int64)
    assert back(values) <= 1.05 * sum(400 * laplace_entropy(scale) / 8 for scale in scales)


def test_decaying_coefficients_beat_general_compressors():
    import lzma

    values = decaying(200, 60)
    assert back(values) < 0.75 * len(
        lzma.compress(
            values.astype(np.int16).T.tobytes(),
            format=lzma.FORMAT_RAW,
            filters=[{"id": lzma.FILTER_LZMA2, "preset": 9}],
        )
    )


def test_differences_are_taken_of_slow_curves():
    values = np.rint(5000 * np.sin(np.arange(600)[:, None] / 40 + np.arange(4))).astype(np.int64)
    assert back(values) < 600 * 4 * 3.5 / 8


def test_sparse_arrays():
    values = np.zeros((4000, 120), np.int64)
    random = np.random.default_rng(4)
    values.flat[random.choice(values.size, 40, replace=False)] = random.integers(-9, 10, 40)
    assert back(values) < 150


def test_a_large_array_of_mostly_zeros_has_one_state():
    values = decaying(400, 60)
    assert np.count_nonzero(values == 0) > 8000
    assert np.count_nonzero(values) < 4000
    back(values)
    assert int.from_bytes(coder.pack(values)[:2], "little") & 0x3FFF >= 64


def test_contexts_save_bytes():
    random = np.random.default_rng(5)
    expected = np.rint(2.0 ** random.uniform(0, 9, (80, 20))).astype(np.int64)
    values = np.rint(random.laplace(size=(80, 20)) * expected).astype(np.int64)
    assert back(values, expected) < 0.93 * back(values)
    with pytest.raises(Corrupt):
        coder.unpack(coder.pack(values, expected), values.shape)


@pytest.mark.parametrize("shape", [(12, 5), (140, 60)])
def test_damage_raises_or_gives_integers(shape: tuple[int, int]):
    data = coder.pack(decaying(*shape))
    bad = [*corruption.prefixes(data, every=1 + len(data) // 60), *corruption.damaged(data, 80)]
    bad += [broken for _, broken in corruption.flips(data, every=1 + len(data) // 80)]
    for broken in bad:
        with contextlib.suppress(Corrupt):
            assert coder.unpack(broken, shape).shape == shape


@settings(deadline=None, derandomize=True, max_examples=300)
@given(st.binary(max_size=40), st.integers(0, 40), st.integers(0, 300))
def test_any_bytes_raise_or_give_integers(data: bytes, steps: int, lanes: int):
    with contextlib.suppress(Corrupt):
        assert coder.unpack(data, (steps, lanes)).shape == (steps, lanes)


def test_a_stream_cut_or_lengthened_is_corrupt():
    for shape in [(12, 5), (200, 60)]:
        data = coder.pack(decaying(*shape))
        for wrong in (data[:-1], data[:-2], data + b"\x07", data + b"\x07\x07"):
            with pytest.raises(Corrupt):
                coder.unpack(wrong, shape)


def test_memory_is_bounded_by_the_shape():
    coder.unpack(coder.pack(decaying(300, 60)), (300, 60))
    tracemalloc.start()
    for head in (b"\x0f\0", b"\0\0\xff\xff\xff\xff\xff\xff", b"\x0e\0" + bytes(range(256))):
        with pytest.raises(Corrupt):
            coder.unpack(head + b"\xff" * 100, (30, 30))
    assert tracemalloc.get_traced_memory()[1] < 8_000_000
    tracemalloc.stop()


@pytest.mark.skipif(not native.available(), reason="the compiled module is not built")
@pytest.mark.parametrize("shape", [(1, 1), (40, 9), (3, 200), (3000, 2), (700, 20)])
@pytest.mark.parametrize("with_contexts", [False, True])
def test_the_compiled_module_packs_the_same_bytes(shape: tuple[int, int], with_contexts: bool):
    random = np.random.default_rng(11)
    for scale in (0.1, 3.0, 1e5, 1e15):
        values = np.rint(random.laplace(size=shape) * scale * random.uniform(size=shape[1])).astype(np.int64)
        contexts = np.abs(values + random.integers(-2, 3, shape)) if with_contexts else None
        for v in (values, np.cumsum(values, axis=0)):
            compiled = coder.pack(v, contexts)
            with native.without():
                assert coder.pack(v, contexts) == compiled
