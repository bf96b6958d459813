"""The container: lossless, small, readable from any input, loaded on demand."""

from __future__ import annotations

import io
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocodec import container
from mocodec.container import names, skeletons, tables, values
from mocodec.container.wire import Cursor, unzigzag, varint, zigzag
from mocodec.encoded import Chunk, Encoded
from mocodec.errors import BadInput, CannotEncode, Corrupt, MocodecError, TooNew, Truncated, UnknownCodec
from mocodec.motion import Motion, Signal, Skeleton
from mocodec.pointcloud import PointClouds

CMU = tuple(tables.CMU_JOINTS.split())
MARKERS = tuple(tables.CMU_MARKERS.split())
EXTRAS: dict[str, Any] = {
    "events": [{"label": "Foot Strike", "time_s": 0.25}],
    "analog": Signal(np.arange(480, dtype=np.int16).reshape(120, 4), 1200.0, ("a", "b", "c", "d"), ("V",) * 4),
    "blob": b"\x00\xff",
    "deep": {"list": [None, True, -5, 1 << 80, 0.1, float("inf"), ""]},
}


def about(**changes: Any) -> Motion:
    return Motion(**{"positions": np.empty((0, 41, 3)), "rate": 120.0, "names": MARKERS, **changes})


def encoded(chunks: int = 3, frames: int = 12, size: int = 40, like: Any = None, **changes: Any) -> Encoded[Any]:
    random = np.random.default_rng(1)
    made = [Chunk(i * frames, frames, random.bytes(size)) for i in range(chunks)]
    return Encoded(**{"codec": "tempo", "about": about() if like is None else like, "chunks": made, **changes})


def content(chunk: Chunk) -> tuple[int, int, bytes]:
    return chunk.start, chunk.frames, chunk.payload


def same_tree(a: Any, b: Any) -> bool:
    if isinstance(a, Signal):
        return (
            isinstance(b, Signal)
            and (a.rate, a.labels, a.units) == (b.rate, b.labels, b.units)
            and same_tree(a.values, b.values)
        )
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return isinstance(b, dict) and list(a) == list(b) and all(same_tree(a[k], b[k]) for k in a)
    if isinstance(a, (list, tuple)):
        return isinstance(b, list) and len(a) == len(b) and all(map(same_tree, a, b))
    return type(a) is type(b) and (a == b or (a != a and b != b))


def test_everything_comes_back():
    skeleton = Skeleton(CMU, tables.CMU_TREE, np.array(tables.CMU_OFFSETS) * 1e-5 + 0.003)
    source = {"format": "amc", "units": "ASF", "unit_m": 0.0254 / 0.45, "first_frame": 7, "odd": [1, 2.5, None]}
    like = Motion(np.empty((0, 31, 3)), 119.88, CMU, "y", skeleton, source=source, extras=EXTRAS)
    before = encoded(4, like=like, shared=(b"basis", b""), margin=2, settings={"max_error": 0.002, "components": 40})
    with container.Reader(container.pack(before)) as reader:
        after = reader.encoded
        assert (after.codec, after.shared, after.margin, after.frames) == ("tempo", (b"basis", b""), 2, 48)
        assert after.settings == {"max_error": 0.002, "components": 40}
        assert list(map(content, after.chunks)) == list(map(content, before.chunks))
        assert (after.about.rate, after.about.names, after.about.up) == (119.88, CMU, "y")
        assert same_tree(source, after.about.source)
        assert same_tree(EXTRAS, dict(after.about.extras))
        assert after.about.skeleton.parents == skeleton.parents
        np.testing.assert_allclose(after.about.skeleton.offsets, skeleton.offsets, atol=skeletons.STEP_M / 2 + 1e-12)
        np.testing.assert_array_equal(after.about.skeleton.offsets, skeletons.rounded(skeleton.offsets))
        reader.verify()


def test_point_clouds_come_back():
    clouds = PointClouds((), 15.0, colours=(), up="z", source={"format": "ply"})
    after = container.Reader(container.pack(encoded(like=clouds, codec="lien2006"))).encoded
    assert isinstance(after.about, PointClouds)
    assert (after.about.rate, after.about.up, after.about.colours, after.about.normals) == (15.0, "z", (), None)


