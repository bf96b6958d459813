"""Positions without loss: float32 bit for bit, in the units of the source, for those who must.

    positions ─► units of the source ─► on a grid? ── yes ─► integers k, x = k / steps ──────────┐
                 as float32                    └─ no ──► bit patterns in numeric order ─────────►├─► residual ─► entropy
                                    one linear predictor for the recording, in fixed point ──────┘

Recordings are smooth far below a millimetre, so that a predictor fitted once to all points (in the least absolute
sense, which is what costs bits) leaves the noise of the cameras and nothing else. Text formats and integer C3D files
hold multiples of a step: those are coded as integers and cost less still. A gap costs its place, nothing else.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .. import progress
from ..encoded import Chunk, Encoded, about, restore
from ..entropy import coder
from ..errors import BadInput, CannotEncode, Corrupt
from ..motion import Floats, Motion
from ..stages import gaps, segment
from . import base

Integers = NDArray[np.int64]

ORDER = 8  # taps of the predictor
TAP_BITS = 14  # fraction bits of a tap
LEVEL_BITS = 40  # bits of a position in the predictor's fixed point; × taps of up to 2^18 stays within int64
GRID_LARGEST = 1 << 36
STEPS_IN_UNIT = tuple(10.0**digits for digits in range(8))  # what a text of so many decimals holds
HEADER = struct.Struct("<Bdd" + "i" * (ORDER - 1) + "bI")
ON_GRID, FLOAT32 = 1, 0


@dataclass(frozen=True)
class Lossless:
    """Settings: seconds of motion in a chunk, which decodes alone."""

    name: ClassVar[str] = "lossless"
    chunk_seconds: float = 4.0

    def encode(self, motion: Motion) -> Encoded[Motion]:
        """Raises CannotEncode for a motion without samples or beyond float32, BadInput for chunks of no length."""
        base.require_frames(motion)
        if not self.chunk_seconds > 0:
            raise BadInput("chunk_seconds must be positive")
        filled, mask = gaps.fill(motion.positions)
        form, unit, steps, values = numbers(filled, ~mask, float(motion.source.get("unit_m", 1.0)))
        ranks = rows(values) if form == ON_GRID else in_order(rows(values))
        scale = fixed_point_scale(form, values)
        taps = fit(rows(values).astype(np.float64))
        clip_frames = max(1, round(self.chunk_seconds * motion.rate))
        chunks = []
        for clip in progress.over(segment.equal_length(len(motion), clip_frames)):
            residual = ranks[clip] - predict_all(ranks[clip], form, taps, scale)
            holes = gaps.pack(mask[clip])
            chunks.append(
                Chunk(clip.start, len(residual), struct.pack("<I", len(holes)) + holes + coder.pack(residual))
            )
        shared = HEADER.pack(form, unit, steps, *taps.tolist(), scale, clip_frames)
        return Encoded(self.name, about(motion), tuple(chunks), (shared,), settings=base.settings(self))

    @staticmethod
    def decode(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
        """Raises Corrupt."""
        start, stop = encoded.range(frames)
        points = encoded.about.points
        if len(encoded.shared) != 1 or len(encoded.shared[0]) != HEADER.size:
            raise Corrupt("lossless: its header is missing or of another size")
        form, unit, steps, *taps, scale, _ = HEADER.unpack(encoded.shared[0])
        if form not in (ON_GRID, FLOAT32) or not -1100 < scale < 1100:
            raise Corrupt("lossless: no such form")
        chunks = list(encoded.covering(start, stop))
        ranks = decode_chunks(chunks, points, form, np.array(taps, np.int64), scale)
        positions = np.empty((sum(c.frames for c in chunks), points, 3))
        at = 0
        for chunk, (values, mask) in zip(chunks, ranks, strict=True):
            with np.errstate(all="ignore"):
                numbers_ = values / steps if form == ON_GRID else from_order(values).astype(np.float64)
                decoded = (numbers_ * unit).reshape(chunk.frames, points, 3)
            positions[at : at + chunk.frames] = gaps.apply(decoded, mask)
            at += chunk.frames
        first = chunks[0].start if chunks else 0
        return restore(encoded, positions[start - first : stop - first], start)


# --- numbers ⇄ positions


def numbers(positions: Floats, present: NDArray[np.bool_], unit: float) -> tuple[int, float, float, NDArray[Any]]:
    """Form, unit, steps in a unit and values: value / steps × unit is each present position, bit for bit in float32.

    In the units of the source where that gives the very float64 back, in metres otherwise. Raises CannotEncode beyond
    the range of float32.
    """
    samples = positions[present]
    some = samples[:: max(1, len(samples) // 500)]
    with np.errstate(all="ignore"):
        for chosen in (unit, 1.0):
            for steps in STEPS_IN_UNIT:
                if all(np.array_equal((np.rint(x / chosen * steps) / steps) * chosen, x) for x in (some, samples)):
                    k = np.rint(positions / chosen * steps)
                    if np.abs(k).max() < GRID_LARGEST:
                        return ON_GRID, chosen, steps, k.astype(np.int64)
            if all(
                np.array_equal((x / chosen).astype(np.float32).astype(np.float64) * chosen, x) for x in (some, samples)
            ):
                return FLOAT32, chosen, 1.0, (positions / chosen).astype(np.float32)
        as_float32 = positions.astype(np.float32)
    if not np.isfinite(as_float32).all():
        raise CannotEncode("positions beyond the range of float32")
    return FLOAT32, 1.0, 1.0, as_float32


def rows(values: NDArray[Any]) -> NDArray[Any]:
    """(frames, points, 3) → (frames, channels)."""
    return values.reshape(len(values), -1)


def in_order(values: NDArray[np.float32]) -> Integers:
    """float32 → its bit pattern as an integer that grows with the value; −0 stands just below +0."""
    bits = np.ascontiguousarray(values, np.float32).view(np.int32).astype(np.int64)
    return np.where(bits < 0, bits ^ 0x7FFFFFFF, bits)


def from_order(ranks: Integers) -> NDArray[np.float32]:
    """The inverse of `in_order`."""
    bits = np.where(ranks < 0, ranks ^ 0x7FFFFFFF, ranks)
    return (bits & 0xFFFFFFFF).astype(np.uint32).view(np.float32)


# --- prediction in fixed point


def fixed_point_scale(form: int, values: NDArray[Any]) -> int:
    """The power of two that brings the largest value to LEVEL_BITS bits: 0 on a grid, which is in integers already."""
    if form == ON_GRID:
        return 0
    largest = float(np.abs(values).max())
    return LEVEL_BITS - int(np.frexp(largest)[1]) if largest > 0 else 0


def fit(values: Floats) -> Integers:
    """Taps of the one predictor, (ORDER − 1,) in fixed point, on differences from the latest value.

    Least absolute error by reweighted least squares over a sample of the channels' frames.
    """
    flat = np.zeros(ORDER - 1, np.int64)
    if len(values) < 4 * ORDER:
        return flat
    moving = values[:, np.ptp(values, axis=0) > 0]
    if moving.shape[1] == 0:
        return flat
    moving = moving[:, :: max(1, moving.size // 100_000)]
    lag = [moving[ORDER - 1 - k : len(moving) - 1 - k] for k in range(ORDER)]
    past = np.stack([(lag[k] - lag[0]).ravel() for k in range(1, ORDER)])
    ahead = (moving[ORDER:] - lag[0]).ravel()
    tiny = max(float(np.abs(ahead).mean()) * 1e-5, 1e-300)
    taps = np.zeros(ORDER - 1)
    weight = np.ones_like(ahead)
    for _ in range(8):
        gram = (past * weight) @ past.T
        ridge = 1e-12 * np.trace(gram) / len(gram) + 1e-300
        taps = np.linalg.solve(gram + ridge * np.eye(len(gram)), (past * weight) @ ahead)
        weight = 1 / (np.abs(ahead - taps @ past) + tiny)
    return np.rint(np.clip(taps, -15, 15) * (1 << TAP_BITS)).astype(np.int64)


def level(ranks: Integers, form: int, scale: int) -> Integers:
    """Values in the predictor's fixed point: exactly rounded operations, the same integers on every machine."""
    if form == ON_GRID:
        return np.clip(ranks, -GRID_LARGEST, GRID_LARGEST)
    with np.errstate(all="ignore"):
        scaled = np.ldexp(from_order(ranks).astype(np.float64), scale)
    top = float(1 << LEVEL_BITS)
    return np.rint(np.clip(np.nan_to_num(scaled), -top, top)).astype(np.int64)


