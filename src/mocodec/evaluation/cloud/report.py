"""Records of point clouds → a Markdown table and a picture: ours, the rivals, and figures from elsewhere as such."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ... import plots
from ..report import markdown_table, measured_on
from .measures import PEAK_M
from .runner import LONG, Measured, Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Cited:
    """A figure that this command cannot measure: system, on what data, ratio, and D1, D2 in metres and views in dB."""

    system: str
    data: str
    ratio: float
    d1_m: float | None
    d2_m: float | None
    views_psnr_db: float | None


SPARSE = "10,000 fresh points a frame"
DENSE = "151,000 points on a 4.1 mm grid"
PAPER = "Lien and Bajcsy 2006, tables 1 and 2"
CITED_FLOOR_DB, CITED_FLOOR_M = 26.8, 0.0078

# Reference software run before this project on a MakeHuman body in CMU motion, 15 fps; then what the paper prints.
CITED = (
    Cited("G-PCC, scale ½", SPARSE, 13, 0.0027, 0.0016, 30),
    Cited("G-PCC, scale ¼", SPARSE, 20, 0.0044, 0.0026, 28),
    Cited("G-PCC, scale ⅛", SPARSE, 55, 0.0083, 0.0052, 26),
    Cited("G-PCC, lossless geometry, qp 40", DENSE, 110, 0.0, 0.0, 36.5),
    Cited("G-PCC, scale ½", DENSE, 244, 0.0050, 0.0027, 29.4),
    Cited("G-PCC, scale ¼", DENSE, 692, 0.0087, 0.0055, 27.3),
    Cited("V-PCC TMC2 r3", DENSE, 147, 0.0029, 0.0020, 29.5),
    Cited("V-PCC TMC2 r1", DENSE, 375, 0.0042, 0.0031, 28.0),
    Cited("uvgVPCCenc fast", DENSE, 134, 0.0039, 0.0033, 26.9),
    Cited("uvgVPCCenc fast", DENSE, 301, 0.0068, 0.0063, 25.0),
    *(Cited(f"Lien 2006, {what}, {motion}", PAPER, ratio, None, None, psnr)
      for what, row in (
          ("no residuals", ((1490.31, 23.87), (3581.52, 24.10), (5839.59, 25.82), (5664.55, 26.27))),
          ("25 % residuals", ((195.62, 25.77), (173.52, 26.18), (183.80, 27.96), (183.82, 28.75))),
          ("100 % residuals", ((66.54, 27.95), (55.33, 28.27), (60.29, 29.91), (61.43, 30.83))),
          ("Yang et al. beside it", ((11.36, None), (11.73, None), (10.23, None), (14.41, None))),
          ("H.264 beside it", ((64.04, None), (53.78, None), (32.04, None), (49.58, None))),
      )
      for motion, (ratio, psnr) in zip(("dancer 1", "dancer 2", "student", "tai-chi"), row, strict=True)),
)  # fmt: skip

COLOURS = {
    "lien2006": "#d1495b", "bodycast": "#00798c", "zlib": "#6b6b6b", "draco": "#5c8a3a", "yang-zlib": "#8d6346",
    "yang-jpeg": "#b08968", "h264": "#c27ba0", "h265": "#7b5ea7", "av1": "#edae49",
}  # fmt: skip
LOSSLESS_DB = 60.0  # from here on a coder is left out of the picture of views: it would squeeze all others together


def good(records: Sequence[Record]) -> list[Record]:
    return [r for r in records if not r.problem]


def rows(records: Sequence[Record]) -> tuple[list[str], list[list[str]]]:
    """One row a coder and setting of one sequence; in brackets what a second perfect sample scores."""
    head = ["coder", "bytes a frame", "ratio", f"ratio, {LONG:,} frames", "D1 cm", "D1 dB", "D2 cm", "D2 dB",
            "Y dB", "views dB", "points", "encode fps", "decode fps"]  # fmt: skip
    table = list[list[str]]()
    for r in sorted(good(records), key=lambda r: not r.ours):
        table.append(
            [
                f"**{r.label}**" if r.ours else r.label,
                f"{r.bytes_per_frame:,.0f}",
                f"{r.ratio:,.1f}",
                f"{r.ratio_1000:,.1f}" if r.once_bytes else "same",
                *(_beside(r, key, scale, form) for key, scale, form in CELLS),
                f"{r.decoded_points:,.0f}",
                f"{r.encode_fps:,.0f}",
                f"{r.decode_fps:,.0f}",
            ]
        )
    return head, table


CELLS = (
    ("d1_m", 100, ".2f"), ("d1_db", 1, ".1f"), ("d2_m", 100, ".2f"), ("d2_db", 1, ".1f"), ("y_psnr_db", 1, ".1f"),
    ("views_psnr_db", 1, ".1f"),
)  # fmt: skip


def _beside(record: Record, key: str, scale: float, form: str) -> str:
    """A measure with its floor."""
    return f"{scale * record.quality[key]:{form}} ({scale * record.floor[key]:{form}})"


def markdown(records: Sequence[Record], machine: dict[str, Any]) -> str:
    """The report as Markdown: a table a sequence, what is counted, what was not measured, and the cited figures."""
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
            markdown_table(*rows(of)),
        ]
    counted = {r.coder: (r.counted, r.version) for r in good(records)}
    parts += [
        "## What is counted",
        markdown_table(["coder", "bytes hold", "version"], [[k, *v] for k, v in counted.items()]),
    ]
    missing = {(r.sequence, r.label, r.problem): None for r in records if r.problem}
    if missing:
        parts += [
            "## Not measured, and why",
            markdown_table(["sequence", "coder", "why"], [list(key) for key in missing]),
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
        markdown_table(["system", "on", "ratio", "D1 cm", "D2 cm", "views dB"], cited),
    ]
    return "\n\n".join(parts) + "\n"


def _or_dash(value: float | None, scale: float) -> str:
    return "–" if value is None else f"{scale * value:g}"


class Point(NamedTuple):
    """A coder at one setting: ratio, views in dB, D1 in metres, ratio at 1,000 frames."""

    ratio: float
    views: float
    d1: float
    ratio_1000: float


def averages(records: Sequence[Record]) -> dict[tuple[str, bool], list[Point]]:
    """Means over the sequences by coder and whether it was given the first pose, of settings that every one has."""
    names = {r.sequence for r in records}
    result: dict[tuple[str, bool], list[Point]] = {}
    for coder, setting in dict.fromkeys((r.coder, r.setting) for r in good(records)):
        of = [r for r in good(records) if (r.coder, r.setting) == (coder, setting)]
        if {r.sequence for r in of} == names:
            ratio, long = (float(np.exp(np.mean([np.log(getattr(r, k)) for r in of]))) for k in ("ratio", "ratio_1000"))
            views, d1 = (float(np.mean([r.quality[key] for r in of])) for key in ("views_psnr_db", "d1_m"))
            result.setdefault((coder, "first pose given" in setting), []).append(Point(ratio, views, d1, long))
    return result


def picture(records: Sequence[Record]) -> Figure:
    """Ratio against the PSNR of six views and against D1; cited figures in grey. Raises MissingExtra."""
    figure = plots.figure(11, 6)
    from matplotlib import ticker

    seen, distance = figure.subplots(1, 2)
    ours = {r.coder for r in records if r.ours}
    for (coder, given), points in averages(records).items():
        ratio, views, d1, long = np.array(points).T
        style: dict[str, Any] = {"color": COLOURS.get(coder, plots.INK), "linewidth": 1.2}
        style |= (
            {"marker": "*" if given else "o", "markersize": 8} if coder in ours else {"marker": "s", "markersize": 4}
        )
        label = f"{coder}{', first pose given' * given}"
        shown = views < LOSSLESS_DB
        for axes, values, which in ((seen, views, shown), (distance, 100 * d1, d1 > 0)):
            if which.any():
                axes.plot(ratio[which], values[which], label=label if axes is distance else None, **style)
            if coder in ours:
                axes.plot(long[which], values[which], **style | {"markerfacecolor": "none", "linestyle": "--"})
    distance.plot([], [], color=plots.INK, marker="o", markerfacecolor="none", linestyle="--",
                  label=f"ours, were it {LONG:,} frames")  # fmt: skip
    draw_cited(seen, distance)
    dotted: dict[str, Any] = {"color": plots.INK, "linestyle": ":", "linewidth": 1}
    floor = {key: float(np.mean([r.floor[key] for r in records])) for key in ("views_psnr_db", "d1_m")}
    seen.axhline(floor["views_psnr_db"], **dotted)
    seen.axhline(CITED_FLOOR_DB, **dotted | {"color": plots.FAINT})
    distance.axhline(100 * floor["d1_m"], label="a second perfect sample", **dotted)
    distance.plot([], [], label="the same, where G-PCC was run", **dotted | {"color": plots.FAINT})
    frames = sorted({r.frames for r in records})
    for axes, what in ((seen, "PSNR over six views, dB"), (distance, "D1, cm (less is better)")):
        axes.set_xscale("log")
        axes.set_xlabel(f"ratio, all bytes over {' or '.join(map(str, frames))} frames")
        axes.set_ylabel(what)
        axes.spines[["top", "right"]].set_visible(False)
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    distance.set_yscale("log")
    distance.yaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    distance.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    distance.yaxis.set_minor_formatter(ticker.NullFormatter())
    handles, labels = distance.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return figure


def draw_cited(seen: Axes, distance: Axes) -> None:
    """What was not measured here, as hollow grey marks."""
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
        seen.plot(*np.array(by_views).T, **style)
        distance.plot(*np.array(by_d1).reshape(-1, 2).T, label=f"cited: {label}", **style)


def views(measured: Sequence[Measured]) -> Figure:
    """The middle frame of the first sequence from two sides: the original, then every coder's at every setting."""
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