def test_the_lossless_codec_keeps_offsets_to_the_last_bit():
    skeleton = Skeleton(CMU, tables.CMU_TREE, np.random.default_rng(0).normal(size=(31, 3)))
    like = Motion(np.empty((0, 31, 3)), 120.0, CMU, skeleton=skeleton)
    after = container.Reader(container.pack(encoded(like=like, codec="lossless"))).encoded
    assert after.about.skeleton.offsets.tobytes() == skeleton.offsets.tobytes()


def test_same_bytes_twice_and_without_seeking():
    class Pipe(io.RawIOBase):
        def __init__(self) -> None:
            self.data = b""

        def write(self, data: Any) -> int:
            self.data += bytes(data)
            return len(data)

    pipe, before = Pipe(), encoded(like=about(extras=EXTRAS))
    writer = container.Writer(pipe, about=before.about, codec="tempo")  # pyright: ignore[reportArgumentType]
    for chunk in before.chunks:
        writer.add(chunk)
    writer.close()
    assert pipe.data == container.pack(before) == container.pack(encoded(like=about(extras=EXTRAS)))


def test_a_file_that_was_read_packs_to_the_same_bytes():
    data = container.pack(encoded(like=about(extras=EXTRAS, source={"format": "c3d", "x": 1})))
    assert container.pack(container.Reader(data).encoded) == data


def test_the_overhead_of_a_file_is_small():
    one = len(container.pack(encoded(1, 480, 700, settings={"max_error": 0.002}))) - 700
    ten = len(container.pack(encoded(10, 480, 700, settings={"max_error": 0.002}))) - 7000
    assert one <= 40
    assert (ten - one) / 9 <= 12
    prefixed = about(names=tuple("Male:" + name for name in MARKERS))
    assert len(container.pack(encoded(1, 480, 700, like=prefixed))) - 700 <= 45


def test_side_information_is_small():
    assert len(names.pack(CMU)) <= 4
    assert len(names.pack(tables.SMPL.split()[:22])) <= 4
    assert len(names.pack([*MARKERS, "EXTRA1", "EXTRA2", "EXTRA3"])) <= 32
    assert len(names.pack([f"P{i + 1}" for i in range(41)])) <= 6
    assert len(names.pack(sorted(MARKERS))) < len("".join(MARKERS))
    random = np.random.default_rng(3)
    person = np.array(tables.CMU_OFFSETS) * 1e-5 * (1 + 0.05 * random.normal(size=(31, 1)))
    assert len(skeletons.pack(Skeleton(CMU, tables.CMU_TREE, person), CMU)) <= 120


@pytest.mark.parametrize(
    "given",
    [
        (), ("a",), ("",), ("a\nb", "c"), ("x:", "x:"), CMU, ("Male:LFHD", "Male:RFHD"), ("A:1", "B:1"),
        ("P1", "P2", "P3"), ("P01", "P02"), ("*115", "*116"),
        ("l\u00e8vre", "\udcff"), tuple(f"Marker_{i}" for i in range(54)), ("P1",) * 3,
    ],
)  # fmt: skip
def test_names_come_back(given: tuple[str, ...]):
    cursor = Cursor(names.pack(given), "test")
    assert names.unpack(cursor) == given
    cursor.done()


@pytest.mark.parametrize("rate", [120.0, 60.0, 29.97, 30000 / 1001, 59.94, 33.3, 1 / 3, np.pi, 1e-9, 1e12, 0.1 + 0.2])
def test_rates_come_back(rate: float):
    assert container.Reader(container.pack(encoded(like=about(rate=rate)))).encoded.about.rate == rate


