"""Input and output of commands: a path, a URL, or "-" for standard input and output; the options of readers."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Callable, Generator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import click

from .. import api, formats, progress
from ..errors import BadInput, MocodecError
from ..formats.zeros import GAP_OPTIONS
from ..motion import UP_AXES, Motion
from ..pointcloud import PointClouds
from . import closed_streams, printable, quantities, sections

SUFFIX = ".mocz"


def _option(*names: str, **attributes: Any) -> Callable[..., Any]:
    return sections.option(*names, section=sections.READING, **attributes)


READER_OPTIONS = (
    _option(
        "--format",
        "format_",
        metavar="NAME",
        help="Format of standard input, such as c3d or trc; not needed for a .mocz.",
    ),
    _option(
        "--unit", metavar="UNIT", help="Unit of the file's lengths, in place of its own: mm, cm, in; or its metres."
    ),
    _option("--up", type=click.Choice(UP_AXES), help="The vertical axis, in place of the file's."),
    _option("--rate", type=quantities.HERTZ, metavar="HZ", help="Frames per second, in place of the file's: 120."),
    _option("--fps", type=quantities.HERTZ, metavar="HZ", help="Frames per second of a folder of point clouds: 15."),
    _option("--start", type=float, metavar="SECONDS", help="Time of the first frame, in place of the file's."),
    _option("--asf", type=click.Path(), metavar="FILE", help="The skeleton of an .amc; default: the .asf beside it."),
    _option(
        "--smplx",
        type=click.Path(),
        metavar="FILE",
        help="Your own SMPL, SMPL+H or SMPL-X model (.npz), for the bones of AMASS files.",
    ),
    _option("--animation", metavar="NAME|N", help="Which animation of a .glb or .gltf; default: the longest."),
    _option("--skin", metavar="NAME|N", help="Which skin of a .glb or .gltf, or all; default: the largest."),
    _option(
        "--gaps",
        type=click.Choice(GAP_OPTIONS),
        help="Markers at exactly (0, 0, 0) are missing (zeros, the default) or at the origin (keep).",
    ),
    _option(
        "--residuals",
        is_flag=True,
        flag_value=True,
        default=None,
        help="Keep the residual and camera mask of each sample of a .c3d.",
    ),
    _option(
        "--salvage",
        "salvage",
        is_flag=True,
        flag_value=True,
        default=None,
        help="Read a truncated file as far as it goes.",
    ),
)


def reader_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of the formats' readers to a command."""
    for option in reversed(READER_OPTIONS):
        command = option(command)
    return command


def given(**options: Any) -> dict[str, Any]:
    """The options that the user gave: those that are not None."""
    return {name: value for name, value in options.items() if value is not None}


def is_mocz(name: str) -> bool:
    """Whether a path or URL has the suffix .mocz."""
    return name.partition("?")[0].lower().endswith(SUFFIX)


def is_url(name: str) -> bool:
    """Whether it is a URL and not a path."""
    return re.match(r"[a-z][a-z0-9+.-]+://", name, re.IGNORECASE) is not None


def in_archive(name: str) -> tuple[str, str] | None:
    """The archive and the recording's name of ARCHIVE/NAME; None for other arguments."""
    if name == "-" or is_url(name) or is_mocz(name) or Path(name).exists():
        return None
    from ..archive import in_archive

    return in_archive(name)


def is_archive(name: str) -> bool:
    """Whether an argument is the folder of an archive on this machine."""
    if is_url(name) or not Path(name).is_dir():
        return False
    from ..archive import is_archive

    return is_archive(name)


def is_compressed(name: str) -> bool:
    """Whether an argument names a .mocz: by its suffix, as a URL, or as ARCHIVE/NAME."""
    return is_mocz(name) or is_url(name) or in_archive(name) is not None


def holds_compressed(name: str, format_: str | None) -> bool:
    """`is_compressed`, or standard input that is not said to be of another format."""
    return is_compressed(name) or (name == "-" and not format_)


class StandardInput(BytesIO):
    """The bytes of standard input, with a name for error messages."""

    name = "standard input"

    def __init__(self) -> None:
        if "stdin" in closed_streams:
            raise click.UsageError('"-" reads standard input, which is closed')
        if sys.stdin.isatty():
            raise click.UsageError('"-" reads standard input, which is the terminal: pipe a file into it')
        super().__init__(sys.stdin.buffer.read())


