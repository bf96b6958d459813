"""A hard bound on the error: corrections of a prediction, so that no point is farther than max_error from where it was.

    original − prediction ─correct─► whole numbers of a lattice ─pack─► bytes, of the cheaper form
    prediction + lattice  ◄──────────────────────────────── unpack

The lattice is cubic with its diagonal twice the bound, so that a lattice point lies within the bound (a 3-D Euclidean
distance) of every error. Most errors are within it already and need nothing. Where one is not, its correction is chosen
to hold for as many frames as it can, since errors of a transform coder are slow:

    runs    a few stretches of a constant correction: where it starts, how long it lasts, what it is
    dense   every error to the nearest lattice point, where most points need a correction

The prediction must come from the real decoder; its floats agree to 1e-12 m between machines, and the bound keeps a
slack of 1e-9 m for that.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..entropy import coder, varint
from ..errors import CannotEncode, Corrupt
from ..motion import Floats

Integers = NDArray[np.int64]

RUNS, DENSE = 0, 1
"""The first byte of a layer that is not empty."""

RUNS_UP_TO, DENSE_FROM = 0.5, 0.1
"""Shares of samples outside the bound between which both forms are tried."""

BLOCK = 128
"""Frames in which runs are looked for together."""

NEIGHBOURS = np.array([(x, y, z) for x in (0, -1, 1) for y in (0, -1, 1) for z in (0, -1, 1)], np.int64)
NEIGHBOURS = NEIGHBOURS[np.argsort(np.abs(NEIGHBOURS).sum(axis=1), kind="stable")]
"""The lattice points that are tried for a run, nearest first."""


def tolerance(max_error: float) -> float:
    """The bound that the encoder works to: less than max_error by 1e-9 m, or by a thousandth of very small bounds."""
    return max_error - min(1e-9, max_error / 1000)


def lattice(max_error: float) -> float:
    """The lattice's spacing in metres: no point of space is farther than `tolerance` from it."""
    return 2 / math.sqrt(3) * tolerance(max_error)


def pack(original: Floats, prediction: Floats, max_error: float) -> bytes:
    """Bytes of the corrections; b"" where none is needed. Positions (frames, points, 3); NaN of the original is a gap.

    max_error: metres, positive. Raises CannotEncode where the bound is too small for the numbers at hand.
    """
    error = np.nan_to_num(original - prediction, nan=0.0)
    outside = np.einsum("fpc,fpc->fp", error, error) > tolerance(max_error) ** 2
    if not outside.any():
        return b""
    largest = max(float(np.abs(prediction).max()), float(np.abs(error).max()))
    if not largest < max_error * 2.0**40:
        raise CannotEncode(f"a bound of {max_error:g} m is too small for positions of {largest:g} m")
    step = lattice(max_error)
    nearest = np.rint(error / step).astype(np.int64)
    forms: list[bytes] = []
    share = outside.mean()
    if share < RUNS_UP_TO:
        forms.append(bytes([RUNS]) + _pack_runs(_held(error / step, nearest, outside)))
    if share > DENSE_FROM:
        forms.append(bytes([DENSE]) + coder.pack(nearest.reshape(len(nearest), -1)))
    return min(forms, key=len)


def unpack(data: bytes, prediction: Floats, max_error: float) -> Floats:
    """The corrected positions, (frames, points, 3). Raises Corrupt."""
    if not data:
        return prediction
    frames, points, _ = prediction.shape
    if data[0] == DENSE:
        corrections = coder.unpack(data[1:], (frames, 3 * points)).reshape(prediction.shape)
    elif data[0] == RUNS:
        corrections = _unpack_runs(data[1:], frames, points)
    else:
        raise Corrupt(f"a residual layer of unknown form {data[0]}")
    return prediction + corrections * lattice(max_error)


