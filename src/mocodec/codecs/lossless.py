"""Lossless coding: every float32 bit of the positions, in the units of the source file, and every bit of rotations.

    positions ─► units of the source ─► multiples of a step? ── yes ─► integers k, x = k / steps ──────┐
                 as float32                     └─ no ──► bit patterns as integers in numeric order ───├─► residual
                                one linear predictor for the recording, in fixed-point arithmetic ─────┘

    rotations ─► differences in time of their bits ─► bytes of equal weight together ─► deflate

The residual is entropy coded. Recordings are smooth far below a millimetre. One linear predictor, fitted to all points
for the least absolute error (which determines the bits), leaves only the noise of the cameras. Text formats and integer
C3D files hold multiples of a step; those are coded as integers, which need fewer bits. A gap costs only the bits that
mark it.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .. import progress
from ..encoded import Chunk, Encoded, about, batches, most_chunk_frames, restore
from ..entropy import coder
from ..errors import BadInput, Corrupt
from ..motion import Motion
from ..stages import frozen, gaps, rotation_bits, segment
from ..typing import Booleans, Floats, Integers
from . import base

ORDER = 8  # previous values that the predictor uses
TAP_BITS = 14  # fraction bits of a tap
FIXED_POINT_BITS = 40  # bits of a value in the predictor's fixed point; × taps of up to 2^18 stays within int64
GRID_LARGEST = 1 << 36  # largest multiple of a step
STEPS_PER_UNIT = tuple(10.0**digits for digits in range(8))  # text with up to seven decimals
FIT_SAMPLES = 100_000  # about as many samples are used to fit the predictor
FIT_ITERATIONS = 8
RANK_LIMIT = 1 << 37  # every rank is within ±RANK_LIMIT
HEADER = struct.Struct("<Bdd" + "i" * (ORDER - 1) + "bI")
ON_GRID, FLOAT32, FLOAT64 = 1, 0, 2  # forms on disk: never change one
WORDS = 4  # 16-bit words of a float64
WITH_ROTATIONS = b"\x01"  # the second shared part, if chunks begin with rotations


@dataclass(frozen=True)
class Lossless:
    """Settings of lossless: positions as float32 in the unit of their file, bit for bit.

    chunk_seconds: duration of a chunk; each chunk decodes without the others.

    float64: store every bit of float64 positions in metres; always so beyond the range of float32.
    """

    name: ClassVar[str] = "lossless"
    chunk_seconds: float = 4.0
    float64: bool = False

    def encode(self, motion: Motion) -> Encoded[Motion]:
        """Raises CannotEncode for no samples, BadInput for invalid settings."""
        if not base.has_samples(motion):
            return base.encode_gaps(self, motion, base.settings(self))
        if not self.chunk_seconds > 0:
            raise BadInput(f"lossless: chunk_seconds must be positive, not {self.chunk_seconds}")
        apart = frozen.split(motion.positions, tolerance=0.0, bones=motion.skeleton is not None)
        filled, mask = gaps.fill(apart.moving)
        if self.float64 or not fits_float32(filled):
            form, unit, steps, values = FLOAT64, 1.0, 1.0, filled
            ranks, scale, taps = float64_to_rank(filled.reshape(len(filled), -1)), 0, np.zeros(ORDER - 1, np.int64)
        else:
            form, unit, steps, values = to_numbers(filled, ~mask, float(motion.source.get("unit_m", 1.0)))
            channels = values.reshape(len(values), -1)
            ranks = channels if form == ON_GRID else float_to_rank(channels)
            scale = fixed_point_scale(form, values)
            taps = fit_predictor(channels.astype(np.float64))
        longest = most_chunk_frames(motion.points)
        chunk_frames = max(1, round(min(self.chunk_seconds * motion.rate, longest)))
        has_rotations = self.lost_rotations(motion) is None and motion.rotations is not None
        chunks = []
        for run in progress.over(segment.equal_length(len(motion), chunk_frames)):
            if form == FLOAT64:
                residual = to_words(ranks[run])
            else:
                residual = ranks[run] - predict_chunk(ranks[run], form, taps, scale)
            packed_gaps = apart[run].pack()
            payload = struct.pack("<I", len(packed_gaps)) + packed_gaps + coder.pack(residual)
            if has_rotations and motion.rotations is not None:
                packed = rotation_bits.pack(motion.rotations[run])
                payload = struct.pack("<I", len(packed)) + packed + payload
            chunks.append(Chunk(run.start, run.stop - run.start, payload))
        shared = HEADER.pack(form, unit, steps, *taps.tolist(), scale, chunk_frames)
        parts = (shared, WITH_ROTATIONS) if has_rotations else (shared,)
        return Encoded(self.name, about(motion, has_rotations), tuple(chunks), parts, settings=base.settings(self))

    @staticmethod
    def lost_rotations(motion: Motion) -> str | None:
        """Why the rotations of a motion are not kept, in words; None where they are."""
        return "it has no skeleton" if motion.skeleton is None else None

    @staticmethod
    def decode(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
        """The motion, or a slice of its frames. Raises Corrupt."""
        if not encoded.shared:
            return base.decode_gaps(encoded, frames)
        start, stop = encoded.range(frames)
        points = encoded.about.points
        has_rotations = encoded.shared[1:] == (WITH_ROTATIONS,)
        if len(encoded.shared) != 1 + has_rotations or len(encoded.shared[0]) != HEADER.size:
            raise Corrupt(f"lossless: the shared bytes must be one header of {HEADER.size} bytes")
        form, unit, steps, *taps, scale, _ = HEADER.unpack(encoded.shared[0])
        if form not in (ON_GRID, FLOAT32, FLOAT64):
            raise Corrupt(f"lossless: the header has the unknown form {form}")
        if not -1100 < scale < 1100:
            raise Corrupt(f"lossless: the header has the scale {scale}, outside ±1100")
        chunks = list(encoded.covering(start, stop))
        inside = slice(*within(chunks, start, stop))
        rotations = None
        if has_rotations:
            parts = [split_rotations(chunk, points) for chunk in chunks]
            chunks = [chunk for chunk, _ in parts]
            rotations = np.concatenate([*(q for _, q in parts), np.zeros((0, points, 4))])[inside]
        if form == FLOAT64:
            return restore(encoded, decode_float64(chunks, points)[inside], start, rotations)
        decoded_chunks = (
            decoded
            for batch in batches(chunks, points, len(chunks))
            for decoded in decode_ranks(list(batch), points, form, np.array(taps, np.int64), scale)
        )
        positions = np.empty((sum(c.frames for c in chunks), points, 3))
        at = 0
        for chunk, (ranks, packed_gaps) in zip(chunks, decoded_chunks, strict=True):
            with np.errstate(all="ignore"):
                values = ranks / steps if form == ON_GRID else rank_to_float(ranks).astype(np.float64)
                decoded = (values * unit).reshape(chunk.frames, points, 3)
            positions[at : at + chunk.frames] = frozen.restore(decoded, packed_gaps)
            at += chunk.frames
        return restore(encoded, positions[inside], start, rotations)


def within(chunks: list[Chunk], start: int, stop: int) -> tuple[int, int]:
    """Frames [start, stop) of the recording, counted from the first of these chunks."""
    first = chunks[0].start if chunks else 0
    return start - first, stop - first


def split_rotations(chunk: Chunk, joints: int) -> tuple[Chunk, Floats]:
    """A chunk without its rotations, and the rotations (frames, joints, 4). Raises Corrupt."""
    size = int.from_bytes(chunk.payload[:4], "little")
    if len(chunk.payload) < 4 + size:
        raise Corrupt(f"lossless: the chunk at frame {chunk.start} ends within its rotations")
    rotations = rotation_bits.unpack(chunk.payload[4 : 4 + size], chunk.frames, joints)
    return Chunk(chunk.start, chunk.frames, chunk.payload[4 + size :]), rotations


# --- float64: differences of bit patterns, in words


def float64_to_rank(values: Floats) -> Integers:
    """float64 → its bit pattern as an integer that grows with the value; −0 is one below +0."""
    bits = np.ascontiguousarray(values).view(np.int64)
    return np.where(bits < 0, bits ^ np.int64(0x7FFFFFFFFFFFFFFF), bits)


def to_words(ranks: Integers) -> Integers:
    """Differences along time of ranks (frames, channels) modulo 2^64, folded, as 16-bit words (frames, 4 · channels).

    The words of a channel stand one after the other, the highest first.
    """
    unsigned = ranks.view(np.uint64)
    change = np.concatenate([unsigned[:1], unsigned[1:] - unsigned[:-1]]).view(np.int64)
    folded = ((change << 1) ^ (change >> 63)).view(np.uint64)
    shifts = np.arange(48, -1, -16, dtype=np.uint64)
    words = (folded[..., None] >> shifts) & np.uint64(0xFFFF)
    return words.astype(np.int64).reshape(len(ranks), -1)


def from_words(words: Integers) -> Integers:
    """The inverse of `to_words`. Raises Corrupt."""
    if words.size and not 0 <= words.min() <= words.max() <= 0xFFFF:
        raise Corrupt("lossless: a word outside 16 bits")
    parts = words.reshape(len(words), -1, WORDS).astype(np.uint64)
    folded = (parts << np.arange(48, -1, -16, dtype=np.uint64)).sum(axis=2, dtype=np.uint64)
    change = (folded >> np.uint64(1)) ^ (np.uint64(0) - (folded & np.uint64(1)))
    return np.cumsum(change, axis=0, dtype=np.uint64).view(np.int64)


def decode_float64(chunks: list[Chunk], points: int) -> Floats:
    """Positions (frames, points, 3) of chunks in the form FLOAT64. Raises Corrupt."""
    parts = [np.zeros((0, points, 3))]
    for chunk in progress.over(chunks):
        words, packed_gaps = _unpack_payload(chunk, points, WORDS)
        ranks = from_words(words)
        bits = np.where(ranks < 0, ranks ^ np.int64(0x7FFFFFFFFFFFFFFF), ranks)
        positions = bits.view(np.float64).reshape(chunk.frames, points, 3)
        if not np.isfinite(positions).all():
            raise Corrupt(f"lossless: the chunk at frame {chunk.start} has positions that are not finite")
        parts.append(frozen.restore(positions, packed_gaps))
    return np.concatenate(parts)


# --- positions ⇄ numbers ⇄ ranks


def to_numbers(positions: Floats, present: Booleans, unit: float) -> tuple[int, float, float, NDArray[Any]]:
    """Form, unit in metres, steps per unit, and values (frames, points, 3) with value / steps × unit = position.

    positions (frames, points, 3) with gaps filled; present (frames, points): False in gaps. The equation holds exactly
    for present positions: in the units of the source for float64 if possible, else in metres for float32.
    """
    samples = positions[present]
    few = samples[:: max(1, len(samples) // 500)]  # rejects most candidates quickly
    with np.errstate(all="ignore"):
        for chosen in (unit, 1.0):
            for steps in STEPS_PER_UNIT:
                if all(np.array_equal((np.rint(x / chosen * steps) / steps) * chosen, x) for x in (few, samples)):
                    k = np.rint(positions / chosen * steps)
                    if np.abs(k).max() < GRID_LARGEST:
                        return ON_GRID, chosen, steps, k.astype(np.int64)
            if all(
                np.array_equal((x / chosen).astype(np.float32).astype(np.float64) * chosen, x) for x in (few, samples)
            ):
                return FLOAT32, chosen, 1.0, (positions / chosen).astype(np.float32)
        return FLOAT32, 1.0, 1.0, positions.astype(np.float32)


def fits_float32(positions: Floats) -> bool:
    """Whether no position is beyond the range of float32."""
    with np.errstate(over="ignore"):
        return bool(np.isfinite(positions.astype(np.float32)).all())


def float_to_rank(values: NDArray[np.float32]) -> Integers:
    """float32 → its bit pattern as an integer that grows with the value; −0 is one below +0."""
    bits = np.ascontiguousarray(values, np.float32).view(np.int32).astype(np.int64)
    return np.where(bits < 0, bits ^ 0x7FFFFFFF, bits)


def rank_to_float(ranks: Integers) -> NDArray[np.float32]:
    """The inverse of `float_to_rank`."""
    bits = np.where(ranks < 0, ranks ^ 0x7FFFFFFF, ranks)
    return (bits & 0xFFFFFFFF).astype(np.uint32).view(np.float32)


# --- prediction in fixed point


def fixed_point_scale(form: int, values: NDArray[Any]) -> int:
    """Exponent of the power of two that scales the largest value to FIXED_POINT_BITS bits; 0 on a grid of integers."""
    if form == ON_GRID:
        return 0
    largest = float(np.abs(values).max())
    return FIXED_POINT_BITS - int(np.frexp(largest)[1]) if largest > 0 else 0


def fit_predictor(values: Floats) -> Integers:
    """Taps of the predictor, (ORDER − 1,) in fixed point, for values (frames, channels).

    The predictor is latest + Σ taps · (earlier − latest). The taps have the least absolute error, by iteratively
    reweighted least squares over a sample of the channels that move.
    """
    if len(values) < 4 * ORDER:
        return np.zeros(ORDER - 1, np.int64)
    moving = values[:, np.ptp(values, axis=0) > 0]
    if moving.shape[1] == 0:
        return np.zeros(ORDER - 1, np.int64)
    moving = moving[:, :: max(1, moving.size // FIT_SAMPLES)]
    lag = [moving[ORDER - 1 - k : len(moving) - 1 - k] for k in range(ORDER)]
    differences = np.stack([(lag[k] - lag[0]).ravel() for k in range(1, ORDER)])
    target = (moving[ORDER:] - lag[0]).ravel()
    smallest_error = max(float(np.abs(target).mean()) * 1e-5, 1e-300)
    taps = np.zeros(ORDER - 1)
    weight = np.ones_like(target)
    with np.errstate(all="ignore"):
        for _ in range(FIT_ITERATIONS):
            gram = (differences * weight) @ differences.T
            if not np.isfinite(gram).all():  # weights or differences whose products leave the range of float64
                return np.zeros(ORDER - 1, np.int64)
            ridge = 1e-12 * np.trace(gram) / len(gram) + 1e-300
            taps = np.linalg.solve(gram + ridge * np.eye(len(gram)), (differences * weight) @ target)
            weight = 1 / (np.abs(target - taps @ differences) + smallest_error)
    if not np.isfinite(taps).all():
        return np.zeros(ORDER - 1, np.int64)
    return np.rint(np.clip(taps, -15, 15) * (1 << TAP_BITS)).astype(np.int64)


def rank_to_fixed_point(ranks: Integers, form: int, scale: int) -> Integers:
    """Values in the predictor's fixed point. Every operation rounds exactly, so all machines give the same integers."""
    if form == ON_GRID:
        return np.clip(ranks, -GRID_LARGEST, GRID_LARGEST)
    with np.errstate(all="ignore"):
        scaled = np.ldexp(rank_to_float(ranks).astype(np.float64), scale)
    largest = float(1 << FIXED_POINT_BITS)
    return np.rint(np.clip(np.nan_to_num(scaled), -largest, largest)).astype(np.int64)


