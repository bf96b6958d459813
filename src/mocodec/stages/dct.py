"""The orthonormal DCT-II along time and its inverse: M ⇄ M D̃ (Hou 2014, section IV-A).

    samples ─forward─► coefficients of the lowest frequencies ─inverse─► samples, the other frequencies taken as zero

Being orthonormal, the transform keeps squared errors. NumPy only: importing scipy would take longer than decoding.

Up to `MATRIX_FRAMES` frames the transform is a product with its matrix, which is fastest, above all for a few low
frequencies. The cosines of even frequencies are symmetric about the middle of the run and those of odd frequencies
antisymmetric, so half of the matrix is enough. Longer runs go through one complex FFT of the even samples followed by
the odd ones in reverse (Makhoul, "A fast cosine transform in one and two dimensions", 1980).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..typing import Floats

MATRIX_FRAMES = 1024
"""Longer runs are transformed by FFT."""
PANEL = 16
"""Columns that `inverse_panels` transforms together."""


def forward(samples: Floats, frequencies: int | None = None, axis: int = 0) -> Floats:
    """The coefficients of the lowest `frequencies` along an axis: (frames, …) → (frequencies, …); all by default."""
    if axis:
        return np.moveaxis(forward(np.moveaxis(samples, axis, 0), frequencies), 0, axis)
    frames = len(samples)
    count = frames if frequencies is None else min(frequencies, frames)
    if frames > MATRIX_FRAMES:
        return _forward_by_fft(samples)[:count]
    if not frames:
        return np.zeros(samples.shape)
    even, odd = _half_matrices(frames)
    half = len(even)
    flat = samples.reshape(frames, -1)
    head, mirrored = flat[:half], flat[: -half - 1 : -1]
    out = np.empty((count, flat.shape[1]))
    sums = head + mirrored
    if frames % 2:
        sums[-1] /= 2  # the middle sample, which is its own mirror image
    out[::2] = even[:, : (count + 1) // 2].T @ sums
    out[1::2] = odd[:, : count // 2].T @ (head - mirrored)
    return out.reshape(count, *samples.shape[1:])


def inverse(coefficients: Floats, frames: int, axis: int = 0) -> Floats:
    """The samples of the lowest frequencies along an axis: (frequencies ≤ frames, …) → (frames, …)."""
    if axis:
        return np.moveaxis(inverse(np.moveaxis(coefficients, axis, 0), frames), 0, axis)
    known = len(coefficients)
    if not known:
        return np.zeros((frames, *coefficients.shape[1:]))
    if frames > MATRIX_FRAMES:
        return _inverse_by_fft(coefficients, frames)
    even, odd = _half_matrices(frames)
    half = len(even)
    flat = coefficients.reshape(known, -1).T
    symmetric = flat[:, ::2] @ even[:, : (known + 1) // 2].T
    antisymmetric = flat[:, 1::2] @ odd[:, : known // 2].T
    out = np.empty((len(flat), frames))
    np.subtract(symmetric, antisymmetric, out=out[:, : -half - 1 : -1])
    np.add(symmetric, antisymmetric, out=out[:, :half])
    return out.T.reshape(frames, *coefficients.shape[1:])


def _forward_by_fft(samples: Floats) -> Floats:
    """All coefficients by a real FFT: the spectrum of frequency frames − k is the conjugate of that of k."""
    frames = len(samples)
    spectrum = np.fft.rfft(np.concatenate([samples[::2], samples[1::2][::-1]]), axis=0)
    turns = _turns(frames).reshape(-1, *[1] * (samples.ndim - 1))
    out = np.empty(samples.shape)
    known = len(spectrum)
    out[:known] = spectrum.real * turns[:known].real - spectrum.imag * turns[:known].imag
    mirrored = spectrum[frames - known : 0 : -1]
    out[known:] = mirrored.real * turns[known:].real + mirrored.imag * turns[known:].imag
    return out


def inverse_panels(spectra: Floats, out: Floats) -> None:
    """`inverse` of runs (runs, frequencies, columns), in steps, into the first columns of out (runs, frames, …).

    For columns of falling bandwidth: each panel of columns is a product with as many frequencies as it has.
    """
    _, known, columns = spectra.shape
    frames = out.shape[1]
    if not is_by_matrix(frames, known):
        out[..., :columns] = inverse(spectra, frames, axis=1)
        return
    even, odd = _half_matrices_of(frames, known)
    for panel, count in panels(spectra):
        _invert_by_matrix(even, odd, spectra[:, :count, panel], out[..., panel])


def panels(spectra: Floats) -> list[tuple[slice, int]]:
    """The panels of columns of spectra (runs, frequencies, columns), and how many frequencies each has."""
    columns = spectra.shape[2]
    used = (spectra != 0).any(axis=0)
    starts = range(0, columns, PANEL)
    reach = [np.flatnonzero(used[:, first : first + PANEL].any(axis=1)).max(initial=-1) + 1 for first in starts]
    return [(slice(first, min(first + PANEL, columns)), int(count)) for first, count in zip(starts, reach, strict=True)]


def is_by_matrix(frames: int, known: int) -> bool:
    """Whether a product with the matrix inverts the lowest `known` frequencies of runs of `frames`, not an FFT."""
    return frames <= MATRIX_FRAMES or known <= frames // 2


def inverse_runs(spectra: Floats, out: Floats) -> None:
    """`inverse` of runs (runs, frequencies, columns) into out (runs, frames, columns), by the matrix."""
    _invert_by_matrix(*_half_matrices_of(out.shape[1], spectra.shape[1]), spectra, out)


def _half_matrices_of(frames: int, known: int) -> tuple[Floats, Floats]:
    """`_half_matrices` of at least the lowest `known` frequencies."""
    return _half_matrices(frames) if frames <= MATRIX_FRAMES else _low_half_matrices(frames, -(-known // 64) * 64)


def _invert_by_matrix(even: Floats, odd: Floats, spectra: Floats, out: Floats) -> None:
    known, half = spectra.shape[1], len(even)
    for one, to in zip(spectra, out, strict=True):
        symmetric = even[:, : (known + 1) // 2] @ one[::2]
        antisymmetric = odd[:, : known // 2] @ one[1::2]
        np.subtract(symmetric, antisymmetric, out=to[: -half - 1 : -1])
        np.add(symmetric, antisymmetric, out=to[:half])


def _inverse_by_fft(coefficients: Floats, frames: int) -> Floats:
    """By a real FFT, since samples are real: each frequency of the first half is mixed with its mirror image."""
    known, half = len(coefficients), frames // 2 + 1
    turns = _turns(frames).reshape(-1, *[1] * (coefficients.ndim - 1))
    scale = np.abs(turns)
    mixed = np.zeros((half, *coefficients.shape[1:]), np.complex128)
    mixed.real[:known] = coefficients[:half] / scale[: min(known, half)]
    first = frames - known + 1  # the mirror of frequency k is at frames − k
    if first < half:
        mirrored = slice(known - 1, frames - half, -1)
        mixed.imag[first:] = -coefficients[mirrored] / scale[mirrored]
    mixed *= turns[:half].conj() / scale[:half]
    samples = np.fft.irfft(mixed, frames, axis=0)
    out = np.empty_like(samples)
    out[::2] = samples[: (frames + 1) // 2]
    out[1::2] = samples[(frames + 1) // 2 :][::-1]
    return out


@lru_cache(maxsize=32)
def _turns(frames: int) -> NDArray[np.complex128]:
    """Phase of a quarter-sample shift times the orthonormal scale of each frequency, (frames,)."""
    turns = np.exp(-0.5j * np.pi * np.arange(frames) / frames) * np.sqrt(2 / frames)
    turns[0] /= np.sqrt(2)
    return turns


@lru_cache(maxsize=8)
def _low_half_matrices(frames: int, frequencies: int) -> tuple[Floats, Floats]:
    """`_half_matrices` of the lowest frequencies of a long run, from one table of cosines."""
    cosines = _cosines(frames, min(frequencies, frames))[: (frames + 1) // 2]
    return np.ascontiguousarray(cosines[:, ::2]), np.ascontiguousarray(cosines[:, 1::2])


def _cosines(frames: int, frequencies: int) -> Floats:
    """The lowest frequencies of the orthonormal DCT, (frames, frequencies), by cosines of sums from small tables."""
    at = (np.arange(frames)[:, None] + 0.5) * (np.pi / frames)
    coarse, fine = at * np.arange(0, frequencies, 16), at * np.arange(16)
    cosines = (np.cos(coarse) * np.sqrt(2 / frames))[:, :, None] * np.cos(fine)[:, None]
    cosines -= (np.sin(coarse) * np.sqrt(2 / frames))[:, :, None] * np.sin(fine)[:, None]
    cosines = cosines.reshape(frames, -1)[:, :frequencies]
    cosines[:, :1] /= np.sqrt(2)  # there is none where all runs are zero
    return cosines


@lru_cache(maxsize=16)
def _half_matrices(frames: int) -> tuple[Floats, Floats]:
    """The first half of the samples of the even and of the odd frequencies' cosines, (⌈frames / 2⌉, frequencies)."""
    at = np.arange((frames + 1) // 2)[:, None] + 0.5
    cosines = np.cos(np.pi / frames * at * np.arange(frames)) * np.sqrt(2 / frames)
    cosines[:, 0] /= np.sqrt(2)
    return np.ascontiguousarray(cosines[:, ::2]), np.ascontiguousarray(cosines[:, 1::2])
