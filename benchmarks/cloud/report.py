"""Records of point cloud coders as a Markdown report and figures, with results of other systems beside them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mocodec import plots
from mocodec.metrics.point_clouds import PEAK_M

from .. import markdown as md
from ..machine import measured_on
from .cited import CITED, CITED_FLOOR_DB, CITED_FLOOR_M, DENSE, PAPER, SPARSE
from .records import LONG, CloudRecord, Measured

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {
    "lien2006": "#d1495b", "bodycast": "#00798c", "zlib": "#6b6b6b", "draco": "#5c8a3a", "yang-zlib": "#8d6346",
    "yang-jpeg": "#b08968", "h264": "#c27ba0", "h265": "#7b5ea7", "av1": "#edae49",
}  # fmt: skip
LOSSLESS_DB = 60.0
"""The figure of rendered views omits coders above this PSNR, which would squeeze all other points."""
MEASURES = (
    ("d1_m", 100, ".2f"), ("d1_db", 1, ".1f"), ("d2_m", 100, ".2f"), ("d2_db", 1, ".1f"), ("y_psnr_db", 1, ".1f"),
    ("views_psnr_db", 1, ".1f"),
)  # fmt: skip
"""Columns of the table: key, factor (metres to centimetres), format."""


def without_problems(records: Sequence[CloudRecord]) -> list[CloudRecord]:
    """Records of successful coders."""
    return [r for r in records if not r.problem]


def rows(records: Sequence[CloudRecord]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of one sequence's table: a row for each coder and setting, the resampling floor in brackets."""
    head = ["coder", "bytes a frame", "ratio", f"ratio, {LONG:,} frames", "D1 cm", "D1 dB", "D2 cm", "D2 dB",
            "Y dB", "views dB", "points", "encode fps", "decode fps"]  # fmt: skip
    table = list[list[str]]()
    for r in sorted(without_problems(records), key=lambda r: not r.ours):
        table.append(
            [
                f"**{r.label}**" if r.ours else r.label,
                f"{r.bytes_per_frame:,.0f}",
                f"{r.ratio:,.1f}",
                f"{r.ratio_1000:,.1f}" if r.once_bytes else "same",
                *(_with_floor(r, key, scale, form) for key, scale, form in MEASURES),
                f"{r.decoded_points:,.0f}",
                f"{r.encode_fps:,.0f}",
                f"{r.decode_fps:,.0f}",
            ]
        )
    return head, table


def _with_floor(record: CloudRecord, key: str, scale: float, form: str) -> str:
    """A measure, and its floor in brackets."""
    return f"{scale * record.quality[key]:{form}} ({scale * record.floor[key]:{form}})"


def markdown(records: Sequence[CloudRecord], machine: dict[str, Any]) -> str:
    """The report: one table per sequence, contents of the bytes, coders without results, results of other systems."""
    parts = [
        "# Point clouds of people",
        measured_on(machine),
        "Every ratio counts all bytes, against float32 positions and 8-bit colours; the ratio at "
        f"{LONG:,} frames spreads what is sent once over that many. In brackets stands the resampling floor: what a "
        "second perfect sample of the same surface scores (of noisy recordings, a coder that smooths may pass it). D1 "
        f"and D2 are symmetric root mean squares, in dB against {PEAK_M:g} m; Y is the PSNR of luma between nearest "
        "points; views is the mean PSNR of six rendered views.",
    ]
    for name in dict.fromkeys(r.sequence for r in records):
        of = [r for r in records if r.sequence == name]
        first = of[0]
        kilobytes = first.raw_bytes / first.frames / 1000
        about = f"{first.frames} frames of {first.points:,.0f} points at {first.rate:g} Hz, {kilobytes:,.0f} kB a frame"
        measured = max(r.measured_frames for r in of)
        parts += [
            f"## {name}",
            f"{about}, of the actor {first.actor}; measures are means over {measured} frames.",
            md.table(*rows(of)),
        ]
    counted = {r.coder: (r.counted, r.version) for r in without_problems(records)}
    parts += [
        "## What is counted",
        md.table(["coder", "bytes hold", "version"], [[k, *v] for k, v in counted.items()]),
    ]
    missing = {(r.sequence, r.label, r.problem): None for r in records if r.problem}
    if missing:
        parts += [
            "## Not measured, and why",
            md.table(["sequence", "coder", "why"], [list(key) for key in missing]),
        ]
    cited = [
        [c.system, c.data, f"{c.ratio:g}", _or_dash(c.d1_m, 100), _or_dash(c.d2_m, 100), _or_dash(c.views_psnr_db, 1)]
        for c in CITED
    ]
    parts += [
        "## Cited, not measured here",
        "On other recordings of the same kind; at the sparse setting a second perfect sample there scores "
        f"{CITED_FLOOR_M * 100:g} cm D1 and {CITED_FLOOR_DB:g} dB over six views. The paper's ratios are against the "
        "depth and colour images of all cameras and leave out its model; its PSNR is of other people and cameras.",
        md.table(["system", "on", "ratio", "D1 cm", "D2 cm", "views dB"], cited),
    ]
    return "\n\n".join(parts) + "\n"


def _or_dash(value: float | None, scale: float) -> str:
    return "–" if value is None else f"{scale * value:g}"


class AveragePoint(NamedTuple):
    """A coder at one setting, means over the sequences: ratio, views in dB, D1 in metres, ratio at 1,000 frames."""

    ratio: float
    views: float
    d1: float
    ratio_1000: float