def source_of(name: str) -> api.Source:
    """The argument of `mocodec.open` for a name: a path, a URL, ARCHIVE/NAME, or standard input."""
    if (within := in_archive(name)) is not None:
        from ..archive import open_archive

        with open_archive(within[0]) as archive:
            return archive.entry(within[1]).read()
    return StandardInput() if name == "-" else name if is_url(name) else Path(name)


def suffix_of_format(format_: str) -> str:
    """The suffix of a format's name: .trc for trc, .trc or TRC."""
    return f".{format_.lower().lstrip('.')}"


def contradicts(format_: str | None, name: str) -> bool:
    """Whether a --format is given for a named file whose suffix says another one."""
    return bool(format_) and name != "-" and Path(name).suffix.lower() != suffix_of_format(str(format_))


def read(name: str, format_: str | None = None, **options: Any) -> Motion | PointClouds:
    """Read a file, a URL of a .mocz, ARCHIVE/NAME or standard input.

    Raises BadInput; for a .mocz also what `api.decode` raises.
    """
    options = given(**options)
    options |= {key: int(value) for key in ("animation", "skin") if (value := options.get(key, "")).isdecimal()}
    if is_compressed(name):
        require_no_options(name, options)
        return api.decode(source_of(name))
    if name != "-":
        if contradicts(format_, name):
            raise BadInput(f"--format is for standard input; the suffix of {name} says its format")
        return with_notes(name, api.read(Path(name), **options))
    data = StandardInput()
    if format_ is None or format_.lower() == SUFFIX[1:]:
        require_no_options("standard input", options)
        try:
            return api.decode(data)
        except BadInput as error:
            raise BadInput(f"{error}; name its format, such as --format c3d") from error
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"stdin{suffix_of_format(format_)}"
        path.write_bytes(data.getvalue())
        try:
            return with_notes("standard input", api.read(path, **options))
        except MocodecError as error:
            error.args = (str(error).replace(str(path), "standard input"),)
            raise


def require_no_options(name: str, options: dict[str, Any]) -> None:
    """Raises BadInput for reader options that are given for a .mocz."""
    if options:
        listed = ", ".join(f"--{option}" for option in options)
        raise BadInput(f"{name}: {listed} cannot be used with a .mocz, which says all of this itself")


def require_suffix(path: str | None, what: str, suffixes: tuple[str, ...]) -> None:
    """Raises a usage error for an output with another suffix; None is no output."""
    if path is not None and Path(path).suffix.lower() not in suffixes:
        choice = suffixes[0] if len(suffixes) == 1 else f"one of {', '.join(suffixes)}"
        raise click.UsageError(f"{path}: the suffix of {what} must be {choice}")


def refuse_output(source: str, output: str) -> None:
    """Raises a usage error if the output is the source, which a part or another form would replace; BadInput for a file
    in a folder that does not exist: before the work, not after it.
    """
    parent = Path(os.path.realpath(output)).parent
    if output != "-" and Path(output).suffix and not parent.is_dir():
        raise BadInput(f"{output}: there is no folder {parent}")
    try:
        is_same = os.path.samefile(source, output)
    except OSError:  # one does not exist, or is "-" or a URL
        return
    if is_same:
        raise click.UsageError(f"{output} is the file that is read: name another output")


def takes(name: str, format_: str | None, option: str) -> bool:
    """Whether the reader of a file has an option. format_: that of standard input."""
    if holds_compressed(name, format_):
        return False
    return option in formats.read_options(f"x{suffix_of_format(format_)}" if name == "-" and format_ else name)


def with_known_rate(name: str, options: dict[str, Any], known: Motion | PointClouds | None) -> dict[str, Any]:
    """Reader options for a file that does not say its rate (.npy, point clouds): that of the recording that it is
    compared with, unless the user gave one.
    """
    chosen = given(**options)
    option = {"": "fps", ".ply": "fps", ".pcd": "fps", ".npy": "rate"}.get(Path(name).suffix.lower())
    wanted = PointClouds if option == "fps" else Motion
    if option is None or is_url(name) or {"fps", "rate"} & chosen.keys() or not isinstance(known, wanted):
        return chosen
    return {**chosen, option: known.rate}


