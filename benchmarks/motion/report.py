"""Report of the motion benchmark: one self-contained HTML page, Markdown, and the README's tables.

records ──► tables ──► report.md, summary.md
        └─► charts ──► report.html, curves.png
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

from .. import markdown as md
from ..machine import measured_on
from .charts import charts
from .records import Record
from .tables import difference_rows, our_rows, ratio_rows, successful, tables

STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:68rem;margin:2rem auto;padding:0 1rem;color:#222}"
    "table{border-collapse:collapse;display:block;overflow-x:auto;font-variant-numeric:tabular-nums}"
    "td,th{padding:.25rem .7rem;border-bottom:1px solid #ddd;text-align:right}"
    "td:first-child,th:first-child{text-align:left}figure{margin:2rem 0}svg{max-width:100%;height:auto}"
    "figcaption{color:#444}"
)


def markdown(records: Sequence[Record], machine: dict[str, Any]) -> str:
    """The report as Markdown."""
    parts = ["# mocodec: evaluation", measured_on(machine)]
    for title, (head, rows) in tables(records):
        if rows:
            parts += [f"## {title}", md.table(head, rows)]
    return "\n\n".join(parts) + "\n"


def summary(records: Sequence[Record], machine: dict[str, Any]) -> str:
    """The tables of the README: ratios and bytes saved, with notes on the measurement."""
    people = sorted({r.settings["prior"] for r in successful(records) if "prior" in r.settings})
    unseen = (
        "For each person, tempo used a prior trained without that person (leave-subjects-out)."
        if people
        else "tempo used the prior inside the package."
    )
    count = len({r.file for r in successful(records)})
    return (
        "\n\n".join(
            [
                "*Compression ratio against float32 positions at equal error, all side information counted: geometric "
                f"mean over the recordings that all codecs of a column can code, out of {count}. {unseen} "
                f"{measured_on(machine)} Made by `scripts/bench eval`.*",
                md.table(*ratio_rows(records)),
                "*Bytes at equal error, averaged over the three errors (Bjøntegaard difference), and the number of "
                "recordings:*",
                md.table(*our_rows(difference_rows(records))),
            ]
        )
        + "\n"
    )


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


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table as HTML."""

    def line(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(c)}</{tag}>" for c in cells) + "</tr>"

    return f"<table>{line(head, 'th')}{''.join(line(r, 'td') for r in rows)}</table>"
