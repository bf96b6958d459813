"""Many files in one command: `mocodec encode FOLDER|FILES… -o FOLDER -j N`, and the same for verify, info and decode.

    arguments ─find─► sources ─mirrored─► outputs ─done before? (journal)─► tasks ─workers─► records ─► summary table

A folder whose .ply or .pcd files are the frames of a recording is one source. A source that fails is counted, with its
reason.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from .. import formats
from ..formats import rgbd
from ..formats.folders import below, mirrored_name
from . import files, sections, summary
from .display import Display
from .journal import Journal
from .workers import Task, run_tasks

FAILED, SKIPPED, DONE = "failed", "skipped", "done"
ARCHIVE_COMMANDS = {
    "info": "stats {0}` or `mocodec archive list {0}",
    "verify": "verify {0}",
    "decode": "extract {0} -o FOLDER --format npz",
    "encode": "build SOURCES -o {0}` to add recordings, `mocodec archive extract {0} -o FOLDER",
}
"""What to run on an archive in place of a command on many files."""

jobs_option = sections.option(
    "-j",
    "--jobs",
    section=sections.MANY,
    type=click.IntRange(0),
    default=1,
    metavar="N",
    help="Work on N files at the same time; 0: one per core; default: 1.",
)
"""The option of commands that take many files."""
again_option = sections.option(
    "--again", section=sections.MANY, is_flag=True, help="Redo also files that are done; replace existing files."
)
"""The option of commands that write a file for each."""


@dataclass(frozen=True)
class Source:
    """path: of a file, a folder of frames, or a URL. name: relative, with "/", as it is shown and mirrored."""

    path: str
    name: str

    @property
    def stem(self) -> str:
        """The name without the suffix; a folder's whole name."""
        if not files.is_url(self.path) and Path(self.path).is_dir():
            return self.name
        return self.name[: len(self.name) - len(Path(self.name).suffix)]


@dataclass(frozen=True)
class Settings:
    """What the user chose. options: of the work on each file, JSON values; sources done with others are done again."""

    options: Mapping[str, Any]
    jobs: int = 1
    again: bool = False
    as_json: bool = False
    quiet: bool = False


def is_many(sources: Sequence[str], output: str | None = None) -> bool:
    """Whether arguments mean many files: several, a folder that is not one recording, or an output that is a folder
    other than of the frames of a point cloud."""
    if len(sources) != 1:
        return True
    if sources[0] == "-" or files.is_url(sources[0]):
        return False
    if output is not None and output != "-" and not is_recording(sources[0]):
        return Path(sources[0]).is_dir() or (is_folder(output) and not is_recording(output))
    return Path(sources[0]).is_dir() and not is_recording(sources[0])


def is_folder(output: str) -> bool:
    """Whether an output names a folder: it exists as one, or ends with a slash."""
    return output.endswith(("/", os.sep)) or Path(output).is_dir()


def is_recording(path: str) -> bool:
    """Whether a path is a folder whose only recording are the frames in it: .ply or .pcd."""
    return Path(path).is_dir() and [s.path for s in find([path], formats.FORMATS)] == [path]


def find(arguments: Sequence[str], suffixes: Collection[str]) -> list[Source]:
    """The sources that the arguments name, sorted by name: files as they are, and those in folders with these suffixes.

    One folder: names are relative to it. Otherwise names are relative to the folder that contains all arguments.
    Hidden files and folders are left out. Raises a usage error for "-", and for several frames of one folder.
    """
    if "-" in arguments:
        raise click.UsageError('"-" cannot be one of many files')
    local = [argument for argument in arguments if not files.is_url(argument)]
    refuse_frames([path for path in local if not Path(path).is_dir()])
    if len(arguments) == 1 and local and Path(local[0]).is_dir():
        base = os.path.abspath(local[0])
    else:
        base = os.path.commonpath([os.path.dirname(os.path.abspath(path)) for path in local] or ["."])
    paths = [path for argument in local for path in below(argument, suffixes)]
    found = {os.path.abspath(path): path for path in paths}
    sources = [Source(path, mirrored_name(absolute, base)) for absolute, path in found.items()]
    sources += [
        Source(url, url.partition("?")[0].rstrip("/").rpartition("/")[2]) for url in arguments if files.is_url(url)
    ]
    return sorted(sources, key=lambda source: source.name)