def with_notes(name: str, recording: Motion | PointClouds) -> Motion | PointClouds:
    """The recording; its reader's notes are left for `run`."""
    for text in formats.notes(recording):
        note(name, text)
    return recording


def note(name: str, text: str) -> None:
    """Leave a note on a file for `run`, which shows each once, after the command has succeeded and unless --quiet."""
    name = "standard input" if name == "-" else name
    context = click.get_current_context(silent=True)
    if context is not None and isinstance(context.obj, dict) and not context.params.get("quiet"):
        shown: list[str] = context.obj.setdefault("notes", [])
        noted = f"note: {name}: {printable(text)}"
        if noted not in shown:
            shown.append(noted)


def clear_notes() -> None:
    """Drop the notes that were left for `run`, for a command that prints them itself."""
    click.get_current_context().obj.pop("notes", None)


def echo(text: str, err: bool = False) -> None:
    """Print text on standard output or error; control characters, which files may put into names, are replaced."""
    click.echo("\n".join(map(printable, text.split("\n"))), err=err)


def line(text: str, err: bool = False) -> None:
    """Print text as one line, as `echo`: a line break in a name cannot begin another."""
    click.echo(printable(text), err=err)


def write(
    name: str, motion: Motion | PointClouds, format_: str | None = None, quiet: bool = False, **options: Any
) -> None:
    """Write in the format of the suffix, or for "-" in `format_`. options: those of the format's writer.

    The file appears complete or not at all. A note on standard error lists what the format cannot store, unless
    `quiet`.
    """
    if name != "-":
        api.write(Path(name), motion, **options)
        print_dropped(Path(name).suffix, motion, quiet)
        return
    if format_ is None:
        raise click.UsageError("standard output needs --format c3d, trc, npz, …")
    refuse_terminal()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"stdout{suffix_of_format(format_)}"
        api.write(path, motion, **options)
        sys.stdout.buffer.write(path.read_bytes())
        print_dropped(path.suffix, motion, quiet)


def print_dropped(suffix: str, motion: Motion | PointClouds, quiet: bool) -> None:
    """List on standard error what a file with this suffix cannot store of the recording."""
    if quiet or suffix.lower() == SUFFIX:
        return
    if left_out := formats.dropped(f"motion{suffix}", motion):
        line(f"note: {suffix.lower()} cannot store {', '.join(left_out)}", err=True)


def write_bytes(name: str, data: bytes) -> None:
    """Write bytes to standard output or a path, where the file appears complete or not at all."""
    if name == "-":
        refuse_terminal()
        sys.stdout.buffer.write(data)
    else:
        formats.replace_whole(name, data)


def refuse_terminal() -> None:
    """Raises a usage error where standard output is a terminal, or closed."""
    if "stdout" in closed_streams:
        raise click.UsageError("standard output is closed: redirect it, or name a file with -o")
    if sys.stdout.isatty():
        raise click.UsageError("standard output is the terminal: redirect it, or name a file with -o")


@contextmanager
def working(what: str) -> Generator[None, None, None]:
    """Show a progress bar on standard error during the context: only on a terminal, and after half a second.

    The bar shows the fractions that codecs report to `progress`, and moves to and fro until the first of them.
    """
    if not sys.stderr.isatty():
        yield
        return
    from threading import Timer

    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(24), TimeElapsedColumn())
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task(what, total=None)

    def show(fraction: float) -> None:
        if fraction > 0:
            bar.update(task, total=1.0, completed=fraction)

    begin = Timer(0.5, bar.start)
    begin.start()
    try:
        with progress.listening(show):
            yield
    finally:
        begin.cancel()
        begin.join()
        bar.stop()


def progress_line(quiet: bool) -> Any:
    """A context with a function that shows how many sources are done: on a terminal only."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(24), MofNCompleteColumn(), TimeRemainingColumn())
    hidden = quiet or not sys.stderr.isatty()
    bar = Progress(*columns, console=Console(stderr=True), transient=True, disable=hidden)

    class Shown:
        def __enter__(self) -> Callable[[int, int, str], None]:
            bar.start()
            task = bar.add_task("building", total=None)
            return lambda done, total, path: bar.update(
                task, completed=done, total=total, description=printable(path[-40:])
            )

        def __exit__(self, *_: object) -> None:
            bar.stop()

    return Shown()
