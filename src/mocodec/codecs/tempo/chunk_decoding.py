"""Chunks, decoded: each by the compiled module, or many side by side by NumPy.

payload ─► gaps, numbers ─engine─► positions with y up ─► gaps and frozen samples ─► the axes of the motion
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from ... import parallel, progress
from ...encoded import Chunk, batches
from ...errors import Corrupt
from ...stages import frozen, lattice
from ...typing import Floats
from . import compiled_chunks
from .chunk import ALWAYS_FRAMES, BATCH, DIRECT, GAPPED, LONGEST_SECONDS, TRANSFORM, Payload, grid_size, in_metres
from .coding import coefficients, corrections, direct, quantise, rows
from .models.model import Model
from .pose import heading

FEWEST_PARALLEL = 4
"""Fewer chunks are decoded sooner than threads start."""


def decode(model: Model, chunks: Sequence[Chunk]) -> list[Floats]:
    """Positions (frames, points, 3), y up, of chunks, side by side; NaN in their gaps. Raises Corrupt."""
    _require_usual_lengths(model, chunks)
    found: list[Floats | None] = [None] * len(chunks)
    for i, chunk in enumerate(chunks):
        if compiled_chunks.decodes(model, chunk.frames):
            out = np.empty((chunk.frames, model.points, 3))
            found[i] = out if _decode_compiled(model, chunk, out, chunk.start, "y") else None
    rest = iter(_decode_by_numpy(model, [c for c, done in zip(chunks, found, strict=True) if done is None]))
    return [next(rest) if done is None else done for done in found]


def decode_into(model: Model, chunks: Sequence[Chunk], out: Floats, start: int, up: str) -> bool:
    """Frames [start, start + len(out)) of chunks that cover them, into `out` (frames, points, 3), metres.

    up: the vertical axis of the result. Chunks are read and decoded in the threads of `parallel`. Returns whether all
    positions are known to be finite. Raises Corrupt.
    """
    _require_usual_lengths(model, chunks)
    for frames in sorted({chunk.frames for chunk in chunks}):
        compiled_chunks.decodes(model, frames)  # what all threads share is made here
    for chunk in chunks[:1]:
        chunk.payload  # noqa: B018 - a remote file sends all chunks with the first

    def attempt(chunk: Chunk) -> bool:
        return compiled_chunks.decodes(model, chunk.frames) and _decode_compiled(model, chunk, out, start, up)

    rest: list[Chunk] = []
    for chunk, done in zip(progress.over(chunks), parallel.over(attempt, chunks, FEWEST_PARALLEL), strict=True):
        rest += [] if done else [chunk]
    for batch in progress.over(list(batches(rest, model.points, BATCH))):
        for chunk, decoded in zip(batch, _decode_by_numpy(model, batch), strict=True):
            _put(chunk, heading.from_y_up(decoded, up), out, start)
    return not rest and not any(chunk.payload[0] & GAPPED for chunk in chunks)


def _require_usual_lengths(model: Model, chunks: Sequence[Chunk]) -> None:
    for c in chunks:
        if c.frames > max(LONGEST_SECONDS * model.rate, ALWAYS_FRAMES) + 2:
            raise Corrupt(f"tempo: a chunk of {c.frames} frames is longer than {LONGEST_SECONDS} s")


def _decode_compiled(model: Model, chunk: Chunk, out: Floats, start: int, up: str) -> bool:
    """Into the frames of `out` that the chunk covers. False where NumPy has to do it. Raises Corrupt."""
    payload = Payload.unpack(chunk.payload)
    if payload.engine != TRANSFORM:
        return False
    step_m = 0.0 if payload.step is None else grid_size(payload.step)
    if payload.gaps:
        whole = np.empty((chunk.frames, model.points, 3))
        done = compiled_chunks.decode(model, chunk.frames, payload.numbers, step_m, whole)
        if done:
            _put(chunk, heading.from_y_up(frozen.restore(whole, payload.gaps), up), out, start)
        return done
    a, b = max(start, chunk.start), min(start + len(out), chunk.stop)
    axes = _axes(up)
    here, first = out[a - start : b - start], a - chunk.start
    return compiled_chunks.decode(model, chunk.frames, payload.numbers, step_m, here, first, axes)


@cache
def _axes(up: str) -> tuple[int, ...]:
    """The axes of a motion that x, y and z of positions with y up are."""
    return tuple(int(axis) for axis in heading.to_y_up(np.arange(3.0)[None], up)[0])


def _put(chunk: Chunk, decoded: Floats, out: Floats, start: int) -> None:
    """A whole chunk's positions into the frames of `out` that it covers."""
    a, b = max(start, chunk.start), min(start + len(out), chunk.stop)
    here = decoded[a - chunk.start : b - chunk.start]
    for axis in range(3):  # `here` may have the frames of a point next to each other, `out` has the axes
        out[a - start : b - start, :, axis] = here[..., axis]


def _decode_by_numpy(model: Model, chunks: Sequence[Chunk]) -> list[Floats]:
    """The same side by side: positions (frames, points, 3), y up. Raises Corrupt."""
    payloads = [Payload.unpack(c.payload) for c in chunks]
    transformed = [i for i, p in enumerate(payloads) if p.engine == TRANSFORM]
    if transformed and not model.rows:
        raise Corrupt("tempo: coefficients in a stream without a model")
    decoded: dict[int, coefficients.DecodedNumbers] = {}
    if transformed:
        frames, numbers = [chunks[i].frames for i in transformed], [payloads[i].numbers for i in transformed]
        found = coefficients.unpack(model, frames, numbers, corrections.FIELDS)
        decoded = dict(zip(transformed, found, strict=True))
    out: list[Floats] = []
    for i, (chunk, payload) in enumerate(zip(chunks, payloads, strict=True)):
        size = 0.0 if payload.step is None else grid_size(payload.step)
        shape = chunk.frames, model.points
        if payload.engine == TRANSFORM:
            positions = _positions(model, chunk.frames, decoded[i], size)
        else:
            if payload.engine == DIRECT:
                values = direct.unpack(payload.numbers, (chunk.frames, 3 * model.points)).reshape(*shape, 3)
            elif model.neighbours is None:
                raise Corrupt("tempo: a chunk of the lattice engine in a stream without neighbours")
            else:
                values = lattice.decode(payload.numbers, frozen.apart(payload.gaps, shape), model.neighbours)
            positions = in_metres(model, values, size)
        out.append(frozen.restore(positions, payload.gaps))
    return out


def _positions(model: Model, frames: int, numbers: coefficients.DecodedNumbers, size: float) -> Floats:
    """Positions of the transform, with corrections. size: step of corrections, metres."""
    sizes = rows.sizes(model.rows, frames, numbers.step)
    positions = model.synthesise(quantise.dequantise(numbers.values, sizes), frames)
    if numbers.lists.size:
        moved = corrections.from_numbers(numbers.lists, frames, model.points)
        corrections.apply(positions, moved, size, model.weights)
    return positions