def find_readable(command: str, arguments: Sequence[str], suffixes: Collection[str]) -> list[Source]:
    """As `find`. Raises a usage error where nothing is found, which says what to do with other files in the folders;
    and for archives, whose files are not those of recordings.
    """
    for argument in arguments:
        if files.is_archive(argument):
            do = ARCHIVE_COMMANDS[command].format(argument)
            raise click.UsageError(f"{argument} is an archive: run `mocodec archive {do}`")
    found = find(arguments, suffixes)
    if not found:
        folders = [folder for folder in arguments if Path(folder).is_dir()]
        names = [name for folder in folders for name in os.listdir(folder)]
        present = sorted({Path(name).suffix.lower() for name in names})
        hints = dict.fromkeys(f"; {suffix}: {formats.OTHERS[suffix]}" for suffix in present if suffix in formats.OTHERS)
        if ".ply" in suffixes and (images := rgbd.hint(names)):
            hints[f"; {images}"] = None
        where = f"{', '.join(arguments)}: there is no file that `mocodec {command}` reads"
        raise click.UsageError(where + "".join(hints))
    return found


def refuse_frames(paths: Sequence[str]) -> None:
    """Raises a usage error for several .ply or .pcd files of one folder: they are frames of one recording."""
    for suffix in formats.FRAMES:
        folders = [os.path.dirname(path) for path in paths if path.lower().endswith(suffix)]
        for folder in folders:
            if folders.count(folder) > 1:
                raise click.UsageError(
                    f"several {suffix} files of one folder are frames of one recording: name the folder {folder or '.'}"
                )


def output_names(sources: Sequence[Source], suffixes: Mapping[str, str]) -> dict[str, str]:
    """The output of each source, by its path: stem and new suffix, or whole name and new suffix where stems collide.

    suffixes: by path. Names that differ only in case collide, since many file systems do not tell them apart.
    """
    names = {s.path: s.stem.removesuffix(suffixes[s.path]) + suffixes[s.path] for s in sources}
    while True:
        taken: dict[str, list[Source]] = {}
        for source in sources:
            taken.setdefault(names[source.path].casefold(), []).append(source)
        short = [
            source
            for group in taken.values()
            if len(group) > 1
            for source in group
            if names[source.path] != source.name + suffixes[source.path]
        ]
        if not short:
            return names
        names |= {source.path: source.name + suffixes[source.path] for source in short}


def run(
    command: str,
    sources: Sequence[Source],
    outputs: Mapping[str, str],
    folder: str,
    settings: Settings,
    each: Mapping[str, Mapping[str, Any]] | None = None,
) -> int:
    """Work on every source in worker processes, print the summary, and return the exit code.

    command: the module of `cli` whose `one(source, output, **options)` works on a file. outputs: by source path, below
    `folder`; empty for commands that write nothing. each: further options of a source, by its path.
    """
    started = time.monotonic()
    journal = Journal(folder, command, settings.options) if outputs else None
    records: list[dict[str, Any]] = []
    tasks: list[Task] = []
    for source in sources:
        output = outputs.get(source.path)
        before = journal.done(output, source.path) if journal and output and not settings.again else None
        if before is not None:
            records.append({**before, "file": source.name, "output": output, "status": SKIPPED})
            continue
        where = None if output is None else os.path.join(folder, output)
        may_replace = settings.again or journal is None or journal.knows(output)
        chosen = {**settings.options, **(each or {}).get(source.path, {}), "may_replace": may_replace}
        tasks.append(Task(source.name, source.path, where, output, chosen))
    display = Display(len(tasks), len(records), settings.quiet)
    try:
        with display:
            for task, record in run_tasks(command, tasks, settings.jobs or os.cpu_count() or 1, display, journal):
                records.append({"file": task.name, "output": task.output, **record})
                display.finish(records[-1])
                if journal and task.output and record["status"] == DONE:
                    journal.add(task.output, task.source, record)
    except KeyboardInterrupt:
        done = sum(record["status"] != FAILED for record in records)
        again = "; the same command goes on from there" if outputs else ""
        files.line(f"mocodec: stopped after {done} of {len(sources)} files{again}", err=True)
        raise
    report = summary.report(command, sorted(records, key=lambda r: r["file"]), time.monotonic() - started)
    if settings.as_json:
        files.echo(json.dumps(report, indent=2))
    elif not settings.quiet:
        for text in summary.lines(command, report):
            files.line(text)
    return max((record["code"] for record in records if record["status"] == FAILED), default=0)
