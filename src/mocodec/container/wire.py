"""The smallest things on disk: varints, strings, bits, checksums, bounded inflation. Forward and inverse side by side.

Whatever is read is checked against the bytes that are left before anything is allocated.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from ..entropy.varint import signed as zigzag
from ..entropy.varint import unsigned as unzigzag
from ..entropy.varint import write
from ..errors import Corrupt, Truncated

__all__ = [
    "BitReader", "BitWriter", "Cursor", "blob", "checksum", "deflate", "inflate", "text", "unzigzag", "varint",
    "zigzag",
]  # fmt: skip

MAX_VARINT_BYTES = 9  # 63 bits: every count and offset fits a signed 64-bit integer


def checksum(*parts: bytes | memoryview) -> bytes:
    """CRC-32 (as in zlib, PNG) of the parts joined, little-endian: finds every error of up to 32 bits in a row."""
    crc = 0
    for part in parts:
        crc = zlib.crc32(part, crc)
    return crc.to_bytes(4, "little")


def varint(value: int) -> bytes:
    """Seven bits a byte, lowest first, the high bit set on all bytes but the last (LEB128); 0 ≤ value < 2⁶³."""
    return write([value])


def blob(data: bytes) -> bytes:
    """Length, then the bytes."""
    return varint(len(data)) + data


def text(value: str) -> bytes:
    """A blob of UTF-8; lone surrogates, which file systems and old labels bring, are kept."""
    return blob(value.encode("utf-8", "surrogatepass"))


class Cursor:
    """Reads from bytes, front to back, and says where it is. Raises Truncated past the end, Corrupt for nonsense."""

    def __init__(self, data: bytes | memoryview, what: str, at: int = 0, end: int | None = None) -> None:
        self.data = bytes(data)
        self.what = what
        self.at = at
        self.end = len(self.data) if end is None else end

    @property
    def left(self) -> int:
        return self.end - self.at

    def take(self, count: int) -> bytes:
        if count > self.left:
            raise Truncated(f"{self.what} ends at byte {self.end}, {count - self.left} bytes too early")
        self.at += count
        return self.data[self.at - count : self.at]

    def byte(self) -> int:
        return self.take(1)[0]

    def varint(self) -> int:
        data, at, value = self.data, self.at, 0
        for shift in range(0, 7 * MAX_VARINT_BYTES, 7):
            if at == self.end:
                self.take(at - self.at + 1)  # raises Truncated
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                self.at = at
                if byte == 0 and shift:
                    break  # one number, one spelling: so that a file's bytes follow from its content
                return value
        raise self.corrupt("a number is badly written")

    def plain(self, most: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The next numbers, at most so many, and where each ends, without taking them: up to one that is not of four
        bytes or fewer, and well written."""
        window = np.frombuffer(self.data, np.uint8, min(4 * most, self.left), self.at)
        last = np.flatnonzero(window < 0x80)[:most]
        first = np.concatenate([[0], last[:-1] + 1]) if len(last) else last
        size = last - first + 1
        odd = np.flatnonzero((size > 4) | (size > 1) & (window[last] == 0))
        some = int(odd[0]) if len(odd) else len(last)
        value = np.zeros(some, np.int64)
        for place in range(int(size[:some].max(initial=0))):
            more = np.flatnonzero(size[:some] > place)
            value[more] |= (window[first[more] + place] & 0x7F).astype(np.int64) << 7 * place
        return value, self.at + last[:some] + 1

    def varints(self, count: int) -> list[int]:
        """So many numbers in a row: an index has thousands."""
        plain, ends = self.plain(count)
        if len(plain):
            self.at = int(ends[-1])
        return plain.tolist() + [self.varint() for _ in range(count - len(plain))]

    def signed(self) -> int:
        return unzigzag(self.varint())

    def count(self, at_least_bytes: int = 1) -> int:
        """A number of things that take at least so many bytes each: never more than could still follow."""
        value = self.varint()
        if value * at_least_bytes > self.left:
            raise self.corrupt(f"{value} things are announced where {self.left} bytes are left")
        return value

    def blob(self) -> bytes:
        return self.take(self.count())

    def text(self) -> str:
        try:
            return self.blob().decode("utf-8", "surrogatepass")
        except UnicodeDecodeError:
            raise self.corrupt("a string is not UTF-8") from None

    def float64(self) -> float:
        return struct.unpack("<d", self.take(8))[0]

    def done(self) -> None:
        if self.left:
            raise self.corrupt(f"{self.left} bytes are left over")

    def corrupt(self, message: str) -> Corrupt:
        return Corrupt(f"{self.what}, byte {self.at}: {message}")


class BitWriter:
    """Bits, first bit lowest."""

    def __init__(self) -> None:
        self.bits: list[int] = []

    def put(self, value: int, width: int) -> None:
        self.bits.extend(value >> i & 1 for i in range(width))

    def golomb(self, value: int, k: int) -> None:
        """Exponential Golomb of order k: value ≥ 0; small values short."""
        value += 1 << k
        extra = value.bit_length() - 1 - k
        self.put(0, extra)
        self.put(1, 1)
        self.put(value & ((1 << (extra + k)) - 1), extra + k)

    def bytes(self) -> bytes:
        whole = sum(bit << i for i, bit in enumerate(self.bits))
        return whole.to_bytes(-(-len(self.bits) // 8), "little")


class BitReader:
    """The inverse of BitWriter, over the rest of a cursor's bytes."""

    def __init__(self, cursor: Cursor) -> None:
        self.cursor = cursor
        self.held = 0
        self.width = 0

    def get(self, width: int) -> int:
        while self.width < width:
            self.held |= self.cursor.byte() << self.width
            self.width += 8
        value = self.held & ((1 << width) - 1)
        self.held >>= width
        self.width -= width
        return value

    def golomb(self, k: int) -> int:
        extra = 0
        while not self.get(1):
            extra += 1
            if extra > 40:
                raise self.cursor.corrupt("a number is badly written")
        return (1 << (extra + k)) + self.get(extra + k) - (1 << k)

    def done(self) -> None:
        if self.held:
            raise self.cursor.corrupt("padding bits are set")


def deflate(data: bytes, dictionary: bytes = b"") -> bytes:
    """Raw deflate (RFC 1951), primed with a dictionary. Bytes may differ between zlibs; all of them are valid."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15, 9, zlib.Z_DEFAULT_STRATEGY, dictionary)
    return packer.compress(data) + packer.flush()


def inflate(data: bytes, size: int, what: str, dictionary: bytes = b"") -> bytes:
    """Exactly `size` bytes from raw deflate; never allocates more. Raises Corrupt."""
    unpacker = zlib.decompressobj(-15, dictionary)
    try:
        out = unpacker.decompress(data, size) if size else unpacker.decompress(data, 1)
        rest = unpacker.decompress(unpacker.unconsumed_tail, 1) if not unpacker.eof else b""
    except zlib.error as error:
        raise Corrupt(f"{what}: {error}") from None
    if len(out) != size or rest or not unpacker.eof or unpacker.unused_data:
        raise Corrupt(f"{what}: does not unpack to the {size} bytes announced")
    return out
