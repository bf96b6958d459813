"""Figures of Hou et al. (2014), drawn from the stored results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..figures import pyplot, remove_frame, save_png, set_logarithmic
from .hou2014_tables import TABLE_IV, CurvePoint


def draw(results: dict[str, Any], output: Path) -> None:
    """Write all figures of these results."""
    plt = pyplot()
    if results["analysis"]:
        draw_analysis(plt, results["analysis"], output)
    for number, key, title in (
        ("7", "r", "r = l / k"),
        ("8", "Q", "bits of the fractional part"),
        ("9", "L", "length of clips, 120 Hz"),
        ("11", "60 Hz", "length of clips, 60 Hz"),
        ("12", "adaptive", "number of adaptive clips"),
    ):
        draw_setting(plt, results["closely"], key, title, output / f"hou2014_figure{number}.png")
    draw_rivals(plt, results["sequences"], output / "hou2014_figure9_rivals.png")
    draw_databases(plt, results["databases"], output / "hou2014_databases.png")


def draw_analysis(plt: Any, sequences: Sequence[dict[str, Any]], output: Path) -> None:
    """Figures 2 to 5."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.4), layout="constrained")
    for i, one in enumerate(sequences):
        axes[0].plot(one["singular_values"], color=f"C{i}", label=one["sequence"])
        axes[2].plot(one["of_unfolded"], color=f"C{i}", label=one["sequence"])
    axes[1].plot(sequences[0]["singular_values"], color="0.2", label=f"{sequences[0]['sequence']}, whole")
    for clip in sequences[0]["of_clips"]:
        axes[1].plot(clip, color="#00798c", lw=0.9)
    axes[1].plot([], color="#00798c", lw=0.9, label="clips of 300 frames")
    for one, title in zip(axes, ("sequences (2a)", "clips and the whole (2b)", "clips as rows (3a)"), strict=True):
        one.set(title=title, xlabel="index", ylabel="singular value over the largest", yscale="log", ylim=(1e-5, 1.2))
        one.legend(frameon=False, fontsize=8)
    save(figure, axes, output / "hou2014_figures2_3.png")
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    axes[0].stem(np.abs(sequences[0]["column_spectrum"]), markerfmt=" ", basefmt=" ")
    axes[1].stem(np.abs(sequences[0]["row_spectrum"]), markerfmt=" ", basefmt=" ")
    for one, title in zip(axes, ("a column of M (figure 4)", "a row of M (figure 5)"), strict=True):
        one.set(title=f"DCT of {title}", xlabel="frequency", ylabel="size, m", yscale="log", ylim=(1e-4, None))
    save(figure, axes, output / "hou2014_figures4_5.png")


def draw_setting(plt: Any, sequences: Sequence[dict[str, Any]], key: str, title: str, path: Path) -> None:
    """Error against ratio at values of one setting, a panel for each sequence."""
    if not sequences:
        return
    figure, axes = plt.subplots(
        1, len(sequences), figsize=(5.2 * len(sequences), 3.8), squeeze=False, layout="constrained"
    )
    for panel, one in zip(axes[0], sequences, strict=True):
        groups = list(dict.fromkeys(label.split(",")[0] for label in one[key]))  # colour by L, line style by r
        colours = plt.get_cmap("viridis")(np.linspace(0, 0.88, len(groups)))
        drawn = dict.fromkeys(groups, 0)
        for label, points in one[key].items():
            group = label.split(",")[0]
            line = (":", "-.", "--", "-")[drawn[group]] if "," in label else "-"
            draw_points(panel, points, label, color=colours[groups.index(group)], ls=line)
            drawn[group] += 1
        panel.set_title(f"{one['sequence']}: {title}", fontsize=10)
        finish(panel)
    save(figure, axes[0], path)


def draw_rivals(plt: Any, sequences: Sequence[dict[str, Any]], path: Path) -> None:
    """Figure 9: our codec, our codec as published, and the transforms of equations (1) and (2)."""
    if not sequences:
        return
    columns = min(3, len(sequences))
    rows = math.ceil(len(sequences) / columns)
    figure, axes = plt.subplots(rows, columns, figsize=(4.6 * columns, 3.6 * rows), squeeze=False, layout="constrained")
    styles = {
        "ours, steered": {"color": "#00798c", "lw": 2.2},
        "ours, k as in the paper": {"color": "#00798c", "ls": "--"},
        "as published": {"color": "#d1495b", "ls": "--"},
        "as published, steered": {"color": "#d1495b"},
    }
    for panel, one in zip(axes.flat, sequences, strict=False):
        for i, (label, points) in enumerate(one["curves"].items()):
            if label != "hard bound":
                style = styles.get(label, {"color": f"C{i}", "lw": 0.9})
                draw_points(panel, points, label, **style)
        for i, (ratio, error) in enumerate(TABLE_IV.get(one["sequence"], ())):
            panel.plot(ratio, error, "o", mfc="none", color="0.2", label="printed in Table IV" if i == 0 else None)
        panel.set_title(f"{one['sequence']}, {one['points']} points", fontsize=10)
        finish(panel, legend=False)
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    for spare in axes.flat[len(sequences) :]:
        spare.axis("off")
    save(figure, axes.flat[: len(sequences)], path)


def draw_databases(plt: Any, databases: Sequence[dict[str, Any]], path: Path) -> None:
    """Error against ratio by the number of transforms K, a panel for each database."""
    if not databases:
        return
    figure, axes = plt.subplots(
        1, len(databases), figsize=(5 * len(databases), 3.8), squeeze=False, layout="constrained"
    )
    for panel, one in zip(axes[0], databases, strict=True):
        for count in sorted({row["K"] for row in one["rows"]}):
            draw_points(panel, [row for row in one["rows"] if row["K"] == count], f"K = {count}")
        panel.set_title(f"{one['database']}: {one['files']} files, {one['frames']:,} frames", fontsize=10)
        finish(panel)
    save(figure, axes[0], path)


def draw_points(panel: Any, points: Sequence[CurvePoint], label: str, **style: Any) -> None:
    """One curve of mean error against ratio."""
    known = sorted(points, key=lambda point: point["ratio"])
    panel.plot([p["ratio"] for p in known], [p["mean_cm"] for p in known], marker=".", label=label, **style)


def finish(panel: Any, legend: bool = True) -> None:
    """Axes and legend of a panel."""
    panel.set(xscale="log", yscale="log", xlabel="compression ratio", ylabel="mean error, cm")
    set_logarithmic(panel)
    if legend:
        panel.legend(frameon=False, fontsize=7, loc="upper left")


def save(figure: Any, axes: Sequence[Any], path: Path) -> None:
    """Write a figure without frames around its panels."""
    for panel in axes:
        remove_frame(panel)
    save_png(figure, path)