def fixed_point_to_rank(values: Integers, form: int, scale: int) -> Integers:
    """The inverse of `rank_to_fixed_point`, up to its rounding."""
    if form == ON_GRID:
        return values
    with np.errstate(all="ignore"):
        return float_to_rank(np.ldexp(values.astype(np.float64), -scale).astype(np.float32))


def predict(past: Integers, taps: Integers) -> Integers:
    """The next value in fixed point from the past ORDER values, (ORDER, …), latest first."""
    change = np.tensordot(taps, past[1:] - past[0], axes=1)
    half = 1 << (TAP_BITS - 1)
    largest = 1 << FIXED_POINT_BITS
    return np.clip(past[0] + ((change + half) >> TAP_BITS), -largest, largest)


def predict_chunk(ranks: Integers, form: int, taps: Integers, scale: int) -> Integers:
    """Predicted ranks (frames, channels) of a whole chunk.

    The prediction of the first frame is zero; before it, the past repeats the first frame.
    """
    values = rank_to_fixed_point(ranks, form, scale)
    padded = np.concatenate([np.repeat(values[:1], ORDER - 1, axis=0), values])
    n = len(values) - 1
    past = np.stack([padded[ORDER - 1 - k : ORDER - 1 - k + n] for k in range(ORDER)])
    return np.concatenate([np.zeros_like(ranks[:1]), fixed_point_to_rank(predict(past, taps), form, scale)])


