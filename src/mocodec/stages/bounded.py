"""A hard bound on the error: corrections of a decoded motion, so that no point is farther off than max_error.

    original − prediction ─► lattice points ─pack─► bytes, in the shortest of three forms
    prediction + lattice points ◄──────────unpack── bytes

The bound is a 3-D Euclidean distance. Where the prediction is about as good as the bound, most errors are within it and
need no correction. The others are lattice points, within the bound of the error. The errors of a transform coder change
slowly, so a correction is chosen to stay valid for as many frames as possible:

    runs     runs of frames with one constant correction: first frame, length, point of a cubic lattice
    dense    the nearest point of the cubic lattice for every sample, where most of them need a correction
    engine   the errors as a motion of their own, coded by the lattice engine (`lattice`): predicted in time and from
             neighbours, on a body-centred cubic lattice; for predictions that are much coarser than the bound

The prediction must be what the decoder makes: its floats agree to 1e-12 m between machines, and the bound leaves 1e-9 m
for that.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from .. import native
from ..entropy import coder, varint
from ..errors import CannotEncode, Corrupt
from ..typing import Booleans, Floats, Integers
from . import frozen, lattice

RUNS, DENSE, ENGINE = 0, 1, 2
"""The forms: the first byte of corrections that are not empty. Never change them."""

RUNS_UP_TO, DENSE_FROM, ENGINE_FROM = 0.5, 0.1, 0.3
"""Runs are tried up to this share of samples outside the bound, the dense form and the engine from theirs on."""

ENGINE_STRIDES = (2, 0)
"""log₂ of the distances between the first frames of the lattice engine: smooth errors, and noise."""

BLOCK = 128
"""Runs are found in blocks of this many frames, which are independent of each other."""

NEIGHBOURS = np.array([(x, y, z) for x in (0, -1, 1) for y in (0, -1, 1) for z in (0, -1, 1)], np.int64)
NEIGHBOURS = NEIGHBOURS[np.argsort(np.abs(NEIGHBOURS).sum(axis=1), kind="stable")]
"""The lattice points that a run may have, nearest to zero first."""


def tolerance(max_error: float) -> float:
    """The bound of the encoder, metres: less than max_error by 1e-9 m, or by a thousandth of it if that is less."""
    return max_error - min(1e-9, max_error / 1000)


def cubic_step(max_error: float) -> float:
    """The cubic lattice's spacing, metres: no point of space is farther than `tolerance` from a lattice point."""
    return 2 / math.sqrt(3) * tolerance(max_error)


def pack(original: Floats, prediction: Floats, max_error: float, known: lattice.Neighbours | None = None) -> bytes:
    """The bytes of the corrections; b"" where none is needed.

    original, prediction: positions (frames, points, 3), metres; NaN in the original is a gap. max_error: metres,
    positive. known: neighbours of the points for the lattice engine; None to leave it out. Raises CannotEncode for a
    bound of less than 2^−40 of the largest position.
    """
    missing = np.isnan(original[..., 0])
    error = np.where(missing[..., None], 0.0, original - prediction)
    outside = np.einsum("fpc,fpc->fp", error, error) > tolerance(max_error) ** 2
    if not outside.any():
        return b""
    largest = max(float(np.abs(prediction).max()), float(np.abs(error).max()))
    if not largest < max_error * 2.0**40:
        raise CannotEncode(f"a bound of {max_error:g} m is too small for positions of {largest:g} m")
    step = cubic_step(max_error)
    nearest = np.rint(error / step).astype(np.int64)
    forms: list[bytes] = []
    share = outside.mean()
    if share < RUNS_UP_TO:
        forms.append(bytes([RUNS]) + _pack_runs(_lasting_corrections(error / step, nearest, outside)))
    if share > DENSE_FROM:
        forms.append(bytes([DENSE]) + coder.pack(nearest.reshape(len(nearest), -1)))
    if share > ENGINE_FROM and known is not None:
        forms += [bytes([ENGINE]) + found for found in _pack_by_engine(error, missing, max_error, known)]
    return min(forms, key=len)


def unpack(data: bytes, prediction: Floats, max_error: float, packed_gaps: bytes = b"") -> Floats:
    """The corrected positions, (frames, points, 3). packed_gaps: bytes of `frozen.Split.pack`. Raises Corrupt."""
    if not data:
        return prediction
    frames, points, _ = prediction.shape
    if data[0] == ENGINE:
        return prediction + _unpack_by_engine(data[1:], frozen.apart(packed_gaps, (frames, points)), max_error)
    if data[0] == DENSE:
        corrections = coder.unpack(data[1:], (frames, 3 * points)).reshape(prediction.shape)
    elif data[0] == RUNS:
        corrections = _unpack_runs(data[1:], frames, points)
    else:
        raise Corrupt(f"corrections of an unknown form {data[0]}")
    return prediction + corrections * cubic_step(max_error)


def _pack_by_engine(error: Floats, missing: Booleans, max_error: float, known: lattice.Neighbours) -> list[bytes]:
    """Errors (frames, points, 3), metres, by the lattice engine in each stride that keeps the bound after rounding."""
    half_step = lattice.half_step(tolerance(max_error))
    neighbours = known.pack()
    head = varint.write([len(neighbours)]) + neighbours
    packed: list[bytes] = []
    for stride in ENGINE_STRIDES:
        found = lattice.encode(error / half_step, missing, known, stride)
        if found is not None:
            left = np.where(missing[..., None], 0.0, error - found[1] * half_step)
            if np.einsum("fpc,fpc->fp", left, left).max() <= tolerance(max_error) ** 2:
                packed.append(head + found[0])
    return packed


