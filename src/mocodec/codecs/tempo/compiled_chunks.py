"""Whole chunks of the transform by the compiled module: from bytes to positions, and trials of a step.

    payload ─integers, contexts─► coefficients ─bases, inverse DCT─► poses ─corrections─► the caller's array
    coefficients, step ─quantise─► integers ─bases, inverse DCT─► poses ─► errors, corrections            `trial`

`coding.coefficients`, `Model.synthesise` and `trial` define the result: the integers are the same, positions agree to
rounding. Bytes that no encoder writes are left to them, since they say what is wrong. The interpreter is free
meanwhile, so that chunks are coded and decoded in several threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ... import native
from ...stages import dct
from ...typing import Booleans, Floats
from .coding import contexts, quantise
from .coding.rows import heading_step, step_size
from .models.coordinates import DirectionCoordinates
from .models.model import Model

MOST_LENGTHS = 16
"""Lengths of chunks of a model whose matrices are kept."""
MODEL = 0
"""Key of what chunks of all lengths share."""
Y_UP = (0, 1, 2)


def decode(
    model: Model, frames: int, numbers: bytes, step_m: float, out: Floats, first: int = 0, axes: tuple[int, ...] = Y_UP
) -> bool:
    """Frames [first, first + len(out)) of a chunk into `out` (frames, points, 3), metres. False if NumPy has to do it.

    numbers: of the payload. step_m: step of the corrections. axes: the axis of `out` that x, y and z of positions with
    y up go to.
    """
    return _of_length(model, frames).decode(numbers, step_m, out, first, axes)


def trial(
    model: Model,
    spectrum: Floats,
    wanted: Floats,
    apart: Booleans,
    step: int,
    slope: float,
    bound: float = 0.0,
    grid: float = 0.0,
    keeps: bool = False,
) -> tuple[Any, ...] | None:
    """What `ChunksOfLength.trial` returns; None if NumPy has to do it. Arguments as in `trial`; bound: 0 for none."""
    compiled = _of_length(model, len(spectrum))
    if compiled is None:
        return None
    mask = np.ascontiguousarray(apart, np.uint8) if apart.any() else _NOTHING_APART
    prices, free = quantise.prices(model), quantise.FIRST_FREE_ROW
    return compiled.trial(spectrum, wanted, mask, step, float(step_size(step)), slope, free, prices, bound, grid, keeps)


_NOTHING_APART = np.zeros((0, 0), np.uint8)


def decodes(model: Model, frames: int) -> bool:
    """Whether `decode` may be asked for chunks of this length."""
    return _of_length(model, frames) is not None


def _of_length(model: Model, frames: int) -> Any:
    """Decodes chunks of this length; None where the module does not."""
    if native.kernel("ChunkDecoder") is None or not 0 < frames <= dct.MATRIX_FRAMES or not model.rows:
        return None
    found = model.compiled.get(frames)
    if found is None:
        if len(model.compiled) > MOST_LENGTHS:
            model.compiled.clear()
        whole = model.compiled.get(MODEL) or _of_model(model)
        band_ends = [band.stop for band in model.bands(frames)]
        heading_radians = float(step_size(heading_step(frames)))
        found = _made("ChunksOfLength", whole, model.expected(frames, 0), band_ends, heading_radians)
        model.compiled.update({MODEL: whole, frames: found})
    return found


def _made(name: str, *arguments: Any) -> Any:
    kernel = native.kernel(name)
    assert kernel is not None
    return kernel(*arguments)


def _of_model(model: Model) -> Any:
    weights = np.zeros(0) if model.weights is None else model.weights
    copied = {id(basis): np.ascontiguousarray(basis) for basis in model.synthesis_bases}  # bands may share a basis
    bases = [copied[id(basis)] for basis in model.synthesis_bases]
    coordinates = model.coordinates
    decoder = _made("ChunkDecoder", model.tables.frequencies, *contexts.constants(), bases, coordinates.pose, weights)
    if isinstance(coordinates, DirectionCoordinates):
        tree, schedule = coordinates.tree, coordinates.tree.schedule
        direction = np.full(len(tree.parents), -1, np.int64)
        direction[schedule.points] = np.arange(len(schedule.points))
        decoder.set_tree(
            *schedule.program, schedule.order, np.array(tree.parents, np.int64), direction, tree.lengths,
            np.asarray(coordinates.columns, np.int64),
        )  # fmt: skip
    return decoder
