"""What makes motion capture data special, measured (section III): smooth rows, rough columns, few dimensions.

    v̄, σ̄               how little a row changes from frame to frame, beside how much it varies     Table I
    singular values     of the sequence, of clips, of clips as rows                                   figures 2, 3
    DCT of a column, of a row    spread over all frequencies; only the lowest                         figures 4, 5

Positions are (frames, points, 3) without gaps, in metres; M (3n, frames) has all x, then all y, then all z.
"""

from __future__ import annotations

import numpy as np

from ...motion import Floats
from ...stages import dct


def matrix(positions: Floats) -> Floats:
    """M, (3n, frames)."""
    return positions.transpose(2, 1, 0).reshape(-1, len(positions))


def variation(m: Floats) -> float:
    """v̄ = ‖∇ Mᵀ‖₁ / 3nf, section III-A."""
    return float(np.abs(np.diff(m, axis=1)).sum() / m.size)


def spread(m: Floats) -> float:
    """σ̄ = Σ σ_i over the rows, section III-A."""
    return float(m.std(axis=1).sum())


def singular_values(m: Floats) -> Floats:
    """The singular values of a matrix over the largest, falling."""
    values = np.linalg.svd(m, compute_uv=False)
    return np.asarray(values / values[0] if len(values) and values[0] > 0 else values, np.float64)


def clips(m: Floats, length: int, count: int, seed: int = 0) -> list[Floats]:
    """So many clips of this length at random places, (3n, length) each; fewer frames make shorter ones."""
    starts = np.random.default_rng(seed).integers(0, max(1, m.shape[1] - length + 1), count)
    return [m[:, start : start + length] for start in starts.tolist()]


def unfolded(m: Floats, length: int) -> Floats:
    """Clips as rows, (J, 3n · length): the third unfolding of the tensor of section III-C, less what fills no clip."""
    count = m.shape[1] // length
    return m[:, : count * length].reshape(len(m), count, length).transpose(1, 0, 2).reshape(count, len(m) * length)


def column_spectrum(m: Floats, frame: int) -> Floats:
    """DCT of one column of M over the points, (3n,): wide. Figure 4."""
    return dct.forward(m[:, frame : frame + 1])[:, 0]


def row_spectrum(m: Floats, row: int) -> Floats:
    """DCT of one row of M along time, (frames,): narrow. Figure 5."""
    return dct.forward(m[row][:, None])[:, 0]


def coefficients_for(spectrum: Floats, share: float = 0.9999) -> int:
    """How many coefficients, the largest first, hold this share of the energy."""
    energy = np.sort(spectrum**2)[::-1]
    total = energy.sum()
    return int(np.searchsorted(np.cumsum(energy), share * total)) + 1 if total > 0 else 0
