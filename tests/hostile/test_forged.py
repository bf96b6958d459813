"""Files with right checksums and hostile contents: refused before memory or time is spent, by MocodecErrors only."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import codecs, container, encoded, native
from mocodec.codecs.tempo.coding import coefficients
from mocodec.codecs.tempo.header import StreamHeader
from mocodec.container import records
from mocodec.encoded import Chunk, Encoded
from mocodec.entropy import coder, varint
from mocodec.errors import BadInput, CannotEncode, Corrupt, MocodecError
from mocodec.pointcloud import PointClouds
from mocodec.stages import basis, bounded, segment
from mocodec.testing import synthetic

MIB = 1 << 20


@contextmanager
def at_most(mebibytes: float) -> Iterator[None]:
    """Fails if more memory than this is allocated inside."""
    tracemalloc.start()
    try:
        yield
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < mebibytes * MIB, f"{peak / MIB:.0f} MiB"


@pytest.fixture(params=["compiled", "pure"])
def both(request: pytest.FixtureRequest) -> Iterator[None]:
    """With the compiled module, and without it."""
    if request.param == "pure":
        with native.without():
            yield
    else:
        yield


def forged(monkeypatch: pytest.MonkeyPatch, stream: Encoded[Any]) -> bytes:
    """The bytes of a .mocz whose chunks may be longer than the format allows."""
    with monkeypatch.context() as patch:
        patch.setattr(records, "most_frames", lambda points: 1 << 40)
        return container.pack(stream)


def walk(frames: int = 240) -> mc.Motion:
    return synthetic.markers(frames=frames, seed=3)


def with_frames(stream: Encoded[Any], frames: int) -> Encoded[Any]:
    """The stream as one chunk that declares this many frames."""
    return replace(stream, chunks=(Chunk(0, frames, stream.chunks[0].payload),), margin=0)


CODECS = ("tempo", "hou2014", "liu2006", "lossless")


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("frames", [1 << 40, 1 << 24, (1 << 22) // 41 + 1])
def test_chunks_above_the_limit_are_refused(codec: str, frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = with_frames(codecs.codec_class(codec)().encode(walk()), min(frames, 1 << 22))
    data = forged(monkeypatch, stream)
    with at_most(4), pytest.raises(Corrupt):
        mc.open(data)
    with at_most(4), pytest.raises(Corrupt):
        mc.open(data, salvage=True)


@pytest.mark.parametrize("codec", ["tempo", "liu2006"])
def test_a_slice_of_a_chunk_at_the_limit_needs_bounded_memory(
    codec: str, both: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream = codecs.codec_class(codec)().encode(walk())
    data = forged(monkeypatch, with_frames(stream, encoded.most_chunk_frames(41)))
    with at_most(1024), mc.open(data) as opened, suppress(Corrupt):
        assert len(opened[100:102]) == 2


def test_the_writer_refuses_what_the_reader_refuses() -> None:
    stream = codecs.codec_class("lossless")().encode(walk())
    with pytest.raises(CannotEncode, match="out of range"):
        container.pack(with_frames(stream, encoded.most_chunk_frames(41) + 1))
    clouds = Encoded("bodycast", PointClouds((), 30.0), (Chunk(0, 1 << 15, b""),))
    with pytest.raises(CannotEncode, match="out of range"):
        container.pack(clouds)


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("kind", ["walk", "still", "repeats"])
def test_encoders_stay_within_the_limit(codec: str, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """As with thousands of points: here the limit is small instead."""
    monkeypatch.setattr(encoded, "MAX_CHUNK_SAMPLES", 41 * 50)
    motion = walk(360)
    if kind == "still":
        motion = replace(motion, positions=np.repeat(motion.positions[:1], 360, axis=0))
    if kind == "repeats":
        which = np.concatenate([np.arange(60), np.full(240, 60), np.arange(61, 121)])
        motion = replace(motion, positions=motion.positions[which])
    target: dict[str, Any] = {} if codec == "lossless" else {"max_error": 0.005}
    data = mc.encode(motion, codec, **target)
    with mc.open(data) as opened:
        assert max(chunk.frames for chunk in opened.encoded.chunks) <= 50
        decoded = opened[:]
    assert np.linalg.norm(decoded.positions - motion.positions, axis=2).max() <= 0.005 * (1 + 1e-9)


def test_an_empty_stream_of_integers_has_a_limit() -> None:
    with at_most(1):
        for shape in ((1 << 30, 1), (1 << 20, 1 << 20), (5000, 5000)):
            with pytest.raises(Corrupt, match="at most"):
                coder.unpack(b"", shape)
        with pytest.raises(Corrupt, match="at most 10"):
            coder.unpack(b"", (11, 1), most=10)
    assert coder.unpack(b"", (3, 2)).shape == (3, 2)


def test_lists_of_tempo_are_compared_with_the_bytes_first() -> None:
    motion = walk()
    stream = codecs.codec_class("tempo")().encode(motion)
    model = StreamHeader.unpack(stream.shared, 41).read_model(motion)
    frames = 400
    head = varint.write([coefficients.HAS_LISTS, 2048, frames * 41, 0, 0, 0, 0, 0]) + bytes(20)
    with at_most(1), pytest.raises(Corrupt, match="corrections"):
        coefficients.unpack(model, [frames], [head], 5)


def test_a_basis_is_in_proportion_to_its_bytes() -> None:
    with at_most(1), pytest.raises(Corrupt, match="basis"):
        basis.unpack(bytes(20), 4000, np.zeros(4000, np.int64))
    identity = np.eye(12, 5)
    precision = np.full(5, 20)
    restored = basis.unpack(basis.pack(identity, precision), 12, precision)
    assert np.allclose(np.abs(restored), identity)


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("source", [{"first_frame": "x"}, {"first_frame": None}, {"first_frame": [1]}, {"unit_m": "q"}])
def test_a_source_of_any_types_is_no_obstacle(codec: str, source: dict[str, Any]) -> None:
    stream = codecs.codec_class(codec)().encode(walk())
    data = container.pack(replace(stream, about=replace(stream.about, source=source)))
    with mc.open(data) as opened:
        assert dict(opened[10:12].source) == source


@pytest.mark.parametrize(
    ("codec", "about"),
    [("lossless", PointClouds((), 30.0)), ("bodycast", walk()[:0]), ("tempo", PointClouds((), 30.0, colours=()))],
)
def test_a_codec_of_the_other_kind_is_corrupt(codec: str, about: Any) -> None:
    data = container.pack(Encoded(codec, about, (Chunk(0, 3, b"abc"),)))
    with pytest.raises(Corrupt, match="does not code"):
        mc.decode(data)


@pytest.mark.parametrize(
    ("raised", "expected"),
    [(ValueError("shapes"), Corrupt), (KeyError("x"), Corrupt), (RecursionError(), Corrupt), (MemoryError(), BadInput)],
)
def test_only_mocodec_errors_reach_the_user(
    raised: Exception, expected: type[MocodecError], monkeypatch: pytest.MonkeyPatch
) -> None:
    data = mc.encode(walk(), "lossless")

    def fail(*_: object) -> None:
        raise raised

    monkeypatch.setattr(codecs.codec_class("lossless"), "decode", staticmethod(fail))
    with mc.open(data) as opened, pytest.raises(expected):
        opened[:]


def test_more_frames_than_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many chunks of a few bytes may declare more than a machine has; each can be decoded."""
    payload = codecs.codec_class("lossless")().encode(walk(10)).chunks[0].payload
    stream = codecs.codec_class("lossless")().encode(walk(10))
    most = encoded.most_chunk_frames(41)
    chunks = [Chunk(i * most, most, payload) for i in range(40_000)]
    data = container.pack(replace(stream, chunks=chunks))
    with mc.open(data) as opened, pytest.raises(BadInput, match="more memory than there is"):
        opened[:]


