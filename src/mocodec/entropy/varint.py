"""A few whole numbers as bytes, seven bits each: for headers, where every byte counts and nothing is worth modelling.

numbers ─write─► bytes ─read─► numbers and where they end
"""

from __future__ import annotations

from collections.abc import Iterable

from ..errors import Corrupt

LONGEST = 10
"""No number takes more bytes than this (63 bits)."""


def write(numbers: Iterable[int]) -> bytes:
    """Whole numbers from 0 to 2^63 − 1, low bits first; the top bit of a byte says that more follow."""
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
    numbers: list[int] = []
    for _ in range(count):
        number = shift = 0
        while True:
            if at >= len(data) or shift > 7 * (LONGEST - 1):
                raise Corrupt("a number in a header runs past its end")
            byte = data[at]
            at += 1
            number |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                break
        if number >> 63:
            raise Corrupt("a number in a header is beyond 63 bits")
        numbers.append(number)
    return numbers, at


def signed(number: int) -> int:
    """A whole number of either sign as one that is not negative: 0, −1, 1, −2 → 0, 1, 2, 3."""
    return number << 1 if number >= 0 else (-number << 1) - 1


def unsigned(number: int) -> int:
    """The number that `signed` folded."""
    return -((number + 1) >> 1) if number & 1 else number >> 1
