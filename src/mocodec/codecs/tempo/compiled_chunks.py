"""Whole chunks of the transform by the compiled module: from bytes to positions, and back.

    payload ─integers, contexts─► coefficients ─bases, inverse DCT─► poses ─corrections─► the caller's array
    positions ─heading, bones, DCT, bases─► coefficients                                                  `analyse`
    coefficients, step ─quantise─► integers ─bases, inverse DCT─► poses ─► errors, corrections            `trial`
    integers, corrections ─contexts─► payload                                                             `pack`

`coding.coefficients`, `Model` and `trial` define the result: integers are the same, coefficients and positions agree to
rounding. Bytes that no encoder writes are left to them, since they raise the error. The interpreter is free
meanwhile, so that chunks are coded and decoded in several threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ... import native
from ...stages import dct
from ...typing import Booleans, Floats
from .coding import contexts, quantise
from .coding.coefficients import ChunkNumbers
from .coding.rows import heading_step, step_size
from .models.coordinates import DirectionCoordinates
from .models.model import Model, heading_frequencies

MOST_LENGTHS = 16
"""Lengths of chunks of a model whose matrices are kept."""
MODEL, ENCODES = 0, -1
"""Keys of what chunks of all lengths share, and of whether it can encode."""
MOST_DIMENSIONS = 256
"""Matrix products of more coordinates are faster in NumPy."""
Y_UP = (0, 1, 2)


def decode(
    model: Model, frames: int, numbers: bytes, step_m: float, out: Floats, first: int = 0, axes: tuple[int, ...] = Y_UP
) -> bool:
    """Frames [first, first + len(out)) of a chunk into `out` (frames, points, 3), metres. False if NumPy has to do it.

    numbers: of the payload. step_m: step of the corrections. axes: the axis of `out` that x, y and z of positions with
    y up go to.
    """
    return _of_length(model, frames).decode(numbers, step_m, out, first, axes)


def analyse(model: Model, positions: Floats) -> Floats:
    """`Model.analyse`, by the compiled module where it can."""
    if model.coordinates.dimensions > MOST_DIMENSIONS or (compiled := _encoder(model, len(positions))) is None:
        return model.analyse(positions)
    return compiled.analyse(positions)


def of_step(
    model: Model, spectrum: Floats, wanted: Floats, apart: Booleans, step: int, slope: float, keeps: bool
) -> tuple[Any, ...] | None:
    """What `ChunksOfLength.of_step` returns; None if NumPy has to do it. Arguments as in `trial`."""
    if (compiled := _encoder(model, len(spectrum))) is None:
        return None
    return compiled.of_step(spectrum, wanted, _mask(apart), step, float(step_size(step)), slope, FREE, keeps)


def within_bound(
    model: Model,
    spectrum: Floats,
    wanted: Floats,
    apart: Booleans,
    step: int,
    slope: float,
    bound: float,
    grid: float,
    most_bits: float,
) -> tuple[Any, ...] | None:
    """What `ChunksOfLength.within_bound` returns; None if NumPy has to do it. Arguments as in `trial`."""
    if (compiled := _encoder(model, len(spectrum))) is None:
        return None
    size = float(step_size(step))
    return compiled.within_bound(spectrum, wanted, _mask(apart), step, size, slope, FREE, bound, grid, most_bits)


def pack(model: Model, chunk: ChunkNumbers) -> bytes:
    """`coefficients.pack` of one chunk, whose length `decodes` accepts."""
    compiled = _encoder(model, chunk.frames)
    return compiled.pack(chunk.values, chunk.step, chunk.threshold, NO_LISTS if chunk.lists is None else chunk.lists)


FREE = quantise.FIRST_FREE_ROW
NO_LISTS = np.zeros((0, 0), np.int64)
_NOTHING_APART = np.zeros((0, 0), np.uint8)


def _mask(apart: Booleans) -> Any:
    return np.ascontiguousarray(apart, np.uint8) if apart.any() else _NOTHING_APART


def decodes(model: Model, frames: int) -> bool:
    """Whether `decode` may be asked for chunks of this length."""
    return _of_length(model, frames) is not None


def encodes(model: Model, frames: int) -> bool:
    """Whether chunks of this length are coded here."""
    return _encoder(model, frames) is not None


def _is_supported(model: Model, frames: int) -> bool:
    """Whether the module codes chunks of this length."""
    return native.kernel("ChunkCodec") is not None and 0 < frames <= dct.MATRIX_FRAMES and model.rows > 0


def _of_length(model: Model, frames: int) -> Any:
    """Codes chunks of this length; None where the module does not."""
    found = model.compiled.get(frames) if frames > 0 and native.kernel("ChunkCodec") is not None else None
    if found is None and _is_supported(model, frames):
        if len(model.compiled) > MOST_LENGTHS:
            kept = {key: model.compiled[key] for key in (MODEL, ENCODES) if key in model.compiled}
            model.compiled.clear()
            model.compiled.update(kept)
        whole = model.compiled.get(MODEL) or _of_model(model)
        band_ends = [band.stop for band in model.bands(frames)]
        heading_radians = float(step_size(heading_step(frames)))
        kept_frequencies = heading_frequencies(frames, model.rate)
        found = _made("ChunksOfLength", whole, model.expected(frames, 0), band_ends, heading_radians, kept_frequencies)
        model.compiled.update({MODEL: whole, frames: found})
    return found


def _encoder(model: Model, frames: int) -> Any:
    """The same for encoding, which needs more of the model than decoding."""
    if ENCODES not in model.compiled and _is_supported(model, frames):
        whole = model.compiled.get(MODEL) or _of_model(model)
        whole.set_encoding(model.tables.cost.ravel(), quantise.prices(model), *_analysis(model))
        model.compiled.clear()
        model.compiled.update({MODEL: whole, ENCODES: True})
    return _of_length(model, frames)


def _analysis(model: Model) -> tuple[Any, ...]:
    """Bases from coordinates to components, none of too many coordinates; joints and hubs of bones."""
    coordinates, nothing = model.coordinates, np.zeros(0, np.int64)
    bases: list[Floats] = []
    if coordinates.dimensions <= MOST_DIMENSIONS:
        of_basis = {id(b): np.ascontiguousarray(coordinates.analysing(b)) for b in model.statistics.bases}
        bases = [of_basis[id(b)] for b in model.statistics.bases]
    if isinstance(coordinates, DirectionCoordinates):
        schedule = coordinates.tree.schedule
        return bases, schedule.points, *schedule.hub_pairs
    return bases, nothing, nothing.reshape(0, 2), np.zeros((0, 3, 3))


def _made(name: str, *arguments: Any) -> Any:
    kernel = native.kernel(name)
    assert kernel is not None
    return kernel(*arguments)


def _of_model(model: Model) -> Any:
    weights = np.zeros(0) if model.weights is None else model.weights
    copied = {id(basis): np.ascontiguousarray(basis) for basis in model.synthesis_bases}  # bands may share a basis
    bases = [copied[id(basis)] for basis in model.synthesis_bases]
    coordinates = model.coordinates
    decoder = _made("ChunkCodec", model.tables.frequencies, *contexts.constants(), bases, coordinates.pose, weights)
    if isinstance(coordinates, DirectionCoordinates):
        tree, schedule = coordinates.tree, coordinates.tree.schedule
        direction = np.full(len(tree.parents), -1, np.int64)
        direction[schedule.points] = np.arange(len(schedule.points))
        decoder.set_tree(
            *schedule.program, schedule.order, np.array(tree.parents, np.int64), direction, tree.lengths,
            np.asarray(coordinates.columns, np.int64),
        )  # fmt: skip
    return decoder