def test_bits_behind_the_end_are_corrupt() -> None:
    flags = varint.write([1, 0, 0]) + bytes([0b0100_0000])
    with pytest.raises(Corrupt, match="bits behind"):
        bounded.unpack(bytes([bounded.RUNS]) + flags, np.zeros((4, 1, 3)), 0.01)


def test_messages_have_no_control_characters() -> None:
    for error in (BadInput("a\x1b[31mb\nc"), Corrupt("\x00\x07"), CannotEncode("ok µ")):
        assert str(error).isprintable()
    assert str(BadInput("a\tb")) == "a b"
    motion = replace(walk(), names=tuple(f"\x1b]0;{i}" for i in range(41)))
    with mc.open(mc.encode(motion, "lossless")) as opened:
        assert repr(opened).isprintable()
        with pytest.raises(BadInput) as caught:
            opened[0:1, ["no"]]
    assert str(caught.value).isprintable()


def test_long_segments_are_divided() -> None:
    cut = segment.no_longer_than([slice(0, 10), slice(10, 33)], 10)
    assert cut == [slice(0, 10), slice(10, 17), slice(17, 25), slice(25, 33)]


def test_batches_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(encoded, "MAX_CHUNK_SAMPLES", 100)
    sizes = [10, 10, 90, 5, 5, 5, 100, 1]
    starts = np.cumsum([0, *sizes]).tolist()
    chunks = [Chunk(start, size, b"") for start, size in zip(starts, sizes, strict=False)]
    found = [[c.frames for c in batch] for batch in encoded.batches(chunks, 1, 2)]
    assert found == [[10, 10], [90], [5, 5], [5], [100], [1]]
    assert [[c.frames for c in b] for b in encoded.batches(chunks[:0], 1, 2)] == []
