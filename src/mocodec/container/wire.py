"""What the container needs beside `fields`: single bits, checksums.

Forward and inverse stand side by side.
"""

from __future__ import annotations

import zlib

from ..entropy.compressors import deflate, inflate
from ..entropy.varint import signed as zigzag
from ..entropy.varint import unsigned as unzigzag
from ..fields.cursor import Cursor, blob, text, varint

__all__ = [
    "BitReader", "BitWriter", "Cursor", "blob", "checksum", "deflate", "inflate", "text", "unzigzag", "varint",
    "zigzag",
]  # fmt: skip


def checksum(*parts: bytes | memoryview) -> bytes:
    """CRC-32 (as in zlib, PNG) of the parts joined, little-endian: finds every error of up to 32 bits in a row."""
    crc = 0
    for part in parts:
        crc = zlib.crc32(part, crc)
    return crc.to_bytes(4, "little")


READ_AHEAD_BYTES, HELD_BITS = 16, 128
"""Bytes that a BitReader takes at a time, and bits that a BitWriter holds at most: shifts of integers up to this size
cost the same."""


class BitWriter:
    """Bits, first bit lowest."""

    def __init__(self) -> None:
        self.held = 0
        self.width = 0
        self.written = bytearray()

    def put(self, value: int, width: int) -> None:
        self.held |= (value & ((1 << width) - 1)) << self.width
        self.width += width
        if self.width >= HELD_BITS:
            self._flush(self.width // 8)

    def golomb(self, value: int, k: int) -> None:
        """Exponential Golomb of order k: value ≥ 0; small values short."""
        value += 1 << k
        extra = value.bit_length() - 1 - k
        self.put(1 << extra | value << (extra + 1), 2 * extra + k + 1)  # the leading one of the value is cut off

    def bytes(self) -> bytes:
        self._flush((self.width + 7) // 8)
        return bytes(self.written)

    def _flush(self, count: int) -> None:
        """Move this many bytes out of the bits held."""
        whole = self.held & ((1 << 8 * count) - 1)
        self.written += whole.to_bytes(count, "little")
        self.held >>= 8 * count
        self.width = max(0, self.width - 8 * count)


class BitReader:
    """The inverse of BitWriter, over the rest of a cursor's bytes; `done` moves the cursor behind the bits."""

    def __init__(self, cursor: Cursor) -> None:
        self.cursor = cursor
        self.held = 0
        self.width = 0

    def get(self, width: int) -> int:
        if self.width < width:
            self._fill(width)
        value = self.held & ((1 << width) - 1)
        self.held >>= width
        self.width -= width
        return value

    def golomb(self, k: int) -> int:
        extra = 0
        while not self.held:
            extra += self.width
            self._require_usual(extra)
            self.width = 0
            self._fill(1)
        zeros = (self.held & -self.held).bit_length() - 1
        extra += zeros
        self._require_usual(extra)
        self.held >>= zeros + 1
        self.width -= zeros + 1
        return (1 << (extra + k)) + self.get(extra + k) - (1 << k)

    def _fill(self, width: int) -> None:
        """Hold at least `width` bits."""
        needed = (width - self.width + 7) // 8
        data = self.cursor.take(max(needed, min(READ_AHEAD_BYTES, self.cursor.left)))
        self.held |= int.from_bytes(data, "little") << self.width
        self.width += 8 * len(data)

    def _require_usual(self, extra: int) -> None:
        if extra > 40:
            raise self.cursor.corrupt("a number is badly written")

    def done(self) -> None:
        self.cursor.at -= self.width // 8
        if self.held & ((1 << self.width % 8) - 1):
            raise self.cursor.corrupt("padding bits are set")
