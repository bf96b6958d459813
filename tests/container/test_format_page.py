"""docs/format.md is exact: a file taken apart by the page alone, with nothing of the container but its tables."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np

from mocodec import container
from mocodec.container import tables
from mocodec.container.values import dictionary, lab_dictionary  # the streams of typical_extras() and lab_extras()
from mocodec.encoded import Chunk, Encoded
from mocodec.motion import Motion, Signal, Skeleton
from mocodec.signals import codec

JOINTS = ("hip", "l_leg", "r_leg", "l_foot", "r_foot", "Left Hand")
OFFSETS = np.array([[0, 90, 0], [9, -2, 1], [-9, -2, 1], [0.5, -40, 3], [-0.5, -41, 3], [20, 0.125, 0]]) * 1e-2


class Page:
    """Reads the primitives of the section "Numbers"."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, count: int) -> bytes:
        assert self.at + count <= len(self.data)
        self.at += count
        return self.data[self.at - count : self.at]

    def varint(self) -> int:
        value = shift = 0
        while True:
            byte = self.take(1)[0]
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    def signed(self) -> int:
        value = self.varint()
        return -(value + 1) // 2 if value & 1 else value // 2

    def blob(self) -> bytes:
        return self.take(self.varint())

    def string(self) -> str:
        return self.blob().decode()

    def float64(self) -> float:
        return struct.unpack("<d", self.take(8))[0]

    def names(self) -> list[str]:
        head = self.varint()
        prefix = self.string() if head & 4 else ""
        names: list[str] = []
        if head & 3 == 0:
            while len(names) < head >> 3:
                start = self.varint()
                names += tables.VOCABULARY[start - 1 :][: self.varint()] if start else [self.string()]
        elif head & 3 == 1:
            stem, first = self.string(), self.varint()
            names = [f"{stem}{first + i}" for i in range(head >> 3)]
        else:
            size = self.varint()
            text = zlib.decompressobj(-15, tables.NAME_DICTIONARY).decompress(self.blob())
            assert len(text) == size
            names = text.decode().split("\n")
        return [prefix + name for name in names]

    def tree(self, dictionary: bytes) -> dict[str, Any]:
        head = self.varint()
        size = self.varint() if head == 1 else head >> 1
        words = lab_dictionary() if head == 1 else dictionary
        data = zlib.decompressobj(-15, words).decompress(self.blob()) if head & 1 else self.take(size)
        assert len(data) == size
        stream, result = Page(data), {}
        while stream.at < len(data):
            key = stream.value()
            result[key] = stream.value()
        return result

    def value(self) -> Any:
        byte = self.take(1)[0]
        simple = {0: lambda: None, 1: lambda: False, 2: lambda: True, 3: self.signed, 5: self.float64, 6: self.string}
        if byte in simple:
            return simple[byte]()
        if byte == 4:
            return float(f"{self.signed()}e{self.signed()}")
        if byte == 7:
            return [self.value() for _ in range(self.varint())]
        if byte == 8:
            return {self.value(): self.value() for _ in range(self.varint())}
        if byte == 9:
            return self.blob()
        if byte == 10:
            return int.from_bytes(self.blob(), "little", signed=True)
        if byte == 11:
            return "array"
        if byte == 12:
            return [self.value() for _ in range(4)]
        if byte == 13:
            dtype = np.dtype(self.value())
            shape = [self.varint() for _ in range(self.varint())]
            return np.frombuffer(self.take(int(np.prod(shape)) * dtype.itemsize), dtype).reshape(shape)
        if byte == 15:
            parts = [self.value() for _ in range(4)]
            return [*parts, tuple(self.varint() for _ in range(self.varint()))]
        if byte == 14:
            return tables.MORE_WORDS[self.varint()]
        assert byte >= 32
        if byte < 96:
            return byte - 32
        return self.take(byte - 96).decode() if byte < 128 else tables.WORDS[byte - 128]


