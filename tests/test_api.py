"""The public functions, with a codec for tests: float32 positions, ten frames per chunk."""

from __future__ import annotations

import io
import pickle
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import mocodec as mc
from mocodec import codecs, container
from mocodec.codecs.base import settings
from mocodec.container.remote_sources import Url
from mocodec.encoded import Chunk, Encoded, about, restore
from mocodec.errors import BadInput
from mocodec.testing import synthetic


@dataclass(frozen=True)
class Plain:
    """Positions as float32."""

    name: ClassVar[str] = "plain"
    max_error: float = 1.0
    frames: int = 10

    def encode(self, motion: mc.Motion) -> Encoded[mc.Motion]:
        chunks = []
        for start in range(0, len(motion), self.frames):
            part = motion.positions[start : start + self.frames]
            chunks.append(Chunk(start, len(part), part.astype("<f4").tobytes()))
        return Encoded(self.name, about(motion), chunks, settings=settings(self))

    @staticmethod
    def decode(encoded: Encoded[mc.Motion], frames: slice | None = None) -> mc.Motion:
        start, stop = encoded.range(frames)
        chunks = encoded.covering(start, stop)
        data = b"".join(chunk.payload for chunk in chunks)
        positions = np.frombuffer(data, "<f4").reshape(-1, encoded.about.points, 3).astype(np.float64)
        first = chunks[0].start if chunks else start
        return restore(encoded, positions[start - first : stop - first], start)


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(codecs.CODECS, "plain", f"{__name__}:Plain")
    monkeypatch.setitem(sys.modules, __name__, sys.modules[Plain.__module__])


def walk(frames: int = 95) -> mc.Motion:
    random = np.random.default_rng(0)
    positions = np.float32(random.normal(size=(frames, 4, 3))).astype(np.float64)
    positions[3:7, 1] = np.nan
    extras = {
        "analog": mc.Signal(np.arange(frames * 10), 1200.0, ("emg",)),
        "events": [{"label": "Foot Strike", "time_s": 0.5}],
    }
    return mc.Motion(positions, 120.0, ("LKNE", "RKNE", "LANK", "RANK"), "y", source={"first_frame": 1}, extras=extras)


def equal(a: mc.Motion, b: mc.Motion) -> bool:
    np.testing.assert_array_equal(a.positions, b.positions)
    np.testing.assert_array_equal(a.extras["analog"].values, b.extras["analog"].values)
    assert dict(a.source) == dict(b.source)
    assert a.extras["events"] == b.extras["events"]
    return (a.rate, a.names, a.up) == (b.rate, b.names, b.up)


def test_encode_and_decode(tmp_path: Path):
    motion = walk()
    blob = mc.encode(motion, "plain", max_error=0.25)
    assert blob == mc.encode(motion, Plain(max_error=0.25))
    path = tmp_path / "walk.mocz"
    mc.write(path, motion, codec="plain", max_error=0.25)
    assert path.read_bytes() == blob
    for source in (blob, path, str(path), io.BytesIO(blob)):
        assert equal(mc.decode(source), motion)
    assert equal(mc.read(path), motion)  # pyright: ignore[reportArgumentType]
    with pytest.raises(mc.BadInput):
        mc.read(path, asf="x")


def test_random_access():
    motion = walk()
    with mc.open(mc.encode(motion, "plain", max_error=0.25)) as f:
        assert f.shape == (95, 4, 3)
        assert (f.rate, f.names, len(f)) == (120.0, motion.names, 95)
        assert f.info["promise"] == {"max_error": 0.25}
        assert equal(f[12:47], motion[12:47])
        assert f[12:47, ["RANK", "LKNE"]].names == ("RANK", "LKNE")
        np.testing.assert_array_equal(f[90:].positions, motion.positions[90:])
        np.testing.assert_array_equal(f.at(seconds=slice(0.1, 0.3)).positions, motion.positions[12:36])
        np.testing.assert_array_equal(f.at(seconds=slice(0.7, None)).positions, motion.positions[84:])
        np.testing.assert_array_equal(f.at(seconds=slice(0.101, 99)).positions, motion.positions[13:])
        assert [len(part) for part in f] == [10] * 9 + [5]
        assert len(f[40:40]) == 0
        f.verify()
        for bad in (
            lambda: f[::-1],
            lambda: f[95],
            lambda: f[:, ["X"]],
            lambda: f.at(slice(-1, 2)),
            lambda: f.at(slice(0, 1, 2)),
        ):  # type: ignore[index]
            with pytest.raises(mc.BadInput):
                bad()


def test_extras_of_a_slice_load_after_closing(tmp_path: Path):
    motion, path = walk(), tmp_path / "walk.mocz"
    mc.write(path, motion, codec="plain")
    with mc.open(path) as f:
        part = f[60:80]
    assert equal(part, motion[60:80])


