"""`mocodec archive …`: many recordings in one place, found by conditions on their catalogue.

build, append ─► archive ─► list, query, stats, verify      extract ─► files      merge, remove, repair
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from .. import api, archive, codecs, formats
from ..archive import Entry, Options, Recordings, Report, Row
from ..encoded import TARGETS
from ..errors import BadInput, Corrupt, MocodecError
from ..selection import counted
from . import DAMAGED, archive_search, debug_option, files, message_and_code, quantities, sections
from .quantities import setting

TABLE = ("name", "frames", "rate", "points", "seconds", "bytes", "ratio", "mean_error", "max_error", "labels")
MAX_FAILURES = 20
"""Failed sources that a summary lists, at most."""
WORKER_OPTIONS = (
    click.option(
        "-j",
        "--jobs",
        "--workers",
        type=click.IntRange(0),
        default=1,
        metavar="N",
        help="Work in N processes; 0: one per core; default: 1.",
    ),
    click.option("--dask", metavar="ADDRESS", help="Work on a Dask cluster, whose machines see the same files."),
)
"""Where the work is done: options of commands that build or learn."""


class Archives(click.Group):
    """The commands on archives; each has --debug."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        found = super().get_command(ctx, cmd_name)
        if found is not None and not any(p.name == "debug" for p in found.params):
            found.params.append(debug_option())
        return found

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group("archive", cls=Archives)
def command() -> None:
    """Keep many recordings in an archive: a folder with shard files and a catalogue.

    `build` makes an archive from folders, globs, .zip and .tar files and URLs, in several runs if need be. Other
    commands show one of its recordings as ARCHIVE/NAME: mocodec view vault/walk_01.
    """


def build_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """The options of `build` and `append`."""
    options = (
        click.option(
            "--codec", type=click.Choice(list(codecs.CODECS)), help="Default: tempo; bodycast for point clouds."
        ),
        click.option(
            "--max-error", type=quantities.LENGTH, help="No point of any frame is farther off than this: 2mm."
        ),
        click.option(
            "--mean-error", type=quantities.LENGTH, help="The average distance in each recording is at most this: 3mm."
        ),
        click.option(
            "--ratio",
            type=quantities.RATIO,
            metavar="N",
            help="Each recording is at least N times smaller than float32 positions.",
        ),
        click.option("--signal-error", metavar="ERROR", help="How far samples of signals may be off: 12bit or 0.1%."),
        click.option(
            "--set", "settings", multiple=True, metavar="NAME=VALUE", help="A setting of the codec; can be repeated."
        ),
        click.option("--bare", is_flag=True, help="Leave out analog channels, events and parameters."),
        click.option("--no-rotations", is_flag=True, help="Keep the positions of joints, and not their rotations."),
        *WORKER_OPTIONS,
        click.option(
            "--prior", metavar="FILE", help="A prior of your own, by `mocodec prior train`; the archive keeps a copy."
        ),
        click.option(
            "--prefix", default="", metavar="TEXT", help="Put this before the name of every recording, such as lab/."
        ),
        click.option("--index", "is_indexed", is_flag=True, help="Also update the index of similar motion."),
        click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON."),
        click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors."),
        files.reader_options,
    )
    for option in reversed(options):
        function = option(function)
    return function


@command.command("build", cls=sections.Command)
@click.argument("sources", nargs=-1, required=True)
@click.option("-o", "--output", required=True, metavar="DB", help="The folder of the archive.")
@build_options
def build(sources: tuple[str, ...], output: str, **given: Any) -> int:
    """Put the recordings of SOURCES into an archive.

    The archive is created if it does not exist. Without a target, no point of a motion is farther off than 5 mm
    (tempo). SOURCES are files, folders, globs, .zip or .tar files, or URLs (s3://…, with
    fsspec). Run the command again after an interruption, or when files were added or changed: recordings that are
    done are skipped. A .mocz is taken as it is.
    """
    return run_build(sources, output, **given)


