"""Truncated discrete cosine transform along time: M ⇄ M D̃ (Hou 2014, section IV-A).

    samples (…, frames, lanes) ─forward─► spectrum (…, frequencies, lanes) ─inverse─► samples, without what was left out

The transform is orthonormal, so squared errors are the same on both sides.
"""

from __future__ import annotations

import numpy as np

from ..motion import Floats


def forward(samples: Floats, frequencies: int | None = None) -> Floats:
    """The lowest `frequencies` DCT-II coefficients: (…, frames, lanes) → (…, frequencies, lanes); all by default."""
    from scipy import fft

    return np.asarray(fft.dct(samples, axis=-2, norm="ortho"))[..., :frequencies, :]


def inverse(spectrum: Floats, frames: int) -> Floats:
    """Samples of the lowest frequencies: (…, frequencies, lanes) → (…, frames, lanes), the others being zero."""
    from scipy import fft

    if spectrum.shape[-2] == 0:
        return np.zeros((*spectrum.shape[:-2], frames, spectrum.shape[-1]))
    return np.asarray(fft.idct(spectrum, n=frames, axis=-2, norm="ortho"))
