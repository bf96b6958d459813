"""How far one motion is from another. Lengths in metres; gaps (NaN) are left out of every measure."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ..errors import BadInput
from ..motion import Motion
from ..typing import Floats


def distances(original: Floats, decoded: Floats) -> Floats:
    """Euclidean distance of every point in every frame: (frames, points, 3) twice → (frames, points); NaN at gaps."""
    return np.sqrt(np.einsum("fpc,fpc->fp", d := original - decoded, d))


def mean_distance(original: Floats, decoded: Floats) -> float:
    """d̄, the average Euclidean distance. Hou 2014, equation (11)."""
    return float(np.nanmean(distances(original, decoded)))


def distortion_percent(original: Floats, decoded: Floats) -> float:
    """d = 100 ‖A − Ã‖ / ‖A − E(A)‖, Frobenius norm; E(A): mean of each coordinate. Liu and McMillan 2006, section 4."""
    present = ~np.isnan(original)
    mean = np.nansum(original, axis=0) / np.maximum(present.sum(axis=0), 1)
    spread = np.nansum((original - mean) ** 2)
    return float(100 * np.sqrt(np.nansum((original - decoded) ** 2) / spread)) if spread > 0 else 0.0


def rms_per_frame(original: Floats, decoded: Floats) -> Floats:
    """Root mean square error over the points of each frame, (frames,). Liu and McMillan 2006, section 4, figure 4."""
    squares = distances(original, decoded) ** 2
    present = ~np.isnan(squares)
    count = np.where(present.any(axis=1), present.sum(axis=1), np.nan)
    return np.sqrt(np.where(present, squares, 0).sum(axis=1) / count)


@dataclass(frozen=True)
class Comparison:
    """Errors of one motion against another, in metres. The fields are the keys of `to_json`.

    max_at: frame and point of the largest error; per_point: mean, 99th percentile and largest error by point name;
    ratio: compression ratio, if the stored size is known.
    """

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
    """Measure the errors of b against a.

    stored_bytes: size of b on disk, for the ratio of a's float32 positions to it. Raises BadInput where the two differ
    in frames or points.
    """
    if a.positions.shape != b.positions.shape:
        raise BadInput(f"cannot compare {len(a)} frames of {a.points} points with {len(b)} frames of {b.points} points")
    if a.names != b.names and sorted(a.names) == sorted(b.names) and len(set(a.names)) == a.points:
        b = b.select(a.names)
    error = distances(a.positions, b.positions)
    present = error[~np.isnan(error)]
    frame, point = np.unravel_index(int(np.nanargmax(error)), error.shape) if present.size else (0, 0)
    columns = {name: e[~np.isnan(e)] for name, e in zip(a.names, error.T, strict=True)}
    return Comparison(
        frames=len(a),
        points=a.points,
        mean_error=float(present.mean()) if present.size else 0.0,
        p99_error=float(np.percentile(present, 99)) if present.size else 0.0,
        max_error=float(present.max()) if present.size else 0.0,
        max_at=(int(frame), a.names[int(point)]) if present.size else None,
        rms=float(np.sqrt((present**2).mean())) if present.size else 0.0,
        d_percent=distortion_percent(a.positions, b.positions) if present.size else 0.0,
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