@command.command("append", cls=sections.Command)
@click.argument("db", metavar="DB")
@click.argument("sources", nargs=-1, required=True)
@build_options
def append(db: str, sources: tuple[str, ...], **given: Any) -> int:
    """Add recordings to an archive.

    They are coded with the options of its last build, unless you give others.
    """
    archive.open_archive(db).close()
    return run_build(sources, db, **given)


def run_build(
    sources: tuple[str, ...],
    output: str,
    jobs: int,
    dask: str | None,
    prior: str | None,
    prefix: str,
    is_indexed: bool,
    as_json: bool,
    quiet: bool,
    **given: Any,
) -> int:
    """Build, and print the summary."""
    options = options_of(**given)
    with files.progress_line(quiet) as show, archive.dask_cluster(dask) if dask else nullcontext() as executor:
        report = archive.build(
            sources, output, options, workers=jobs or os.cpu_count() or 1, executor=executor, prior=prior,
            prefix=prefix,
            report_to=show,
        )  # fmt: skip
    if is_indexed:
        with files.progress_line(quiet) as show:
            archive.index(output, show)
    return print_report(output, report, as_json, quiet)


def options_of(
    codec: str | None,
    settings: tuple[str, ...],
    signal_error: str | None,
    bare: bool,
    no_rotations: bool,
    **given: Any,
) -> Options | None:
    """The options of a build; None if the user gave none: then those of the last build hold."""
    given = files.given(**given)
    targets = {name: given.pop(name) for name in TARGETS if name in given}
    kind = codecs.codec_class(codec or "tempo")
    try:
        chosen = dict(setting(kind, text) for text in settings)
    except (BadInput, TypeError) as error:
        raise click.UsageError(str(error)) from error
    if given.pop("format_", None):
        raise click.UsageError("--format is for standard input, which cannot be put into an archive")
    options = Options(codec, targets, chosen, given, signal_error, bare, not no_rotations)
    return options if options.stored() else None


def print_report(output: str, report: Report, as_json: bool, quiet: bool) -> int:
    """The summary of a build or merge; returns the exit code: 3 if a source failed."""
    with archive.open_archive(output) as db:
        sums = db.sums()
    if as_json:
        files.echo(json.dumps({"archive": output, **asdict(report), **sums}, indent=2))
    elif not quiet:
        counts = [f"{len(report.added):,} added"]
        counts += [f"{len(report.replaced):,} replaced"] if report.replaced else []
        counts += [f"{len(report.unchanged):,} unchanged"] if report.unchanged else []
        counts += [f"{len(report.failed):,} failed"] if report.failed else []
        files.line(f"{output}: {', '.join(counts)}; {totals(sums)}", err=True)
        for path, reason in report.failed[:MAX_FAILURES]:
            files.line(f"failed: {path}: {reason}", err=True)
        if len(report.failed) > MAX_FAILURES:
            files.line(f"… and {len(report.failed) - MAX_FAILURES:,} more: mocodec archive stats", err=True)
    return 3 if report.failed else 0


def totals(sums: dict[str, Any]) -> str:
    """The sums over recordings, in words."""
    line = f"{counted(sums['recordings'], 'recording')}, {counted(sums['frames'], 'frame')}"
    line += f", {quantities.size(sums['stored_bytes'])}"
    if sums["raw_bytes"] and sums["stored_bytes"]:
        plain = sums["stored_bytes"] - sums["side_bytes"]
        line += f", {100 * plain / sums['raw_bytes']:.2f} % of float32 positions"
        line += f" and {quantities.size(sums['side_bytes'])} of signals and extras" if sums["side_bytes"] else ""
    if sums["mean_error"] is not None:
        line += f"; mean error {quantities.length(sums['mean_error'])}, max {quantities.length(sums['max_error'])}"
    return line


@command.command("list")
@click.argument("db", metavar="DB")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line, with all columns.")
def list_(db: str, as_json: bool) -> None:
    """List the recordings of the archive DB."""
    with archive.open_archive(db) as opened:
        print_rows(opened.rows(), as_json)


