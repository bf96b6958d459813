"""Pictures of a motion and of what coding it cost. Needs matplotlib: the [plot] extra.

errors      error over time, and per point
recording   stick figures of the original and the decoded, with the error over time
"""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from . import metrics
from .errors import MissingExtra
from .motion import Floats, Motion, point_columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg", ".pdf")
INK, OURS, FAINT = "#333333", "#c8442e", "#bbbbbb"


def figure(width: float, height: float) -> Figure:
    """An empty figure. Raises MissingExtra where matplotlib is not installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtra("drawing", "plot") from error
    return Figure(figsize=(width, height), layout="constrained")


def save(picture: Figure, path: str | PathLike[str]) -> None:
    """Write a figure, by suffix .png, .svg or .pdf. Raises BadInput for another."""
    from io import BytesIO
    from pathlib import Path

    from .errors import BadInput
    from .formats import replace_whole

    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise BadInput(f"{path}: pictures are written as {', '.join(SUFFIXES)}")
    drawn = BytesIO()
    picture.savefig(drawn, format=suffix[1:], dpi=120, metadata={"Software": None} if suffix == ".png" else None)
    replace_whole(path, drawn.getvalue())


def in_order_of(original: Motion, decoded: Motion) -> Motion:
    """The decoded with its points in the order of the original, where the names tell."""
    same_names = sorted(original.names) == sorted(decoded.names) and len(set(original.names)) == original.points
    return decoded.select(original.names) if same_names else decoded


def errors(original: Motion, decoded: Motion, title: str = "") -> Figure:
    """Error over time (root mean square and largest of each frame) and per point (mean, 99 %, largest)."""
    decoded = in_order_of(original, decoded)
    mm = 1000 * metrics.distances(original.positions, decoded.positions)
    picture = figure(9, 5 + 0.1 * original.points)
    over_time, per_point = picture.subplots(2, 1, height_ratios=[3, 2 + 0.1 * original.points])
    picture.suptitle(title)
    draw_error_over_time(over_time, mm, original.rate)
    known = [name for column, name in enumerate(original.names) if not np.isnan(mm[:, column]).all()]
    columns = mm[:, point_columns(original.names, known)] if known else mm[:, :0]
    rows = np.arange(len(known))
    for values, colour, label in (
        (nan_quantile(columns, 1.0), FAINT, "largest"),
        (nan_quantile(columns, 0.99), "#e5a598", "99 %"),
        (np.nanmean(columns, axis=0) if known else rows, OURS, "mean"),
    ):
        per_point.barh(rows, values, color=colour, label=label)
    per_point.set_yticks(rows, known, fontsize=7)
    per_point.set_ylim(len(known) - 0.4, -0.6)
    per_point.set_xlabel("error of each point, mm")
    legend_above(per_point)
    for axes in (over_time, per_point):
        axes.spines[["top", "right"]].set_visible(False)
    return picture


def nan_quantile(columns: Floats, share: float) -> Floats:
    """Quantile over frames of each column, gaps left out; (columns,)."""
    return np.nanquantile(columns, share, axis=0) if columns.size else np.zeros(columns.shape[1])


def draw_error_over_time(axes: Axes, mm: Floats, rate: float) -> None:
    """Root mean square and largest error of each frame against time."""
    here = ~np.isnan(mm).all(axis=1)
    seconds = np.arange(len(mm)) / rate
    rms, largest = np.full(len(mm), np.nan), np.full(len(mm), np.nan)
    rms[here] = np.sqrt(np.nanmean(mm[here] ** 2, axis=1))
    largest[here] = np.nanmax(mm[here], axis=1)
    axes.plot(seconds, largest, color=FAINT, linewidth=0.8, label="largest of the frame")
    axes.plot(seconds, rms, color=OURS, linewidth=1.2, label="root mean square")
    axes.set_xlabel("time, s")
    axes.set_ylabel("error, mm")
    axes.set_ylim(bottom=0)
    axes.margins(x=0)
    legend_above(axes)


def legend_above(axes: Axes) -> None:
    """The legend in one line above the axes, where it covers nothing."""
    axes.legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0, ncols=3, fontsize=8)


def recording(original: Motion, decoded: Motion, title: str = "", poses: int = 7) -> Figure:
    """Poses of the original (grey) with the decoded (red) drawn over them; below, the error over time."""
    decoded = in_order_of(original, decoded)
    picture = figure(9, 4.8)
    figures, curve = picture.subplots(2, 1, height_ratios=[3, 2])
    picture.suptitle(title, fontsize=10)
    frames = np.linspace(0, len(original) - 1, poses + 2).round().astype(int)[1:-1]
    up = "xyz".index(original.up)
    across = widest(original.positions, up)
    tall = [np.ptp(body[~np.isnan(body)]) for body in original.positions[frames, :, up] if not np.isnan(body).all()]
    step = 0.75 * max(tall, default=1.0)
    for place, frame in enumerate(frames):
        middle = np.nanmean(original.positions[frame], axis=0) if not original.gaps[frame].all() else np.zeros(3)
        for motion, style in (
            (original, {"color": FAINT, "linewidth": 3.5}),
            (decoded, {"color": OURS, "linewidth": 1.0}),
        ):
            body = motion.positions[frame] - middle
            flat = np.stack([body[:, across] + step * place, motion.positions[frame][:, up]], axis=1)
            draw_body(figures, flat, original, style)
        seconds = frame / original.rate
        figures.annotate(
            f"{seconds:.1f} s",
            (step * place, 0),
            (0, -12),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=INK,
        )
    figures.plot([], [], color=FAINT, linewidth=3.5, label="original")
    figures.plot([], [], color=OURS, linewidth=1.0, label="decoded")
    legend_above(figures)
    figures.set_aspect("equal")
    figures.set_axis_off()
    draw_error_over_time(curve, 1000 * metrics.distances(original.positions, decoded.positions), original.rate)
    curve.spines[["top", "right"]].set_visible(False)
    return picture


def widest(positions: Floats, up: int) -> int:
    """The level axis along which the points of one frame spread more: a body is drawn against it."""
    level = [axis for axis in range(3) if axis != up]
    seen = positions[~np.isnan(positions).all(axis=(1, 2))]
    spread = [np.sum(np.nanvar(seen[:: max(1, len(seen) // 50), :, axis], axis=1)) for axis in level]
    return level[int(np.argmax(spread))]


def draw_body(axes: Axes, flat: Floats, like: Motion, style: dict[str, Any]) -> None:
    """One pose: the bones of a skeleton, or its points. flat: (points, 2)."""
    if like.skeleton is None:
        axes.plot(*flat.T, linestyle="", marker="o", color=style["color"], markersize=1.3 * style["linewidth"])
        return
    for joint, parent in enumerate(like.skeleton.parents):
        if parent >= 0:
            axes.plot(*flat[[parent, joint]].T, solid_capstyle="round", **style)
