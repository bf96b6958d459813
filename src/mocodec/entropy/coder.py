"""Integers to bytes and back.

First form, behind the interface that stays: zigzag, planes of bytes, DEFLATE.
"""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import Corrupt

Integers = NDArray[np.int64]


def pack(values: NDArray[Any], contexts: NDArray[Any] | None = None) -> bytes:
    """Integers (steps, lanes), within ±2^62, as bytes."""
    v = np.ascontiguousarray(values, np.int64)
    if v.size == 0:
        return b""
    zigzag = ((v << 1) ^ (v >> 63)).astype("<u8")
    return zlib.compress(zigzag.ravel().view(np.uint8).reshape(-1, 8).T.tobytes(), 9)


def unpack(data: bytes, shape: tuple[int, int], contexts: NDArray[Any] | None = None) -> Integers:
    """The integers of `pack`, of this shape. Raises Corrupt."""
    size = int(shape[0]) * int(shape[1])
    if size == 0:
        if data:
            raise Corrupt("coded integers where there should be none")
        return np.zeros(shape, np.int64)
    inflate = zlib.decompressobj()
    try:
        plain = inflate.decompress(data, 8 * size)
    except zlib.error as error:
        raise Corrupt(f"coded integers: {error}") from None
    if len(plain) != 8 * size or not inflate.eof and inflate.decompress(inflate.unconsumed_tail, 1):
        raise Corrupt(f"coded integers: not {size} of them")
    u = np.frombuffer(plain, np.uint8).reshape(8, size).T.copy().view("<u8").ravel()
    return ((u >> np.uint64(1)).astype(np.int64) ^ -(u & np.uint64(1)).astype(np.int64)).reshape(shape)
