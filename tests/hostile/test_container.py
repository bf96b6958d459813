"""Damaged and hostile files: every prefix, every flipped bit, false declarations: only MocodecErrors, little memory."""

from __future__ import annotations

import contextlib
import tracemalloc
import zlib
from typing import Any

import numpy as np
import pytest

from mocodec import container
from mocodec.container import records, tables, values
from mocodec.container.wire import Cursor, checksum, varint
from mocodec.encoded import Chunk, Encoded
from mocodec.errors import Corrupt, MocodecError, Truncated
from mocodec.motion import Motion, Signal, Skeleton

JOINTS = tuple(tables.CMU_JOINTS.split())


def small_file(chunks: int) -> bytes:
    """A file with every optional part: skeleton, source, settings, extras, shared bytes."""
    skeleton = Skeleton(JOINTS, tables.CMU_TREE, np.array(tables.CMU_OFFSETS) * 1.1e-5)
    extras = {"analog": Signal(np.arange(60.0).reshape(30, 2), 1200.0, ("a", "b")), "note": "x" * 40, "blob": b"12"}
    about = Motion(
        np.empty((0, 31, 3)), 120.0, JOINTS, "y", skeleton, source={"format": "amc", "a": 0.1}, extras=extras
    )
    made = [Chunk(i * 10, 10, bytes(range(i, i + 20))) for i in range(chunks)]
    return container.pack(Encoded("tempo", about, made, (b"shared",), 0, {"max_error": 0.002}))


def read_all(data: bytes, salvage: bool = False) -> list[Any]:
    with container.Reader(data, salvage=salvage) as reader:
        reader.info()
        reader.verify()
        return [chunk.payload for chunk in reader.encoded.chunks] + [str(dict(reader.encoded.about.extras))]


@pytest.mark.parametrize("chunks", [0, 1, 3])
def test_every_prefix_is_detected(chunks: int):
    data = small_file(chunks)
    for end in range(len(data)):
        with pytest.raises((Truncated, Corrupt)):
            container.Reader(data[:end])


@pytest.mark.parametrize("chunks", [0, 3])
def test_every_flipped_bit_is_detected(chunks: int):
    data = small_file(chunks)
    for at in range(len(data)):
        for bit in range(8):
            broken = bytearray(data)
            broken[at] ^= 1 << bit
            with pytest.raises(Corrupt):
                read_all(bytes(broken))


def test_bytes_put_in_or_taken_out_are_detected():
    data = small_file(3)
    for at in range(len(data)):
        for broken in (
            data[:at] + data[at + 1 :],
            data[:at] + b"\0" + data[at:],
            data[:at] + data[at : at + 1] + data[at:],
        ):
            if broken != data:
                with pytest.raises(MocodecError):
                    read_all(broken)


def test_a_damaged_chunk_affects_no_other():
    data = small_file(3)
    whole = container.Reader(data)
    layout, offsets = whole.layout, whole.chunks.offsets
    for at in range(layout.chunks, layout.index_at):
        hit = next(k for k in range(3) if at < offsets[k + 1])
        broken = bytearray(data)
        broken[at] ^= 0x40
        reader = container.Reader(bytes(broken))
        for k in range(3):
            if k == hit:
                with pytest.raises(Corrupt, match=f"chunk {k} "):
                    _ = reader.encoded.chunks[k].payload
            else:
                assert reader.encoded.chunks[k].payload == bytes(range(k, k + 20))
        assert sum(stop - start for start, stop in reader.intact_runs()) == 20
        assert len(dict(reader.encoded.about.extras)) == 3


def test_invalid_events_are_corrupt():
    """Invalid events with valid checksums are found when the extras are read, not when a slice is cut."""
    for events in (3, [{"label": "x"}], [{"time_s": "now"}]):
        like = Motion(np.zeros((0, 1, 3)), 120.0)
        object.__setattr__(like, "extras", {"events": events})
        reader = container.Reader(container.pack(Encoded("lossless", like, ())))
        with pytest.raises(Corrupt, match="events"):
            len(reader.encoded.about.extras)
        with pytest.raises(Corrupt, match="events"):
            reader.verify()


