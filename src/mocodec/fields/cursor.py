"""The elementary values on disk (varints, byte strings, text, floats): what writes them beside what reads them.

The reader checks every length against the bytes that are left before it allocates anything.
"""

from __future__ import annotations

import struct
from typing import NoReturn

import numpy as np

from .. import native
from ..entropy.varint import read_one, unsigned, write
from ..errors import Corrupt, MocodecError, Truncated
from ..typing import Integers


def varint(value: int) -> bytes:
    """Seven bits a byte, lowest first, the high bit set on all bytes but the last (LEB128); 0 ≤ value < 2⁶³."""
    return write([value])


def blob(data: bytes) -> bytes:
    """The length as a varint, then the bytes."""
    return varint(len(data)) + data


def text(value: str) -> bytes:
    """A blob of UTF-8. Lone surrogates, which occur in file names and old labels, are kept."""
    return blob(value.encode("utf-8", "surrogatepass"))


class Cursor:
    """Reads values from bytes, front to back.

    data: all bytes; what: their name, for error messages; at, end: the range to read; ends_early: the error for a value
    that runs past the end, Truncated for a file, Corrupt for bytes whose length is known to be right. Every method
    raises `ends_early` there, and Corrupt for bytes that no encoder writes. `field`: the field that is being read, for
    error messages.
    """

    def __init__(
        self,
        data: bytes | memoryview,
        what: str,
        at: int = 0,
        end: int | None = None,
        ends_early: type[MocodecError] = Truncated,
    ) -> None:
        self.data = bytes(data)
        self.what = what
        self.at = at
        self.end = len(self.data) if end is None else end
        self.ends_early = ends_early
        self.field = ""

    @property
    def left(self) -> int:
        return self.end - self.at

    def take(self, count: int) -> bytes:
        """The next `count` bytes."""
        if count > self.left:
            self._end_early(count - self.left)
        self.at += count
        return self.data[self.at - count : self.at]

    def rest(self) -> bytes:
        """All bytes that are left."""
        return self.take(self.left)

    def part(self, size: int) -> Cursor:
        """A cursor over the next `size` bytes, which this one skips."""
        if size > self.left:
            self._end_early(size - self.left)
        inside = Cursor(self.data, self.what, self.at, self.at + size, self.ends_early)
        inside.field = self.field
        self.at += size
        return inside

    def byte(self) -> int:
        return self.take(1)[0]

    def varint(self) -> int:
        try:
            value, self.at = read_one(self.data, self.at, self.end)
        except Truncated:
            self._end_early(1)
        except Corrupt:
            raise self.corrupt("a number is badly written") from None
        return value

    def signed(self) -> int:
        return unsigned(self.varint())

    def plain(self, most: int) -> tuple[Integers, Integers]:
        """Values and ends of the next varints, without moving: at most `most`, up to the first that takes more than
        four bytes or is badly written."""
        window = np.frombuffer(self.data, np.uint8, min(4 * most, self.left), self.at)
        if (kernel := native.kernel("plain_varints")) is not None:
            value, ends = kernel(window, most)
            return value, self.at + ends
        last = np.flatnonzero(window < 0x80)[:most]
        first = np.concatenate([[0], last[:-1] + 1]) if len(last) else last
        size = last - first + 1
        odd = np.flatnonzero((size > 4) | (size > 1) & (window[last] == 0))
        count = int(odd[0]) if len(odd) else len(last)
        value = np.zeros(count, np.int64)
        for place in range(int(size[:count].max(initial=0))):
            more = np.flatnonzero(size[:count] > place)
            value[more] |= (window[first[more] + place] & 0x7F).astype(np.int64) << 7 * place
        return value, self.at + last[:count] + 1

    def varints(self, count: int) -> list[int]:
        """The next `count` varints."""
        return self.varint_array(count).tolist()

    def varint_array(self, count: int) -> Integers:
        """The next `count` varints, (count,); fast enough for the thousands of an index."""
        plain, ends = self.plain(count)
        if len(plain):
            self.at = int(ends[-1])
        rest = [self.varint() for _ in range(count - len(plain))]
        return np.append(plain, np.array(rest, np.int64)) if rest else plain

    def count(self, at_least_bytes: int = 1) -> int:
        """A number of items that take at least `at_least_bytes` each: never more than the bytes left can hold."""
        value = self.varint()
        if value * at_least_bytes > self.left:
            raise self.corrupt(f"{value} items are announced, but only {self.left} bytes are left")
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
        """Raises Corrupt where bytes are left."""
        if self.left:
            raise self.corrupt(f"{self.left} bytes are left over")

    def corrupt(self, message: str) -> Corrupt:
        """The error to raise for damage at this position."""
        return Corrupt(f"{self._where}, byte {self.at}: {message}")

    @property
    def _where(self) -> str:
        return f"{self.what}, {self.field}" if self.field else self.what

    def _end_early(self, missing: int) -> NoReturn:
        raise self.ends_early(f"{self._where} ends at byte {self.end}, {missing} bytes too early")
