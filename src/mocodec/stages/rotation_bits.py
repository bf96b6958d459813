"""Rotations to the last bit: differences in time of float64 bit patterns, bytes of equal weight together, deflate.

rotations (frames, joints, 4) ─pack─► bytes ─unpack─► the same rotations
"""

from __future__ import annotations

import zlib

import numpy as np

from ..errors import Corrupt
from ..typing import Floats


def pack(rotations: Floats) -> bytes:
    """Rotations (frames, joints, 4): each number is combined by exclusive or with that of the frame before."""
    bits = np.ascontiguousarray(rotations, "<f8").view("<u8").reshape(len(rotations), -1)
    changed = bits.copy()
    changed[1:] ^= bits[:-1]
    planes = changed.T.copy().view(np.uint8).reshape(-1, 8).T
    return zlib.compress(planes.tobytes(), 9)


def unpack(data: bytes, frames: int, joints: int) -> Floats:
    """The inverse of `pack`. Raises Corrupt."""
    size = frames * joints * 4 * 8
    unpacker = zlib.decompressobj()
    try:
        planes = unpacker.decompress(data, size)
    except zlib.error as problem:
        raise Corrupt(f"the rotations cannot be unpacked: {problem}") from None
    if len(planes) != size or unpacker.unconsumed_tail or unpacker.unused_data or not unpacker.eof:
        raise Corrupt("the rotations do not unpack to their size")
    changed = np.frombuffer(planes, np.uint8).reshape(8, -1).T.copy().view("<u8").reshape(joints * 4, frames).T
    bits = np.bitwise_xor.accumulate(changed, axis=0)
    return np.ascontiguousarray(bits).view("<f8").reshape(frames, joints, 4).astype(np.float64)
