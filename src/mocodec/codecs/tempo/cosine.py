"""The orthonormal DCT-II along the first axis and its inverse, with NumPy alone (scipy takes long to import).

Makhoul, "A fast cosine transform in one and two dimensions", 1980: one complex transform of the samples, evens first
and the odds after them in reverse.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...motion import Floats

MATRIX_FRAMES = 1024
"""Up to here the inverse is a product with a matrix, which is faster for the few lowest frequencies."""


def forward(samples: Floats) -> Floats:
    """Samples (frames, …) → coefficients (frequencies, …), as many."""
    frames = len(samples)
    spectrum = np.fft.fft(np.concatenate([samples[::2], samples[1::2][::-1]]), axis=0)
    out = (spectrum * _turns(frames).reshape(-1, *[1] * (samples.ndim - 1))).real
    return out


def inverse(coefficients: Floats, frames: int) -> Floats:
    """The first coefficients (k ≤ frames, …) → samples (frames, …)."""
    known = len(coefficients)
    if not known:
        return np.zeros((frames, *coefficients.shape[1:]))
    if frames <= MATRIX_FRAMES:
        return (_matrix(frames)[:, :known] @ coefficients.reshape(known, -1)).reshape(frames, *coefficients.shape[1:])
    turns = _turns(frames).reshape(-1, *[1] * (coefficients.ndim - 1))
    scale = np.abs(turns)
    padded = np.zeros((frames, *coefficients.shape[1:]))
    padded[:known] = coefficients / scale[:known]
    mirrored = np.zeros_like(padded)
    mirrored[1:] = padded[:0:-1]
    mixed = np.fft.ifft((padded - 1j * mirrored) * (turns.conj() / scale), axis=0).real
    out = np.empty_like(padded)
    out[::2] = mixed[: (frames + 1) // 2]
    out[1::2] = mixed[(frames + 1) // 2 :][::-1]
    return out


@lru_cache(maxsize=32)
def _turns(frames: int) -> NDArray[np.complex128]:
    """Quarter-sample shifts with the orthonormal scale of each frequency."""
    turns = np.exp(-0.5j * np.pi * np.arange(frames) / frames) * np.sqrt(2 / frames)
    turns[0] /= np.sqrt(2)
    return turns


@lru_cache(maxsize=16)
def _matrix(frames: int) -> Floats:
    """The inverse as a matrix, (frames, frequencies)."""
    cosines = np.cos(np.pi / frames * (np.arange(frames)[:, None] + 0.5) * np.arange(frames)) * np.sqrt(2 / frames)
    cosines[:, 0] /= np.sqrt(2)
    return cosines
