"""Records → one self-contained HTML page and a Markdown table. Nothing here is typed by hand: records in, pages out.

    records ─► tables (ratio by coder and target, Bjøntegaard, bytes by part, speed)  ─► report.md
            └► charts as SVG inside the page                                          ─► report.html

Averages over recordings are geometric, over the recordings that every coder in the table could code, and say how many.
"""

from __future__ import annotations

import html
import io
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ..errors import MissingExtra
from .published import PUBLISHED
from .rivals import RIVALS
from .runner import OURS, Record

MEAN, HARD = "mean_error", "max_error"
HEADINGS = {MEAN: "mean error", HARD: "hard maximum"}
COLOURS = {"tempo": "#d1495b", "hou2014": "#00798c", "liu2006": "#edae49", "lossless": "#7b5ea7", "sz3": "#30638e"}


def good(records: Iterable[Record]) -> list[Record]:
    """Records that carry a result."""
    return [r for r in records if r.bytes and not r.problem]


def coders(records: Sequence[Record]) -> list[str]:
    """Coders in order: ours first, as in OURS, then the rivals by name."""
    names = {r.codec for r in records}
    return [n for n in OURS if n in names] + sorted(names - set(OURS))


def geometric(values: Sequence[float]) -> float:
    """The geometric mean."""
    return float(np.exp(np.mean(np.log(values)))) if len(values) else float("nan")


def cell(records: Sequence[Record], codec: str, target: str, wanted: float) -> list[Record]:
    """The good records of one table cell."""
    return [r for r in good(records) if (r.codec, r.target, r.target_m) == (codec, target, wanted)]


MOST = 0.8
"""A coder that manages less than this share of the recordings at a target is left out of that comparison."""


def comparable(
    records: Sequence[Record], names: Sequence[str], target: str, wanted: float
) -> tuple[list[str], set[str]]:
    """The coders that managed most recordings at this target, and the recordings that all of these could code."""
    files = {n: {r.file for r in cell(records, n, target, wanted)} for n in names}
    most = max(map(len, files.values()), default=0)
    able = [n for n in names if files[n] and len(files[n]) >= MOST * most]
    return able, set.intersection(*(files[n] for n in able)) if able else set()


def targets_of(records: Sequence[Record]) -> list[tuple[str, float]]:
    return sorted({(r.target, r.target_m) for r in records if r.target in HEADINGS}, key=lambda t: (t[0] == HARD, t[1]))


def bjontegaard(records: Sequence[Record], codec: str, against: str, target: str = MEAN) -> tuple[float, int]:
    """Average bytes of `codec` over those of `against` at equal error, as a factor, and over how many files.

    Log bytes are integrated over log error by trapezoids between the measured targets, then averaged over files:
    Bjøntegaard's difference in rate, with the measured points themselves in place of a fitted polynomial.
    """
    errors = sorted({m for t, m in targets_of(records) if t == target})
    factors = []
    for file in sorted({r.file for r in records}):
        gains = []
        for wanted in errors:
            a = [r.bytes for r in cell(records, codec, target, wanted) if r.file == file]
            b = [r.bytes for r in cell(records, against, target, wanted) if r.file == file]
            if a and b:
                gains.append((np.log(wanted), np.log(a[0] / b[0])))
        if len(gains) >= 2:
            x, y = np.array(gains).T
            factors.append(float(np.exp(np.trapezoid(y, x) / (x[-1] - x[0]))))
        elif gains:
            factors.append(float(np.exp(gains[0][1])))
    return geometric(factors), len(factors)


def ratio_rows(records: Sequence[Record]) -> tuple[list[str], list[list[str]]]:
    """The main table: geometric mean ratio of every coder at every target, over files that all of them could code."""
    wanted = targets_of(records)
    names = [n for n in coders(good(records)) if any(cell(records, n, *t) for t in wanted)]
    compared = {t: comparable(records, names, *t) for t in wanted}
    head = ["codec"] + [f"{HEADINGS[t]} {m * 100:g} cm" for t, m in wanted]
    rows = []
    for name in names:
        row = [name]
        for t in wanted:
            able, files = compared[t]
            ratios = [r.ratio for r in cell(records, name, *t) if name in able and r.file in files]
            row.append(f"{geometric(ratios):.1f}" if ratios else "–")
        rows.append(row)
    rows.append(["recordings"] + [str(len(compared[t][1])) for t in wanted])
    return head, rows


def difference_rows(records: Sequence[Record]) -> tuple[list[str], list[list[str]]]:
    """Bytes at equal error against SZ3 and hou2014, one number each."""
    rows = []
    for name in coders(good(records)):
        row = [name]
        for target in (MEAN, HARD):
            for against in ("sz3", "hou2014"):
                factor, count = bjontegaard(records, name, against, target)
                row.append(f"{(factor - 1) * 100:+.0f} % ({count})" if count else "–")
        if any(c != "–" for c in row[1:]):
            rows.append(row)
    head = ["codec"] + [f"{HEADINGS[t]}, against {a}" for t in (MEAN, HARD) for a in ("SZ3", "hou2014")]
    return head, rows


