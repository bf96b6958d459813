"""How far one point cloud is from another: D1, D2, luma, and rendered views.

D1 and D2 are the symmetric errors of MPEG's pc_error: the root mean square error from a to b and from b to a, the
larger of the two. On sparse clouds, a codec that resamples the surface scores an error even if its surface is exact. To
judge it, measure a second perfect sample of the same surface as well: its error is the resampling floor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from ..geometry.normals import estimate
from ..motion import Motion
from ..pointcloud import PointClouds
from ..selection import counted
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


def luma_squares(a: tuple[Floats, Bytes | None], b: tuple[Floats, Bytes | None]) -> Floats:
    """(2, 2): for a frame (points, colours) of two clouds, from a to b and from b to a: the sum of squared differences
    of the luma between nearest points, and their number. 0 where either has no points or colours.
    """
    (p, c), (q, d) = a, b
    if c is None or d is None or not len(p) or not len(q):
        return np.zeros((2, 2))
    errors = (luma(c) - luma(d)[_nearest(p, q)[1]], luma(d) - luma(c)[_nearest(q, p)[1]])
    return np.array([[float(np.sum(error**2)), len(error)] for error in errors])


def pooled_psnr(squares: Floats) -> float:
    """PSNR, dB, of sums of `luma_squares` over frames: the lower of both directions; NaN where nothing was compared."""
    if not squares[:, 1].all():
        return float("nan")
    return min(psnr(total / count) for total, count in squares.tolist())


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


@dataclass(frozen=True, eq=False)
class CloudErrors:
    """Distances between nearest points of two point clouds, metres, over all frames in which both have points.

    mean_error: the larger of the two means, from a to b and from b to a. max_error: the largest of all distances; ∞ if
    a frame has points in only one of the two. d1: the mean of the frames' D1. psnr: of luma between nearest points, dB;
    NaN without colours. frames: numbers of the compared frames. d1_of_frame, max_of_frame (frames,): by frame.
    """

    mean_error: float
    max_error: float
    d1: float
    psnr: float
    points: int
    frames: list[int]
    d1_of_frame: Floats
    max_of_frame: Floats


def errors(a: PointClouds, b: PointClouds) -> CloudErrors:
    """The errors of b against a, which has as many frames. Raises BadInput for other numbers of frames."""
    if len(a) != len(b):
        raise BadInput(f"the first has {counted(len(a), 'frame')}, the second {len(b):,}")
    sums, squares = np.zeros((2, 2)), np.zeros((2, 2))
    frames, d1s, largest, alone = list[int](), list[float](), list[float](), False
    for frame in range(len(a)):
        (p, c), (q, d) = splats.finite_points(a, frame), splats.finite_points(b, frame)
        alone |= (len(p) > 0) != (len(q) > 0)
        if not len(p) or not len(q):
            continue
        (there, to_q), (back, to_p) = _nearest(p, q), _nearest(q, p)
        sums += [[float(there.sum()), len(there)], [float(back.sum()), len(back)]]
        if c is not None and d is not None:
            for k, difference in enumerate((luma(c) - luma(d)[to_q], luma(d) - luma(c)[to_p])):
                squares[k] += [float(np.sum(difference**2)), len(difference)]
        frames.append(frame)
        d1s.append(max(float(np.sqrt(np.mean(gap**2))) for gap in (there, back)))
        largest.append(max(float(there.max()), float(back.max())))
    means = sums[:, 0] / np.maximum(sums[:, 1], 1)
    return CloudErrors(
        float(means.max()), float("inf") if alone else max(largest, default=0.0), float(np.mean(d1s)) if d1s else 0.0,
        pooled_psnr(squares), int(sums[0, 1]), frames, np.array(d1s), np.array(largest),
    )  # fmt: skip


def errors_by_joint(a: PointClouds, b: PointClouds, body: Motion, frames: Iterable[int]) -> dict[str, float]:
    """Mean distance, metres, from points of a to the nearest of b, for the points nearest to each joint of a body.

    body: as many frames as a. Joints that no point is nearest to are left out.
    """
    sums, counts = np.zeros(body.points), np.zeros(body.points, np.int64)
    for frame in frames:
        (p, _), (q, _) = splats.finite_points(a, frame), splats.finite_points(b, frame)
        known = np.flatnonzero(np.isfinite(body.positions[frame]).all(axis=1))
        if not len(p) or not len(q) or not len(known):
            continue
        joint = known[_nearest(p, body.positions[frame][known])[1]]
        sums += np.bincount(joint, _nearest(p, q)[0], body.points)
        counts += np.bincount(joint, minlength=body.points)
    return {body.names[j]: float(sums[j] / counts[j]) for j in np.flatnonzero(counts).tolist()}


def resampling_floor(clouds: PointClouds, frames: Iterable[int]) -> float:
    """About the D1, metres, that a second perfect sample of the same surface scores, with as many points.

    Measured between two random halves of each frame; distances fall with the root of the number of points. Of a noisy
    recording the floor contains the noise. NaN without frames of two points.
    """
    rng, found = np.random.default_rng(0), list[float]()
    for frame in frames:
        points = splats.finite_points(clouds, frame)[0]
        if len(points) < 2:
            continue
        half = rng.permutation(len(points))
        p, q = points[half[: len(points) // 2]], points[half[len(points) // 2 :]]
        found.append(max(float(np.sqrt(np.mean(gap**2))) for gap in (_nearest(p, q)[0], _nearest(q, p)[0])))
    return float(np.mean(found) / np.sqrt(2)) if found else float("nan")


def has_points(clouds: PointClouds, frame: int) -> bool:
    """Whether a frame has any point with finite coordinates."""
    return bool(np.isfinite(clouds.positions[frame]).all(axis=1).any())


def _nearest(p: Floats, q: Floats) -> tuple[Floats, AnyInteger]:
    """Distance from each point of p to the nearest point of q, and the index of that point."""
    from scipy.spatial import KDTree

    distance, row = KDTree(q).query(p)
    return np.asarray(distance), np.asarray(row)
