"""How far one point cloud is from another: D1, D2, luma, and the pictures that a viewer sees.

D1 and D2 are the symmetric errors of MPEG's pc_error: the worse of the two directions' root mean squares. None of them
can tell a resampling codec from a bad one on sparse clouds by itself, so `floor` says what a second perfect sample of
the same surface would score.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry.normals import estimate
from ...motion import Floats
from ...pointcloud import PointClouds
from . import splats

PEAK_M = 1.8  # metres: what D1 and D2 in decibels are taken against, a person's height


def d1(a: PointClouds, b: PointClouds, frame: int) -> float:
    """Symmetric point-to-point error of a frame, metres: max of the two root mean square distances."""
    p, q = splats.finite(a, frame)[0], splats.finite(b, frame)[0]
    return max(float(np.sqrt(np.mean(gap**2))) for gap in (_nearest(p, q)[0], _nearest(q, p)[0]))


def d2(a: PointClouds, b: PointClouds, frame: int) -> float:
    """Symmetric point-to-plane error of a frame, metres, along the normals of `a` (estimated where it has none)."""
    p, q = splats.finite(a, frame)[0], splats.finite(b, frame)[0]
    normals = estimate(p) if a.normals is None else np.asarray(a.normals[frame])
    _, to_q = _nearest(p, q)
    _, to_p = _nearest(q, p)
    forth = np.sum((p - q[to_q]) * normals, axis=1)
    back = np.sum((q - p[to_p]) * normals[to_p], axis=1)
    return max(float(np.sqrt(np.mean(gap**2))) for gap in (forth, back))


def y_psnr(a: PointClouds, b: PointClouds, frame: int) -> float:
    """Decibels of the luma (BT.709, peak 255) between nearest points, the worse of both directions."""
    (p, c), (q, d) = splats.finite(a, frame), splats.finite(b, frame)
    if c is None or d is None:
        return float("nan")
    errors = (luma(c) - luma(d)[_nearest(p, q)[1]], luma(d) - luma(c)[_nearest(q, p)[1]])
    return min(psnr(float(np.mean(error**2))) for error in errors)


def views_psnr(a: PointClouds, b: PointClouds, frame: int, size: int = 256) -> float:
    """PSNR over six rendered views (Lien and Bajcsy 2006, table 1), as the mean of the views' decibels.

    The paper prints rmse = √Σ|I − J|², without a division by the count; it is taken as the mean here, over all pixels
    and channels of the view, background included.
    """
    pairs = zip(splats.views(a, frame, size=size), splats.views(b, frame, like=a, size=size), strict=True)
    return float(np.mean([psnr(float(np.mean((x.astype(float) - y) ** 2))) for x, y in pairs]))


def psnr(mean_square: float, peak: float = 255.0) -> float:
    """Decibels; 99 for no error at all."""
    return 99.0 if mean_square <= 0 else min(99.0, float(10 * np.log10(peak**2 / mean_square)))


def luma(colours: NDArray[np.uint8]) -> Floats:
    return colours.astype(float) @ np.array([0.2126, 0.7152, 0.0722])


MEASURES: dict[str, Callable[[PointClouds, PointClouds, int], float]] = {
    "d1_m": d1, "d2_m": d2, "y_psnr_db": y_psnr, "views_psnr_db": views_psnr,
}  # fmt: skip


def compare(a: PointClouds, b: PointClouds, frames: Iterable[int]) -> dict[str, float]:
    """Every measure, averaged over these frames; D1 and D2 also in decibels against PEAK_M."""
    chosen = [f for f in frames if has_points(a, f) and has_points(b, f)]
    result = {name: float(np.mean([measure(a, b, f) for f in chosen])) for name, measure in MEASURES.items()}
    for name in ("d1", "d2"):
        result[f"{name}_db"] = psnr(result[f"{name}_m"] ** 2, PEAK_M)
    return result


def has_points(clouds: PointClouds, frame: int) -> bool:
    """Whether any point of a frame has a place."""
    return bool(np.isfinite(clouds.positions[frame]).all(axis=1).any())


def joint_error(estimated: Floats, true: Floats, points: Floats) -> float:
    """e_t (section 5.1): the mean distance of joints (n, 3) over the radius of the points' smallest ball."""
    return float(np.linalg.norm(estimated - true, axis=1).mean()) / ball_radius(points)


def ball_radius(points: Floats) -> float:
    """The radius of a ball around points (n, 3), by Bădoiu and Clarkson's iteration."""
    centre = points.mean(axis=0)
    for step in range(1, 60):
        farthest = points[np.argmax(np.sum((points - centre) ** 2, axis=1))]
        centre = centre + (farthest - centre) / (step + 1)
    return float(np.sqrt(np.max(np.sum((points - centre) ** 2, axis=1))))


def _nearest(p: Floats, q: Floats) -> tuple[Floats, NDArray[Any]]:
    """For each point of p, the distance and row of the nearest of q."""
    from scipy.spatial import KDTree

    distance, row = KDTree(q).query(p)
    return np.asarray(distance), np.asarray(row)