@command.command("query")
@click.argument("db", metavar="DB")
@click.argument("condition")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line, with all columns.")
@click.option("--names", is_flag=True, help="Only the names, one a line.")
def query(db: str, condition: str, as_json: bool, names: bool) -> None:
    """List the recordings that meet a CONDITION.

    A condition compares columns of the catalogue of the archive DB with values:

    \b
    mocodec archive query vault "subject == 86 and seconds > 10"
    mocodec archive query vault "'walk' in labels and not max_error > 0.01"
    mocodec archive query vault 'like(name, "86_*") or trial in (1, 2)'
    """
    with archive.open_archive(db) as opened:
        found = opened.query(condition)
        if names:
            for row in found.rows():
                files.line(row.name)
        else:
            print_rows(found.rows(), as_json)


def print_rows(rows: Iterable[Row], as_json: bool) -> None:
    """Rows as a table, or as lines of JSON."""
    if as_json:
        for row in rows:
            files.line(json.dumps(asdict(row)))
        return
    lines = [TABLE, *(tuple(cell(row, column) for column in TABLE) for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(TABLE))]
    for line in lines:
        padded = (
            text.ljust(w) if c in ("name", "labels") else text.rjust(w)
            for c, text, w in zip(TABLE, line, widths, strict=True)
        )
        files.line("  ".join(padded).rstrip())


def cell(row: Row, column: str) -> str:
    """A value of a row as text."""
    value = getattr(row, column)
    if value is None:
        return "-"
    if column.endswith("_error"):
        return quantities.length(value)
    if column in ("seconds", "ratio"):
        return f"{value:.1f}"
    return f"{value:g}" if isinstance(value, float) else f"{value:,}" if isinstance(value, int) else value.strip()


@command.command("extract")
@click.argument("db", metavar="DB")
@click.argument("names", nargs=-1)
@click.option("-o", "--output", required=True, metavar="FOLDER", help="The folder to write to.")
@click.option("--query", "condition", metavar="CONDITION", help="The recordings that meet a condition.")
@click.option(
    "--format",
    "format_",
    default="mocz",
    metavar="NAME",
    help="mocz (default: the bytes as they are), c3d, trc, bvh, npz, …",
)
def extract(db: str, names: tuple[str, ...], output: str, condition: str | None, format_: str) -> int:
    """Write recordings to files.

    NAMES or a --query choose recordings; without them, all of the archive DB are written. Every byte is checked;
    recordings that are damaged, or that the format cannot store, are listed, and the others are written.
    """
    suffix = files.suffix_of_format(format_)
    if suffix != files.SUFFIX and suffix not in formats.WRITABLE:
        known = ", ".join(known[1:] for known in (files.SUFFIX, *formats.WRITABLE))
        raise click.UsageError(f"--format is one of {known}, not {format_[:40]!r}")
    code = 0
    with archive.open_archive(db) as opened:
        chosen: Recordings = opened.query(condition) if condition else opened
        rows = (chosen.entry(name).row for name in names) if names else chosen.rows_or_problems()
        for row in list(rows) if names else rows:
            name = row[0] if isinstance(row, tuple) else row.name
            try:
                if isinstance(row, tuple):
                    raise Corrupt(f"the catalogue is damaged ({row[1]})")
                extract_one(chosen.entry_of(row), Path(output), suffix)
            except MocodecError as error:
                reason, this = message_and_code(error)
                code = max(code, this)
                files.line(f"failed: {name}: {reason.removeprefix(f'{chosen.folder}: {name}: ')}", err=True)
    return code


def extract_one(entry: Entry, folder: Path, suffix: str) -> None:
    """Check a recording's bytes, and write it below a folder. Raises MocodecError."""
    parts = safe_parts(entry.row.name)
    target = Path(folder, *parts).with_name(parts[-1] + suffix)
    blob = archive.whole_bytes(entry)
    target.parent.mkdir(parents=True, exist_ok=True)
    if suffix == files.SUFFIX:
        files.write_bytes(str(target), blob)
    else:
        files.write(str(target), api.decode(blob))


