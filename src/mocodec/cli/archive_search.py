"""`mocodec archive index`, `similar` and `duplicates`: search for similar motion."""

from __future__ import annotations

import json
from dataclasses import asdict

import click

from .. import api, archive
from ..archive import Recordings
from ..errors import BadInput
from ..motion import Motion
from . import files, quantities
from .cut import Time


@click.command("index")
@click.argument("db", metavar="DB")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
def index(db: str, quiet: bool) -> None:
    """Make or update the index of similar motion.

    `similar` and `duplicates` search it. Run the command again after a build.
    """
    with files.progress_line(quiet) as show:
        windows = archive.index(db, show)
    if not quiet:
        files.line(f"{db}: {windows:,} windows in the index", err=True)


@click.command("similar")
@click.argument("db", metavar="DB")
@click.argument("query", metavar="NAME|FILE")
@click.option("--from", "begin", type=quantities.TIME_OR_SECONDS, default="0s", help="Where the query begins: 1.5s.")
@click.option("--to", "end", type=quantities.TIME_OR_SECONDS, help="Where the query ends; default: 4 s later.")
@click.option(
    "-n", "--count", type=click.IntRange(1), default=10, metavar="N", help="List at most N parts; default: 10."
)
@click.option(
    "--where", "condition", metavar="CONDITION", help="Search only recordings that meet a condition (see `query`)."
)
@click.option("--json", "as_json", is_flag=True, help="As JSON, lengths in metres.")
def similar(
    db: str, query: str, begin: Time, end: Time | None, count: int, condition: str | None, as_json: bool
) -> None:
    """Find motion similar to part of a recording or file.

    The query is the part of a recording NAME of the archive DB, or of a FILE, from --from to --to. Similar parts may
    happen anywhere, face any way, and be up to a quarter faster or slower. The nearest come first, with their RMS
    distance to the query.
    """
    with archive.open_archive(db) as opened:
        inside = query in opened
        source = api.decode(opened.entry(query).place) if inside else files.read(query)
        if not isinstance(source, Motion):
            raise BadInput(f"{query}: point clouds cannot be searched for")
        start = frame_at(begin, source.rate)
        stop = start + round(4.0 * source.rate) if end is None else frame_at(end, source.rate)
        part = source[start:stop]
        own = opened.entry(query).row.name if inside else ""
        chosen: Recordings = opened.query(condition) if condition else opened
        hits = archive.search(chosen, part, count, leave_out=own)
    if as_json:
        files.echo(json.dumps([asdict(hit) for hit in hits], indent=2))
        return
    for hit in hits:
        files.line(f"{hit.name}  {hit.start:.1f} to {hit.stop:.1f} s  {quantities.length(hit.distance)}")
    if not hits:
        files.line(f"{db}: no other recording is in the index; after a build renew it: mocodec archive index", err=True)


def frame_at(time: Time, rate: float) -> int:
    """The frame that is nearest to a time."""
    seconds, frame = time
    return round(seconds * rate) if seconds is not None else frame or 0


@click.command("duplicates")
@click.argument("db", metavar="DB")
@click.option(
    "--within",
    type=quantities.LENGTH,
    default=0.02,
    help="How far apart two motions may be on average and count as the same; default: 2cm.",
)
def duplicates(db: str, within: float) -> None:
    """List recordings that are equal or show the same motion."""
    with archive.open_archive(db) as opened:
        for pair in archive.duplicates(opened, within):
            how = "equal" if pair.equal else f"{100 * pair.share:.0f} % within {quantities.length(pair.distance)}"
            files.line(f"{pair.one}  {pair.other}  {how}")


COMMANDS = (index, similar, duplicates)