def test_damaged_extras_affect_no_chunk():
    data = bytearray(small_file(3))
    reader = container.Reader(bytes(data))
    data[reader.layout.extras + 5] ^= 1
    reader = container.Reader(bytes(data))
    assert reader.intact_runs() == [(0, 30)]
    with pytest.raises(Corrupt, match="extras"):
        len(reader.encoded.about.extras)


def test_a_stream_cut_anywhere_is_salvaged():
    data = small_file(3)
    layout, offsets = container.Reader(data).layout, container.Reader(data).chunks.offsets
    for end in range(len(data)):
        try:
            reader = container.Reader(data[:end], salvage=True)
        except (Truncated, Corrupt):
            assert end < layout.extras, "a complete header can be opened"
            continue
        chunks = sum(offset <= end for offset in offsets[1:])
        assert len(reader.encoded.chunks) == chunks
        assert reader.intact_runs() == ([(0, 10 * chunks)] if chunks else [])
        assert reader.problems
        with pytest.raises(Corrupt):
            reader.verify()


def test_salvage_respects_the_margin():
    about = Motion(np.empty((0, 1, 3)), 100.0)
    made = [Chunk(i * 10, 10, bytes(20)) for i in range(6)]
    data = bytearray(container.pack(Encoded("liu2006", about, made, margin=1)))
    data[container.Reader(bytes(data)).chunks.offsets[2] + 5] ^= 1
    assert container.Reader(bytes(data)).intact_runs() == [(0, 10), (40, 60)]


def framed(header: bytes, rest: bytes = b"") -> bytes:
    head = records.MAGIC + bytes([records.VERSION]) + varint(len(header)) + header
    return head + checksum(head) + rest


def ended(body: bytes) -> bytes:
    index = body + checksum(body)
    return index + varint(len(index))[::-1] + records.END_MAGIC


def peak(data: bytes) -> int:
    """Peak bytes allocated while everything is read; errors must be MocodecErrors."""
    tracemalloc.start()
    try:
        read_all(data)
    except MocodecError:
        pass
    finally:
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return top


HUGE = varint((1 << 62) - 1)


@pytest.mark.parametrize(
    "header",
    [
        b"\0\1\1" + HUGE,  # names: a huge count
        b"\0\1\1" + varint(65536 << 3 | 5) + varint(60000) + b"x" * 60000 + b"\0\1",  # a long prefix for many
        b"\0\1\1" + varint(65537 << 3 | 1) + b"\1P\1",
        b"\0\1\1" + varint(3 << 3) + b"\1" + HUGE,  # a run past the vocabulary
        b"\0\1\1" + varint(3 << 3 | 2) + HUGE + b"\1a",  # text that unpacks to too much
        b"\0\1\1" + varint(3 << 3 | 2) + varint(1 << 22) + varint(8) + bytes(8),
        b"\0\1\1" + b"\0" + HUGE,  # shared blobs
        b"\0\1\1" + b"\0\1" + HUGE,
        b"\0\1\1" + b"\0\1\1",  # reserved: kept elsewhere
        b"\x20\1\1" + b"\0" + HUGE,  # settings
        b"\x20\1\1" + b"\0" + varint(9 << 1) + b"\x80\7" + b"\7" * 7,
        b"\x20\1\1" + b"\0" + varint(1 << 27 | 1) + varint(4) + bytes(4),
        b"\x40\1\1" + b"\0\x7f",  # source
        b"\x08\1\1" + HUGE,  # margin
        b"\x10\1\1" + b"\0\xf0",  # skeleton
        b"\x10\1\1" + varint(31 << 3) + b"\1\x1f" + b"\x10" + bytes(40),
        b"\x10\1\1" + varint(1 << 3 | 1) + b"\1P\1" + b"\1\1" + b"\3<f8\2" + HUGE + HUGE,
        b"\x80\1\1" + b"\0" + HUGE + HUGE + b"\0",  # extras longer than the file
        b"\6\1\1\0\0",
        b"\0\0\xff\xff",
        b"\0\1\0\0" + b"\xff" * 8,
        b"\0\1\0\1\0\0\0",
    ],
)
def test_hostile_headers(header: bytes):
    data = framed(header, ended(b"\0\0"))
    with pytest.raises(MocodecError):
        read_all(data)
    assert peak(data) < 16_000_000


