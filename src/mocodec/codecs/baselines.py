"""The methods that the papers compare themselves with, on our quantiser and entropy coder, side information counted.

    clip_svd        each clip's own left basis and coefficients                 Hou 2014, equation (1)
    dct_2d          DCT along time and along the rows of M                      Hou 2014, equation (2)
    dwt_2d          biorthogonal 4.4 wavelets (JPEG 2000's) along both          Hou 2014, section VI; the [bench] extra
    global_pca      one mean and basis, coefficients along time                 Liu & McMillan 2006, table 3
    piecewise_pca   the same for each of equal segments                         Liu & McMillan 2006, table 3

Each takes positions (frames, points, 3) without gaps and a step in metres, which is its knob, and gives bytes; `decode`
needs the bytes and the shape. They are rivals in tables, not codecs: no container, no bound, no slices.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..entropy import coder, varint
from ..errors import Corrupt, MissingExtra
from ..motion import Floats
from ..stages import basis, dct, quantise

Integers = NDArray[np.int64]
Shape = tuple[int, int, int]

CLIP_FRAMES = 280
SEGMENT_FRAMES = 1120

ROUNDING = 0.4
"""Numbers nearer to zero than this rounds up to are worth more as zeros, for all methods alike."""

PAYS = 32.0
"""A component is worth its basis where its energy is beyond this many squared steps."""

WAVELET = "bior4.4"
STEP_OF_MEAN = 3.0


@dataclass(frozen=True)
class Baseline:
    """One method as the evaluation drives it."""

    name: str
    coded: Callable[[Floats, float], bytes]
    decoded: Callable[[bytes, Shape, float], Floats]

    def encode(self, positions: Floats, knob: float) -> bytes:
        """positions (frames, points, 3) without gaps; knob: the step in metres, rounded to the ladder of steps."""
        rung = quantise.rung(knob)
        return struct.pack("<h", rung) + self.coded(np.asarray(positions, np.float64), quantise.step(rung))

    def decode(self, data: bytes, shape: Shape) -> Floats:
        """Positions of this shape. Raises Corrupt."""
        if len(data) < 2:
            raise Corrupt("a baseline's stream is too short")
        return self.decoded(data[2:], shape, quantise.step(struct.unpack_from("<h", data)[0]))

    def knob_of(self, mean_error: float) -> float:
        """Where to begin to search for a mean error in metres."""
        return STEP_OF_MEAN * mean_error

    def version(self) -> str:
        return "mocodec"


# ------------------------------------------------------------------------------------------- bases found from the data


def _pack_pca(rows: Floats, step: float) -> bytes:
    """Mean, basis and coefficients of rows (frames, 3 points)."""
    mean_step = step / np.sqrt(len(rows))
    mean = quantise.forward(rows.mean(axis=0), mean_step)
    centred = rows - mean * mean_step
    vectors, energies = basis.fit(centred.T @ centred)
    k = int((energies > PAYS * step**2).sum())
    precision = np.minimum.accumulate(basis.precisions(energies[:k], step))
    rounded = basis.rounded(vectors[:, :k], precision)
    numbers = quantise.forward(centred @ rounded, step, ROUNDING)
    parts = [
        coder.pack(mean.reshape(-1, 3)),
        coder.pack(precision[:, None]),
        basis.pack(vectors[:, :k], precision, _before(rows.shape[1])),
        coder.pack(numbers),
    ]
    return varint.write([k, *map(len, parts)]) + b"".join(parts)


def _unpack_pca(data: bytes, at: int, shape: Shape, step: float) -> tuple[Floats, int]:
    frames, points, _ = shape
    (k, *sizes), at = varint.read(data, 5, at)
    if k > 3 * points:
        raise Corrupt("a baseline with more components than coordinates")
    ends = np.cumsum([at, *sizes]).tolist()
    parts = [data[a:b] for a, b in pairwise(ends)]
    mean = coder.unpack(parts[0], (points, 3)).ravel() * (step / np.sqrt(frames))
    precision = coder.unpack(parts[1], (k, 1))[:, 0]
    rounded = basis.unpack(parts[2], 3 * points, precision, _before(3 * points))
    curves = quantise.inverse(coder.unpack(parts[3], (frames, k)), step)
    return (curves @ rounded.T + mean).reshape(shape), ends[-1]


def _before(dimensions: int) -> Integers:
    """For each coordinate the same of the point before."""
    return np.maximum(np.arange(dimensions) - 3, -1)


def _pack_clips(positions: Floats, step: float, length: int) -> bytes:
    rows = positions.reshape(len(positions), -1)
    return b"".join(_pack_pca(rows[a : a + length], step) for a in range(0, len(rows), length))


def _unpack_clips(data: bytes, shape: Shape, step: float, length: int) -> Floats:
    clips: list[Floats] = []
    at = 0
    for start in range(0, shape[0], length):
        clip, at = _unpack_pca(data, at, (min(length, shape[0] - start), *shape[1:]), step)
        clips.append(clip)
    return np.concatenate(clips)


CLIP_SVD = Baseline(
    "clip-wise SVD",
    lambda positions, step: _pack_clips(positions, step, CLIP_FRAMES),
    lambda data, shape, step: _unpack_clips(data, shape, step, CLIP_FRAMES),
)
"""Equation (1): U_iᵀ M_i V_i. Σ_i V_iᵀ is coded as one, along time, which is cheaper than V_i and Σ_i apart."""

PIECEWISE_PCA = Baseline(
    "piecewise PCA",
    lambda positions, step: _pack_clips(positions, step, SEGMENT_FRAMES),
    lambda data, shape, step: _unpack_clips(data, shape, step, SEGMENT_FRAMES),
)

GLOBAL_PCA = Baseline(
    "global PCA",
    lambda positions, step: _pack_clips(positions, step, len(positions)),
    lambda data, shape, step: _unpack_clips(data, shape, step, shape[0]),
)


# ---------------------------------------------------------------------------------------------------- fixed transforms


def _matrix(positions: Floats) -> Floats:
    """Mᵀ of section III, (frames, 3n): all x, then all y, then all z."""
    return positions.transpose(0, 2, 1).reshape(len(positions), -1)


def _positions(rows: Floats, shape: Shape) -> Floats:
    return rows.reshape(shape[0], 3, shape[1]).transpose(0, 2, 1)


def _pack_dct(positions: Floats, step: float) -> bytes:
    parts: list[bytes] = []
    rows = _matrix(positions)
    for start in range(0, len(rows), CLIP_FRAMES):
        clip = rows[start : start + CLIP_FRAMES]
        both = dct.forward(np.ascontiguousarray(dct.forward(clip).T)).T
        part = coder.pack(quantise.forward(both, step, ROUNDING))
        parts.append(varint.write([len(part)]) + part)
    return b"".join(parts)


def _unpack_dct(data: bytes, shape: Shape, step: float) -> Floats:
    rows: list[Floats] = []
    at = 0
    for start in range(0, shape[0], CLIP_FRAMES):
        frames = min(CLIP_FRAMES, shape[0] - start)
        (size,), at = varint.read(data, 1, at)
        both = quantise.inverse(coder.unpack(data[at : at + size], (frames, 3 * shape[1])), step)
        at += size
        rows.append(dct.inverse(np.ascontiguousarray(dct.inverse(both.T, 3 * shape[1]).T), frames))
    return _positions(np.concatenate(rows), shape)


DCT_2D = Baseline("2-D DCT", _pack_dct, _unpack_dct)
"""Equation (2): D_lᵀ M_i D_r."""


def _pywt() -> Any:
    try:
        return import_module("pywt")
    except ImportError as missing:
        raise MissingExtra("the 2-D DWT", "bench") from missing


def _levels(shape: tuple[int, int]) -> int:
    """Octaves along both: as many as the shorter side bears."""
    return int(_pywt().dwtn_max_level(shape, WAVELET))


def _bands(shape: tuple[int, int]) -> list[tuple[int, int]]:
    """Shapes of the approximation and of the details of each level, coarse first."""
    pywt = _pywt()
    template = pywt.wavedec2(np.zeros(shape), WAVELET, "symmetric", _levels(shape))
    return [template[0].shape, *(band.shape for details in template[1:] for band in details)]


def _pack_dwt(positions: Floats, step: float) -> bytes:
    rows = _matrix(positions)
    found = _pywt().wavedec2(rows, WAVELET, "symmetric", _levels(rows.shape))
    bands = [found[0], *(band for details in found[1:] for band in details)]
    parts = [coder.pack(quantise.forward(band, step, ROUNDING)) for band in bands]
    return varint.write(map(len, parts)) + b"".join(parts)


def _unpack_dwt(data: bytes, shape: Shape, step: float) -> Floats:
    size = (shape[0], 3 * shape[1])
    shapes = _bands(size)
    sizes, at = varint.read(data, len(shapes), 0)
    ends = np.cumsum([at, *sizes]).tolist()
    bands = [
        quantise.inverse(coder.unpack(data[a:b], band), step)
        for (a, b), band in zip(pairwise(ends), shapes, strict=True)
    ]
    details = [tuple(bands[i : i + 3]) for i in range(1, len(bands), 3)]
    rows = _pywt().waverec2([bands[0], *details], WAVELET, "symmetric")
    return _positions(rows[: size[0], : size[1]], shape)


DWT_2D = Baseline("2-D DWT", _pack_dwt, _unpack_dwt)

ALL = (CLIP_SVD, DCT_2D, DWT_2D, GLOBAL_PCA, PIECEWISE_PCA)
