"""The cache of decoded chunks: windows are those of the decoded motion, and memory stays within its bound."""

from __future__ import annotations

import io
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import decoded_chunks
from mocodec.codecs.lossless import Lossless
from mocodec.decoded_chunks import ChunkCache, DecodedChunk
from mocodec.errors import BadInput
from mocodec.testing import synthetic


@pytest.fixture
def cache(monkeypatch: pytest.MonkeyPatch) -> ChunkCache:
    """A cache of its own, as large as four chunks of a second of `motion`."""
    own = ChunkCache(4 * 120 * synthetic.joints(1).points * 24)
    monkeypatch.setattr(decoded_chunks, "CACHE", own)
    return own


@pytest.fixture(scope="module")
def data() -> bytes:
    """Chunks of a second."""
    return mc.encode(replace(synthetic.joints(1200), skeleton=None, rotations=None), Lossless(1.0))


def decodings(monkeypatch: pytest.MonkeyPatch) -> list[slice]:
    """The slices that the codec decodes from now on."""
    seen: list[slice] = []
    inner = Lossless.decode

    def decode(encoded, frames=None):  # type: ignore[no-untyped-def]
        seen.append(frames or slice(0, None))
        return inner(encoded, frames)

    monkeypatch.setattr(Lossless, "decode", staticmethod(decode))
    return seen


def test_windows_are_slices_of_the_whole(data: bytes, cache: ChunkCache):
    whole = mc.decode(data, mc.Motion)
    random = np.random.default_rng(1)
    with mc.open(data, mc.Motion) as f:
        for start, length in zip(random.integers(0, 1200, 25), random.integers(0, 700, 25), strict=True):
            stop = min(1200, int(start + length))
            part = f[int(start) : stop]
            np.testing.assert_array_equal(part.positions, whole.positions[start:stop])
            assert part.source.get("first_frame") == whole[int(start) : stop].source.get("first_frame")
            assert cache.bytes <= cache.most_bytes
        assert cache.bytes > 0
    assert cache.bytes == 0


def test_a_chunk_is_decoded_once(data: bytes, cache: ChunkCache, monkeypatch: pytest.MonkeyPatch):
    seen = decodings(monkeypatch)
    with mc.open(data, mc.Motion) as f:
        for start in (130, 140, 150, 170):
            assert len(f[start : start + 64]) == 64
        assert f[200:300:2].rate == 60
        assert [(s.start, s.stop) for s in seen] == [(120, 240), (240, 360)]


def test_the_first_window_of_a_chunk_is_decoded_alone(cache: ChunkCache):
    motion = replace(synthetic.joints(1200), rotations=None)
    blob = mc.encode(motion, max_error=0.002, chunk_seconds=1.0, model="transform")
    whole = mc.decode(blob, mc.Motion).positions
    with mc.open(blob, mc.Motion) as f:
        np.testing.assert_array_equal(f[130:160].positions, whole[130:160])
        assert cache.bytes == 0
        np.testing.assert_array_equal(f[150:171].positions, whole[150:171])
        assert cache.bytes > 0
    assert cache.first_use(f._number, range(12))


def test_a_window_may_be_written_to(data: bytes, cache: ChunkCache):
    with mc.open(data, mc.Motion) as f:
        before = f[0:120].positions.copy()
        f[0:120].positions[:] = 0
        np.testing.assert_array_equal(f[0:120].positions, before)


def test_rotations_are_kept(cache: ChunkCache):
    motion = synthetic.joints(300)
    turned = np.zeros((300, motion.points, 4))
    turned[..., 0] = np.cos(np.linspace(0, 1, 300))[:, None]
    turned[..., 1] = np.sin(np.linspace(0, 1, 300))[:, None]
    motion = replace(motion, rotations=turned)
    with mc.open(mc.encode(motion, Lossless(1.0)), mc.Motion) as f:
        for _ in range(2):
            rotations = f[100:140].rotations
            assert rotations is not None
            np.testing.assert_allclose(rotations, turned[100:140], atol=1e-7)


def test_large_windows_and_iteration_are_not_kept(data: bytes, cache: ChunkCache):
    with mc.open(data, mc.Motion) as f:
        assert len(f[:]) == sum(len(part) for part in f) == 1200
        assert cache.bytes == 0


def test_off(data: bytes, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(decoded_chunks, "CACHE", ChunkCache(0))
    seen = decodings(monkeypatch)
    with mc.open(data, mc.Motion) as f:
        assert len(f[5:20]) == len(f[5:20]) == 15
    assert len(seen) == 2


def test_least_recently_used_chunks_leave():
    def chunk(frames: int) -> DecodedChunk:
        return DecodedChunk(np.zeros((frames, 1, 3)), None)

    cache = ChunkCache(3 * 24)
    for number in range(3):
        cache.put(0, number, chunk(1))
    assert cache.get(0, 0) is not None
    cache.put(1, 0, chunk(1))
    assert [cache.get(0, n) is not None for n in range(3)] == [True, False, True]
    cache.put(1, 1, chunk(9))
    assert cache.bytes == 0
    cache.put(2, 5, chunk(2))
    cache.put(2, 5, chunk(1))
    assert cache.bytes == 24
    cache.forget_all()
    assert cache.bytes == 0


@pytest.mark.parametrize("by", ["path", "file object", "bytes"])
def test_threads_share_a_file(data: bytes, cache: ChunkCache, by: str, tmp_path: Path):
    whole = mc.decode(data, mc.Motion).positions
    path = tmp_path / "walk.mocz"
    path.write_bytes(data)
    source = {"path": path, "bytes": data, "file object": io.BytesIO(data)}[by]
    with mc.open(source, mc.Motion) as f, ThreadPoolExecutor(4) as pool:
        starts = np.random.default_rng(2).integers(0, 1100, 40).tolist()
        windows = pool.map(lambda start: f[start : start + 64].positions, starts)
        for start, window in zip(starts, windows, strict=True):
            np.testing.assert_array_equal(window, whole[start : start + 64])


@pytest.mark.parametrize(("text", "size"), [("2", 2_000_000), ("0", 0), ("many", 64_000_000), ("-1", 0)])
def test_size_from_the_environment(text: str, size: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("MOCODEC_CACHE_MB", text)
    assert decoded_chunks.size_from_environment() == size


def test_positions_as_an_array(data: bytes):
    whole = mc.decode(data, mc.Motion).positions
    with mc.open(data, mc.Motion) as f:
        np.testing.assert_array_equal(f.positions(), whole)
        narrow = f.positions(slice(100, 900), np.float32, threads=2)
        assert narrow.dtype == np.float32
        np.testing.assert_array_equal(narrow, whole[100:900].astype(np.float32))
        out = np.zeros((50, *whole.shape[1:]), np.float32)
        assert f.positions(slice(0, 50), out=out) is out
        np.testing.assert_array_equal(out, whole[:50].astype(np.float32))
        assert f.positions(slice(7, 7)).shape == (0, *whole.shape[1:])
        for wrong in (slice(0, 9, 2), slice(0, 49)):
            with pytest.raises(BadInput, match="an array of the shape"):
                f.positions(wrong, out=out)
