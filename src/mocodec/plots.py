"""Pictures of a motion and of its coding error. Needs matplotlib: the [plot] extra.

errors      error over time, and per point
recording   stick figures of the original and the decoded motion, with the error over time
"""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from . import metrics
from .errors import MissingExtra
from .metrics import skeletal
from .motion import Motion
from .selection import point_columns
from .typing import Floats, Integers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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

    from .errors import BadInput
    from .formats import replace_whole

    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise BadInput(f"{path}: a picture's suffix must be one of {', '.join(SUFFIXES)}")
    drawn = BytesIO()
    picture.savefig(drawn, format=suffix[1:], dpi=120, metadata={"Software": None} if suffix == ".png" else None)
    replace_whole(path, drawn.getvalue())


def errors(original: Motion, decoded: Motion, title: str = "") -> Figure:
    """Error over time (root mean square and largest of each frame) and per point (mean, 99th percentile, largest).

    If both motions have rotations, also the largest error of the shell points, and the angles of the joints' frames.
    """
    poses = skeletal.errors(original, decoded) if skeletal.measurable(original, decoded) else None
    decoded = metrics.in_order_of(original, decoded)
    mm = 1000 * metrics.distances(original.positions, decoded.positions)
    panels = 2 if poses is None else 3
    picture = figure(9, 2 + 1.5 * panels + 0.1 * original.points)
    heights = [3, 2 + 0.1 * original.points, 2][:panels]
    over_time, per_point, *angles = picture.subplots(panels, 1, height_ratios=heights)
    picture.suptitle(title)
    draw_error_over_time(over_time, mm, original.rate, None if poses is None else 1000 * poses.shell)
    if poses is not None:
        draw_angles(angles[0], poses.world, original.rate)
    measured = [name for column, name in enumerate(original.names) if not np.isnan(mm[:, column]).all()]
    columns = mm[:, point_columns(original.names, measured)] if measured else mm[:, :0]
    rows = np.arange(len(measured))
    for values, colour, label in (
        (nan_quantile(columns, 1.0), FAINT, "largest"),
        (nan_quantile(columns, 0.99), "#e5a598", "99 %"),
        (np.nanmean(columns, axis=0) if measured else rows, OURS, "mean"),
    ):
        per_point.barh(rows, values, color=colour, label=label)
    per_point.set_yticks(rows, measured, fontsize=7)
    per_point.set_ylim(len(measured) - 0.4, -0.6)
    per_point.set_xlabel("error of each point, mm")
    legend_above(per_point)
    for axes in (over_time, per_point, *angles):
        axes.spines[["top", "right"]].set_visible(False)
    return picture


def nan_quantile(columns: Floats, share: float) -> Floats:
    """Quantile over rows of each column without its gaps, (columns,); NaN for a column of gaps only."""
    result = np.full(columns.shape[1], np.nan)
    measured = ~np.isnan(columns).all(axis=0)
    if columns.size:
        result[measured] = np.nanquantile(columns[:, measured], share, axis=0)
    return result


def draw_error_over_time(axes: Axes, mm: Floats, rate: float, shell_mm: Floats | None = None) -> None:
    """Root mean square and largest error of each frame against time; shell_mm: errors (frames, joints, 3)."""
    measured = ~np.isnan(mm).all(axis=1)
    seconds = np.arange(len(mm)) / rate
    rms, largest = np.full(len(mm), np.nan), np.full(len(mm), np.nan)
    rms[measured] = np.sqrt(np.nanmean(mm[measured] ** 2, axis=1))
    largest[measured] = np.nanmax(mm[measured], axis=1)
    if shell_mm is not None:
        worst = nan_quantile(shell_mm.reshape(len(shell_mm), -1).T, 1.0)
        axes.plot(seconds, worst, color=SHELL, linewidth=0.8, label="largest of the shell points")
    axes.plot(seconds, largest, color=FAINT, linewidth=0.8, label="largest of the frame")
    axes.plot(seconds, rms, color=OURS, linewidth=1.2, label="root mean square")
    axes.set_xlabel("time, s")
    axes.set_ylabel("error, mm")
    axes.set_ylim(bottom=0)
    axes.margins(x=0)
    legend_above(axes)


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