def _unpack_by_engine(data: bytes, apart: Booleans, max_error: float) -> Floats:
    """The errors (frames, points, 3), metres. apart (frames, points): missing or frozen. Raises Corrupt."""
    (size,), at = varint.read(data, 1)
    known = lattice.Neighbours.unpack(data[at : at + size], apart.shape[1])
    return lattice.decode(data[at + size :], apart, known) * lattice.half_step(tolerance(max_error))


def _lasting_corrections(error: Floats, nearest: Integers, outside: Booleans) -> Integers:
    """A correction for every sample, (frames, points, 3) in lattice units, that changes as seldom as possible.

    error: in lattice units, in which the bound is √3/2. nearest: lattice points. outside (frames, points): whether the
    error is beyond the bound. A correction stays until it is no longer valid; then comes the lattice point of
    `NEIGHBOURS` that is valid for the most frames from there on. All blocks of all points are computed side by side.
    """
    if (kernel := native.kernel("lasting_corrections")) is not None:
        return kernel(error, nearest, outside.astype(np.uint8), NEIGHBOURS, BLOCK)
    frames, points, _ = error.shape
    blocks = -(-frames // BLOCK)
    pad = ((0, blocks * BLOCK - frames), (0, 0), (0, 0))
    shape = (blocks, BLOCK, points, 3)
    e = np.pad(error, pad).reshape(shape).transpose(1, 0, 2, 3).reshape(BLOCK, -1, 3)
    n = np.pad(nearest, pad).reshape(shape).transpose(1, 0, 2, 3).reshape(BLOCK, -1, 3)
    lanes = np.pad(outside, pad[:2]).reshape(shape[:3]).any(axis=1).ravel()
    corrections = np.zeros((BLOCK, blocks * points, 3), np.int64)
    corrections[:, lanes] = _longest_lasting(e[:, lanes], n[:, lanes])
    return corrections.reshape(BLOCK, blocks, points, 3).transpose(1, 0, 2, 3).reshape(-1, points, 3)[:frames]


def _longest_lasting(error: Floats, nearest: Integers) -> Integers:
    """Corrections (frames, lanes, 3) of one block; before its first frame the correction is zero."""
    squared_bound = 0.75
    frames, lanes, _ = error.shape
    squares = (error**2).sum(axis=2)
    distances = (NEIGHBOURS**2).sum(axis=1) - 2 * (error @ NEIGHBOURS.T.astype(np.float64))
    valid = distances <= (squared_bound - squares)[:, :, None]
    lasts = np.zeros((lanes, len(NEIGHBOURS)), np.int16)
    best = np.zeros((frames, lanes), np.int64)
    for frame in reversed(range(frames)):
        lasts += 1
        lasts *= valid[frame]
        best[frame] = lasts.argmax(axis=1)
    fresh = np.where(valid.any(axis=2)[:, :, None], NEIGHBOURS[best], nearest)
    corrections = np.empty_like(nearest)
    current = np.zeros((lanes, 3), np.int64)
    for frame in range(frames):
        stays = ((error[frame] - current) ** 2).sum(axis=1) <= squared_bound
        current = np.where(stays[:, None], current, fresh[frame])
        corrections[frame] = current
    return corrections


def _pack_runs(corrections: Integers) -> bytes:
    """The runs of equal corrections that are not zero, point after point.

    One bit a run says whether there are frames between it and the run before; then follow the numbers of those frames,
    the lengths of the runs, and their corrections.
    """
    frames, points, _ = corrections.shape
    track = corrections.transpose(1, 0, 2)
    changes = np.ones((points, frames), bool)
    changes[:, 1:] = (track[:, 1:] != track[:, :-1]).any(axis=2)
    starts = np.flatnonzero(changes)
    values = track.reshape(-1, 3)[starts]
    lengths = np.diff(starts, append=points * frames)
    nonzero = values.any(axis=1)
    starts, values, lengths = starts[nonzero], values[nonzero], lengths[nonzero]
    pauses = starts - np.append(0, starts + lengths)[:-1]
    apart = pauses > 0
    parts = [coder.pack(pauses[apart][:, None] - 1), coder.pack(lengths[:, None] - 1)]
    sizes = varint.write([len(starts), *map(len, parts)])
    return sizes + np.packbits(apart).tobytes() + b"".join(parts) + coder.pack(values)


def _unpack_runs(data: bytes, frames: int, points: int) -> Integers:
    (count, *sizes), at = varint.read(data, 3)
    if count > frames * points or at + -(-count // 8) + sum(sizes) > len(data):
        raise Corrupt("more runs of corrections than samples")
    ends = np.cumsum([at, -(-count // 8), *sizes]).tolist()
    bits, pauses_part, lengths_part = (data[a:b] for a, b in pairwise(ends))
    flags = np.unpackbits(np.frombuffer(bits, np.uint8))
    if flags[count:].any():
        raise Corrupt("runs of corrections with bits behind their end")
    apart = flags[:count].astype(bool)
    pauses = np.zeros(count, np.int64)
    pauses[apart] = coder.unpack(pauses_part, (int(apart.sum()), 1))[:, 0] + 1
    lengths = coder.unpack(lengths_part, (count, 1))[:, 0] + 1
    values = coder.unpack(data[ends[-1] :], (count, 3))
    if count and (pauses.min() < 0 or lengths.min() < 1 or max(pauses.max(), lengths.max()) > frames * points):
        raise Corrupt("a correction outside the frames")
    stops = np.cumsum(pauses + lengths)
    if count and stops[-1] > frames * points:
        raise Corrupt("a correction outside the frames")
    track = np.zeros((points * frames, 3), np.int64)
    inside = np.repeat(stops - np.cumsum(lengths), lengths) + np.arange(lengths.sum())
    track[inside] = np.repeat(values, lengths, axis=0)
    return track.reshape(points, frames, 3).transpose(1, 0, 2)
