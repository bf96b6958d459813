"""`mocodec prior train`: a prior of your own people, from an archive of their motion."""

from __future__ import annotations

import click

from .. import api, archive, formats
from ..codecs.tempo import training
from ..errors import BadInput
from ..motion import Motion
from . import files, quantities


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
    default=300_000,
    show_default=True,
    help="Learn from recordings with this many frames together, spread over the archive.",
)
def train(db: str, output: str, condition: str | None, frames: int) -> None:
    """Learn a prior from an archive.

    It is learned from the recordings of the archive DB that have rotations and the same skeleton.

    Files that are encoded with it (`mocodec encode --prior FILE`, `mocodec archive build --prior FILE`) need it to be
    decoded: an archive keeps a copy; for other files, name its folder in the environment variable MOCODEC_PRIORS.
    """
    if not output.endswith(".prior"):
        raise click.UsageError(f"{output}: the name of a prior ends in .prior")
    with archive.open_archive(db) as opened:
        chosen = opened.query("rotations == 1" + (f" and ({condition})" if condition else ""))
        rows = list(chosen.rows())
        if not rows:
            raise BadInput(f"{db}: there are no recordings with rotations")
        step = max(1, round(sum(row.frames for row in rows) / frames))
        with files.working(f"reading {db}"):
            motions = [api.decode(chosen.entry(row.name).place, Motion) for row in rows[::step]]
    with files.working("learning"):
        data = training.train(motions)
    formats.replace_whole(output, data)
    total = sum(map(len, motions))
    files.echo(f"{output}: {quantities.size(len(data))}, from {len(motions):,} recordings, {total:,} frames", err=True)