def averages(records: Sequence[CloudRecord]) -> dict[tuple[str, bool], list[AveragePoint]]:
    """Means over the sequences, by coder and whether it got the first pose, for settings of all sequences."""
    names = {r.sequence for r in records}
    result: dict[tuple[str, bool], list[AveragePoint]] = {}
    for coder, setting in dict.fromkeys((r.coder, r.setting) for r in without_problems(records)):
        of = [r for r in without_problems(records) if (r.coder, r.setting) == (coder, setting)]
        if {r.sequence for r in of} == names:
            ratio, long = (float(np.exp(np.mean([np.log(getattr(r, k)) for r in of]))) for k in ("ratio", "ratio_1000"))
            views, d1 = (float(np.mean([r.quality[key] for r in of])) for key in ("views_psnr_db", "d1_m"))
            result.setdefault((coder, "first pose given" in setting), []).append(AveragePoint(ratio, views, d1, long))
    return result


def curves(records: Sequence[CloudRecord]) -> Figure:
    """Figure of ratio against the PSNR of six views and against D1; other systems in grey. Raises MissingExtra."""
    figure = plots.figure(11, 6)
    from matplotlib import ticker

    psnr_axes, d1_axes = figure.subplots(1, 2)
    ours = {r.coder for r in records if r.ours}
    for (coder, given), points in averages(records).items():
        ratio, views, d1, long = np.array(points).T
        style: dict[str, Any] = {"color": COLOURS.get(coder, plots.INK), "linewidth": 1.2}
        style |= (
            {"marker": "*" if given else "o", "markersize": 8} if coder in ours else {"marker": "s", "markersize": 4}
        )
        label = f"{coder}{', first pose given' * given}"
        shown = views < LOSSLESS_DB
        for axes, values, which in ((psnr_axes, views, shown), (d1_axes, 100 * d1, d1 > 0)):
            if which.any():
                axes.plot(ratio[which], values[which], label=label if axes is d1_axes else None, **style)
            if coder in ours:
                axes.plot(long[which], values[which], **style | {"markerfacecolor": "none", "linestyle": "--"})
    d1_axes.plot([], [], color=plots.INK, marker="o", markerfacecolor="none", linestyle="--",
                  label=f"ours, at {LONG:,} frames")  # fmt: skip
    draw_cited(psnr_axes, d1_axes)
    dotted: dict[str, Any] = {"color": plots.INK, "linestyle": ":", "linewidth": 1}
    floor = {key: float(np.mean([r.floor[key] for r in records])) for key in ("views_psnr_db", "d1_m")}
    psnr_axes.axhline(floor["views_psnr_db"], **dotted)
    psnr_axes.axhline(CITED_FLOOR_DB, **dotted | {"color": plots.FAINT})
    d1_axes.axhline(100 * floor["d1_m"], label="a second perfect sample", **dotted)
    d1_axes.plot([], [], label="the same, where G-PCC was run", **dotted | {"color": plots.FAINT})
    frames = sorted({r.frames for r in records})
    for axes, what in ((psnr_axes, "PSNR over six views, dB"), (d1_axes, "D1, cm (lower is better)")):
        axes.set_xscale("log")
        axes.set_xlabel(f"ratio, all bytes over {' or '.join(map(str, frames))} frames")
        axes.set_ylabel(what)
        axes.spines[["top", "right"]].set_visible(False)
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    d1_axes.set_yscale("log")
    d1_axes.yaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    d1_axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    d1_axes.yaxis.set_minor_formatter(ticker.NullFormatter())
    handles, labels = d1_axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return figure


def draw_cited(psnr_axes: Axes, d1_axes: Axes) -> None:
    """Draws results of other systems as hollow grey marks."""
    what = {
        SPARSE: f"G-PCC, {SPARSE}",
        DENSE: "G-PCC, V-PCC, 151,000 points on a grid",
        PAPER: "Lien 2006, its own data",
    }
    for (data, label), marker in zip(what.items(), "^Dv", strict=True):
        of = [c for c in CITED if c.data == data]
        style: dict[str, Any] = {"linestyle": "", "marker": marker, "markerfacecolor": "none", "markersize": 5,
                                 "color": "#777777" if data == SPARSE else plots.FAINT}  # fmt: skip
        by_views = [(c.ratio, c.views_psnr_db) for c in of if c.views_psnr_db is not None]
        by_d1 = [(c.ratio, 100 * c.d1_m) for c in of if c.d1_m]
        psnr_axes.plot(*np.array(by_views).T, **style)
        d1_axes.plot(*np.array(by_d1).reshape(-1, 2).T, label=f"cited: {label}", **style)


def images(measured: Sequence[Measured]) -> Figure:
    """Figure of the first sequence's middle frame from two sides: the original, then all coders at all settings."""
    of = [m for m in measured if m.record.sequence == measured[0].record.sequence and m.decoded is not None]
    titled = [("original", measured[0].original)]
    for m in of:
        r = m.record
        about = f"{r.ratio:,.0f} : 1, {r.quality['views_psnr_db']:.1f} dB, D1 {100 * r.quality['d1_m']:.2f} cm"
        titled.append((f"{r.coder}\n{r.setting}\n{about}", np.asarray(m.decoded)))
    across = 8
    down = -(-len(titled) // across)
    figure = plots.figure(1.7 * across, 4.1 * down)
    for axes in figure.subplots(down, across, squeeze=False).flat:
        axes.set_axis_off()
        if titled:
            title, image = titled.pop(0)
            axes.imshow(image, interpolation="nearest")
            axes.set_title(title, fontsize=7)
    return figure
