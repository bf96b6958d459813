"""`scripts/bench eval` and `scripts/bench report`: every codec and rival over recordings."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

import click

from mocodec import formats
from mocodec.errors import BadInput

from .. import datasets, folds
from ..machine import machine_description
from ..progress import progress
from ..results import read_json
from . import charts, records, report, rivals, runner

QUICK = ("tempo", "hou2014", "liu2006", "lossless", "sz3", "pcodec")


@click.command("eval")
@click.option("-o", "--output", required=True, type=click.Path(file_okay=False, path_type=Path), help="Result folder.")
@click.option(
    "--data", multiple=True, metavar="NAME|FOLDER", help="package, synthetic, shared, shared-all or a folder."
)
@click.option("--quick", is_flag=True, help="A few recordings and coders: under two minutes.")
@click.option("--codec", "chosen", multiple=True, metavar="NAME", help="Only this coder; may be repeated.")
@click.option("--workers", type=click.IntRange(1), help="Number of processes. Default: one per core.")
@click.option("--again", is_flag=True, help="Also measure tasks with a result in the folder.")
def command(
    output: Path, data: tuple[str, ...], quick: bool, chosen: tuple[str, ...], workers: int | None, again: bool
) -> None:
    """Run our codecs and rivals over recordings to equal errors.

    Writes results.json, machine.json, report.html, report.md, summary.md and curves.png. Without --data: the
    development recordings if they exist, the recording inside the package, and synthetic motion. An interrupted run
    continues where it stopped. The report lists unreadable recordings with the reason.
    """
    coders = coders_of(chosen, quick)
    own = ("package",) if quick else ("package", "synthetic")
    names = data or ((("shared",) if datasets.SHARED.is_dir() else ()) + own)
    recordings = [recording for name in names for recording in datasets.recordings(name, quick)]
    output.mkdir(parents=True, exist_ok=True)
    priors = train_priors(recordings, output / "priors") if "tempo" in coders else None
    tasks = runner.tasks(recordings, coders, priors)
    known = [] if again else records.load(output / "results.json")
    results: list[records.Record] = []
    with progress(len(tasks)) as advance:
        for done in runner.run(tasks, workers or os.cpu_count() or 1, known):
            results += done
            records.save(output / "results.json", results)
            advance(f"{done[0].codec} on {done[0].file}" if done else "")
    (output / "machine.json").write_text(json.dumps(machine_description(), indent=1) + "\n")
    for path in write_report(output):
        click.echo(path)


@click.command("report")
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def report_command(folder: Path) -> None:
    """Write the report of FOLDER again from its results.json."""
    for path in write_report(folder):
        click.echo(path)


def coders_of(chosen: tuple[str, ...], quick: bool) -> list[str]:
    """The coders to run. Raises UsageError for an unknown name."""
    names = (*records.OURS, *rivals.RIVALS)
    unknown = [name for name in chosen if name not in names]
    if unknown:
        raise click.UsageError(f"no coder named {', '.join(unknown)}; there are: {', '.join(names)}")
    return list(chosen or (QUICK if quick else names))


def train_priors(recordings: Sequence[datasets.Recording], folder: Path) -> Path | None:
    """Train the missing priors for the folds of these recordings; None without training data."""
    if not folds.PEOPLE.is_dir():
        return None
    needed = sorted({fold for recording in recordings if (fold := folds.fold_of(recording)) is not None})
    for fold in needed:
        path = folds.prior_folder(folder, fold)
        if not folds.is_trained(path):
            click.echo(f"training priors without subjects {', '.join(fold)}", err=True)
            folds.train(fold, path)
    return folder


def write_report(folder: Path) -> list[Path]:
    """Write the report, with charts, from results.json; return its paths. Raises BadInput without results."""
    results = records.load(folder / "results.json")
    if not results:
        raise BadInput(f"{folder} holds no results.json with results; measure with: scripts/bench eval -o {folder}")
    machine = read_json(folder / "machine.json") or {}
    formats.replace_whole(folder / "report.html", report.page(results, machine).encode())
    formats.replace_whole(folder / "curves.png", charts.mean_error_png(results))
    return [folder / "report.html", *write_tables(folder)]


def write_tables(folder: Path) -> list[Path]:
    """Write report.md and summary.md from results.json; return their paths."""
    results = records.load(folder / "results.json")
    machine = read_json(folder / "machine.json") or {}
    formats.replace_whole(folder / "report.md", report.markdown(results, machine).encode())
    formats.replace_whole(folder / "summary.md", report.summary(results, machine).encode())
    return [folder / "report.md", folder / "summary.md"]
