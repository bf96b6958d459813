"""How far one point cloud is from another: D1, D2, luma, and rendered views.

D1 and D2 are the symmetric errors of MPEG's pc_error: the root mean square error from a to b and from b to a, the
larger of the two. On sparse clouds, a codec that resamples the surface scores an error even if its surface is exact. To
judge it, measure a second perfect sample of the same surface as well: its error is the resampling floor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from ..geometry.normals import estimate
from ..pointcloud import PointClouds
from ..typing import AnyInteger, Bytes, Floats
from . import splats

PEAK_M = 1.8
"""Peak value of D1 and D2 in decibels: the height of a person, metres."""


def d1(a: PointClouds, b: PointClouds, frame: int) -> float:
    """D1, the symmetric point-to-point error of a frame, metres: the larger of the two root mean square distances."""
    p, q = splats.finite_points(a, frame)[0], splats.finite_points(b, frame)[0]
    return max(float(np.sqrt(np.mean(gap**2))) for gap in (_nearest(p, q)[0], _nearest(q, p)[0]))


def d2(a: PointClouds, b: PointClouds, frame: int) -> float:
    """D2, the symmetric point-to-plane error of a frame, metres, along the normals of `a` (estimated if missing)."""
    p, q = splats.finite_points(a, frame)[0], splats.finite_points(b, frame)[0]
    normals = estimate(p) if a.normals is None else np.asarray(a.normals[frame])
    _, to_q = _nearest(p, q)
    _, to_p = _nearest(q, p)
    from_a = np.sum((p - q[to_q]) * normals, axis=1)
    from_b = np.sum((q - p[to_p]) * normals[to_p], axis=1)
    return max(float(np.sqrt(np.mean(gap**2))) for gap in (from_a, from_b))


def y_psnr(a: PointClouds, b: PointClouds, frame: int) -> float:
    """PSNR of the luma (BT.709, peak 255) between nearest points, dB.

    The lower of the two directions; NaN where either cloud has no colours.
    """
    (p, c), (q, d) = splats.finite_points(a, frame), splats.finite_points(b, frame)
    if c is None or d is None:
        return float("nan")
    errors = (luma(c) - luma(d)[_nearest(p, q)[1]], luma(d) - luma(c)[_nearest(q, p)[1]])
    return min(psnr(float(np.mean(error**2))) for error in errors)


def views_psnr(a: PointClouds, b: PointClouds, frame: int, size: int = 256) -> float:
    """Mean PSNR of six rendered views, dB (Lien and Bajcsy 2006, table 1). size: pixels of a view, each side.

    The paper prints rmse = √Σ|I − J|² without dividing by the number of samples. Here it is the root of the mean over
    all pixels and channels of a view, background included.
    """
    pairs = zip(splats.views(a, frame, size=size), splats.views(b, frame, like=a, size=size), strict=True)
    return float(np.mean([psnr(float(np.mean((x.astype(float) - y) ** 2))) for x, y in pairs]))


def psnr(mean_square: float, peak: float = 255.0) -> float:
    """Peak signal-to-noise ratio, dB, at most 99 (which also stands for no error)."""
    return 99.0 if mean_square <= 0 else min(99.0, float(10 * np.log10(peak**2 / mean_square)))


def luma(colours: Bytes) -> Floats:
    """BT.709 luma (n,) of colours (n, 3)."""
    return colours.astype(float) @ np.array([0.2126, 0.7152, 0.0722])


MEASURES: dict[str, Callable[[PointClouds, PointClouds, int], float]] = {
    "d1_m": d1, "d2_m": d2, "y_psnr_db": y_psnr, "views_psnr_db": views_psnr,
}  # fmt: skip


def compare(a: PointClouds, b: PointClouds, frames: Iterable[int]) -> dict[str, float]:
    """Every measure, averaged over those of `frames` that have points in both; D1 and D2 also in dB against PEAK_M."""
    chosen = [f for f in frames if has_points(a, f) and has_points(b, f)]
    result = {name: float(np.mean([measure(a, b, f) for f in chosen])) for name, measure in MEASURES.items()}
    for name in ("d1", "d2"):
        result[f"{name}_db"] = psnr(result[f"{name}_m"] ** 2, PEAK_M)
    return result


def has_points(clouds: PointClouds, frame: int) -> bool:
    """Whether a frame has any point with finite coordinates."""
    return bool(np.isfinite(clouds.positions[frame]).all(axis=1).any())


def _nearest(p: Floats, q: Floats) -> tuple[Floats, AnyInteger]:
    """Distance from each point of p to the nearest point of q, and the index of that point."""
    from scipy.spatial import KDTree

    distance, row = KDTree(q).query(p)
    return np.asarray(distance), np.asarray(row)
