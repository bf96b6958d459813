"""Damaged copies of bytes: bits, bytes, numbers, blocks, and the numbers and words of text."""

from __future__ import annotations

import re

import numpy as np

LIMITS = (0, 1, 2, 127, 128, 255, 256, 32767, 32768, 65535, 65536, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, (1 << 63) - 1)
WORDS = (
    b"nan",
    b"inf",
    b"-inf",
    b"1e999",
    b"-1",
    b"0",
    b"1e-320",
    b"99999999999999999999",
    b"",
    b"\t",
    b"\n\n",
    b"1,5",
)
NUMBER = re.compile(rb"-?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")


def mutate(data: bytes, random: np.random.Generator, other: bytes = b"") -> bytes:
    """The bytes with one to six changes. other: bytes of another file of the kind, to splice in."""
    for _ in range(int(random.integers(1, 7))):
        text = data[:2000].isascii() and random.random() < 0.6
        data = _change_text(data, random) if text else _change(data, random, other)
    return data


def same_length(data: bytes, random: np.random.Generator) -> bytes:
    """The bytes with one to four bytes or numbers replaced in place."""
    out = bytearray(data)
    for _ in range(int(random.integers(1, 5)) if out else 0):
        at = int(random.integers(len(out)))
        if random.random() < 0.5:
            out[at] = int(random.integers(256))
        else:
            number = _limit(random)[: len(out) - at]
            out[at : at + len(number)] = number
    return bytes(out)


def _limit(random: np.random.Generator) -> bytes:
    """A number at the limit of some type, in 1 to 8 bytes of either order."""
    width = int(random.choice([1, 2, 4, 8]))
    number = LIMITS[random.integers(len(LIMITS))] & ((1 << 8 * width) - 1)
    return number.to_bytes(width, "little" if random.random() < 0.7 else "big")


def _change(data: bytes, random: np.random.Generator, other: bytes) -> bytes:
    at, size = int(random.integers(len(data) + 1)), int(2 ** random.integers(0, 10))
    match int(random.integers(8)):
        case 0 | 1:
            return same_length(data, random)
        case 2:
            return data[:at] + data[at + size :]
        case 3:
            return data[:at] + random.bytes(min(size, 64)) + data[at:]
        case 4:
            return data[:at] + data[at : at + size] * int(random.integers(2, 6)) + data[at + size :]
        case 5:
            return data[:at]
        case 6 if other:
            start = int(random.integers(len(other)))
            return data[:at] + other[start : start + size] + data[at + size :]
        case _:
            return (
                data[:at] + bytes([data[at] ^ 1 << int(random.integers(8))]) + data[at + 1 :]
                if at < len(data)
                else data
            )


def _change_text(data: bytes, random: np.random.Generator) -> bytes:
    """Another number or word, or a line removed, repeated or moved."""
    if random.random() < 0.5:
        found = list(NUMBER.finditer(data[:200_000]))
        if found:
            one = found[random.integers(len(found))]
            word = (
                WORDS[random.integers(len(WORDS))]
                if random.random() < 0.6
                else str(LIMITS[random.integers(15)]).encode()
            )
            return data[: one.start()] + word + data[one.end() :]
    lines = data.split(b"\n")
    a, b = (int(n) for n in random.integers(len(lines), size=2))
    match int(random.integers(4)):
        case 0:
            del lines[a]
        case 1:
            lines.insert(b, lines[a])
        case 2:
            lines[a], lines[b] = lines[b], lines[a]
        case _:
            words = lines[a].split()
            lines[a] = b" ".join(words[: int(random.integers(len(words) + 1))])
    return b"\n".join(lines)