def lossless_rows(records: Sequence[Record]) -> tuple[list[str], list[list[str]]]:
    """Ratios without loss."""
    names = [n for n in coders(good(records)) if cell(records, n, "lossless", 0.0)]
    names, files = comparable(records, names, "lossless", 0.0)
    return ["codec", "lossless ratio", "recordings"], [
        [
            n,
            f"{geometric([r.ratio for r in cell(records, n, 'lossless', 0.0) if r.file in files]):.2f}",
            str(len(files)),
        ]
        for n in names
    ]


def speed_rows(records: Sequence[Record]) -> tuple[list[str], list[list[str]]]:
    """Median frames a second. Ours encode to a target in one call; a rival's time is its last search step alone."""
    rows = []
    for name in coders(good(records)):
        mine = [r for r in good(records) if r.codec == name]
        encode, decode = (float(np.median([getattr(r, k) for r in mine])) for k in ("encode_fps", "decode_fps"))
        memory = float(np.median([r.peak_memory_mb for r in mine]))
        rows.append([name, f"{encode:,.0f}", f"{decode:,.0f}", f"{memory:,.0f}"])
    return ["codec", "encode, frames/s", "decode, frames/s", "peak memory of the process, MB"], rows


def file_rows(records: Sequence[Record]) -> tuple[list[str], list[list[str]]]:
    """Every recording: size and the ratio of ours and SZ3 at every target."""
    names = [n for n in ("tempo", "hou2014", "liu2006", "sz3") if n in coders(good(records))]
    wanted = targets_of(records)
    head = ["recording", "frames", "points", "Hz"] + [
        f"{n} {'≤' if t == HARD else '~'}{m * 100:g}" for t, m in wanted for n in names
    ]
    rows = []
    for file in sorted({r.file for r in good(records)}):
        one = next(r for r in good(records) if r.file == file)
        row = [file, str(one.frames), str(one.points), f"{one.rate:g}"]
        for t in wanted:
            for n in names:
                found = [r.ratio for r in cell(records, n, *t) if r.file == file]
                row.append(f"{found[0]:.1f}" if found else "–")
        rows.append(row)
    return head, rows


def problem_rows(records: Sequence[Record]) -> tuple[list[str], list[list[str]]]:
    """What could not be measured, and why."""
    seen = {}
    for r in records:
        if r.problem:
            what = "" if r.frames == 0 else f"{r.codec} at {HEADINGS.get(r.target, r.target)} {r.target_m * 100:g} cm"
            seen.setdefault((r.file, what, r.problem), None)
    return ["recording", "codec and target", "why"], [list(key) for key in sorted(seen)]


def tables(records: Sequence[Record]) -> list[tuple[str, tuple[list[str], list[list[str]]]]]:
    """Every table of the report with its title."""
    return [
        ("Compression ratio against float32, all side information counted", ratio_rows(records)),
        ("Bytes saved at equal error (Bjøntegaard difference, number of recordings)", difference_rows(records)),
        ("Without loss", lossless_rows(records)),
        ("Speed and memory", speed_rows(records)),
        ("Every recording", file_rows(records)),
        ("Not measured, and why", problem_rows(records)),
    ]


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""

    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(c.replace("|", "\\|").replace("\n", " ") for c in cells) + " |"

    return "\n".join([line(head), "|" + "---|" * len(head), *map(line, rows)])


def measured_on(machine: dict[str, Any]) -> str:
    return (
        f"Measured with mocodec {machine.get('mocodec', '?')}, Python {machine.get('python', '?')}, "
        f"NumPy {machine.get('numpy', '?')} on {machine.get('cores', '?')} cores ({machine.get('processor', '?')})."
    )


def markdown(records: Sequence[Record], machine: dict[str, Any]) -> str:
    """The report as Markdown."""
    parts = ["# mocodec: evaluation", measured_on(machine)]
    for title, (head, rows) in tables(records):
        if rows:
            parts += [f"## {title}", markdown_table(head, rows)]
    return "\n\n".join(parts) + "\n"


def summary(records: Sequence[Record], machine: dict[str, Any]) -> str:
    """What a README shows: the main table, bytes saved, and how they were measured."""
    people = sorted({r.settings["prior"] for r in good(records) if "prior" in r.settings})
    unseen = (
        "tempo's prior had not seen the people it is judged on (leave-subjects-out)."
        if people
        else "tempo used the prior inside the package."
    )
    count = len({r.file for r in good(records)})
    return (
        "\n\n".join(
            [
                "*Compression ratio against float32 positions at equal error, all side information counted: geometric "
                f"mean over the recordings that all codecs of a column could code, of {count} measured. {unseen} "
                f"{measured_on(machine)} Made by `mocodec eval`.*",
                markdown_table(*ratio_rows(records)),
                "*Bytes at equal error, average over the three errors (Bjøntegaard), and over how many recordings:*",
                markdown_table(*ours_only(difference_rows(records))),
            ]
        )
        + "\n"
    )


