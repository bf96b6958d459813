"""LZF: decompression of the format of Marc Lehmann's liblzf, which PCD files use.

    000lllll              l + 1 literal bytes follow
    lllooooo oooooooo     l + 2 bytes from o + 1 bytes back, 0 < l < 7
    111ooooo llllllll oooooooo   l + 9 bytes from o + 1 bytes back

Each line is a control byte and what follows it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import native

MAX_RATIO = 88
"""Bytes that a compressed byte becomes at most: three become 264."""


def decompress(data: bytes, size: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """The bytes (size,) that `data` was made of. Raises ValueError for damaged data and for data of another size."""
    if size > MAX_RATIO * len(data):
        raise ValueError("too few bytes for the size")
    if (kernel := native.kernel("lzf_decompress")) is not None:
        return np.asarray(kernel(np.frombuffer(data, np.uint8), size))
    result = bytearray()
    at = 0
    try:
        while at < len(data):
            control = data[at]
            at += 1
            if control < 32:
                result += data[at : at + control + 1]
                at += control + 1
                continue
            length = (control >> 5) + 2
            if length == 9:
                length += data[at]
                at += 1
            back = ((control & 31) << 8) + data[at] + 1
            at += 1
            start = len(result) - back
            if start < 0:
                raise ValueError("a reference before the start")
            copied = result[start : start + length]
            result += (copied * (length // back + 1))[:length]  # a reference may overlap what it writes
            if len(result) > size:
                raise ValueError("more bytes than the size")
    except IndexError:
        raise ValueError("cut off within a reference") from None
    if at != len(data) or len(result) != size:
        raise ValueError("another number of bytes")
    return np.frombuffer(result, np.uint8)
