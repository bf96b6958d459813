"""Pictures of a motion and of its coding error. Needs matplotlib: the [plot] extra.

errors      error over time, and per point
recording   stick figures of the original and the decoded motion, with the error over time
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from . import metrics
from .errors import BadInput, MissingExtra
from .geometry import links, views
from .metrics import skeletal
from .motion import Motion
from .selection import point_columns
from .typing import Floats, Integers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TILT = np.radians(6.0)
"""Angle from which poses are seen from above, radians."""
SUFFIXES = (".png", ".svg", ".pdf")
INK, OURS, FAINT, SHELL = "#333333", "#c8442e", "#bbbbbb", "#7a8fb8"


def figure(width: float, height: float) -> Figure:
    """An empty figure; sizes in inches. Raises MissingExtra without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtra("drawing", "plot") from error
    return Figure(figsize=(width, height), layout="constrained")


def save(picture: Figure, path: str | PathLike[str]) -> None:
    """Write a figure as .png, .svg or .pdf, by suffix. Raises BadInput for others."""
    from io import BytesIO
    from pathlib import Path

    from .formats import replace_whole

    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise BadInput(f"{path}: a picture's suffix must be one of {', '.join(SUFFIXES)}")
    drawn = BytesIO()
    picture.savefig(drawn, format=suffix[1:], dpi=120, metadata={"Software": None} if suffix == ".png" else None)
    replace_whole(path, drawn.getvalue())


def errors(original: Motion, decoded: Motion, title: str = "", promise: Mapping[str, float] | None = None) -> Figure:
    """Error over time (root mean square and largest of each frame), and how the errors of each point are distributed.

    promise: of the compressed file; `max_error` and `mean_error`, metres, are drawn as lines. If both motions have
    rotations, also the largest error of the shell points, and the angles of the joints' frames.
    """
    poses = skeletal.errors(original, decoded) if skeletal.measurable(original, decoded) else None
    decoded = metrics.in_order_of(original, decoded)
    mm = 1000 * metrics.distances(original.positions, decoded.positions)
    panels = 2 if poses is None else 3
    picture = figure(9, 2 + 1.5 * panels + 0.1 * original.points)
    heights = [3, 2 + 0.1 * original.points, 2][:panels]
    over_time, per_point, *angles = picture.subplots(panels, 1, height_ratios=heights)
    picture.suptitle(title)
    draw_error_over_time(over_time, mm, original.rate, None if poses is None else 1000 * poses.shell, promise)
    if poses is not None:
        draw_angles(angles[0], poses.world, original.rate)
    measured = [name for column, name in enumerate(original.names) if not np.isnan(mm[:, column]).all()]
    columns = mm[:, point_columns(original.names, measured)] if measured else mm[:, :0]
    draw_error_of_points(per_point, columns, measured, promise)
    for axes in (over_time, per_point, *angles):
        axes.spines[["top", "right"]].set_visible(False)
    return picture


QUANTILES = (
    (0.0, 1.0, "#e8e4e2", "all errors"),
    (0.05, 0.95, "#e5a598", "5 to 95 %"),
    (0.25, 0.75, OURS, "25 to 75 %"),
)


def draw_error_of_points(axes: Axes, mm: Floats, names: list[str], promise: Mapping[str, float] | None) -> None:
    """A row for each point, the largest errors above: bands that hold all, 90 % and half of its errors; its median.

    mm (frames, points): errors, NaN at gaps.
    """
    order = np.argsort(-nan_quantile(mm, 1.0)) if mm.shape[1] else np.zeros(0, int)
    rows = np.arange(len(order))
    for low, high, colour, label in QUANTILES:
        left, right = nan_quantile(mm, low)[order], nan_quantile(mm, high)[order]
        axes.barh(rows, right - left, left=left, height=0.7, color=colour, label=label)
    axes.plot(nan_quantile(mm, 0.5)[order], rows, linestyle="", marker="|", color="white", markersize=5)
    axes.set_yticks(rows, [names[i] for i in order], fontsize=7)
    axes.set_ylim(len(order) - 0.4, -0.6)
    axes.set_xlim(left=0)
    axes.set_xlabel("errors of each point, mm")
    draw_promise(axes.axvline, promise, labelled=False)
    legend_above(axes, columns=4)