def decode_ranks(
    chunks: Sequence[Chunk], points: int, form: int, taps: Integers, scale: int
) -> list[tuple[Integers, bytes]]:
    """Ranks (frames, channels) and the packed gaps of each chunk. All chunks step through time together."""
    unpacked = [_unpack_payload(chunk, points) for chunk in chunks]
    if not chunks:
        return []
    longest = max(c.frames for c in chunks)
    residuals = np.zeros((longest, len(chunks), points * 3), np.int64)
    for i, (residual, _) in enumerate(unpacked):
        residuals[: len(residual), i] = residual
    if residuals.min() < -2 * RANK_LIMIT or residuals.max() > 2 * RANK_LIMIT:
        raise Corrupt(f"lossless: a residual is outside ±{2 * RANK_LIMIT}")
    ranks = np.zeros_like(residuals)
    ranks[0] = np.clip(residuals[0], -RANK_LIMIT, RANK_LIMIT)
    past = np.repeat(rank_to_fixed_point(ranks[:1], form, scale), ORDER, axis=0)
    for t in progress.over(range(1, longest)):
        predicted = fixed_point_to_rank(predict(past, taps), form, scale)
        ranks[t] = np.clip(predicted + residuals[t], -RANK_LIMIT, RANK_LIMIT)
        past = np.concatenate([rank_to_fixed_point(ranks[t : t + 1], form, scale), past[:-1]])
    return [(ranks[: c.frames, i], part) for i, (c, (_, part)) in enumerate(zip(chunks, unpacked, strict=True))]


def _unpack_payload(chunk: Chunk, points: int, words: int = 1) -> tuple[Integers, bytes]:
    """Residual (frames, channels) and the packed gaps of a chunk. Raises Corrupt."""
    if len(chunk.payload) < 4:
        raise Corrupt(f"lossless: the chunk at frame {chunk.start} has {len(chunk.payload)} bytes, fewer than 4")
    (size,) = struct.unpack_from("<I", chunk.payload)
    if size > len(chunk.payload) - 4:
        raise Corrupt(f"lossless: in the chunk at frame {chunk.start} the gaps are longer than the chunk")
    return coder.unpack(chunk.payload[4 + size :], (chunk.frames, points * 3 * words)), chunk.payload[4 : 4 + size]
