"""Error measures, with the equation numbers of the papers that define them. Lengths in metres; gaps are left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from html import escape
from typing import Any, NamedTuple, cast

import numpy as np

from .. import native, parallel
from ..errors import BadInput
from ..motion import Motion
from ..typing import Floats
from . import skeletal


def distances(original: Floats, decoded: Floats) -> Floats:
    """Euclidean distance of every point in every frame: (frames, points, 3) twice → (frames, points); NaN at gaps."""
    return np.sqrt(np.einsum("fpc,fpc->fp", d := original - decoded, d))


class Errors(NamedTuple):
    """same_gaps: whether the same samples are missing. samples: number of the others; sum, max: of their distances,
    metres, NaN where a position is."""

    same_gaps: bool
    samples: int
    sum: float
    max: float

    @property
    def mean(self) -> float:
        """Metres; 0 without samples."""
        return self.sum / max(1, self.samples)


def errors(original: Floats, decoded: Floats) -> Errors:
    """Errors of decoded positions. original, decoded: (frames, points, 3), metres, NaN at gaps."""
    if (kernel := native.kernel("compare_positions")) is not None:
        if original.shape != decoded.shape:
            raise ValueError(f"positions of shapes {original.shape} and {decoded.shape}")
        blocks = parallel.blocks(max(1, len(original)))
        parts = [Errors(*part) for part in parallel.over(lambda some: kernel(original[some], decoded[some]), blocks)]
        same_gaps, samples, sums, largest = zip(*parts, strict=True)
        return Errors(all(same_gaps), sum(samples), sum(sums), float(np.max(largest)))
    gaps = np.isnan(original[..., 0])
    off = distances(original, decoded)[~gaps]
    same_gaps = bool((np.isnan(decoded[..., 0]) == gaps).all())
    return Errors(same_gaps, off.size, float(off.sum()), float(off.max(initial=0.0)))


def mean_distance(original: Floats, decoded: Floats) -> float:
    """d̄, the average Euclidean distance. Hou 2014, equation (11)."""
    return float(np.nanmean(distances(original, decoded)))


def distortion_percent(original: Floats, decoded: Floats) -> float:
    """d = 100 ‖A − Ã‖ / ‖A − E(A)‖ in the Frobenius norm; E(A) is the mean of each coordinate over time.

    Liu & McMillan 2006, section 4.
    """
    present = ~np.isnan(original)
    mean = np.nansum(original, axis=0) / np.maximum(present.sum(axis=0), 1)
    spread = np.nansum((original - mean) ** 2)
    return float(100 * np.sqrt(np.nansum((original - decoded) ** 2) / spread)) if spread > 0 else 0.0


def rms_per_frame(original: Floats, decoded: Floats) -> Floats:
    """Root mean square error over the points of each frame, (frames,). Liu and McMillan 2006, section 4, figure 4."""
    squares = distances(original, decoded) ** 2
    present = ~np.isnan(squares)
    counts = np.where(present.any(axis=1), present.sum(axis=1), np.nan)
    return np.sqrt(np.where(present, squares, 0).sum(axis=1) / counts)


@dataclass(frozen=True)
class Comparison:
    """How far a decoded motion is from the original. The keys of `to_json` are these fields.

    mean_error, p99_error, max_error, rms: over all points and frames, metres. max_at: frame and point of the largest
    error. d_percent: `distortion_percent`. gaps_equal: both motions have the same gaps. per_point: mean, 99th
    percentile and largest error of each point. ratio: size as float32 positions over stored bytes, if these are known.
    skeletal: errors of shell points and rotations, if both motions have rotations.
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
    per_point: dict[str, dict[str, float]] = field(default_factory=dict[str, dict[str, float]])
    ratio: float | None = None
    skeletal: skeletal.SkeletalErrors | None = None

    def to_json(self, **extra: Any) -> str:
        """All fields, and `extra` ones, as a JSON object."""
        import json

        return json.dumps({**asdict(self), **extra}, indent=2)

    def _repr_html_(self) -> str:
        """The errors as tables, for notebooks: of the whole, then of each point, the largest first."""
        whole = [
            ("frames, points", f"{self.frames:,}, {self.points:,}"),
            ("mean error", _millimetres(self.mean_error)),
            ("99 % below", _millimetres(self.p99_error)),
            ("largest error", _millimetres(self.max_error) + (f" at frame {self.max_at[0]}" if self.max_at else "")),
            ("gaps", "equal" if self.gaps_equal else "not equal"),
        ]
        whole += [("ratio to float32", f"{self.ratio:.1f} : 1")] if self.ratio is not None else []
        points = sorted(self.per_point.items(), key=lambda item: -item[1]["max_error"])
        rows = [
            (name, *(_millimetres(e[key]) for key in ("mean_error", "p99_error", "max_error"))) for name, e in points
        ]
        head = ("point", "mean", "99 % below", "largest")
        return _html_table(whole) + (
            f"<details><summary>points</summary>{_html_table([head, *rows])}</details>" if rows else ""
        )


