"""Damaged copies of bytes: truncated, with flipped bits, with bytes replaced, removed or inserted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def prefixes(data: bytes, every: int = 1) -> Iterator[bytes]:
    """All proper prefixes, or those at multiples of `every` bytes; always the empty and the longest one."""
    for end in sorted({*range(0, len(data), every), len(data) - 1} - {-1}):
        yield data[:end]


def flips(data: bytes, every: int = 1) -> Iterator[tuple[int, bytes]]:
    """(offset, copy with that byte changed): a different bit flipped at each offset, all eight at every third."""
    for at in range(0, len(data), every):
        broken = bytearray(data)
        broken[at] ^= 0xFF if at % 3 == 0 else 1 << at % 8
        yield at, bytes(broken)


def damaged(data: bytes, count: int, seed: int = 0) -> Iterator[bytes]:
    """Randomly damaged copies: bytes replaced, removed or inserted, the end cut off, or all bytes random."""
    random = np.random.default_rng(seed)
    for kind in random.integers(0, 5, count):
        at = int(random.integers(0, len(data) + 1))
        size = int(random.integers(1, 9))
        if kind == 0:
            yield data[:at] + random.bytes(min(size, len(data) - at)) + data[at + size :]
        elif kind == 1:
            yield data[:at] + data[at + size :]
        elif kind == 2:
            yield data[:at] + random.bytes(size) + data[at:]
        elif kind == 3:
            yield data[:at]
        else:
            yield random.bytes(len(data))