def rank(levels: Integers, form: int, scale: int) -> Integers:
    """The inverse of `level` as near as the values allow."""
    if form == ON_GRID:
        return levels
    with np.errstate(all="ignore"):
        return in_order(np.ldexp(levels.astype(np.float64), -scale).astype(np.float32))


def combine(past: Integers, taps: Integers) -> Integers:
    """The prediction from past levels (ORDER, …), latest first."""
    drift = np.tensordot(taps, past[1:] - past[0], axes=1)
    half = 1 << (TAP_BITS - 1)
    top = 1 << LEVEL_BITS
    return np.clip(past[0] + ((drift + half) >> TAP_BITS), -top, top)


def predict_all(ranks: Integers, form: int, taps: Integers, scale: int) -> Integers:
    """Predictions of a whole chunk (frames, channels) at once; before its first frame everything is zero, then held."""
    levels = level(ranks, form, scale)
    padded = np.concatenate([np.repeat(levels[:1], ORDER - 1, axis=0), levels])
    n = len(levels) - 1
    past = np.stack([padded[ORDER - 1 - k : ORDER - 1 - k + n] for k in range(ORDER)])
    return np.concatenate([np.zeros_like(ranks[:1]), rank(combine(past, taps), form, scale)])


def decode_chunks(
    chunks: list[Chunk], points: int, form: int, taps: Integers, scale: int
) -> list[tuple[Integers, NDArray[np.bool_]]]:
    """Ranks (frames, channels) and gaps of each chunk. Steps through time once, all chunks side by side."""
    residuals, masks = [], []
    for chunk in chunks:
        if len(chunk.payload) < 4:
            raise Corrupt(f"lossless: the chunk at frame {chunk.start} is too short")
        (length,) = struct.unpack_from("<I", chunk.payload)
        if length > len(chunk.payload) - 4:
            raise Corrupt(f"lossless: the gaps of the chunk at frame {chunk.start} are longer than the chunk")
        masks.append(gaps.unpack(chunk.payload[4 : 4 + length], (chunk.frames, points)))
        residuals.append(coder.unpack(chunk.payload[4 + length :], (chunk.frames, points * 3)))
    if not chunks:
        return []
    longest = max(c.frames for c in chunks)
    together = np.zeros((longest, len(chunks), points * 3), np.int64)
    for i, residual in enumerate(residuals):
        together[: len(residual), i] = residual
    lowest, highest = -(1 << 37), 1 << 37
    if together.min() < 2 * lowest or together.max() > 2 * highest:
        raise Corrupt("lossless: a residual is out of range")
    ranks = np.zeros_like(together)
    ranks[0] = np.clip(together[0], lowest, highest)
    past = np.repeat(level(ranks[:1], form, scale), ORDER, axis=0)
    for t in progress.over(range(1, longest)):
        ranks[t] = np.clip(rank(combine(past, taps), form, scale) + together[t], lowest, highest)
        past = np.concatenate([level(ranks[t : t + 1], form, scale), past[:-1]])
    return [(ranks[: c.frames, i], mask) for i, (c, mask) in enumerate(zip(chunks, masks, strict=True))]
