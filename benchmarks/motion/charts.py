"""Charts of the motion benchmark, from its records."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocodec.errors import MissingExtra

from ..figures import set_logarithmic
from .published import PUBLISHED
from .records import HARD, MEAN, OURS, Record
from .rivals import RIVALS
from .tables import cell, coders, geometric, successful, targets_of

COLOURS = {"tempo": "#d1495b", "hou2014": "#00798c", "liu2006": "#edae49", "lossless": "#7b5ea7", "sz3": "#30638e"}
HOLLOW = "Geometric mean over recordings; hollow marks are printed figures of other systems, on other sequences."


def mean_error_png(records: Sequence[Record]) -> bytes:
    """The chart of ratio against mean error as a PNG. Raises MissingExtra without Matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError as missing:
        raise MissingExtra("the report's charts", "plot") from missing
    figure = Figure(figsize=(8.6, 4.4), layout="constrained")
    draw_mean(figure, records)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return buffer.getvalue()


def charts(records: Sequence[Record]) -> list[tuple[str, str, str]]:
    """Title, note and SVG of each chart. Raises MissingExtra without Matplotlib."""
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as missing:
        raise MissingExtra("the report's charts", "plot") from missing
    with matplotlib.rc_context({"svg.hashsalt": "mocodec", "svg.fonttype": "none", "font.size": 9}):
        drawn = []
        for title, note, draw in (
            ("Ratio against mean error.", HOLLOW, draw_mean),
            ("Ratio under a hard maximum.", "Greatest distance of any point in any frame.", draw_hard),
            ("Bytes by part.", "Share of each part of our files, summed over recordings.", draw_parts),
            ("Speed against size.", "Median frames a second; left: encoding, right: decoding.", draw_speed),
            ("Error by point.", "tempo at mean 0.3 cm, on the first recording with a skeleton.", draw_figure),
        ):  # fmt: skip
            figure = Figure(figsize=(8.6, 4.4), layout="constrained")
            if draw(figure, records):
                drawn.append((title, note, svg_of(figure)))
        return drawn