def safe_parts(name: str) -> list[str]:
    """The parts of a name as those of a path below a folder. Raises BadInput for names that lead out of it."""
    parts = [part for part in name.split("/") if part]
    if not parts or any(part in (".", "..") or "\\" in part or ":" in part for part in parts):
        raise BadInput(f"the name {name!r} is not one of a file below a folder")
    return parts


for searching in archive_search.COMMANDS:
    command.add_command(searching)


@command.command("verify")
@click.argument("db", metavar="DB")
@click.option("--decode", is_flag=True, help="Also decode every frame.")
@click.option("--query", "condition", metavar="CONDITION", help="Only the recordings that meet a condition.")
def verify(db: str, decode: bool, condition: str | None) -> int:
    """Check every byte, and list damaged recordings."""
    with archive.open_archive(db) as opened:
        chosen: Recordings = opened.query(condition) if condition else opened
        count, damaged = len(chosen), 0
        for name, reason in archive.damage(chosen, decode):
            damaged += 1
            files.line(f"{name}: {reason}")
        files.line(f"{db}: {count - damaged:,} of {count:,} recordings are undamaged")
        if not damaged:
            opened.catalogue.require_consistent()
    return DAMAGED if damaged else 0


@command.command("stats")
@click.argument("db", metavar="DB")
@click.option("--json", "as_json", is_flag=True, help="As JSON, lengths in metres.")
def stats(db: str, as_json: bool) -> None:
    """Show sums over all recordings: frames, bytes and errors.

    Also the bytes that no recording uses, and the sources that failed.
    """
    with archive.open_archive(db) as opened:
        sums, unused, failures = opened.sums(), archive.unused_bytes(opened), opened.failures
    if as_json:
        files.echo(json.dumps({**sums, "unused_bytes": unused, "failures": failures}, indent=2))
        return
    files.line(f"{db}: {totals(sums)}")
    seconds = sums["seconds"]
    length = f"{seconds / 3600:.2f} hours" if seconds >= 360 else f"{seconds:.1f} s"
    files.line(f"{length} of motion; {quantities.size(unused)} unused in shards")
    for path, reason in failures:
        files.line(f"failed: {path}: {reason}")


@command.command("merge")
@click.argument("archives", nargs=-1, required=True)
@click.option("-o", "--output", required=True, metavar="DB", help="The archive to copy into.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
def merge(archives: tuple[str, ...], output: str, quiet: bool) -> int:
    """Copy recordings from archives into another archive.

    Recordings are not coded again. Merging one archive into a new one leaves out the bytes of removed and replaced
    recordings.
    """
    with files.progress_line(quiet) as show:
        report = archive.merge(archives, output, report_to=show)
    return print_report(output, report, False, quiet)


@command.command("remove")
@click.argument("db", metavar="DB")
@click.argument("names", nargs=-1)
@click.option("--query", "condition", metavar="CONDITION", help="The recordings that meet a condition.")
def remove(db: str, names: tuple[str, ...], condition: str | None) -> None:
    """Remove recordings, by NAMES or a --query.

    Their bytes stay in the files of the archive DB; merging the archive into a new one leaves them out.
    """
    if bool(names) == bool(condition):
        raise click.UsageError("name the recordings to remove, or give a --query")
    with archive.open_archive(db) as opened:
        chosen = list(names) if condition is None else opened.query(condition).names
    removed = archive.remove(db, chosen)
    files.line(f"{db}: removed {counted(len(removed), 'recording')}", err=True)


@command.command("repair")
@click.argument("db", metavar="DB")
def repair(db: str) -> int:
    """Rebuild a lost or damaged catalogue from the shards.

    Names and recordings come back, removed ones too; damaged recordings are listed and dropped. Measured errors and
    the paths of sources are only in the catalogue, so they come back only if it can still be read. The old catalogue
    stays as catalogue.damaged.
    """
    report = archive.repair(db)
    return print_report(db, report, False, False)
