"""Files as the command line names them: a path, a URL, or "-" for standard input and output; the readers' options."""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import click

from .. import api, formats
from ..errors import BadInput, MocodecError
from ..motion import UP_AXES, Motion
from ..pointcloud import PointClouds

MAGIC_SUFFIX = ".mocz"

READER_OPTIONS = (
    click.option("--format", "format_", metavar="NAME", help='Format of "-", such as c3d or trc; a .mocz needs none.'),
    click.option(
        "--asf", type=click.Path(), metavar="FILE", help="The skeleton of an .amc, where none lies beside it."
    ),
    click.option("--rate", type=click.FloatRange(0, min_open=True), help="Frames a second, in place of the file's."),
    click.option("--fps", type=click.FloatRange(0, min_open=True), help="The same, for a folder of point clouds."),
    click.option("--unit", metavar="UNIT", help="Unit of the file's lengths, in place of its own: mm, cm, in, 0.02."),
    click.option("--up", type=click.Choice(UP_AXES), help="The vertical axis, in place of the file's."),
    click.option("--start", type=float, metavar="SECONDS", help="Time of the first frame, in place of the file's."),
    click.option(
        "--residuals",
        is_flag=True,
        flag_value=True,
        default=None,
        help="Keep what a .c3d says of each sample's quality.",
    ),
)


def reader_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options that go to a format's reader."""
    for option in reversed(READER_OPTIONS):
        command = option(command)
    return command


def named(**options: Any) -> dict[str, Any]:
    """Those options that were given."""
    return {name: value for name, value in options.items() if value is not None}


def is_mocz(name: str) -> bool:
    """Whether a name is that of a .mocz file, here or behind a URL."""
    return name.partition("?")[0].lower().endswith(MAGIC_SUFFIX)


def is_url(name: str) -> bool:
    """Whether it is to be fetched from the network."""
    return re.match(r"[a-z][a-z0-9+.-]+://", name, re.IGNORECASE) is not None


class StandardInput(BytesIO):
    """All of standard input, with a name for messages."""

    name = "standard input"

    def __init__(self) -> None:
        if sys.stdin.isatty():
            raise click.UsageError('"-" reads standard input, but that is the terminal: pipe a file into it')
        super().__init__(sys.stdin.buffer.read())


def source_of(name: str) -> Any:
    """What `mocodec.open` takes for a name: a path, a URL, or standard input."""
    return StandardInput() if name == "-" else name if is_url(name) else Path(name)


def read(name: str, format_: str | None = None, **options: Any) -> Motion | PointClouds:
    """Read any file that mocodec knows. Raises BadInput, and the container's errors for a .mocz."""
    options = named(**options)
    if is_url(name) or is_mocz(name):
        return api.decode(source_of(name))
    if name != "-":
        path = Path(name)
        if format_ and path.suffix.lower() != f".{format_.lower().lstrip('.')}":
            raise BadInput(f"--format is for standard input; {name} is read by its suffix")
        return with_notes(name, api.read(path, **options))
    data = StandardInput()
    if format_ is None or format_.lower() == MAGIC_SUFFIX[1:]:
        try:
            return api.decode(data)
        except BadInput as error:
            raise BadInput(f"{error}; say what it is with --format c3d, trc, …") from error
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"stdin.{format_.lower().lstrip('.')}"
        path.write_bytes(data.getvalue())
        try:
            return with_notes("standard input", api.read(path, **options))
        except MocodecError as error:
            error.args = (str(error).replace(str(path), "standard input"),)
            raise


def with_notes(name: str, recording: Motion | PointClouds) -> Motion | PointClouds:
    """The recording; its reader's notes are left for `run`, which shows them once the command has succeeded."""
    context = click.get_current_context(silent=True)
    if context is not None and isinstance(context.obj, dict) and not context.params.get("quiet"):
        shown: list[str] = context.obj.setdefault("notes", [])
        lines = [f"note: {name}: {printable(note)}" for note in formats.notes(recording)]
        shown.extend(line for line in lines if line not in shown)
    return recording


def printable(text: str) -> str:
    """The text without control characters, which files may put into names."""
    return "".join(character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in text)


def write(
    name: str, motion: Motion | PointClouds, format_: str | None = None, quiet: bool = False, **options: Any
) -> None:
    """Write by suffix, or for "-" in the format named. The file appears whole or not at all. The options are those of
    the format.

    What the format has no place for is said in a line on standard error, unless `quiet`.
    """
    if name != "-":
        api.write(Path(name), motion, **options)
        note_dropped(Path(name).suffix, motion, quiet)
        return
    if format_ is None:
        raise click.UsageError("standard output needs --format c3d, trc, npz, …")
    refuse_terminal()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"stdout.{format_.lower().lstrip('.')}"
        api.write(path, motion, **options)
        sys.stdout.buffer.write(path.read_bytes())
        note_dropped(path.suffix, motion, quiet)


def note_dropped(suffix: str, motion: Motion | PointClouds, quiet: bool) -> None:
    """Say on standard error what a file of this suffix has no place for; a .mocz has for all but rotations."""
    if quiet or suffix.lower() == MAGIC_SUFFIX:
        return
    if left_out := formats.dropped(f"motion{suffix}", motion):
        click.echo(f"note: {suffix.lower()} holds no {printable(', '.join(left_out))}", err=True)


def write_bytes(name: str, data: bytes) -> None:
    """Write bytes to a path, whole or not at all, or to standard output."""
    if name == "-":
        refuse_terminal()
        sys.stdout.buffer.write(data)
    else:
        formats.replace_whole(name, data)


def refuse_terminal() -> None:
    """Raises a usage error where standard output is a terminal."""
    if sys.stdout.isatty():
        raise click.UsageError("standard output is the terminal: pipe it on, or name a file with -o")


@contextmanager
def working(what: str) -> Iterator[None]:
    """A line with a clock on standard error while work goes on; only on a terminal, and after half a second."""
    if not sys.stderr.isatty():
        yield
        return
    from threading import Timer

    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(24), TimeElapsedColumn())
    progress = Progress(*columns, console=Console(stderr=True), transient=True)
    progress.add_task(what, total=None)
    begin = Timer(0.5, progress.start)
    begin.start()
    try:
        yield
    finally:
        begin.cancel()
        begin.join()
        progress.stop()
