"""What keeps the promise: samples that the transform leaves too far off are moved back, a few numbers each.

positions, decoded, bound ─find─► corrections ─pack─► bytes ─unpack─► corrections ─apply─► within the bound
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import CannotEncode, Corrupt
from ...motion import Floats
from .direct import LARGEST, cell

Integers = NDArray[np.int64]


class Corrections(NamedTuple):
    """which (n,): point · frames + frame, rising; by (n, 3): whole steps to add."""

    which: Integers
    by: Integers


def find(error: Floats, bound: Floats, step: float) -> Corrections:
    """Corrections for errors (frames, points, 3) beyond the bound (points,), in steps that bring any error within it."""
    which = np.flatnonzero(np.sqrt((error**2).sum(axis=2)).T > bound[:, None])
    scaled = error.swapaxes(0, 1).reshape(-1, 3)[which] / step
    if not (np.abs(scaled) < LARGEST).all():
        raise CannotEncode("the motion is too large for so small an error")
    return Corrections(which, np.rint(scaled).astype(np.int64))


def apply(positions: Floats, corrections: Corrections, step: float) -> None:
    """Add the corrections to positions (frames, points, 3), in place."""
    frames = len(positions)
    positions[corrections.which % frames, corrections.which // frames] += corrections.by * step


def pack(corrections: Corrections) -> bytes:
    """Bytes; b"" where there are none."""
    if not len(corrections.which):
        return b""
    gaps = np.diff(corrections.which, prepend=-1) - 1
    return varint.write([len(gaps)]) + coder.pack(np.concatenate([gaps[:, None], corrections.by], axis=1))


def unpack(data: bytes, frames: int, points: int) -> Corrections:
    """The corrections of `pack`. Raises Corrupt."""
    if not data:
        return Corrections(np.zeros(0, np.int64), np.zeros((0, 3), np.int64))
    (count,), at = varint.read(data, 1)
    if not 0 < count <= frames * points:
        raise Corrupt("tempo: more corrections than there are samples")
    numbers = coder.unpack(data[at:], (count, 4))
    if (numbers[:, 0] < 0).any() or (numbers[:, 0] > frames * points).any():
        raise Corrupt("tempo: a correction beyond the last sample")
    which = np.cumsum(numbers[:, 0] + 1) - 1
    if which[-1] >= frames * points:
        raise Corrupt("tempo: a correction beyond the last sample")
    return Corrections(which, numbers[:, 1:])


__all__ = ["Corrections", "apply", "cell", "find", "pack", "unpack"]