class Bits:
    """A string of bits, first bit lowest."""

    def __init__(self, page: Page) -> None:
        self.page, self.byte, self.left = page, 0, 0

    def get(self, count: int) -> int:
        value = 0
        for i in range(count):
            if not self.left:
                self.byte, self.left = self.page.take(1)[0], 8
            value |= (self.byte & 1) << i
            self.byte, self.left = self.byte >> 1, self.left - 1
        return value

    def golomb(self, k: int) -> int:
        zeros = 0
        while not self.get(1):
            zeros += 1
        return (1 << (k + zeros)) + self.get(k + zeros) - (1 << k)

    def residual(self, k: int) -> int:
        if not self.get(1):
            return 0
        number = self.golomb(k) + 1
        return -(number + 1) // 2 if number & 1 else number // 2


def half_up(numerator: int, denominator: int) -> int:
    return (2 * numerator + denominator) // (2 * denominator)


def partner(name: str, earlier: list[str]) -> int | None:
    for left, right in (("left", "right"), ("Left", "Right"), ("l", "r"), ("L", "R")):
        for this, other in ((left, right), (right, left)):
            at = name.find(this)
            if at >= 0 and (len(this) > 1 or at == 0 or not name[at - 1].isalpha()):
                exchanged = name[:at] + other + name[at + len(this) :]
                if exchanged in earlier:
                    return earlier.index(exchanged)
    return None


def skeleton(page: Page, names: list[str]) -> tuple[list[int], np.ndarray]:
    flags = page.take(1)[0]
    assert not flags & 3
    assert flags >> 4 & 7 == 0, "this test has no known tree"
    mirror, chained = flags >> 2 & 3, flags >> 7
    bits = Bits(page)
    parents = [joint - 1 - bits.golomb(0) for joint in range(len(names))]
    orders = bits.get(4), bits.get(4)
    offsets: list[list[int]] = []
    ratio = (1, 1)
    for joint, name in enumerate(names):
        other = partner(name, names[:joint]) if mirror else None
        q = [0, 0, 0] if other is None else [-v if i == mirror - 1 else v for i, v in enumerate(offsets[other])]
        p = [half_up(v * ratio[0], ratio[1]) for v in q] if chained else q
        a = max(range(3), key=lambda i: abs(p[i]))
        first = p[a] + bits.residual(orders[0])
        scaled = [half_up(v * first, p[a]) if p[a] else v for v in p]
        offset = [first if i == a else scaled[i] + bits.residual(orders[1]) for i in range(3)]
        b = max(range(3), key=lambda i: abs(q[i]))
        ratio = (offset[b], q[b]) if offset[b] * q[b] > 0 else (1, 1)
        offsets.append(offset)
    return parents, np.array(offsets)


def array(page: Page) -> np.ndarray:
    """Only numbers here: the forms that this test's file has."""
    dtype = np.dtype(page.string())
    shape = [page.varint() for _ in range(page.varint())]
    form = page.take(1)[0]
    coder, transform = form & 3, form >> 2
    if coder == 3:
        return np.full(shape, np.frombuffer(page.take(dtype.itemsize), dtype)[0])
    step = page.float64() if transform == 3 else None
    data = page.blob()
    if coder == 1:
        data = zlib.decompress(data, -15)
    elif coder == 2:
        import lzma

        data = lzma.decompress(data, lzma.FORMAT_RAW, filters=[{"id": lzma.FILTER_LZMA2, "dict_size": 1 << 22}])
    if transform == 0:
        return np.frombuffer(data, dtype).reshape(shape)
    width = 4 if step is not None else dtype.itemsize
    numbers = np.frombuffer(data, np.uint8).reshape(width, -1).T.copy().view(f"<u{width}")
    numbers = numbers.reshape(*shape[1:], shape[0])
    if transform > 1:
        numbers = np.cumsum(numbers, axis=-1, dtype=numbers.dtype)
    numbers = np.ascontiguousarray(np.moveaxis(numbers, -1, 0))
    return numbers.view("<i4") * step if step is not None else numbers.view(dtype)


def crc(data: bytes) -> bytes:
    return zlib.crc32(data).to_bytes(4, "little")


