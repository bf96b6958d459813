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
