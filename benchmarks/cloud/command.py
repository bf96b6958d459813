"""`scripts/bench cloud`: point cloud codecs, ours and rivals, as JSON, a Markdown table and figures."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import click

from mocodec import formats, plots
from mocodec.errors import MissingExtra
from mocodec.metrics import point_clouds

from ..machine import machine_description
from ..progress import progress
from ..results import read_json, rounded, write_json
from . import report, runner
from .records import CloudRecord, Measured


@click.command("cloud")
@click.option("-o", "--output", required=True, type=click.Path(file_okay=False, path_type=Path), help="Result folder.")
@click.option("--quick", is_flag=True, help="One short sequence and fewer settings: under five minutes on one core.")
@click.option("--codec", "chosen", multiple=True, metavar="NAME", help="Only this coder; may be repeated.")
def command(output: Path, quick: bool, chosen: tuple[str, ...]) -> None:
    """Measure coders of point clouds, ours and rivals, on synthetic sequences of people.

    Takes about an hour without --quick. Coders whose package is not installed are listed with the reason; install
    the rivals with: pip install -e '.[bench]'. Writes cloud.json, cloud.md, cloud.png and cloud_views.png.
    """
    unknown = [name for name in chosen if name not in runner.coders()]
    if unknown:
        raise click.UsageError(f"no coder named {', '.join(unknown)}; there are: {', '.join(runner.coders())}")
    output.mkdir(parents=True, exist_ok=True)
    scenes, codings = runner.scenes(quick), runner.codings(chosen or runner.coders(), quick)
    measured: list[Measured] = []
    try:
        with progress(len(scenes) * len(codings)) as advance:
            for one in runner.run(scenes, codings):
                measured.append(one)
                advance(f"{one.record.label} on {one.record.sequence}")
    finally:  # an interrupted run keeps the results so far
        for path in write(output, measured) if measured else ():
            click.echo(path)


def write(folder: Path, measured: Sequence[Measured]) -> list[Path]:
    """Write cloud.json and cloud.md, and with Matplotlib cloud.png and cloud_views.png; return the paths."""
    records = [m.record for m in measured]
    content = {
        "machine": machine_description(), "peak_m": point_clouds.PEAK_M, "records": [asdict(r) for r in records],
    }  # fmt: skip
    write_json(folder / "cloud.json", rounded(content))
    paths = [folder / "cloud.json", write_tables(folder)]
    with contextlib.suppress(MissingExtra):
        for name, figure in (("cloud.png", report.curves(records)), ("cloud_views.png", report.images(measured))):
            plots.save(figure, folder / name)
            paths.append(folder / name)
    return paths


def write_tables(folder: Path) -> Path:
    """Write cloud.md from cloud.json; return its path."""
    content = read_json(folder / "cloud.json")
    records = [CloudRecord(**record) for record in content["records"]]
    formats.replace_whole(folder / "cloud.md", report.markdown(records, content["machine"]).encode())
    return folder / "cloud.md"