def svg_of(figure: Any) -> str:
    """A figure as an SVG element; without a date, so that equal records give equal text."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue().split("?>", 1)[1].split(">", 1)[1].strip()


def colour_of(name: str) -> Any:
    """The colour of a coder in all charts."""
    from matplotlib import colormaps

    return COLOURS.get(name) or colormaps["tab20b"](sorted(RIVALS).index(name) * 3 % 20 if name in RIVALS else 0)


def draw_curves(axes: Any, records: Sequence[Record], target: str) -> bool:
    """Draws ratio against the error of one kind of target, a curve per coder. Returns whether there are any.

    The legend lists the curves from top to bottom. Dashes and marks distinguish overlapping curves.
    """
    curves: list[tuple[str, list[tuple[float, float]]]] = []
    for name in coders(successful(records)):
        points = []
        for t, wanted in targets_of(records):
            ratios = [r.ratio for r in cell(records, name, t, wanted)] if t == target else []
            if ratios:
                points.append((wanted * 100, geometric(ratios)))
        if points:
            curves.append((name, points))
    curves.sort(key=lambda curve: -curve[1][-1][1])
    for number, (name, points) in enumerate(curves):
        x, y = zip(*points, strict=True)
        if name in OURS:
            axes.plot(x, y, "o-", color=colour_of(name), label=name, linewidth=2.4, markersize=5, zorder=2)
            continue
        axes.plot(
            x, y, MARKS[number % len(MARKS)], color=colour_of(name), label=name, linewidth=1.3, markersize=4.5,
            linestyle=DASHES[number % len(DASHES)], zorder=3,
        )  # fmt: skip
    axes.set_ylabel("compression ratio (float32)")
    set_logarithmic(axes)
    return bool(curves)


DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1, 1.2)), (0, (6, 2, 1, 2)))
MARKS = ("o", "s", "^", "D", "v")


def draw_mean(figure: Any, records: Sequence[Record]) -> bool:
    """Draws ratio against mean error, with printed results of other systems."""
    axes = figure.subplots()
    drawn = draw_curves(axes, records, MEAN)
    systems = sorted({p.system for p in PUBLISHED})
    for system, marker in zip(systems, "sD^v<>", strict=False):
        mine = [p for p in PUBLISHED if p.system == system]
        axes.plot(
            [p.mean_error_m * 100 for p in mine], [p.ratio for p in mine], marker, markerfacecolor="none",
            color="#555", label=f"{system} (printed)", markersize=5,
        )  # fmt: skip
    axes.set_xlabel("mean error, cm")
    axes.legend(
        fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), title_fontsize=7,
        title="lines: measured here\nhollow: printed in papers,\non their own sequences",
    )  # fmt: skip
    return drawn


def draw_hard(figure: Any, records: Sequence[Record]) -> bool:
    """Draws ratio against the hard maximum."""
    axes = figure.subplots()
    drawn = draw_curves(axes, records, HARD)
    axes.set_xlabel("hard maximum, cm")
    if drawn:
        axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return drawn


def draw_parts(figure: Any, records: Sequence[Record]) -> bool:
    """Draws shares of the parts of our files."""
    rows = [(n, t, m) for n in coders(successful(records)) if n in OURS for t, m in targets_of(records)]
    rows = [row for row in rows if cell(records, *row)]
    if not rows:
        return False
    from matplotlib import colormaps

    axes = figure.subplots()
    axes.set_prop_cycle(color=[colormaps["tab20"](i) for i in range(20)])
    names = sorted({p for r in successful(records) if r.ours for p in r.bytes_by_part})
    left = np.zeros(len(rows))
    labels = [f"{n} {'≤' if t == HARD else '~'}{m * 100:g} cm" for n, t, m in rows]
    for part in names:
        sizes = np.array([sum(r.bytes_by_part.get(part, 0) for r in cell(records, *row)) for row in rows], float)
        totals = np.array([sum(sum(r.bytes_by_part.values()) for r in cell(records, *row)) for row in rows], float)
        share = 100 * sizes / np.maximum(totals, 1)
        axes.barh(labels, share, left=left, label=part)
        left += share
    axes.invert_yaxis()
    axes.set_xlabel("share of the file, %")
    axes.legend(fontsize=7, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return True


def draw_speed(figure: Any, records: Sequence[Record]) -> bool:
    """Draws ratio against frames a second, at a mean error of 0.3 cm."""
    names = [n for n in coders(successful(records)) if cell(records, n, MEAN, 0.003)]
    if not names:
        return False
    for axes, way in zip(figure.subplots(1, 2, sharey=True), ("encode", "decode"), strict=True):
        for name in names:
            mine = cell(records, name, MEAN, 0.003)
            speed = float(np.median([getattr(r, f"{way}_fps") for r in mine]))
            ratio = geometric([r.ratio for r in mine])
            axes.plot(speed, ratio, "o", color=colour_of(name), markersize=8 if name in OURS else 5)
            axes.annotate(name, (speed, ratio), textcoords="offset points", xytext=(5, 4), fontsize=7)
        axes.set_xlabel(f"{way}, frames/s")
        set_logarithmic(axes)
        axes.tick_params(axis="x", labelsize=7)
    figure.axes[0].set_ylabel("ratio at mean 0.3 cm")
    return True


def draw_figure(figure: Any, records: Sequence[Record]) -> bool:
    """Draws the mean error of each joint on a stick figure of the first recording with a skeleton."""
    one = next((r for r in successful(records) if r.figure.get("parents")), None)
    if one is None:
        return False
    at, parents = np.array(one.figure["positions"]), one.figure["parents"]
    error = np.array(one.figure["mean_error_m"]) * 1000
    axes = figure.subplots()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            axes.plot(at[[joint, parent], 0], at[[joint, parent], 1], "-", color="#bbb", zorder=1)
    marks = axes.scatter(at[:, 0], at[:, 1], c=error, cmap="viridis", s=60, zorder=2)
    figure.colorbar(marks, ax=axes, label="mean error, mm")
    axes.set(aspect="equal", xlabel="m", ylabel="m", title=one.file)
    return True