def ours_only(table: tuple[list[str], list[list[str]]]) -> tuple[list[str], list[list[str]]]:
    """The rows of our codecs."""
    head, rows = table
    return head, [row for row in rows if row[0] in OURS]


def curves(records: Sequence[Record]) -> bytes:
    """The ratio against mean error as a PNG. Raises MissingExtra without Matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError as missing:
        raise MissingExtra("the report's charts", "plot") from missing
    figure = Figure(figsize=(8.6, 4.4), layout="constrained")
    draw_mean(figure, records)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return buffer.getvalue()


def page(records: Sequence[Record], machine: dict[str, Any]) -> str:
    """The report as one self-contained HTML page. Raises MissingExtra without Matplotlib."""
    body = [f"<h1>mocodec: evaluation</h1><p>{html.escape(measured_on(machine))}</p>"]
    for title, note, svg in charts(records):
        body.append(f"<figure>{svg}<figcaption><b>{html.escape(title)}</b> {html.escape(note)}</figcaption></figure>")
    for title, (head, rows) in tables(records):
        if rows:
            body.append(f"<h2>{html.escape(title)}</h2>{html_table(head, rows)}")
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>mocodec: evaluation</title><style>{STYLE}</style><body>{''.join(body)}</body></html>\n"
    )


HOLLOW = "Geometric mean over recordings; hollow marks are printed figures of other systems, on other sequences."

STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:68rem;margin:2rem auto;padding:0 1rem;color:#222}"
    "table{border-collapse:collapse;display:block;overflow-x:auto;font-variant-numeric:tabular-nums}"
    "td,th{padding:.25rem .7rem;border-bottom:1px solid #ddd;text-align:right}"
    "td:first-child,th:first-child{text-align:left}figure{margin:2rem 0}svg{max-width:100%;height:auto}"
    "figcaption{color:#444}"
)


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(c)}</{tag}>" for c in cells) + "</tr>"

    return f"<table>{line(head, 'th')}{''.join(line(r, 'td') for r in rows)}</table>"


def charts(records: Sequence[Record]) -> list[tuple[str, str, str]]:
    """Title, note and SVG of every chart."""
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
    """A figure as SVG text without date and declaration, equal for equal records."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue().split("?>", 1)[1].split(">", 1)[1].strip()


def colour_of(name: str) -> Any:
    """The same colour for the same coder in every chart."""
    from matplotlib import colormaps

    return COLOURS.get(name) or colormaps["tab20b"](sorted(RIVALS).index(name) * 3 % 20 if name in RIVALS else 0)


def short(value: float) -> str:
    """A number as an axis shows it: 0.2, 50, 20k, 1M."""
    for unit, letter in ((1e6, "M"), (1e3, "k")):
        if value >= unit:
            return f"{value / unit:g}{letter}"
    return f"{value:g}"


def plain_logarithmic(axes: Any, which: str = "xy") -> None:
    """Logarithmic axes with numbers a person reads, and a grid."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for letter in which:
        getattr(axes, f"set_{letter}scale")("log")
        axis = getattr(axes, f"{letter}axis")
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: short(value)))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(True, which="both", alpha=0.2)


def draw_curves(axes: Any, records: Sequence[Record], target: str) -> bool:
    names = coders(good(records))
    any_drawn = False
    for name in names:
        points = []
        for t, wanted in targets_of(records):
            ratios = [r.ratio for r in cell(records, name, t, wanted)] if t == target else []
            if ratios:
                points.append((wanted * 100, geometric(ratios)))
        if points:
            any_drawn = True
            x, y = zip(*points, strict=True)
            width = 2.4 if name in OURS else 1.1
            axes.plot(x, y, "o-", color=colour_of(name), label=name, linewidth=width, markersize=4)
    axes.set_ylabel("compression ratio (float32)")
    plain_logarithmic(axes)
    return any_drawn


def draw_mean(figure: Any, records: Sequence[Record]) -> bool:
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
    axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return drawn


def draw_hard(figure: Any, records: Sequence[Record]) -> bool:
    axes = figure.subplots()
    drawn = draw_curves(axes, records, HARD)
    axes.set_xlabel("hard maximum, cm")
    if drawn:
        axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return drawn


def draw_parts(figure: Any, records: Sequence[Record]) -> bool:
    rows = [(n, t, m) for n in coders(good(records)) if n in OURS for t, m in targets_of(records)]
    rows = [row for row in rows if cell(records, *row)]
    if not rows:
        return False
    from matplotlib import colormaps

    axes = figure.subplots()
    axes.set_prop_cycle(color=[colormaps["tab20"](i) for i in range(20)])
    names = sorted({p for r in good(records) if r.ours for p in r.bytes_by_part})
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
    names = [n for n in coders(good(records)) if cell(records, n, MEAN, 0.003)]
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
        plain_logarithmic(axes)
        axes.tick_params(axis="x", labelsize=7)
    figure.axes[0].set_ylabel("ratio at mean 0.3 cm")
    return True


def draw_figure(figure: Any, records: Sequence[Record]) -> bool:
    one = next((r for r in good(records) if r.figure.get("parents")), None)
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