def test_odd_skeletons_come_back():
    random = np.random.default_rng(0)
    for joints in (1, 2, 5, 22, 60):
        parents = (-1, *(int(random.integers(-1, j)) for j in range(1, joints)))
        offsets = random.choice([0, 0.3, -0.2, 1e-5, 20.0], (joints, 3))
        labels = tuple(f"{random.choice(['Left', 'Right', 'l', 'r', ''])}{j % 7}" for j in range(joints))
        skeleton = Skeleton(labels, parents, offsets)
        for exact in (False, True):
            cursor = Cursor(skeletons.pack(skeleton, ("x",) * joints, exact), "test")
            again = skeletons.unpack(cursor, ("x",) * joints)
            cursor.done()
            assert (again.names, again.parents) == (labels, parents)
            np.testing.assert_array_equal(again.offsets, offsets if exact else skeletons.rounded(offsets))
    huge = Skeleton(("a",), (-1,), np.full((1, 3), 1e9 / 3))
    again = skeletons.unpack(Cursor(skeletons.pack(huge, ("a",)), "test"), ("a",))
    np.testing.assert_array_equal(again.offsets, huge.offsets)
    with pytest.raises(CannotEncode):
        skeletons.pack(Skeleton(("a",), (-1,), np.full((1, 3), np.nan)), ("a",))


def arrays() -> list[np.ndarray]:
    random = np.random.default_rng(0)
    nan = np.array([0x7FF8000000000001, 0xFFF0000000000000, 0x7FF0DEADBEEF0001, 1 << 63], np.uint64).view(np.float64)
    walk = np.cumsum(random.integers(-9, 10, (3000, 5)), 0)
    return [
        np.tile(nan, 40), np.zeros(100_000), np.full((300, 4), np.nan), np.zeros((0, 3)), np.array(5.0),
        walk.astype(np.int16), walk * 0.0003, (walk * np.float32(0.1)).astype(np.float32), random.normal(size=(500, 3)),
        walk.astype(">i4"), walk.astype(">f8"), walk.astype(np.uint8), (walk % 2).astype(bool), walk.T, walk[::2, ::-1],
        np.array(["LFHD", "b"] * 50), np.array([b"abc", b""] * 50), walk.astype("m8[ms]"), walk.astype("M8[s]"),
        random.normal(size=300) + 1j, random.normal(size=300).astype(np.float16), np.array([1, 2, 3], np.int8),
        np.arange(1 << 16, dtype=np.uint64) << np.uint64(40),
    ]  # fmt: skip


@pytest.mark.parametrize("array", arrays(), ids=lambda a: f"{a.dtype}{a.shape}")
def test_arrays_come_back_bit_for_bit(array: np.ndarray):
    packed = values.pack_extras({"a": array})
    again = values.unpack_extras(packed.section, packed.size)["a"]
    assert (again.dtype, again.shape) == (array.dtype, array.shape)
    assert again.tobytes() == array.tobytes()
    assert len(packed.section) <= array.nbytes + 40


def test_arrays_are_packed_well():
    counts = np.cumsum(np.random.default_rng(0).integers(-9, 10, (3000, 5)), 0)
    assert len(values.pack_extras({"a": np.zeros(1_000_000)}).section) < 40
    assert len(values.pack_extras({"a": counts * 0.000305}).section) < counts.size * 1.2


@pytest.mark.parametrize(
    "tree",
    [
        {}, {"a": {}, "b": [], "c": ""}, {"x" * 400: "y" * 400, "é": "\udcff"}, {str(i): -i for i in range(200)},
        {"f": [0.0, -0.0, 1.0, 0.002, 1e300, 5e-324, 1 / 3, float("nan"), 119.88, 1e22, -2.5e-7]},
        {"i": [0, 63, 64, -1, 1 << 60, -(1 << 61), 1 << 61, 1 << 100, -(1 << 100)]},
    ],
)  # fmt: skip
def test_json_trees_come_back(tree: dict[str, Any]):
    cursor = Cursor(values.pack(tree, "test"), "test")
    again = values.unpack(cursor)
    cursor.done()
    assert same_tree(tree, again)
    assert str(again) == str(tree)


@pytest.mark.parametrize("bad", [{1: 2}, {"a": object()}, {"a": np.array([object()])}, {"a": {1, 2}}])
def test_values_that_cannot_be_stored_raise(bad: Any):
    with pytest.raises(CannotEncode):
        values.pack_extras(bad)
    deep: list[Any] = []
    for _ in range(100):
        deep = [deep]
    with pytest.raises(CannotEncode):
        values.pack({"deep": deep}, "test")


