"""A few whole numbers as bytes, seven bits each: for headers, which are too short for an entropy coder.

numbers ─write─► bytes ─read─► numbers, and the position after them
"""

from __future__ import annotations

from collections.abc import Iterable

from ..errors import Corrupt, Truncated

MAX_BYTES = 9
"""No number takes more bytes than this: every number fits a signed 64-bit integer."""


def write(numbers: Iterable[int]) -> bytes:
    """Whole numbers from 0 to 2^63 − 1 (LEB128): low bits first; the top bit of a byte says that more follow."""
    out = bytearray()
    for number in numbers:
        rest = int(number)
        assert 0 <= rest < 1 << 63, rest
        while rest > 127:
            out.append(rest & 127 | 128)
            rest >>= 7
        out.append(rest)
    return bytes(out)


def read(data: bytes, count: int, at: int = 0) -> tuple[list[int], int]:
    """`count` numbers of the bytes from `at` on, and the position after them. Raises Corrupt."""
    short = data[at : at + count]
    if len(short) == count and short.isascii():  # most numbers are less than 128
        return list(short), at + count
    numbers: list[int] = []
    end = len(data)
    for _ in range(count):
        if at < end and data[at] < 128:
            numbers.append(data[at])
            at += 1
            continue
        try:
            number, at = read_one(data, at, end)
        except Truncated:
            raise Corrupt("a number in a header runs past its end") from None
        numbers.append(number)
    return numbers, at


def read_one(data: bytes, at: int, end: int) -> tuple[int, int]:
    """The number at `at` in bytes that end at `end`, and the position after it.

    Raises Truncated where it runs past the end, Corrupt where it takes more bytes than it needs or than MAX_BYTES: a
    number has one spelling, so that the bytes of a file follow from its content.
    """
    number = 0
    for shift in range(0, 7 * MAX_BYTES, 7):
        if at >= end:
            raise Truncated("a number runs past its end")
        byte = data[at]
        at += 1
        number |= (byte & 127) << shift
        if byte < 128:
            if byte == 0 and shift:
                break
            return number, at
    raise Corrupt("a number is badly written")


def signed(number: int) -> int:
    """A whole number of either sign as one that is not negative: 0, −1, 1, −2 → 0, 1, 2, 3."""
    return number << 1 if number >= 0 else (-number << 1) - 1


def unsigned(number: int) -> int:
    """The number of either sign that `signed` turned into this one."""
    return -((number + 1) >> 1) if number & 1 else number >> 1
