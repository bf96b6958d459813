"""`mocodec prior train`: a prior of your own people, from an archive of their motion."""

from __future__ import annotations

import os
from contextlib import nullcontext
from pathlib import Path

import click

from .. import archive, formats
from . import files, quantities
from .archive import WORKER_OPTIONS


@click.group("prior")
def command() -> None:
    """Learn a prior from your own recordings, so that tempo encodes similar motion in fewer bytes."""


@command.command("train")
@click.argument("db", metavar="DB")
@click.option("-o", "--output", required=True, metavar="FILE", help="The file to write, such as mine.prior.")
@click.option("--query", "condition", metavar="CONDITION", help="Only the recordings that meet a condition.")
@click.option(
    "--frames",
    type=click.IntRange(1),
    metavar="N",
    help="Learn from about N frames, spread over the archive; default: all.",
)
@WORKER_OPTIONS[0]
@WORKER_OPTIONS[1]
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
def train(
    db: str, output: str, condition: str | None, frames: int | None, jobs: int, dask: str | None, quiet: bool
) -> None:  # fmt: skip
    """Learn a prior from an archive.

    It is learned from the recordings of the archive DB that have rotations and the same skeleton. Any number of
    processes gives the same result.

    Files that are encoded with it (`mocodec encode --prior FILE`, `mocodec archive build --prior FILE`) need it to be
    decoded: an archive keeps a copy; for other files, name its folder in the environment variable MOCODEC_PRIORS.
    """
    if not output.endswith(".prior"):
        raise click.UsageError(f"{output}: the name of a prior ends in .prior")
    Path(output).parent.mkdir(parents=True, exist_ok=True)
    with (
        archive.open_archive(db) as opened,
        archive.dask_cluster(dask) if dask else nullcontext() as executor,
        files.progress_line(quiet) as show,
    ):
        chosen = opened.query(condition) if condition else opened
        data, recordings, total = archive.train_prior(
            chosen, frames=frames, workers=jobs or os.cpu_count() or 1, executor=executor, report_to=show
        )
    formats.replace_whole(output, data)
    if not quiet:
        files.echo(
            f"{output}: {quantities.size(len(data))}, from {recordings:,} recordings, {total:,} frames", err=True
        )