def test_chunks_must_follow_each_other():
    writer = container.Writer(io.BytesIO(), about=about(), codec="tempo")
    writer.add(Chunk(0, 5, b""))
    for chunk in (Chunk(4, 5, b""), Chunk(5, 0, b"")):
        with pytest.raises(CannotEncode):
            writer.add(chunk)


def test_tables_are_frozen():
    """Released entries never move. New entries are appended, which changes these checksums."""
    assert len(tables.WORDS) == len(set(tables.WORDS)) == 128
    assert zlib.crc32("\n".join(tables.VOCABULARY).encode()) == VOCABULARY_CRC
    assert zlib.crc32("\n".join(tables.WORDS).encode()) == WORDS_CRC
    assert not set(tables.WORDS) & set(tables.MORE_WORDS)
    assert zlib.crc32("\n".join(tables.MORE_WORDS).encode()) == MORE_WORDS_CRC
    assert zlib.crc32(tables.NAME_DICTIONARY) == NAME_DICTIONARY_CRC
    assert zlib.crc32(values.dictionary()) == VALUES_DICTIONARY_CRC
    assert zlib.crc32(values.lab_dictionary()) == LAB_DICTIONARY_CRC
    assert len(values.lab_dictionary()) < 1 << 15  # the window of deflate
    assert zlib.crc32(repr((tables.TREES, tables.RATES, tables.CODEC_IDS, tables.SOURCES)).encode()) == TABLES_CRC


VOCABULARY_CRC = 0x77674222
WORDS_CRC = 0x8B632B99
MORE_WORDS_CRC = 0xDA4C7490
NAME_DICTIONARY_CRC = 0x93C6EC59
VALUES_DICTIONARY_CRC = 0x22D177A8
LAB_DICTIONARY_CRC = 0xF8F0A211
TABLES_CRC = 0xC20C14FE


