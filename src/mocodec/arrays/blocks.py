# pyright: strict
"""Positions of an open file as a Dask array, in blocks of whole chunks that are decoded when they are computed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from ..motion import Motion
from ..opened import File
from .libraries import library
from .stored import StoredArray

BLOCK_BYTES = 1 << 20
"""About the positions of a block: chunks may be much smaller, and each block costs the scheduler a task."""


def to_dask(file: File[Motion], dtype: DTypeLike = np.float64, block_bytes: int = BLOCK_BYTES) -> Any:
    """A dask.array of the positions (frames, points, 3), metres, NaN in gaps.

    A block is a run of whole chunks of at most block_bytes, or one chunk. Blocks are decoded when they are computed,
    so the file has to stay open; other processes open it again by its path or URL. Raises MissingExtra without Dask.
    """
    array = library("dask.array", "mocodec.arrays.to_dask", "dask")
    positions = StoredArray(file, dtype=np.dtype(dtype))
    frames, points, axes = positions.shape
    if frames == 0:
        return array.zeros(positions.shape, dtype=positions.dtype)
    most = block_bytes // max(1, points * axes * positions.dtype.itemsize)
    blocks = (block_lengths([chunk.frames for chunk in file.encoded.chunks], most), (points,), (axes,))
    return array.from_array(positions, chunks=blocks, meta=np.empty((0, 0, 0), positions.dtype))


def block_lengths(chunk_frames: list[int], most: int) -> tuple[int, ...]:
    """Frames of each block: as many whole chunks as have at most `most` frames together, at least one."""
    lengths: list[int] = []
    for frames in chunk_frames:
        if lengths and lengths[-1] + frames <= most:
            lengths[-1] += frames
        else:
            lengths.append(frames)
    return tuple(lengths)
