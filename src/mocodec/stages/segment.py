"""Cutting a motion along time: into clips of equal length (Hou), or where the poses change their distribution (Liu).

equal_length   frames, length ──► slices
ppca           poses ──► slices, and the distance curves that the cuts were read from (Liu & McMillan 2006, figure 3)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..motion import Floats

LEADING = 32
"""Directions of the whole sequence that `ppca` looks at one by one; what lies outside counts as discarded variance."""

STILL_M = 1e-4
"""Variance below (0.1 mm)² in a direction is the noise of a camera system; no distribution is narrower."""


def equal_length(frames: int, length: int) -> list[slice]:
    """Runs of `length` frames; the last may be shorter."""
    return [slice(start, min(start + length, frames)) for start in range(0, frames, length)]


class Curve(NamedTuple):
    """One search for a cut: H for each end of the model, a frame of the sequence, and where it cut, if it did."""

    frames: NDArray[np.int64]
    distances: Floats
    cut: int | None


class Segmentation(NamedTuple):
    segments: list[slice]
    curves: list[Curve]


def ppca(
    poses: Floats,
    initial: int = 200,
    ahead: int = 150,
    step: int = 10,
    kept: float = 0.95,
    rise: float = 500.0,
) -> Segmentation:
    """Segments of simple motion, by probabilistic PCA. Liu & McMillan 2006, section 3.2, after Barbič et al. 2004.

    poses (frames, dimensions), metres. Model the first `initial` frames (K) as a Gaussian whose leading directions hold
    the fraction `kept` (τ) of the variance; H is the average squared Mahalanobis distance of the next `ahead` frames
    (T); grow K by `step` (Δ) and repeat; cut at the peak that rises more than `rise` (R) above the valley before it. Go
    on behind the cut until fewer than K + T frames remain. No segment but an only one is shorter than both K and T.

    Sums are carried along, so that time grows linearly with frames however long a segment is.
    """
    frames = len(poses)
    leading, outside = _leading_directions(poses)
    segments: list[slice] = []
    curves: list[Curve] = []
    start = 0
    while frames - start >= initial + ahead:
        curve = _search(leading[start:], outside[start:], poses.shape[1], start, (initial, ahead, step), kept, rise)
        curves.append(curve)
        if curve.cut is None:
            break
        segments.append(slice(start, curve.cut))
        start = curve.cut
    segments.append(slice(start, frames))
    return Segmentation(segments, curves)


def _leading_directions(poses: Floats) -> tuple[Floats, Floats]:
    """Poses in the sequence's own LEADING principal directions, and the squared length that lies outside, per frame."""
    centred = poses - poses.mean(axis=0)
    if centred.shape[1] <= LEADING:
        return centred, np.zeros(len(centred))
    _, vectors = np.linalg.eigh(centred.T @ centred)
    leading = centred @ vectors[:, -LEADING:]
    outside = np.einsum("fd,fd->f", centred, centred) - np.einsum("fd,fd->f", leading, leading)
    return leading, np.maximum(outside, 0.0)


def _search(
    poses: Floats, outside: Floats, dimensions: int, first: int, lengths: tuple[int, int, int], kept: float, rise: float
) -> Curve:
    """Grow one model until a peak of H follows a valley, or the frames end."""
    initial, ahead, step = lengths
    total = poses[:initial].sum(axis=0)
    squares = poses[:initial].T @ poses[:initial]
    outer = outside.cumsum()
    ends: list[int] = []
    distances: list[float] = []
    valley = np.inf
    for end in range(initial, len(poses) - ahead + 1, step):
        if end > initial:
            new = poses[end - step : end]
            total = total + new.sum(axis=0)
            squares = squares + new.T @ new
        ends.append(first + end)
        distances.append(
            _distance(total / end, squares / end, outer[end - 1] / end, poses[end : end + ahead],
                      (outer[end + ahead - 1] - outer[end - 1]) / ahead, dimensions, kept)
        )  # fmt: skip
        if len(distances) < 3:
            continue
        before, here, after = distances[-3:]
        if before >= here <= after:
            valley = min(valley, here)
        elif before < here >= after and here - valley > rise:
            return Curve(np.array(ends), np.array(distances), ends[-2])
    return Curve(np.array(ends), np.array(distances), None)


def _distance(
    mean: Floats,
    second_moment: Floats,
    outside: float,
    ahead: Floats,
    ahead_outside: float,
    dimensions: int,
    kept: float,
) -> float:
    """H: the average of (x − μ)ᵀ C⁻¹ (x − μ), C = W Wᵀ + σ²I: p leading variances, σ² the average of the rest."""
    variances, directions = np.linalg.eigh(second_moment - np.outer(mean, mean))
    variances, directions = np.maximum(variances[::-1], 0.0), directions[:, ::-1]
    whole = variances.sum() + outside
    p = int(np.searchsorted(np.cumsum(variances), kept * whole)) + 1
    p = min(p, len(variances), dimensions - 1)
    rest = max((whole - variances[:p].sum()) / max(dimensions - p, 1), STILL_M**2)
    away = ahead - mean
    along = (away @ directions[:, :p]) ** 2
    across = np.einsum("fd,fd->", away, away) / len(away) + ahead_outside - along.sum() / len(away)
    return float((along.mean(axis=0) / np.maximum(variances[:p], STILL_M**2)).sum() + max(across, 0.0) / rest)
