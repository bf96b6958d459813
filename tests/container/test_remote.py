"""Recordings on web servers and in stores: how many requests they take, and what they return."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import container
from mocodec.container import remote_sources
from mocodec.container.remote_sources import BLOCK_BYTES, several_parts
from mocodec.encoded import Chunk
from mocodec.file_range import FileRange
from mocodec.testing import synthetic

from .web_server import NGINX, WebServer, serving

needs_nginx = pytest.mark.skipif(NGINX is None, reason="nginx is not installed")


def an_hour(hours: int = 1) -> bytes:
    """Hours at 120 Hz: 8 s, whose chunks are repeated."""
    piece = synthetic.joints(frames=960, rate=120.0)
    reader = container.Reader(mc.encode(piece, "tempo", max_error=0.002))
    chunks: list[Chunk] = []
    for _ in range(450 * hours):
        for chunk in reader.encoded.chunks:
            chunks.append(Chunk(chunks[-1].stop if chunks else 0, chunk.frames, chunk.payload))
    return container.pack(dataclasses.replace(reader.encoded, chunks=chunks))


@pytest.fixture(scope="module")
def hour() -> bytes:
    return an_hour()


@pytest.fixture
def server(tmp_path: Path, hour: bytes) -> Iterator[WebServer]:
    (tmp_path / "root").mkdir()
    (tmp_path / "nginx").mkdir()
    (tmp_path / "root" / "hour.mocz").write_bytes(hour)
    (tmp_path / "root" / "part.bin").write_bytes(bytes(1000) + hour)
    mc.write(tmp_path / "root" / "short.mocz", synthetic.joints(frames=200), max_error=0.01)
    with serving(tmp_path / "root", tmp_path / "nginx") as web:
        yield web


@needs_nginx
def test_a_window_of_an_hour_takes_two_requests(server: WebServer, hour: bytes) -> None:
    with mc.open(hour, mc.Motion) as local:
        assert len(local) == 432_000
        for start in (0, 217_311, 431_880):
            with mc.open(f"{server.url}/hour.mocz", mc.Motion) as f:
                window = f[start : start + 120]
            np.testing.assert_array_equal(window.positions, local[start : start + 120].positions)
            requests = server.requests()
            assert len(requests) <= 2, requests
            assert sum(sent for _, _, sent in requests) < 80_000 < len(hour) / 8


@needs_nginx
def test_a_window_of_ten_hours_takes_two_requests(server: WebServer, tmp_path: Path) -> None:
    (tmp_path / "root" / "day.mocz").write_bytes(an_hour(10))
    for start in (1_000_000, 4_319_880):
        with mc.open(f"{server.url}/day.mocz", mc.Motion) as f:
            assert len(f[start : start + 120]) == 120
        requests = server.requests()
        assert len(requests) <= 2, requests


@needs_nginx
def test_many_frames_are_fetched_together(server: WebServer, hour: bytes) -> None:
    with mc.open(f"{server.url}/hour.mocz", mc.Motion) as f:
        server.requests()
        f[60_000:66_000]
        assert len(server.requests()) == 1
        f[60_000:66_000]
        f[60_100:60_200]
        assert server.requests() == []
        with pickle.loads(pickle.dumps(f)) as again:
            assert len(again) == len(f)


@needs_nginx
def test_small_files_and_parts_of_files(server: WebServer, hour: bytes) -> None:
    assert len(mc.decode(f"{server.url}/short.mocz", mc.Motion)) == 200
    assert len(server.requests()) == 1
    with mc.open(FileRange(f"{server.url}/part.bin", 1000, len(hour), "hour"), mc.Motion) as f:
        assert len(f[200_000:200_120]) == 120
    assert len(server.requests()) == 2
    with pytest.raises(mc.BadInput, match="404"):
        mc.open(f"{server.url}/none.mocz")
    assert len(server.requests()) == 1


@needs_nginx
@pytest.mark.parametrize(("most", "requests"), [(1, 4), (0, 1)])
def test_servers_with_one_range_or_none(tmp_path: Path, hour: bytes, most: int, requests: int) -> None:
    (tmp_path / "nginx").mkdir()
    (tmp_path / "hour.mocz").write_bytes(hour)
    with serving(tmp_path, tmp_path / "nginx", f"max_ranges {most};") as web:
        with mc.open(f"{web.url}/hour.mocz", mc.Motion) as f:
            assert len(f[200_000:200_120]) == 120
        assert len(web.requests()) == requests


@needs_nginx
def test_a_file_that_is_cut_short_is_salvaged(server: WebServer, tmp_path: Path, hour: bytes) -> None:
    (tmp_path / "root" / "cut.mocz").write_bytes(hour[: len(hour) // 20])
    with pytest.raises(mc.Truncated):
        mc.open(f"{server.url}/cut.mocz")
    server.requests()
    with mc.open(f"{server.url}/cut.mocz", salvage=True) as f:
        assert f.whole()
    assert len(server.requests()) < 40


def test_stores_of_fsspec(hour: bytes) -> None:
    fsspec: Any = pytest.importorskip("fsspec", reason="needs the [remote] extra")
    files = fsspec.filesystem("memory")
    files.pipe_file("/mocodec-test/hour.mocz", hour)
    with mc.open("memory://mocodec-test/hour.mocz", mc.Motion) as f, mc.open(hour, mc.Motion) as local:
        np.testing.assert_array_equal(f[9000:9120].positions, local[9000:9120].positions)
    with pytest.raises(mc.BadInput):
        mc.open("memory://mocodec-test/none.mocz")
    with pytest.raises(mc.BadInput, match="nosuchstore"):
        mc.open("nosuchstore://a/b.mocz")
    files.rm("/mocodec-test", recursive=True)


def test_answers_with_two_ranges_are_checked() -> None:
    part = b"--x\r\nContent-Type: a/b\r\nContent-Range: bytes %d-%d/100\r\n\r\n%s\r\n"
    body = part % (0, 3, b"\r\n\r\n") + part % (98, 99, b"yz") + b"--x--\r\n"
    assert several_parts(body, "u") == (100, [(0, b"\r\n\r\n"), (98, b"yz")])
    for wrong in (b"", part % (98, 100, b"xyz"), part % (0, 30, b"short")):
        with pytest.raises(mc.BadInput):
            several_parts(wrong, "u")


def test_pieces_leave_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_sources, "CACHE_BYTES", 3 * BLOCK_BYTES)
    data = np.random.default_rng(0).bytes(20 * BLOCK_BYTES)

    class Fake(remote_sources.RemoteFile):
        def _fetch(self, start: int, stop: int) -> bytes:
            self.requests += 1
            return data[start:stop]

    file = Fake("x://y", FileRange("x://y", 0, len(data)))
    for start, count, ahead in ((0, 5, 0), (9 * BLOCK_BYTES, 7, 0), (BLOCK_BYTES - 3, 6, 0), (40, 10, 4 * BLOCK_BYTES)):
        assert file.read(start, count, ahead) == data[start : start + count]
    assert file.requests == 3
    file.read(15 * BLOCK_BYTES, 1)
    assert sum(map(len, file._pieces.values())) <= 3 * BLOCK_BYTES
    with pytest.raises(mc.Truncated):
        file.read(len(data), 1)