@pytest.mark.parametrize(
    "index",
    [
        b"\0" + HUGE, b"\0\2\1\1", b"\0\2\2\0\0\0", b"\0\1" + HUGE + b"\1\1", b"\0\1\1" + HUGE + b"\1",
        b"\0\1\1\1" + HUGE,
        b"\1", b"\0", b"\0\0\0", b"\0\x05\x05" + varint(1 << 24) + varint(1 << 29) * 5,
    ],
)  # fmt: skip
def test_hostile_indexes(index: bytes):
    data = framed(b"\0\1\1\0\0", ended(index))
    with pytest.raises(MocodecError):
        read_all(data)
    assert peak(data) < 1_000_000


def extras_file(extras: bytes, size: int) -> bytes:
    header = b"\x80\1\1\0" + varint(len(extras)) + varint(size) + b"\0"
    return framed(header, extras + checksum(extras) + ended(b"\0\0"))


def tree(stream: bytes) -> bytes:
    return varint(len(stream) << 1) + stream


@pytest.mark.parametrize("size", [100, 1 << 40])
def test_hostile_extras(size: int):
    array = tree(b"\x61a\x0b")
    bombs = [
        array + b"\3<f8\1" + varint(1 << 38) + b"\3" + bytes(8),  # constant, two terabytes
        array + b"\3<f8\2" + varint(1 << 39) * 2 + b"\3" + bytes(8),
        array + b"\3<f8\1" + varint(1 << 38) + b"\1" + varint(2) + b"\3\0",  # deflate
        array + b"\3<f8\1" + varint(1 << 38) + b"\2" + varint(1) + b"\0",  # LZMA
        array + b"\3<f8\1\5\x0d" + bytes(8) + b"\1\0",
        array + b"\3|O8\1\1\0\x08" + bytes(8),
        array + b"\x05<U999999"[:6] + b"\0",
        array + b"\7<U99999" + b"\1\7\0\1\0",
        tree(b"\x61a" + b"\7\1" * 500),
        tree(b"\x61a\7" + HUGE),
        tree(b"\x61a\x0c" + b"\0" * 4),
        tree(b"\x61a\x0d\x08\0"),
        tree(b"\x61a\x00\x61a\x00"),
        tree(b"\x61a\x61\xff"),
    ]
    for bomb in bombs:
        data = extras_file(bomb, size)
        with pytest.raises((Corrupt, Truncated)):
            read_all(data)
        assert peak(data) < 8_000_000


def test_a_deflate_bomb_is_refused_before_it_is_unpacked():
    stream = b"\x61a\x09" + varint(1 << 26) + bytes(1 << 26)
    packed = zlib.compressobj(9, zlib.DEFLATED, -15)
    bomb = packed.compress(stream) + packed.flush()
    data = extras_file(varint(len(stream) << 1 | 1) + varint(len(bomb)) + bomb, 1000)
    assert peak(data) < 2_000_000
    with pytest.raises(Corrupt):
        read_all(data)


def test_random_headers_and_extras():
    """Random bytes behind valid checksums, which forgery can have."""
    random = np.random.default_rng(7)
    good = small_file(2)
    length = good[5] & 0x7F | good[6] << 7
    header = good[7 : 7 + length]
    with container.Reader(good) as reader:
        extras = reader.source.read(reader.layout.extras, reader.header["extras"][0])
    for _ in range(1500):
        broken = bytearray(header)
        for _ in range(random.integers(1, 4)):
            broken[random.integers(len(broken))] = random.integers(256)
        data = framed(bytes(broken[: random.integers(1, len(broken) + 1)]), good[7 + length + 4 :])
        with contextlib.suppress(MocodecError):
            read_all(data)
        broken = bytearray(extras)
        broken[random.integers(len(broken))] = random.integers(256)
        with contextlib.suppress(MocodecError):
            values.unpack_extras(bytes(broken), 5000)
        with contextlib.suppress(MocodecError):
            records.INDEX.read(Cursor(random.bytes(12), "test"))
