"""Frames within a page: 16-bit numbers in a zlib stream, as base64. web/viewer/src/packed.ts reads them.

    positions            round((p − origin) / step) ─► − frame before, modulo 2^16 ─► low bytes, high bytes ─► zlib
    relative positions   32767 + round((p − decoded p) / step)                     ─► low bytes, high bytes ─► zlib

A gap is 65535 in all three coordinates. Relative positions have their own step, so errors are exact to a small share of
the largest error even where positions are coarser.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..typing import Floats

GAP, MIDDLE = 65535, 32767
FINEST_M = 2e-5
ERROR_LEVELS = 500
"""Relative positions have steps of the largest difference over this number."""

Numbers = NDArray[np.uint16]


def scale(arrays: Sequence[Floats], finest: float = FINEST_M) -> tuple[Floats, float]:
    """Origin (3,) and step, both metres, with which all coordinates of these arrays (…, 3) are 0 to 65534."""
    flat = [a.reshape(-1, 3)[~np.isnan(a.reshape(-1, 3)[:, 0])] for a in arrays]
    present = [a for a in flat if len(a)]
    if not present:
        return np.zeros(3), finest
    origin = np.min([a.min(axis=0) for a in present], axis=0)
    extent = float(max((a - origin).max() for a in present))
    return origin, max(finest, extent / (GAP - 1))


def quantise(positions: Floats, origin: Floats, step: float) -> Numbers:
    """Positions (frames, points, 3) as numbers, metres to 16 bits."""
    gaps = np.isnan(positions[..., 0])
    numbers = np.round((np.where(gaps[..., None], origin, positions) - origin) / step).clip(0, GAP - 1)
    numbers[gaps] = GAP
    return numbers.astype(np.uint16)


def pack_motion(positions: Floats, origin: Floats, step: float) -> dict[str, Any]:
    """Positions (frames, points, 3), metres, as the session's "packed" media."""
    frames = quantise(positions, origin, step).reshape(len(positions), 3 * positions.shape[1])
    differences = np.diff(frames, axis=0, prepend=np.zeros_like(frames[:1]))
    return _media(differences, origin, step, relative=False)


def pack_original(original: Floats, decoded: Floats, origin: Floats, step: float) -> dict[str, Any]:
    """Original positions as differences to the decoded ones, if both have the same gaps; else as they are."""
    gaps = np.isnan(original[..., 0])
    if not np.array_equal(gaps, np.isnan(decoded[..., 0])):
        return pack_motion(original, origin, step)
    difference = np.where(gaps[..., None], 0.0, original - decoded)
    fine = max(float(np.abs(difference).max(initial=0.0)) / ERROR_LEVELS, 1e-12)
    numbers = (MIDDLE + np.round(difference / fine)).astype(np.uint16)
    numbers[gaps] = GAP
    return _media(numbers, origin, fine, relative=True)


def _media(numbers: Numbers, origin: Floats, step: float, relative: bool) -> dict[str, Any]:
    packed = _compressed(_planes(numbers))
    return {"type": "packed", "base64": packed, "step": step, "origin": origin.tolist(), "relative": relative}


def pack_clouds(positions: Sequence[Floats], colours: Sequence[NDArray[np.uint8]] | None) -> dict[str, Any]:
    """Frames of points (n, 3) in metres and their colours (n, 3) as the session's "packed-clouds" media."""
    origin, step = scale(positions, 1e-4)
    numbers = [quantise(p[None], origin, step)[0] for p in positions]
    joined = np.concatenate([n.reshape(-1, 3) for n in numbers]) if numbers else np.zeros((0, 3), np.uint16)
    shades = np.concatenate(colours) if colours is not None and len(colours) else np.full(joined.shape, 128, np.uint8)
    return {
        "type": "packed-clouds",
        "base64": _compressed(_planes(joined) + shades.astype(np.uint8).tobytes()),
        "counts": [len(p) for p in positions],
        "step": step,
        "origin": origin.tolist(),
    }


def _planes(numbers: Numbers) -> bytes:
    """All low bytes, then all high bytes."""
    return (numbers & 255).astype(np.uint8).tobytes() + (numbers >> 8).astype(np.uint8).tobytes()


def _compressed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode("ascii")
