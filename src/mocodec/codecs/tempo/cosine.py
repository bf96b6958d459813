"""The orthonormal DCT-II along the first axis and its inverse, with NumPy alone (scipy takes long to import).

Few frames are multiplied by a matrix, which is faster, most of all for the few lowest frequencies: even frequencies are
mirror images about the middle, odd ones too but for their sign, so half of the matrix does. For many, Makhoul, "A fast
cosine transform in one and two dimensions", 1980: one complex transform of the samples, evens first and the odds after
them in reverse.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...motion import Floats

MATRIX_FRAMES = 1024


def forward(samples: Floats) -> Floats:
    """Samples (frames, …) → coefficients (frequencies, …), as many."""
    frames = len(samples)
    if 0 < frames <= MATRIX_FRAMES:
        even, odd = _half_matrices(frames)
        half = len(even)
        head, mirrored = samples.reshape(frames, -1)[:half], samples.reshape(frames, -1)[: -half - 1 : -1]
        out = np.empty((frames, head.shape[1]))
        both = head + mirrored
        if frames % 2:
            both[-1] /= 2
        out[::2] = even.T @ both
        out[1::2] = odd.T @ (head - mirrored)
        return out.reshape(samples.shape)
    spectrum = np.fft.fft(np.concatenate([samples[::2], samples[1::2][::-1]]), axis=0)
    out = (spectrum * _turns(frames).reshape(-1, *[1] * (samples.ndim - 1))).real
    return out


def inverse(coefficients: Floats, frames: int) -> Floats:
    """The first coefficients (k ≤ frames, …) → samples (frames, …)."""
    known = len(coefficients)
    if not known:
        return np.zeros((frames, *coefficients.shape[1:]))
    if frames <= MATRIX_FRAMES:
        even, odd = _half_matrices(frames)
        half = len(even)
        flat = coefficients.reshape(known, -1).T
        alike = flat[:, ::2] @ even[:, : (known + 1) // 2].T
        opposed = flat[:, 1::2] @ odd[:, : known // 2].T
        out = np.empty((len(flat), frames))
        np.subtract(alike, opposed, out=out[:, : -half - 1 : -1])
        np.add(alike, opposed, out=out[:, :half])
        return out.T.reshape(frames, *coefficients.shape[1:])
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
def _half_matrices(frames: int) -> tuple[Floats, Floats]:
    """The first half of the samples of every even frequency, and of every odd one, (half the frames, frequencies)."""
    at = np.arange((frames + 1) // 2)[:, None] + 0.5
    cosines = np.cos(np.pi / frames * at * np.arange(frames)) * np.sqrt(2 / frames)
    cosines[:, 0] /= np.sqrt(2)
    return np.ascontiguousarray(cosines[:, ::2]), np.ascontiguousarray(cosines[:, 1::2])