BOUNDS = {"max_error": (0, (4, 3)), "mean_error": (0, (1, 2))}
"""Promises that are drawn as lines, and how these are dashed."""


def draw_promise(line: Callable[..., Any], promise: Mapping[str, float] | None, labelled: bool = True) -> None:
    """Promised errors as dashed lines, in millimetres. line: `axhline` or `axvline` of the axes."""
    for name, bound in (promise or {}).items():
        if name in BOUNDS:
            label = f"promised {'maximum' if name == 'max_error' else 'mean'}" if labelled else None
            line(1000 * bound, color=INK, linewidth=0.8, linestyle=BOUNDS[name], label=label)


def nan_quantile(columns: Floats, share: float) -> Floats:
    """Quantile over rows of each column without its gaps, (columns,); NaN for a column of gaps only."""
    result = np.full(columns.shape[1], np.nan)
    measured = ~np.isnan(columns).all(axis=0)
    if columns.size:
        result[measured] = np.nanquantile(columns[:, measured], share, axis=0)
    return result


def draw_error_over_time(
    axes: Axes, mm: Floats, rate: float, shell_mm: Floats | None = None, promise: Mapping[str, float] | None = None
) -> None:
    """Root mean square and largest error of each frame against time; shell_mm: errors (frames, joints, 3).

    promise: see `errors`. A long recording is drawn as the mean and the largest of runs of frames.
    """
    measured = ~np.isnan(mm).all(axis=1)
    seconds = np.arange(len(mm)) / rate
    rms, largest = np.full(len(mm), np.nan), np.full(len(mm), np.nan)
    rms[measured] = np.sqrt(np.nanmean(mm[measured] ** 2, axis=1))
    largest[measured] = np.nanmax(mm[measured], axis=1)
    if shell_mm is not None:
        worst = nan_quantile(shell_mm.reshape(len(shell_mm), -1).T, 1.0)
        axes.plot(*in_runs(seconds, worst, np.fmax), color=SHELL, linewidth=0.8, label="largest error of a shell point")
    axes.plot(*in_runs(seconds, largest, np.fmax), color=FAINT, linewidth=0.8, label="largest error of a point")
    times, most = in_runs(seconds, rms, np.fmax)
    axes.fill_between(
        times, in_runs(seconds, rms, np.fmin)[1], most, color=OURS, linewidth=0.8, label="root mean square"
    )
    draw_promise(axes.axhline, promise)
    axes.set_xlabel("time, s")
    axes.set_ylabel("error, mm")
    axes.set_ylim(bottom=0)
    axes.margins(x=0)
    legend_above(axes)


MOST_RUNS = 700


def in_runs(seconds: Floats, values: Floats, pick: np.ufunc) -> tuple[Floats, Floats]:
    """Times and values (frames,) in at most MOST_RUNS runs of frames: `pick` (np.fmax, np.fmin) of each run."""
    if len(values) <= MOST_RUNS:
        return seconds, values
    starts = np.linspace(0, len(values), MOST_RUNS, endpoint=False).astype(int)
    return seconds[starts], pick.reduceat(values, starts)


def draw_angles(axes: Axes, degrees: Floats, rate: float) -> None:
    """Mean and largest angle of each frame between the joints' frames; degrees (frames, joints)."""
    seconds = np.arange(len(degrees)) / rate
    measured = ~np.isnan(degrees).all(axis=1)
    mean = np.full(len(degrees), np.nan)
    mean[measured] = np.nanmean(degrees[measured], axis=1)
    axes.plot(seconds, nan_quantile(degrees.T, 1.0), color=FAINT, linewidth=0.8, label="largest angle of the frame")
    axes.plot(seconds, mean, color=OURS, linewidth=1.2, label="mean angle")
    axes.set_xlabel("time, s")
    axes.set_ylabel("angle, °")
    axes.set_ylim(bottom=0)
    axes.margins(x=0)
    legend_above(axes)


