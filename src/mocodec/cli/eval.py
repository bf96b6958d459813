"""`mocodec eval`: where every codec stands, ours and what a user could pick instead; the papers' tables and figures.

mocodec eval -o DIR                     the data set, every coder, every target
mocodec eval report DIR                 the pages again, from DIR/results.json
mocodec eval liu2006 | hou2014 …        a paper's tables and figures
mocodec eval cloud -o DIR               point-cloud codecs, ours and rivals
mocodec eval cloud-grid -o DIR          how closely a body is followed, over clips, rates, noise, shares and views
mocodec eval cloud-long -o DIR          1,000 and 300 frames in fact
mocodec eval cloud-summary DIR          what must be shown, on one page, from those results
mocodec eval fetch cmu --subjects 14    recordings from the CMU site
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from pathlib import Path
from typing import Any

import click

from ..errors import BadInput
from . import files

PAPERS = ("liu2006", "hou2014", "lien2006")


@click.group("eval", invoke_without_command=True)
@click.option("-o", "--output", type=click.Path(file_okay=False), help="Folder for results.json and the report.")
@click.option(
    "--data", multiple=True, metavar="NAME|FOLDER", help="package, synthetic, shared, shared-all, or a folder."
)
@click.option("--quick", is_flag=True, help="A few recordings and coders: under two minutes.")
@click.option("--codec", "chosen", multiple=True, metavar="NAME", help="Only these coders; may be repeated.")
@click.option("--workers", type=click.IntRange(1), help="Processes at a time. Default: one a core.")
@click.option("--again", is_flag=True, help="Measure everything again, results in the folder or not.")
@click.pass_context
def command(
    ctx: click.Context,
    output: str | None,
    data: tuple[str, ...],
    quick: bool,
    chosen: tuple[str, ...],
    workers: int | None,
    again: bool,
) -> None:
    """Run codecs and rivals over recordings, and write DIR/results.json, DIR/report.html and DIR/report.md.

    Without --data: the development recordings where they are, the one inside the package and synthetic motion. A run
    that was stopped goes on where it was. Recordings that cannot be read are listed in the report, with the reason.
    """
    if ctx.invoked_subcommand is not None:
        return
    if output is None:
        raise click.UsageError("eval needs a folder for its results: -o DIR")
    from ..evaluation import datasets, rivals, runner

    coders = coders_of(chosen, quick, (*runner.OURS, *rivals.RIVALS))
    names = data or (("shared",) if datasets.SHARED.is_dir() else ()) + (
        ("package", "synthetic") if not quick else ("package",)
    )
    recordings = [recording for name in names for recording in datasets.recordings(name, quick)]
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    priors = priors_for(recordings, folder / "priors") if "tempo" in coders else None
    work = runner.tasks(recordings, coders, priors)
    known = [] if again else runner.load(folder / "results.json")
    records: list[runner.Record] = []
    with progress(len(work)) as advance:
        for done in runner.run(work, workers or os.cpu_count() or 1, known):
            records += done
            runner.save(folder / "results.json", records)
            advance(f"{done[0].codec} on {done[0].file}" if done else "")
    (folder / "machine.json").write_text(json.dumps(runner.machine(), indent=1) + "\n")
    write_report(folder)


@command.command("report")
@click.argument("folder", type=click.Path(exists=True, file_okay=False))
def report_command(folder: str) -> None:
    """Write the report of FOLDER again from its results.json."""
    write_report(Path(folder))


@command.command("cloud")
@click.option(
    "-o", "--output", required=True, type=click.Path(file_okay=False), help="Folder for cloud.json, .md and pictures."
)
@click.option("--quick", is_flag=True, help="One short sequence, fewer settings: under five minutes on one core.")
@click.option("--codec", "chosen", multiple=True, metavar="NAME", help="Only these coders; may be repeated.")
def cloud_command(output: str, quick: bool, chosen: tuple[str, ...]) -> None:
    """Measure coders of point clouds, ours and rivals, on people whose truth is known; write a table and a picture.

    Without --quick it takes about an hour. A coder whose package is not installed is listed as not measured, with the
    reason. Rivals need: pip install 'mocodec[bench]'.
    """
    from ..evaluation.cloud import runner

    unknown = [name for name in chosen if name not in runner.coders()]
    if unknown:
        raise click.UsageError(f"no coder named {', '.join(unknown)}; there are: {', '.join(runner.coders())}")
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    scenes, codings = runner.scenes(quick), runner.codings(chosen or runner.coders(), quick)
    measured: list[runner.Measured] = []
    try:
        with progress(len(scenes) * len(codings)) as advance:
            for one in runner.run(scenes, codings):
                measured.append(one)
                advance(f"{one.record.label} on {one.record.sequence}")
    finally:  # a run that is stopped keeps what it has measured
        for path in runner.write(folder, measured) if measured else ():
            click.echo(path)


@command.command("cloud-grid")
@click.option(
    "-o", "--output", required=True, type=click.Path(file_okay=False), help="Folder for cloud_grid.json and .md."
)
@click.option("--data", default="../shared/data", show_default=True, type=click.Path(), help="Folder of recordings.")
@click.option("--frames", default=60, show_default=True, type=click.IntRange(2), help="Of every clip.")
@click.option("--quick", is_flag=True, help="One thing varied at a time: an eighth of the grid.")
@click.option("--again", is_flag=True, help="Measure everything again, results in the folder or not.")
def cloud_grid_command(output: str, data: str, frames: int, quick: bool, again: bool) -> None:
    """Follow a body through eight clips at 15 and 30 frames/s with noise, fewer points and fewer cameras.

    A run that was stopped goes on where it was. The whole grid, 768 conditions, takes about half an hour of one core.
    """
    from ..evaluation.cloud import grid

    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    with progress(len(grid.conditions(quick))) as advance:
        paths = grid.measure(folder, quick, frames, again, Path(data), advance)
    for path in paths:
        click.echo(path)


@command.command("cloud-long")
@click.option("-o", "--output", required=True, type=click.Path(file_okay=False), help="Folder for cloud_long.json.")
@click.option("--data", default="../shared/data", show_default=True, type=click.Path(), help="Folder of recordings.")
@click.option("--quick", is_flag=True, help="A tenth of the frames.")
def cloud_long_command(output: str, data: str, quick: bool) -> None:
    """Code 1,000 frames of 10,000 points without residual and 300 with one, by both codecs: about ten minutes."""
    from ..evaluation.cloud import long

    Path(output).mkdir(parents=True, exist_ok=True)
    with progress(len(long.RUNS)) as advance:
        click.echo(long.measure(Path(output), quick, Path(data), advance))


@command.command("cloud-summary")
@click.argument("folder", type=click.Path(exists=True, file_okay=False))
def cloud_summary_command(folder: str) -> None:
    """Write FOLDER/cloud_summary.md from the results that are there."""
    from .. import formats
    from ..evaluation.cloud import summary

    path = Path(folder) / "cloud_summary.md"
    formats.replace_whole(path, summary.markdown(Path(folder)).encode())
    click.echo(path)


@command.group("fetch")
def fetch_command() -> None:
    """Fetch recordings from where they are published."""


@fetch_command.command("cmu")
@click.option("--subjects", required=True, metavar="14,15", help="Subjects of the CMU database.")
@click.option(
    "-o", "--output", default="cmu", show_default=True, type=click.Path(file_okay=False), help="Folder for them."
)
def fetch_cmu(subjects: str, output: str) -> None:
    """Fetch subjects of the Carnegie Mellon database (mocap.cs.cmu.edu; created with funding from NSF EIA-0196217)."""
    from ..evaluation import fetch

    paths = fetch.cmu(subjects.split(","), Path(output), told=lambda path: click.echo(path, err=True))
    click.echo(f"{len(paths)} files below {output}; measure on them with: mocodec eval --data {output} -o results")


def paper_command(name: str) -> click.Command:
    """A command that reproduces the tables and figures of one paper."""

    @click.command(name, help=f"The tables and figures of {name}, ours beside the published.")
    @click.option(
        "--data", default="../shared/data", show_default=True, type=click.Path(), help="Folder of recordings."
    )
    @click.option(
        "-o", "--output", default="docs/results", show_default=True, type=click.Path(), help="Folder for results."
    )
    def run(data: str, output: str) -> None:
        module = importlib.import_module(f"mocodec.evaluation.papers.{name}")
        module.run(Path(data), Path(output))
        for path in sorted(Path(output).glob(f"{name}*")):
            click.echo(str(path))

    return run


for _paper in PAPERS:
    if (Path(__file__).parent.parent / "evaluation" / "papers" / f"{_paper}.py").exists():
        command.add_command(paper_command(_paper))


def priors_for(recordings: list[Any], folder: Path) -> Path | None:
    """Priors that have not seen the people of these recordings, learned where they are not there yet."""
    from ..evaluation import folds

    if not folds.PEOPLE.is_dir():
        return None
    needed = sorted({fold for recording in recordings if (fold := folds.fold_of(recording)) is not None})
    for fold in needed:
        path = folds.prior_path(folder, fold)
        if not path.is_file():
            with files.working(f"learning a prior without subjects {', '.join(fold)}"):
                folds.train(fold, path)
    return folder


def coders_of(chosen: tuple[str, ...], quick: bool, known: tuple[str, ...]) -> list[str]:
    """The coders to run. Raises a usage error for an unknown one."""
    unknown = [name for name in chosen if name not in known]
    if unknown:
        raise click.UsageError(f"no coder named {', '.join(unknown)}; there are: {', '.join(known)}")
    if chosen:
        return list(chosen)
    return ["tempo", "hou2014", "liu2006", "lossless", "sz3", "pcodec"] if quick else list(known)


class progress:
    """A bar on standard error on a terminal, nothing otherwise: `with progress(total) as advance: advance(what)`."""

    def __init__(self, total: int) -> None:
        self.total = total

    def __enter__(self):
        if not sys.stderr.isatty():
            return lambda what: None
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (BarColumn(30), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}"))
        self.bar = Progress(*columns, console=Console(stderr=True))
        task = self.bar.add_task("", total=self.total)
        self.bar.start()
        return lambda what: self.bar.update(task, advance=1, description=what)

    def __exit__(self, *_: object) -> None:
        if hasattr(self, "bar"):
            self.bar.stop()


def write_report(folder: Path) -> None:
    """The report's pages and a summary with its picture, from DIR/results.json. Raises BadInput where there is none."""
    from .. import formats
    from ..evaluation import report, runner

    records = runner.load(folder / "results.json")
    if not records:
        raise BadInput(f"{folder} holds no results.json with results")
    machine_path = folder / "machine.json"
    machine = json.loads(machine_path.read_text()) if machine_path.is_file() else {}
    formats.replace_whole(folder / "report.md", report.markdown(records, machine).encode())
    formats.replace_whole(folder / "report.html", report.page(records, machine).encode())
    formats.replace_whole(folder / "curves.png", report.curves(records))
    formats.replace_whole(folder / "summary.md", report.summary(records, machine).encode())
    click.echo(f"{folder / 'report.html'}\n{folder / 'report.md'}")