def _millimetres(metres: float) -> str:
    return f"{1000 * metres:.3g} mm"


def _html_table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of text as an HTML table; names in it are text, whatever they contain."""
    cells = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows)
    return f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"


def in_order_of(original: Motion, decoded: Motion) -> Motion:
    """The decoded motion with its points in the order of the original, if both have the same, unique names."""
    unique = len(set(original.names)) == original.points
    same_names = unique and sorted(original.names) == sorted(decoded.names)
    return decoded.select(original.names) if same_names else decoded


def compare(
    original: Motion, decoded: Motion, stored_bytes: int | None = None, shell: float = skeletal.SHELL_M
) -> Comparison:
    """Measure the error of `decoded` against `original`, point by point: points are matched by name.

        error = mocodec.compare(motion, mocodec.decode(blob, mocodec.Motion))
        error.mean_error, error.max_error                 # metres
        error.per_point["LKNE"]["max_error"]

    stored_bytes: size of the decoded motion on disk, for the ratio to the original as float32 positions.
    shell: distance of the shell points of skeletal motions from their joints, metres.

    Returns a `Comparison`. Raises BadInput if frames or points differ in number, or for point clouds (`mocodec compare`
    measures these).
    """
    for motion in (original, decoded):
        if not isinstance(cast(object, motion), Motion):
            raise BadInput(f"compare takes two motions, not {type(motion).__name__}; `mocodec compare` does both")
    if original.positions.shape != decoded.positions.shape:
        sizes = [f"{len(motion)} frames of {motion.points} points" for motion in (original, decoded)]
        raise BadInput(f"cannot compare {sizes[0]} with {sizes[1]}")
    pose_errors = skeletal.compare(original, decoded, shell)
    decoded = in_order_of(original, decoded)
    error = distances(original.positions, decoded.positions)
    present = error[~np.isnan(error)]
    largest = np.unravel_index(int(np.nanargmax(error)), error.shape) if present.size else None
    columns = {name: e[~np.isnan(e)] for name, e in zip(original.names, error.T, strict=True)}
    return Comparison(
        frames=len(original),
        points=original.points,
        **_summary(present),
        max_at=None if largest is None else (int(largest[0]), original.names[int(largest[1])]),
        rms=float(np.sqrt((present**2).mean())) if present.size else 0.0,
        d_percent=distortion_percent(original.positions, decoded.positions) if present.size else 0.0,
        gaps_equal=bool((original.gaps == decoded.gaps).all()),
        per_point={name: _summary(errors) for name, errors in columns.items() if errors.size},
        ratio=original.raw_bytes / stored_bytes if stored_bytes else None,
        skeletal=pose_errors,
    )


def _summary(errors: Floats) -> dict[str, float]:
    """Mean, 99th percentile and largest of errors (n,); zeros for none."""
    if not errors.size:
        return {"mean_error": 0.0, "p99_error": 0.0, "max_error": 0.0}
    return {
        "mean_error": float(errors.mean()),
        "p99_error": float(np.percentile(errors, 99)),
        "max_error": float(errors.max()),
    }