class Counting(io.BytesIO):
    """A file object that counts the bytes read."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.count = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self.count += len(data)
        return data


def test_only_needed_bytes_are_read():
    noise = {"a": np.random.default_rng(0).normal(size=100_000)}
    file = Counting(container.pack(encoded(900, 480, 1000, like=about(extras=noise))))
    reader = container.Reader(file)
    reader.info()
    chunks = reader.encoded.covering(200_000, 200_120)
    assert [chunk.start for chunk in chunks] == [199_680]
    assert reader.encoded.frames == 432_000
    opened = file.count
    assert opened < 25_000
    assert len(chunks[0].payload) == 1000
    assert file.count - opened < 1100
    assert len(reader.encoded.about.extras["a"]) == 100_000


def test_covering_equals_a_search_of_all_chunks():
    reader = container.Reader(container.pack(encoded(20, 7, 3, margin=1)))
    for start, stop in ((0, 140), (0, 1), (6, 8), (7, 14), (139, 140), (30, 60), (5, 5)):
        touched = [i for i in range(20) if i * 7 < stop and (i + 1) * 7 > start]
        wanted = range(max(0, touched[0] - 1), min(20, touched[-1] + 2)) if touched and stop > start else range(0)
        assert [chunk.start // 7 for chunk in reader.encoded.covering(start, stop)] == list(wanted)


def test_every_kind_of_input_gives_the_same(tmp_path: Path):
    data = container.pack(encoded(5, like=about(extras=EXTRAS)))
    path = tmp_path / "a.mocz"
    path.write_bytes(data)

    class Stream(io.RawIOBase):
        """Cannot seek, as standard input."""

        def __init__(self) -> None:
            self.inner = io.BytesIO(data)

        def read(self, size: int = -1) -> bytes:
            return self.inner.read(size)

    for where in (
        data,
        bytearray(data),
        memoryview(data),
        path,
        str(path),
        io.BytesIO(data),
        Stream(),
        path.open("rb"),
    ):
        with container.Reader(where) as reader:
            assert [chunk.payload for chunk in reader.encoded.chunks] == [c.payload for c in encoded(5).chunks]
            extras = reader.encoded.about.extras
        assert same_tree(EXTRAS, dict(extras)), "extras can still be read after the file was closed"
        if isinstance(where, io.BufferedReader):
            where.close()
    with pytest.raises(BadInput):
        container.Reader(tmp_path / "none.mocz")
    with pytest.raises(BadInput):
        container.Reader(io.StringIO("text"))
    with pytest.raises(BadInput):
        container.Reader(5)


def test_info_is_json_and_accounts_for_every_byte():
    import json

    like = about(extras=EXTRAS, skeleton=Skeleton(MARKERS, (-1,) * 41, np.zeros((41, 3))), source={"format": "c3d"})
    for chunks in (0, 1, 5):
        data = container.pack(encoded(chunks, like=like, shared=(b"xyz",), settings={"max_error": 0.002}))
        info = container.Reader(data).info()
        assert json.loads(json.dumps(info)) == info
        assert sum(info["bytes_by_part"].values()) == info["bytes"] == len(data)
        assert (info["frames"], info["points"], info["codec"], info["kind"]) == (12 * chunks, 41, "tempo", "motion")
        assert info["promise"] == {"max_error": 0.002}
        assert info["chunks"]["count"] == chunks


def test_numbers():
    for value in (0, 1, 127, 128, 1 << 20, (1 << 63) - 1):
        assert Cursor(varint(value), "test").varint() == value
    for value in (0, -1, 1, -(1 << 61), 1 << 61):
        assert unzigzag(zigzag(value)) == value
    for bad in (b"\x80\x00", b"\xff" * 9 + b"\x01"):
        with pytest.raises(Corrupt):
            Cursor(bad, "test").varint()


def test_errors_have_the_right_class():
    data = container.pack(encoded())
    later = data[:4] + b"\x02" + data[5:]
    head_end = 6 + data[5]
    later = later[:head_end] + zlib.crc32(later[:head_end]).to_bytes(4, "little") + later[head_end + 4 :]
    with pytest.raises(TooNew):
        container.Reader(later)
    with pytest.raises(Corrupt):
        container.Reader(data[:4] + b"\x02" + data[5:])
    with pytest.raises(Truncated):
        container.Reader(data[:-1])
    with pytest.raises(Truncated):
        container.Reader(b"")
    with pytest.raises(BadInput):
        container.Reader(b"\xff\xd8\xff\xe0 a picture")
    with pytest.raises(UnknownCodec):
        container.Reader(data[:7] + b"\x7f" + zlib_tail(data, head_end, 7, 0x7F))
    assert issubclass(UnknownCodec, MocodecError)


def test_errors_name_file_and_chunk(tmp_path):
    data = bytearray(container.pack(encoded(3)))
    (tmp_path / "short.mocz").write_bytes(data[:-3])
    data[len(data) // 2] ^= 1
    path = tmp_path / "flipped.mocz"
    path.write_bytes(data)
    with pytest.raises(Truncated, match=r"^\S*short\.mocz: the file ends"):
        container.Reader(tmp_path / "short.mocz")
    with container.Reader(path) as reader:
        with pytest.raises(Corrupt, match=r"^\S*flipped\.mocz: chunk 1 [^/]*$"):
            reader.verify()
        with pytest.raises(Corrupt, match=r"^\S*flipped\.mocz: chunk 1 [^/]*$"):
            _ = reader.encoded.chunks[1].payload
        assert [message[:7] for _, message in reader.damage()] == ["chunk 1"]
    with open(path, "rb") as file, pytest.raises(Corrupt, match=r"flipped\.mocz: chunk 1"):
        container.Reader(file).verify()


def zlib_tail(data: bytes, head_end: int, at: int, byte: int) -> bytes:
    """The rest of a file after header byte `at` was set to `byte`, with a matching header checksum."""
    head = data[:at] + bytes([byte]) + data[at + 1 : head_end]
    return head[at + 1 :] + zlib.crc32(head).to_bytes(4, "little") + data[head_end + 4 :]


def test_words_of_both_tables_are_short():
    for word in (*tables.WORDS, *tables.MORE_WORDS):
        packed = values.pack({word: 0}, "test")
        assert len(packed) <= 4, word
        assert values.unpack(Cursor(packed, "test")) == {word: 0}
    reserved = bytes([4 << 1, values.MORE, 127, 32, 32])
    with pytest.raises(MocodecError):
        values.unpack(Cursor(reserved, "test"))
