"""The measurements of section III, "Human Mocap Data Analysis".

    v̄, σ̄               mean change of a row from frame to frame; sum of the rows' standard deviations   Table I
    singular values     of a sequence, of its clips, of its unfolding                                    figures 2, 3
    DCT spectra         of a column of M: wide; of a row of M: narrow                                    figures 4, 5

Positions are (frames, points, 3) in metres, without gaps. M is (3n, frames): all x, then all y, then all z.
"""

from __future__ import annotations

import numpy as np

from ...stages import dct
from ...typing import Floats


def matrix(positions: Floats) -> Floats:
    """M, (3n, frames)."""
    return positions.transpose(2, 1, 0).reshape(-1, len(positions))


def mean_variation(m: Floats) -> float:
    """v̄ = ‖∇ Mᵀ‖₁ / 3nf, section III-A."""
    return float(np.abs(np.diff(m, axis=1)).sum() / m.size)


def total_deviation(m: Floats) -> float:
    """σ̄ = Σ σ_i, the sum of the rows' standard deviations, section III-A."""
    return float(m.std(axis=1).sum())


def singular_values(m: Floats) -> Floats:
    """The singular values of a matrix in descending order, normalised by the largest."""
    values = np.linalg.svd(m, compute_uv=False)
    return np.asarray(values / values[0] if len(values) and values[0] > 0 else values, np.float64)


def random_clips(m: Floats, length: int, count: int, seed: int = 0) -> list[Floats]:
    """`count` clips at random places, (3n, length) each; shorter if M has fewer frames. Section III-B."""
    starts = np.random.default_rng(seed).integers(0, max(1, m.shape[1] - length + 1), count)
    return [m[:, start : start + length] for start in starts.tolist()]


def unfold(m: Floats, length: int) -> Floats:
    """Clips as rows, (J, 3n · length): the unfolded tensor of section III-C. The last incomplete clip is left out."""
    count = m.shape[1] // length
    return m[:, : count * length].reshape(len(m), count, length).transpose(1, 0, 2).reshape(count, len(m) * length)


def column_spectrum(m: Floats, frame: int) -> Floats:
    """DCT of one column of M, across the points, (3n,). Figure 4."""
    return dct.forward(m[:, frame : frame + 1])[:, 0]


def row_spectrum(m: Floats, row: int) -> Floats:
    """DCT of one row of M, along time, (frames,). Figure 5."""
    return dct.forward(m[row][:, None])[:, 0]


def coefficients_for_energy(spectrum: Floats, share: float = 0.9999) -> int:
    """The smallest number of coefficients that together hold this share of the energy."""
    energy = np.sort(spectrum**2)[::-1]
    total = energy.sum()
    return int(np.searchsorted(np.cumsum(energy), share * total)) + 1 if total > 0 else 0