def legend_above(axes: Axes, columns: int = 4) -> None:
    """Put the legend in one line above the axes, so that it covers no curve."""
    axes.legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0, ncols=columns, fontsize=8)


def recording(
    original: Motion, decoded: Motion, title: str = "", promise: Mapping[str, float] | None = None, poses: int = 7
) -> Figure:
    """Poses of the original (grey) under those of the decoded motion (red); below them, the error over time.

    promise: see `errors`.
    """
    decoded = metrics.in_order_of(original, decoded)
    picture = figure(9, 4.8)
    figures, curve = picture.subplots(2, 1, height_ratios=[3, 2])
    picture.suptitle(title, fontsize=10)
    draw_poses(figures, original, decoded, np.linspace(0, len(original) - 1, poses + 2).round().astype(int)[1:-1])
    mm = 1000 * metrics.distances(original.positions, decoded.positions)
    draw_error_over_time(curve, mm, original.rate, promise=promise)
    curve.spines[["top", "right"]].set_visible(False)
    return picture


def poses(motion: Motion, title: str = "", count: int = 7) -> Figure:
    """Poses of one motion side by side. Raises BadInput for a motion without frames."""
    if not len(motion):
        raise BadInput("there are no frames to draw")
    picture = figure(9, 3.2)
    axes = picture.subplots()
    picture.suptitle(title, fontsize=10)
    frames = np.linspace(0, len(motion) - 1, count + 2).round().astype(int)[1:-1]
    draw_poses(axes, motion, motion, frames)
    return picture


def draw_poses(axes: Axes, original: Motion, decoded: Motion, frames: Integers) -> None:
    """Poses of both motions at these frames side by side, with their times below."""
    links_ = links.links(original)
    view = views.directions(original.positions, original.up, TILT)[:2]
    levels = original.positions[frames] @ view[1]
    heights = [np.ptp(level[~np.isnan(level)]) for level in levels if not np.isnan(level).all()]
    spacing = 0.75 * max(heights, default=1.0)
    styles = ((original, {"color": FAINT, "linewidth": 3.5}), (decoded, {"color": OURS, "linewidth": 1.0}))
    lowest = np.inf
    for place, frame in enumerate(frames):
        middle = np.nanmean(original.positions[frame], axis=0) if not original.gaps[frame].all() else np.zeros(3)
        height = np.where(np.arange(3) == "xyz".index(original.up), middle, 0.0) @ view[1]
        for motion, style in styles:
            flat = (motion.positions[frame] - middle) @ view.T + [spacing * place, height]
            lowest = min(lowest, np.nanmin(flat[:, 1], initial=lowest))
            draw_pose(axes, flat, links_, style)
    lowest = lowest if np.isfinite(lowest) else 0.0
    axes.update_datalim([(0.0, lowest), (spacing * (len(frames) - 1), lowest)])  # no time is cut off
    axes.autoscale_view()
    for place, frame in enumerate(frames):
        axes.annotate(
            f"{frame / original.rate:.1f} s",
            (spacing * place, lowest),
            (0, -12),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=INK,
        )
    for label, (_, style) in zip(("original", "decoded"), styles, strict=True):
        axes.plot([], [], label=label, **style)
    if original is not decoded:
        legend_above(axes)
    axes.set_aspect("equal")
    axes.set_axis_off()


def draw_pose(axes: Axes, flat: Floats, links_: list[tuple[int, int]], style: dict[str, Any]) -> None:
    """One pose (points, 2): its links, and points that no link joins."""
    alone = np.setdiff1d(np.arange(len(flat)), np.array(links_, int).reshape(-1))
    axes.plot(*flat[alone].T, linestyle="", marker="o", color=style["color"], markersize=1.3 * style["linewidth"])
    for a, b in links_:
        axes.plot(*flat[[a, b]].T, solid_capstyle="round", **style)
