"""The methods that the papers compare with, on this package's quantiser and entropy coder.

    clip-wise SVD   a left basis and its coefficients for each clip              Hou 2014, equation (1)
    2-D DCT         DCT along time and along the columns of M                    Hou 2014, equation (2)
    2-D DWT         biorthogonal 4.4 wavelets (as in JPEG 2000) along both       Hou 2014, section VI; [bench] extra
    global PCA      one mean and basis, coefficients along time                  Liu & McMillan 2006, Table 3
    piecewise PCA   the same for each of equal segments                          Liu & McMillan 2006, Table 3

Each encodes positions (frames, points, 3) without gaps at a quantisation step in metres; its bytes include all side
information. Decoding needs the bytes and the shape. Baselines are for comparison tables, not codecs: they have no
container, no error bound and no slices.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np

from ..entropy import coder, varint
from ..errors import Corrupt, MissingExtra
from ..stages import basis, dct, quantise
from ..typing import Floats, Integers

Shape = tuple[int, int, int]

CLIP_FRAMES = 280
SEGMENT_FRAMES = 1120

ROUNDING = 0.4
"""Rounding offset of the quantiser (`quantise.forward`) for all baselines: a dead zone, near the best trade."""

COMPONENT_ENERGY = 32.0
"""A component is kept if its energy exceeds this many squared steps; a weaker one does not justify its basis vector."""

WAVELET = "bior4.4"

STEP_OF_MEAN = 3.0
"""A typical quantisation step as a multiple of the mean error."""


@dataclass(frozen=True)
class Baseline:
    """One method. pack: positions, step → bytes; unpack: bytes, shape, step → positions."""

    name: str
    pack: Callable[[Floats, float], bytes]
    unpack: Callable[[bytes, Shape, float], Floats]

    def encode(self, positions: Floats, step: float) -> bytes:
        """Bytes of positions (frames, points, 3) without gaps. step: metres, rounded to the ladder of steps."""
        rung = quantise.rung(step)
        return struct.pack("<h", rung) + self.pack(np.asarray(positions, np.float64), quantise.step(rung))

    def decode(self, data: bytes, shape: Shape) -> Floats:
        """Positions of this shape. Raises Corrupt."""
        if len(data) < 2:
            raise Corrupt(f"{self.name}: the data have {len(data)} bytes, fewer than the 2 of the step")
        return self.unpack(data[2:], shape, quantise.step(struct.unpack_from("<h", data)[0]))

    def initial_step(self, mean_error: float) -> float:
        """The step in metres at which a search for this mean error in metres begins."""
        return STEP_OF_MEAN * mean_error

    def version(self) -> str:
        """The name of the package that provides the method."""
        return "mocodec"


# ------------------------------------------------------------------------------------------- bases fitted to the data


def _pack_pca(rows: Floats, step: float) -> bytes:
    """Mean, basis and coefficients of rows (frames, 3 points): the number of components, sizes, parts."""
    mean_step = step / np.sqrt(len(rows))
    mean = quantise.forward(rows.mean(axis=0), mean_step)
    centred = rows - mean * mean_step
    vectors, energies = basis.fit(centred.T @ centred)
    k = int((energies > COMPONENT_ENERGY * step**2).sum())
    precision = np.minimum.accumulate(basis.precisions(energies[:k], step))
    rounded = basis.rounded(vectors[:, :k], precision)
    numbers = quantise.forward(centred @ rounded, step, ROUNDING)
    parts = [
        coder.pack(mean.reshape(-1, 3)),
        coder.pack(precision[:, None]),
        basis.pack(vectors[:, :k], precision, _previous_point(rows.shape[1])),
        coder.pack(numbers),
    ]
    return varint.write([k, *map(len, parts)]) + b"".join(parts)


def _unpack_pca(data: bytes, at: int, shape: Shape, step: float) -> tuple[Floats, int]:
    """The inverse of `_pack_pca` from data[at:]: positions, and the offset after them. Raises Corrupt."""
    frames, points, _ = shape
    (k, *sizes), at = varint.read(data, 5, at)
    if k > 3 * points:
        raise Corrupt(f"a baseline has {k} components, more than its {3 * points} coordinates")
    ends = np.cumsum([at, *sizes]).tolist()
    parts = [data[a:b] for a, b in pairwise(ends)]
    mean = coder.unpack(parts[0], (points, 3)).ravel() * (step / np.sqrt(frames))
    precision = coder.unpack(parts[1], (k, 1))[:, 0]
    rounded = basis.unpack(parts[2], 3 * points, precision, _previous_point(3 * points))
    curves = quantise.inverse(coder.unpack(parts[3], (frames, k)), step)
    return (curves @ rounded.T + mean).reshape(shape), ends[-1]


def _previous_point(dimensions: int) -> Integers:
    """Row that predicts each row of a basis: the same coordinate of the previous point, −1 for the first point."""
    return np.maximum(np.arange(dimensions) - 3, -1)


def _pack_clips(positions: Floats, step: float, length: int) -> bytes:
    """`_pack_pca` of each run of `length` frames."""
    rows = positions.reshape(len(positions), -1)
    return b"".join(_pack_pca(rows[a : a + length], step) for a in range(0, len(rows), length))


def _unpack_clips(data: bytes, shape: Shape, step: float, length: int) -> Floats:
    """The inverse of `_pack_clips`. Raises Corrupt."""
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
"""Hou 2014, equation (1): U_iᵀ M_i V_i. The product S̄_i V_iᵀ is coded as one matrix, cheaper than S̄_i and V_i apart."""

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
    """Mᵀ of Hou 2014, section III, (frames, 3n): all x, then all y, then all z."""
    return positions.transpose(0, 2, 1).reshape(len(positions), -1)


def _positions(rows: Floats, shape: Shape) -> Floats:
    """The inverse of `_matrix`."""
    return rows.reshape(shape[0], 3, shape[1]).transpose(0, 2, 1)


def _pack_dct(positions: Floats, step: float) -> bytes:
    parts: list[bytes] = []
    rows = _matrix(positions)
    for start in range(0, len(rows), CLIP_FRAMES):
        clip = rows[start : start + CLIP_FRAMES]
        coefficients = dct.forward(np.ascontiguousarray(dct.forward(clip).T)).T
        part = coder.pack(quantise.forward(coefficients, step, ROUNDING))
        parts.append(varint.write([len(part)]) + part)
    return b"".join(parts)


def _unpack_dct(data: bytes, shape: Shape, step: float) -> Floats:
    rows: list[Floats] = []
    at = 0
    for start in range(0, shape[0], CLIP_FRAMES):
        frames = min(CLIP_FRAMES, shape[0] - start)
        (size,), at = varint.read(data, 1, at)
        coefficients = quantise.inverse(coder.unpack(data[at : at + size], (frames, 3 * shape[1])), step)
        at += size
        rows.append(dct.inverse(np.ascontiguousarray(dct.inverse(coefficients.T, 3 * shape[1]).T), frames))
    return _positions(np.concatenate(rows), shape)


DCT_2D = Baseline("2-D DCT", _pack_dct, _unpack_dct)
"""Hou 2014, equation (2): D_lᵀ M_i D_r."""


def _pywt() -> Any:
    """The PyWavelets package. Raises MissingExtra."""
    try:
        return import_module("pywt")
    except ImportError as missing:
        raise MissingExtra("the 2-D DWT", "bench") from missing


def _levels(shape: tuple[int, int]) -> int:
    """Number of decomposition levels: the most that the shorter side allows."""
    return int(_pywt().dwtn_max_level(shape, WAVELET))


def _bands(shape: tuple[int, int]) -> list[tuple[int, int]]:
    """Shapes of the approximation and of the three detail bands of each level, coarsest level first."""
    pywt = _pywt()
    template = pywt.wavedec2(np.zeros(shape), WAVELET, "symmetric", _levels(shape))
    return [template[0].shape, *(band.shape for details in template[1:] for band in details)]


def _pack_dwt(positions: Floats, step: float) -> bytes:
    rows = _matrix(positions)
    approximation, *levels = _pywt().wavedec2(rows, WAVELET, "symmetric", _levels(rows.shape))
    bands = [approximation, *(band for details in levels for band in details)]
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

BASELINES = (CLIP_SVD, DCT_2D, DWT_2D, GLOBAL_PCA, PIECEWISE_PCA)
