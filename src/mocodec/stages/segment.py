"""Cutting a motion along time: into clips of equal length (Hou), or where the poses change their distribution (Liu).

equal_length   frames, length ──► slices
ppca           poses ──► slices, and the distance curves that the cuts were read from (Liu & McMillan 2006, figure 3)
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from .. import native
from ..typing import Floats, Integers

LEADING = 24
"""The leading directions that `ppca` tracks as its model grows; far fewer hold τ of the variance in practice."""

STILL_M = 1e-4
"""The standard deviation, metres, of the noise of a camera system: no direction of a model has less."""


def equal_length(frames: int, length: int) -> list[slice]:
    """Runs of `length` frames; the last may be shorter."""
    return [slice(start, min(start + length, frames)) for start in range(0, frames, length)]


def no_longer_than(segments: Sequence[slice], longest: int) -> list[slice]:
    """The segments, those of more than `longest` frames divided into equal parts."""
    result: list[slice] = []
    for one in segments:
        count = one.stop - one.start
        parts = -(-count // longest)
        edges = [one.start + count * i // parts for i in range(parts + 1)]
        result += [slice(a, b) for a, b in pairwise(edges)]
    return result


class Curve(NamedTuple):
    """One search for a cut: the frames at which the model ended, H at each, and the frame of the cut, if any."""

    frames: Integers
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
    (T); grow K by `step` (Δ) and repeat; cut at the peak that rises more than `rise` (R) above the valley before it.
    Repeat behind the cut until fewer than K + T frames remain. Every segment has at least K or T frames, unless there
    is only one.

    Sums are updated as the model grows, so the time is linear in the number of frames.
    """
    frames = len(poses)
    centred = poses - poses.mean(axis=0)
    segments: list[slice] = []
    curves: list[Curve] = []
    start = 0
    while frames - start >= initial + ahead:
        curve = _search(centred, start, (initial, ahead, step), kept, rise)
        curves.append(curve)
        if curve.cut is None:
            break
        segments.append(slice(start, curve.cut))
        start = curve.cut
    segments.append(slice(start, frames))
    return Segmentation(segments, curves)


def _search(poses: Floats, start: int, lengths: tuple[int, int, int], kept: float, rise: float) -> Curve:
    """Grow one model from `start` until a peak of H follows a valley, or the frames end."""
    initial, ahead, step = lengths
    ends = np.arange(start + initial, len(poses) - ahead + 1, step)
    if (kernel := native.kernel("ppca_search")) is not None and poses.shape[1]:
        found, last = kernel(
            poses[start:],
            initial,
            ahead,
            step,
            kept,
            rise,
            LEADING,
            STILL_M,
            lambda covariance: _leading(covariance, None),
        )
        return Curve(ends[: len(found)], found, None if last < 0 else int(ends[last]))
    distances: list[float] = []
    valley = np.inf
    total, squares = np.zeros(poses.shape[1]), np.zeros((poses.shape[1],) * 2)
    directions = None
    modelled = start
    for i, end in enumerate(ends):
        new = poses[modelled:end]
        total += new.sum(axis=0)
        squares += new.T @ new
        modelled = end
        mean = total / (end - start)
        covariance = squares / (end - start) - np.outer(mean, mean)
        variances, directions = _leading(covariance, directions)
        away = poses[end : end + ahead] - mean
        distances.append(_distance(variances, directions, float(np.trace(covariance)), away, kept))
        if i < 2:
            continue
        before, here, after = distances[-3:]
        if before >= here <= after:
            valley = min(valley, here)
        elif before < here >= after and here - valley > rise:
            return Curve(ends[: i + 1], np.array(distances), int(ends[i - 1]))
    return Curve(ends, np.array(distances), None)


def _leading(covariance: Floats, before: Floats | None) -> tuple[Floats, Floats]:
    """The leading variances, strongest first, and their directions, (dimensions, LEADING) at most.

    From the directions Q of a model that is a few frames shorter, one step of subspace iteration finds them many times
    faster than an eigendecomposition: C Q = U S Vᵀ, by way of the small matrix (C Q)ᵀ (C Q). A model without movement
    has no directions.
    """
    if np.trace(covariance) <= len(covariance) * STILL_M**2:
        return np.zeros(0), np.zeros((len(covariance), 0))
    if before is None or before.shape[1] < LEADING:
        variances, directions = np.linalg.eigh(covariance)
        return np.maximum(variances[: -LEADING - 1 : -1], 0.0), directions[:, : -LEADING - 1 : -1]
    image = covariance @ before
    squared, turn = np.linalg.eigh(image.T @ image)
    squared, turn = squared[::-1], turn[:, ::-1]
    reliable = squared > 1e-14 * squared[0]
    variances = np.sqrt(squared[reliable])
    return variances, image @ (turn[:, reliable] / variances)


def _distance(variances: Floats, directions: Floats, total: float, away: Floats, kept: float) -> float:
    """H: the average of (x − μ)ᵀ C⁻¹ (x − μ), C = W Wᵀ + σ²I: p leading variances, σ² the average of the rest.

    total: the variance of all directions. away (frames, dimensions): x − μ.
    """
    dimensions = away.shape[1]
    p = min(int(np.searchsorted(np.cumsum(variances), kept * total)) + 1, len(variances), max(dimensions - 1, 1))
    rest = (total - variances[:p].sum()) / max(dimensions - p, 1)
    along = (away @ directions[:, :p]) ** 2
    across = np.einsum("fd,fd->", away, away) - along.sum()
    within = (along.sum(axis=0) / np.maximum(variances[:p], STILL_M**2)).sum()
    return float(within + max(across, 0.0) / max(rest, STILL_M**2)) / len(away)