def legend_above(axes: Axes) -> None:
    """Put the legend in one line above the axes, so that it covers no curve."""
    axes.legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0, ncols=3, fontsize=8)


def recording(original: Motion, decoded: Motion, title: str = "", poses: int = 7) -> Figure:
    """Poses of the original (grey) under those of the decoded motion (red); below them, the error over time."""
    decoded = metrics.in_order_of(original, decoded)
    picture = figure(9, 4.8)
    figures, curve = picture.subplots(2, 1, height_ratios=[3, 2])
    picture.suptitle(title, fontsize=10)
    draw_poses(figures, original, decoded, np.linspace(0, len(original) - 1, poses + 2).round().astype(int)[1:-1])
    draw_error_over_time(curve, 1000 * metrics.distances(original.positions, decoded.positions), original.rate)
    curve.spines[["top", "right"]].set_visible(False)
    return picture


def poses(motion: Motion, title: str = "", count: int = 7) -> Figure:
    """Poses of one motion side by side."""
    picture = figure(9, 3.2)
    axes = picture.subplots()
    picture.suptitle(title, fontsize=10)
    frames = np.linspace(0, len(motion) - 1, count + 2).round().astype(int)[1:-1]
    draw_poses(axes, motion, motion, frames)
    return picture


def draw_poses(axes: Axes, original: Motion, decoded: Motion, frames: Integers) -> None:
    """Poses of both motions at these frames side by side, with their times below."""
    up = "xyz".index(original.up)
    across = widest_axis(original.positions, up)
    heights = [np.ptp(pose[~np.isnan(pose)]) for pose in original.positions[frames, :, up] if not np.isnan(pose).all()]
    spacing = 0.75 * max(heights, default=1.0)
    styles = ((original, {"color": FAINT, "linewidth": 3.5}), (decoded, {"color": OURS, "linewidth": 1.0}))
    for place, frame in enumerate(frames):
        middle = np.nanmean(original.positions[frame], axis=0) if not original.gaps[frame].all() else np.zeros(3)
        for motion, style in styles:
            level = motion.positions[frame][:, across] - middle[across] + spacing * place
            draw_pose(axes, np.stack([level, motion.positions[frame][:, up]], axis=1), original, style)
        axes.annotate(
            f"{frame / original.rate:.1f} s",
            (spacing * place, 0),
            (0, -12),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=INK,
        )
    for label, (_, style) in zip(("original", "decoded"), styles, strict=True):
        axes.plot([], [], label=label, **style)
    legend_above(axes)
    axes.set_aspect("equal")
    axes.set_axis_off()


def widest_axis(positions: Floats, up: int) -> int:
    """The horizontal axis along which the points of a frame spread most: the view shows this axis."""
    level = [axis for axis in range(3) if axis != up]
    frames = positions[~np.isnan(positions).all(axis=(1, 2))]
    spread = [np.sum(np.nanvar(frames[:: max(1, len(frames) // 50), :, axis], axis=1)) for axis in level]
    return level[int(np.argmax(spread))]


def draw_pose(axes: Axes, flat: Floats, like: Motion, style: dict[str, Any]) -> None:
    """One pose (points, 2): the bones of the skeleton of `like`, or points without a skeleton."""
    if like.skeleton is None:
        axes.plot(*flat.T, linestyle="", marker="o", color=style["color"], markersize=1.3 * style["linewidth"])
        return
    for joint, parent in enumerate(like.skeleton.parents):
        if parent >= 0:
            axes.plot(*flat[[parent, joint]].T, solid_capstyle="round", **style)
