"""A chunk's bytes: which engine made them, its numbers, its corrections, its gaps.

byte: engine, has corrections, has gaps · [length, gaps] · [step, length, corrections] · the engine's bytes

transform   coefficients of the body's curves: few bytes at any error that is not tiny
direct      every sample on a grid, predicted in time: for motion that is no body's, and for tiny errors
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...encoded import Chunk
from ...entropy import varint
from ...errors import Corrupt
from ...motion import Floats
from ...stages import gaps
from . import body, coefficients, corrections, direct
from .model import HEADING, Model, heading_step, step_size

TRANSFORM, DIRECT = 0, 1
ENGINES = 2
STEPPED, GAPPED = 4, 8
FINE = 256
"""Steps of the direct engine and of corrections are 2^(n / 256) metres."""


@dataclass(frozen=True, eq=False)
class Parts:
    """What a chunk is made of."""

    engine: int
    numbers: bytes
    step: int | None = None
    gaps: bytes = b""

    def pack(self) -> bytes:
        flags = self.engine | STEPPED * (self.step is not None) | GAPPED * bool(self.gaps)
        out = bytes([flags])
        if self.gaps:
            out += varint.write([len(self.gaps)]) + self.gaps
        if self.step is not None:
            out += varint.write([varint.signed(self.step)])
        return out + self.numbers

    @classmethod
    def unpack(cls, payload: bytes) -> Parts:
        """Raises Corrupt."""
        if not payload or payload[0] & ~(ENGINES - 1 | STEPPED | GAPPED):
            raise Corrupt("tempo: a chunk of no known kind")
        at, step, missing = 1, None, b""
        if payload[0] & GAPPED:
            missing, at = _blob(payload, at)
        if payload[0] & STEPPED:
            (folded,), at = varint.read(payload, 1, at)
            step = varint.unsigned(folded)
            if abs(step) > 200 * FINE:
                raise Corrupt("tempo: a chunk whose step is out of range")
        return cls(payload[0] & (ENGINES - 1), payload[at:], step, missing)


def _blob(payload: bytes, at: int) -> tuple[bytes, int]:
    (length,), at = varint.read(payload, 1, at)
    if at + length > len(payload):
        raise Corrupt("tempo: a chunk that ends within its parts")
    return payload[at : at + length], at + length


def fine_step(size: float) -> int:
    """The number of the largest fine step that is no larger than this size."""
    n = int(np.floor(np.log2(size) * FINE))
    while fine_size(n) > size:
        n -= 1
    return n


def fine_size(step: int) -> float:
    return 2.0 ** (step / FINE)


def sizes(known: Model, frames: int, step: int) -> Floats:
    """The step of each row, metres or radians: (rows,)."""
    size = np.full(known.rows, float(step_size(step)))
    size[HEADING] = step_size(heading_step(frames))
    return size


def decode(model: Model, chunks: Sequence[Chunk]) -> list[Floats]:
    """The positions (frames, points, 3), y up, of chunks, side by side; NaN in their gaps. Raises Corrupt."""
    parts = [Parts.unpack(c.payload) for c in chunks]
    transformed = [i for i, p in enumerate(parts) if p.engine == TRANSFORM]
    found: dict[int, tuple[np.ndarray, int, np.ndarray]] = {}
    if transformed:
        numbers = coefficients.unpack(
            model,
            [chunks[i].frames for i in transformed],
            [parts[i].numbers for i in transformed],
            corrections.FIELDS,
        )
        found = dict(zip(transformed, numbers, strict=True))
    points = len(model.points.names)
    out = []
    for i, (chunk, p) in enumerate(zip(chunks, parts, strict=True)):
        size = 0.0 if p.step is None else fine_size(p.step)
        if p.engine == TRANSFORM:
            values, step, lists = found[i]
            positions = model.synthesise(
                coefficients.dequantise(values, sizes(model, chunk.frames, step)), chunk.frames
            )
            if lists.size:
                moved = corrections.from_numbers(lists, chunk.frames, points)
                corrections.apply(positions, moved, size, model.weights)
        else:
            values = direct.unpack(p.numbers, (chunk.frames, 3 * points))
            positions = np.asarray(values.reshape(chunk.frames, points, 3) * size, np.float64)
            if model.weights is not None:
                positions /= model.weights[:, None]
        out.append(gaps.apply(positions, gaps.unpack(p.gaps, (chunk.frames, points))))
    return out


__all__ = ["DIRECT", "TRANSFORM", "Parts", "body", "decode", "fine_size", "fine_step"]