def test_a_file_is_as_the_page_says():
    tree = Skeleton(JOINTS, (-1, 0, 0, 1, 2, 0), OFFSETS)
    source = {"format": "trc", "units": "mm", "unit_m": 0.001, "first_frame": 4, "n": [None, True, -70, 0.002, 1 / 3]}
    samples = np.cumsum(np.random.default_rng(0).integers(-9, 10, (300, 2)), 0).astype(np.int16)
    extras = {
        "events": [{"label": "Foot Strike", "time_s": 0.25}], "blob": b"\0\1", "large": -(1 << 70),
        "analog": Signal(samples, 1200.0, ("Fx", "Fy"), ("N", "N")),
        "small": np.array([[1.5, 2.5]]), "steps": samples * 0.25 + 0.0, "zeros": np.zeros(90),
    }  # fmt: skip
    about = Motion(np.empty((0, 6, 3)), 59.0, JOINTS, "y", tree, source=source, extras=extras)
    chunks = [Chunk(0, 10, b"one"), Chunk(10, 10, b"two2"), Chunk(20, 7, b"")]
    data = container.pack(Encoded("hou2014", about, chunks, (b"basis", b""), 1, {"max_error": 0.002}))

    page = Page(data)
    assert page.take(4) == b"mocz"
    assert page.take(1) == b"\1"
    length = page.varint()
    end = page.at + length
    assert page.take(1)[0] == 0 | 1 << 1 | 0b11111 << 3
    assert page.varint() == 2  # hou2014
    assert (page.varint(), page.varint(), page.varint()) == (0, 1, 59)
    assert page.varint() == 1  # margin
    assert page.names() == list(JOINTS)
    parents, offsets = skeleton(page, list(JOINTS))
    assert parents == [-1, 0, 0, 1, 2, 0]
    np.testing.assert_array_equal(offsets, np.rint(OFFSETS * 1e5))
    assert page.tree(dictionary()) == {"max_error": 0.002}
    preset = tables.SOURCES[page.varint()]
    assert {**preset, **page.tree(dictionary())} == source
    assert page.varint() == 0  # with signals
    extras_bytes, unpacked_bytes, signal_bytes = page.varint(), page.varint(), page.varint()
    assert [page.take(page.varint() // 2) for _ in range(page.varint())] == [b"basis", b""]
    assert page.at == end
    assert page.take(4) == crc(data[:end])

    section = page.take(extras_bytes)
    assert page.take(4) == crc(section)
    inner = Page(section)
    values = inner.tree(dictionary())
    assert values["events"] == extras["events"]
    assert (values["blob"], values["large"]) == (extras["blob"], extras["large"])
    assert values["analog"] == [1200.0, ["Fx", "Fy"], ["N", "N"], samples.dtype.str, samples.shape]
    np.testing.assert_array_equal(values["small"], extras["small"])
    head = inner.at
    encoded = codec.encode(samples, 1200.0)
    assert encoded is not None
    assert inner.take(len(codec.pack(encoded[0]))) == codec.pack(encoded[0]), head
    for expected in (extras["steps"], extras["zeros"]):
        np.testing.assert_array_equal(array(inner), expected)
    assert inner.at == len(section)
    assert unpacked_bytes <= (1 << 28) + 1024 * (extras_bytes + signal_bytes)

    signals = page.take(signal_bytes)
    assert signals == b"".join(chunk + crc(chunk) for chunk in encoded[1])

    for chunk in chunks:
        start = page.at
        assert page.varint() == chunk.frames
        assert page.blob() == chunk.payload
        assert page.take(4) == crc(data[start : page.at - 4])
    index = page.at
    assert page.take(1) == b"\0"
    assert [page.varint() for _ in range(8)] == [3, 2, 10, 1, 7, 3, 4, 0]
    assert page.take(4) == crc(data[index : page.at - 4])
    size = page.at - index
    assert Page(data[-3:][:1]).varint() == size
    assert data[page.at + 1 :] == b"cz"


def test_one_chunk_has_no_numbers_in_its_index():
    data = container.pack(Encoded("lossless", Motion(np.empty((0, 1, 3)), 120.0), [Chunk(0, 9, b"x")]))
    assert data[-8:] == b"\0" + crc(b"\0") + b"\5cz"