def _held(error: Floats, nearest: Integers, outside: NDArray[np.bool_]) -> Integers:
    """A correction for every frame of every point, (frames, points, 3) in lattice units, changed as seldom as can be.

    error: in lattice units, where the bound is √3/2. Each correction is kept until it no longer holds, and followed by
    the one of the neighbours of zero that then holds longest. All blocks of frames of all points go side by side.
    """
    frames, points, _ = error.shape
    blocks = -(-frames // BLOCK)
    pad = ((0, blocks * BLOCK - frames), (0, 0), (0, 0))
    shape = (blocks, BLOCK, points, 3)
    e = np.pad(error, pad).reshape(shape).transpose(1, 0, 2, 3).reshape(BLOCK, -1, 3)
    n = np.pad(nearest, pad).reshape(shape).transpose(1, 0, 2, 3).reshape(BLOCK, -1, 3)
    lanes = np.pad(outside, pad[:2]).reshape(shape[:3]).any(axis=1).ravel()
    corrections = np.zeros((BLOCK, blocks * points, 3), np.int64)
    corrections[:, lanes] = _held_in_block(e[:, lanes], n[:, lanes])
    return corrections.reshape(BLOCK, blocks, points, 3).transpose(1, 0, 2, 3).reshape(-1, points, 3)[:frames]


def _held_in_block(error: Floats, nearest: Integers) -> Integers:
    """Corrections (frames, lanes, 3) from none before the first frame."""
    bound = 0.75
    frames, lanes, _ = error.shape
    squares = (error**2).sum(axis=2)
    offers = (NEIGHBOURS**2).sum(axis=1) - 2 * (error @ NEIGHBOURS.T.astype(np.float64))
    holds = offers <= (bound - squares)[:, :, None]
    lasts = np.zeros((lanes, len(NEIGHBOURS)), np.int16)
    best = np.zeros((frames, lanes), np.int64)
    for frame in reversed(range(frames)):
        lasts += 1
        lasts *= holds[frame]
        best[frame] = lasts.argmax(axis=1)
    fresh = np.where(holds.any(axis=2)[:, :, None], NEIGHBOURS[best], nearest)
    corrections = np.empty_like(nearest)
    current = np.zeros((lanes, 3), np.int64)
    for frame in range(frames):
        still = ((error[frame] - current) ** 2).sum(axis=1) <= bound
        current = np.where(still[:, None], current, fresh[frame])
        corrections[frame] = current
    return corrections


def _pack_runs(corrections: Integers) -> bytes:
    """Stretches of an equal correction, zero left out, point after point.

    A bit for each says whether it follows the last at once; then the frames between the others, lengths, corrections.
    """
    frames, points, _ = corrections.shape
    track = corrections.transpose(1, 0, 2)
    changes = np.ones((points, frames), bool)
    changes[:, 1:] = (track[:, 1:] != track[:, :-1]).any(axis=2)
    starts = np.flatnonzero(changes)
    values = track.reshape(-1, 3)[starts]
    lengths = np.diff(starts, append=points * frames)
    some = values.any(axis=1)
    starts, values, lengths = starts[some], values[some], lengths[some]
    waits = starts - np.append(0, starts + lengths)[:-1]
    apart = waits > 0
    parts = [coder.pack(waits[apart][:, None] - 1), coder.pack(lengths[:, None] - 1)]
    sizes = varint.write([len(starts), *map(len, parts)])
    return sizes + np.packbits(apart).tobytes() + b"".join(parts) + coder.pack(values)


def _unpack_runs(data: bytes, frames: int, points: int) -> Integers:
    (count, *sizes), at = varint.read(data, 3)
    if count > frames * points or at + -(-count // 8) + sum(sizes) > len(data):
        raise Corrupt("a residual layer of more corrections than there are samples")
    ends = np.cumsum([at, -(-count // 8), *sizes]).tolist()
    bits, waits_part, lengths_part = (data[a:b] for a, b in pairwise(ends))
    apart = np.unpackbits(np.frombuffer(bits, np.uint8))[:count].astype(bool)
    waits = np.zeros(count, np.int64)
    waits[apart] = coder.unpack(waits_part, (int(apart.sum()), 1))[:, 0] + 1
    lengths = coder.unpack(lengths_part, (count, 1))[:, 0] + 1
    values = coder.unpack(data[ends[-1] :], (count, 3))
    if count and (waits.min() < 0 or lengths.min() < 1 or max(waits.max(), lengths.max()) > frames * points):
        raise Corrupt("a residual layer with a correction outside the frames")
    stops = np.cumsum(waits + lengths)
    if count and stops[-1] > frames * points:
        raise Corrupt("a residual layer with a correction outside the frames")
    track = np.zeros((points * frames, 3), np.int64)
    inside = np.repeat(stops - np.cumsum(lengths), lengths) + np.arange(lengths.sum())
    track[inside] = np.repeat(values, lengths, axis=0)
    return track.reshape(points, frames, 3).transpose(1, 0, 2)
