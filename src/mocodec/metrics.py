"""Each measure of error once, with the paper's equation number. Lengths in metres; gaps count in none of them."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from .errors import BadInput
from .motion import Floats, Motion


def distances(original: Floats, decoded: Floats) -> Floats:
    """Euclidean distance of every point of every frame: (frames, points, 3) twice → (frames, points); NaN at gaps."""
    return np.sqrt(np.einsum("fpc,fpc->fp", d := original - decoded, d))


def mean_distance(original: Floats, decoded: Floats) -> float:
    """d̄, the average Euclidean distance. Hou 2014, equation (11)."""
    return float(np.nanmean(distances(original, decoded)))


def distortion_percent(original: Floats, decoded: Floats) -> float:
    """d = 100 ‖A − Ã‖ / ‖A − E(A)‖ in the Frobenius norm, E(A) each coordinate's average. Liu & McMillan 2006, s. 4."""
    here = ~np.isnan(original)
    mean = np.nansum(original, axis=0) / np.maximum(here.sum(axis=0), 1)
    spread = np.nansum((original - mean) ** 2)
    return float(100 * np.sqrt(np.nansum((original - decoded) ** 2) / spread)) if spread > 0 else 0.0


def rms_per_frame(original: Floats, decoded: Floats) -> Floats:
    """Root mean square error over the points of each frame, (frames,). Liu & McMillan 2006, section 4, figure 4."""
    squares = distances(original, decoded) ** 2
    here = ~np.isnan(squares)
    return np.sqrt(np.where(here, squares, 0).sum(axis=1) / np.where(here.any(axis=1), here.sum(axis=1), np.nan))


@dataclass(frozen=True)
class Comparison:
    """How far one motion is from another. Errors in metres; the keys of `to_json` are these fields."""

    frames: int
    points: int
    mean_error: float
    p99_error: float
    max_error: float
    max_at: tuple[int, str] | None
    rms: float
    d_percent: float
    gaps_equal: bool
    per_point: dict[str, dict[str, float]] = field(default_factory=dict)
    ratio: float | None = None

    def to_json(self, **extra: Any) -> str:
        return json.dumps({**asdict(self), **extra}, indent=2)


def compare(a: Motion, b: Motion, stored_bytes: int | None = None) -> Comparison:
    """Measure b against a. `stored_bytes`: b's size on disk, for the ratio against a as float32 positions.

    Raises BadInput where they do not have the same frames and points.
    """
    if a.positions.shape != b.positions.shape:
        raise BadInput(f"cannot compare {len(a)} frames of {a.points} points with {len(b)} frames of {b.points} points")
    if a.names != b.names and sorted(a.names) == sorted(b.names) and len(set(a.names)) == a.points:
        b = b.select(a.names)
    error = distances(a.positions, b.positions)
    here = error[~np.isnan(error)]
    frame, point = np.unravel_index(int(np.nanargmax(error)), error.shape) if here.size else (0, 0)
    columns = {name: e[~np.isnan(e)] for name, e in zip(a.names, error.T, strict=True)}
    return Comparison(
        frames=len(a),
        points=a.points,
        mean_error=float(here.mean()) if here.size else 0.0,
        p99_error=float(np.percentile(here, 99)) if here.size else 0.0,
        max_error=float(here.max()) if here.size else 0.0,
        max_at=(int(frame), a.names[int(point)]) if here.size else None,
        rms=float(np.sqrt((here**2).mean())) if here.size else 0.0,
        d_percent=distortion_percent(a.positions, b.positions) if here.size else 0.0,
        gaps_equal=bool((a.gaps == b.gaps).all()),
        per_point={
            name: {
                "mean_error": float(e.mean()),
                "p99_error": float(np.percentile(e, 99)),
                "max_error": float(e.max()),
            }
            for name, e in columns.items()
            if e.size
        },
        ratio=a.raw_bytes / stored_bytes if stored_bytes else None,
    )