def test_a_truncated_file_is_salvaged():
    blob = mc.encode(walk(), "plain")
    with pytest.raises(mc.Truncated):
        mc.open(blob[: len(blob) // 2])
    with mc.open(blob[: len(blob) // 2], salvage=True) as f:
        ((start, stop),) = f.whole()
        np.testing.assert_array_equal(f[start:stop].positions, walk().positions[start:stop])
        assert 20 < stop < 60


def test_wrong_arguments_raise():
    with pytest.raises(mc.BadInput, match="no target 'ratio'"):
        mc.encode(walk(), "plain", ratio=3)
    with pytest.raises(mc.BadInput, match=r"max_error must be a number of metres, such as 0\.002, not '2mm'"):
        mc.encode(walk(), max_error="2mm")  # pyright: ignore[reportCallIssue, reportArgumentType]
    with pytest.raises(mc.BadInput, match="no setting"):
        mc.encode(walk(), "plain", colour=3)
    with pytest.raises(mc.UnknownCodec):
        mc.encode(walk(), "nothing")
    with pytest.raises(mc.BadInput, match="Motion"):
        mc.encode(np.zeros((3, 3, 3)), "plain")  # type: ignore[arg-type]
    with pytest.raises(AttributeError):
        _ = mc.Nothing


def test_a_file_of_an_unknown_codec_shows_its_info(monkeypatch: pytest.MonkeyPatch):
    blob = mc.encode(walk(), "plain")
    monkeypatch.delitem(codecs.CODECS, "plain")
    with mc.open(blob) as f:
        assert f.info["codec"] == "plain"
        with pytest.raises(mc.UnknownCodec):
            f[:]


class Server(BaseHTTPRequestHandler):
    """Serves one blob, with range requests if `ranges`."""

    blob = b""
    ranges = True
    sent = 0

    def do_GET(self) -> None:
        cls = type(self)
        asked = self.headers.get("Range")
        part = cls.blob
        if self.path != "/walk.mocz":
            self.send_error(404)
            return
        if asked and cls.ranges and "," in asked:
            self.send_error(501)
            return
        if asked and cls.ranges:
            start, stop = (int(n) for n in asked.removeprefix("bytes=").split("-"))
            if start >= len(cls.blob):
                self.send_error(416)
                return
            part = cls.blob[start : stop + 1]
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{start + len(part) - 1}/{len(cls.blob)}")
        else:
            self.send_response(200)
        self.send_header("Content-Length", str(len(part)))
        self.end_headers()
        self.wfile.write(part)
        cls.sent += len(part)

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture(params=[True, False], ids=["ranges", "no ranges"])
def server(request: pytest.FixtureRequest) -> Iterator[tuple[str, type[Server]]]:
    handler = type("Handler", (Server,), {"ranges": request.param, "sent": 0})
    http = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=http.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{http.server_address[1]}", handler
    http.shutdown()
    http.server_close()
    thread.join()


def test_url(server: tuple[str, type[Server]]):
    address, handler = server
    motion = walk(5000)
    handler.blob = mc.encode(motion, "plain")
    with mc.open(f"{address}/walk.mocz") as f:
        part = f[3000:3020]
        np.testing.assert_array_equal(part.positions, motion.positions[3000:3020])
        if handler.ranges:
            assert handler.sent < 60_000 < len(handler.blob)
    np.testing.assert_array_equal(part.extras["analog"].values, motion[3000:3020].extras["analog"].values)
    assert equal(mc.decode(f"{address}/walk.mocz"), motion)
    handler.blob = mc.encode(walk(5), "plain")
    assert equal(mc.decode(f"{address}/walk.mocz"), walk(5))
    handler.blob = b""
    with pytest.raises(mc.Truncated):
        mc.open(f"{address}/walk.mocz")
    with pytest.raises(mc.BadInput, match="404"):
        mc.open(f"{address}/none.mocz")


def test_a_file_that_changes_behind_a_url_is_detected():
    handler = type("Handler", (Server,), {"blob": bytes(100_000)})
    http = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=http.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    source = Url(f"http://127.0.0.1:{http.server_address[1]}/walk.mocz")
    handler.blob = bytes(90_000)  # type: ignore[attr-defined]
    with pytest.raises(mc.BadInput, match="changed"):
        source.read(50_000, 10)
    http.shutdown()
    http.server_close()
    thread.join()


@pytest.mark.parametrize("url", ["ftp://x/a.mocz", "http://127.0.0.1:1/a.mocz", "file:///etc/hosts"])
def test_urls_that_cannot_be_opened(url: str):
    with pytest.raises(mc.BadInput):
        mc.open(url)


def test_import_loads_no_slow_module():
    slow = ("scipy", "rich", "click", "ezc3d", "json", "mocodec.container")
    code = f"import sys, mocodec; print([m for m in sys.modules if m.startswith({slow})])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_single_frames_and_strides_of_a_file_are_those_of_the_motion():
    motion = walk()
    with mc.open(mc.encode(motion, "plain"), mc.Motion) as f:
        for key in (0, 94, -1, -95, np.int64(7), slice(None, None, 4), slice(11, 60, 3), slice(-20, None)):
            assert equal(f[key], motion[key])
        assert len(f[100 - 6]) == 1
        assert f[::4].rate == 30
        assert f[7, ["LANK"]].names == ("LANK",)
        for outside in (95, -96):
            with pytest.raises(IndexError, match="no frame"):
                f[outside]
            with pytest.raises(mc.FrameOutOfRange):
                motion[outside]
        for wrong in ("LKNE", 1.5, slice(0, 1.5), (1, ["LKNE"], 2)):
            with pytest.raises(mc.BadInput):
                f[wrong]  # type: ignore[index]


def test_a_file_can_be_pickled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    motion, path = walk(), tmp_path / "walk.mocz"
    blob = mc.encode(motion, "plain")
    path.write_bytes(blob)
    monkeypatch.chdir(tmp_path)
    for source in (path, "walk.mocz", blob):
        with mc.open(source) as f:
            data = pickle.dumps(f)
            part = pickle.dumps(f[12:47])
        with pickle.loads(data) as again:
            assert equal(again[12:47], motion[12:47])
        assert equal(pickle.loads(part), motion[12:47])
    with mc.open(io.BytesIO(blob)) as f, pytest.raises(mc.BadInput, match="file object"):
        pickle.dumps(f)


def test_another_kind_than_asked_for_raises(tmp_path: Path):
    mc.write(tmp_path / "walk.mocz", walk(), codec="plain")
    mc.write(tmp_path / "walk.npz", walk())
    for read in (mc.read, mc.decode, mc.open):
        with pytest.raises(mc.BadInput, match=r"walk\.mocz: this file holds a motion, not point clouds"):
            read(tmp_path / "walk.mocz", mc.PointClouds)
    with pytest.raises(mc.BadInput, match=r"the kind is mocodec\.Motion or mocodec\.PointClouds, not 'Motion'"):
        mc.decode(tmp_path / "walk.mocz", "Motion")  # pyright: ignore[reportCallIssue, reportArgumentType]
    with pytest.raises(mc.BadInput, match="holds a motion"):
        mc.read(tmp_path / "walk.npz", mc.PointClouds)
    assert mc.read(tmp_path / "walk.npz", mc.Motion).points == 4


def test_reprs_are_one_short_line():
    motion = walk()
    with mc.open(mc.encode(motion, "plain", max_error=0.25)) as f:
        assert repr(f) == "<File: plain, 95 frames of 4 points at 120 Hz, 0.7917 s, max_error=0.25>"
    assert repr(motion) == "<Motion: 95 frames of 4 points at 120 Hz, 0.7917 s, y up, 1.1 % gaps>"
    assert repr(motion[0]).startswith("<Motion: 1 frame of 4 points")
    assert repr(motion.extras["analog"]) == "<Signal: 950 int64 at 1200 Hz>"
    clouds = mc.PointClouds([np.zeros((5, 3)), np.zeros((700, 3))], rate=15)
    assert repr(clouds) == "<PointClouds: 2 frames of 5 to 700 points at 15 Hz, 0.1333 s, y up>"


def test_a_size_is_met_where_the_codec_stays_below_its_own() -> None:
    motion = synthetic.markers(frames=600, seed=3)
    codec = mc.Tempo(size=40_000, model="points-stored")
    size = len(container.pack(codec.encode(motion))) - 1  # the codec reaches a payload far below this, and again below
    assert len(mc.encode(motion, mc.Tempo(size=size, model="points-stored"))) <= size


@pytest.mark.parametrize("target", [{"max_error": 0.002}, {"mean_error": 0.002}, {"ratio": 60.0}])
def test_the_bytes_do_not_depend_on_threads(target: dict[str, float]) -> None:
    walk = synthetic.markers(frames=2400, seed=4)
    assert mc.encode(walk, threads=1, **target) == mc.encode(walk, threads=3, **target)


def test_a_number_of_threads_that_is_none() -> None:
    with pytest.raises(BadInput, match="threads must be 1 or more"):
        mc.encode(synthetic.markers(frames=10), threads=0)


def test_an_error_of_metres_is_named_with_its_unit() -> None:
    for name in ("max_error", "mean_error"):
        with pytest.warns(UserWarning, match=f"{name}=2 is 2 m: lengths are in metres; 2 mm is 0.002") as caught:
            mc.encode(walk(), **{name: 2})
        assert caught[0].filename == __file__
