"""The command line: one module per command.

    encode → info → verify → decode → compare → cut     archive keeps many     demo tries them on a small recording

`main` is the entry point: it runs a command and turns every error into one line on standard error and an exit code.
The module of a command is imported only when the command runs, so that `mocodec --help` is fast.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from .. import __version__
from ..errors import Corrupt, MocodecError, Truncated
from . import interrupts

COMMANDS = {
    "encode": "Compress a recording into a .mocz file.",
    "decode": "Write the recording in a .mocz file as .c3d, .trc, .bvh, …",
    "convert": "Write a recording in another format, without compression.",
    "info": "Show the contents of a file.",
    "verify": "Check a .mocz file: every checksum, and the promised error.",
    "compare": "Measure the difference between two recordings.",
    "cut": "Cut a time range out of a file.",
    "view": "Show recordings in the browser, with the error against an original.",
    "archive": "Keep many recordings in one place, and find them.",
    "prior": "Learn a prior from your own recordings, for smaller files.",
    "demo": "Encode the recording in the package with several codecs and measure them.",
}

OK, PROMISE_BROKEN, USAGE, BAD_INPUT, DAMAGED = 0, 1, 2, 3, 4
BUG, INTERRUPTED, TERMINATED, BROKEN_PIPE = 70, 130, 143, 141
"""A stopped command exits with 128 + the signal, as in shells: 130 for SIGINT, 143 for SIGTERM, 141 for SIGPIPE."""

EPILOG = """
\b
Exit codes:
  0  success
  1  a promise is broken (verify)
  2  an option or argument is wrong
  3  the input is unreadable, or cannot be coded with these settings
  4  the file is damaged: cut short, or a checksum does not match

\b
"-" as a file is standard input or output.
Lengths need a unit (2mm, 0.3cm, 0.002m), times too (12.5s, 500ms, 1500f for frame 1500).
"""


class BrokenPromise(MocodecError):
    """One of many files does not keep its promise."""


class Commands(click.Group):
    """The commands by name; each is the `command` of a module, which is imported when the command runs."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        here = Path(__file__).parent
        return [name for name in COMMANDS if (here / f"{name}.py").exists() or (here / name).is_dir()]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.list_commands(ctx):
            return None
        command: click.Command = import_module(f"{__name__}.{cmd_name}").command
        if not any(p.name == "debug" for p in command.params):
            command.params.append(debug_option())
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands from COMMANDS, so that help imports none of their modules."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name]) for name in self.list_commands(ctx)])


def debug_option() -> click.Option:
    """The option --debug, which the group and every command have."""

    def remember(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        if value and isinstance(ctx.obj, dict):
            ctx.obj["debug"] = True

    return click.Option(
        ["--debug"], is_flag=True, expose_value=False, callback=remember, help="Show the traceback of an error."
    )


def version_option() -> click.Option:
    """The option --version: of mocodec, Python and NumPy, and whether the compiled module is in use."""

    def show(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        if not value:
            return
        from .. import native

        compiled = "in use" if native.available() else "not in use (everything works, more slowly)"
        click.echo(f"mocodec {__version__}, compiled module {compiled}")
        ctx.exit()

    help_text = "Show the version, and whether the compiled module is in use."
    return click.Option(["--version"], is_flag=True, expose_value=False, is_eager=True, callback=show, help=help_text)


mocodec = Commands(
    "mocodec",
    params=[version_option(), debug_option()],
    help="Compress recordings of human motion, with an error that is measured and guaranteed.",
    epilog=EPILOG,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    no_args_is_help=False,
)


def run(arguments: Sequence[str]) -> int:
    """Run one command line; returns its exit code. Errors become one line on standard error, unless --debug."""
    flags: dict[str, Any] = {"debug": False}
    try:
        if "" in arguments:
            raise click.UsageError("an argument is empty; is a variable of the shell not set?")
        with mocodec.make_context("mocodec", list(arguments) or ["--help"], obj=flags) as ctx:
            result = mocodec.invoke(ctx)
            for note in flags.get("notes", ()):  # of the files that were read
                click.echo(printable(note), err=True)
        if sys.stdout is not None:
            sys.stdout.flush()
        return result if isinstance(result, int) else OK
    except click.exceptions.Exit as exit_:
        return exit_.exit_code
    except KeyboardInterrupt:
        return print_error("interrupted", interrupts.exit_code())
    except BrokenPipeError:
        silence_streams()
        return BROKEN_PIPE
    except Exception as error:
        if interrupts.was_stopped():
            return print_error("interrupted", interrupts.exit_code())
        if flags["debug"]:
            raise
        return print_error(*message_and_code(error))


def message_and_code(error: Exception) -> tuple[str, int]:
    """An error as one line and an exit code."""
    match error:
        case click.UsageError():
            path = error.ctx.command_path if error.ctx else "mocodec"
            return f"{usage_message(error).rstrip('.')} (see '{path} --help')", USAGE
        case click.ClickException():
            return error.format_message(), BAD_INPUT
        case BrokenPromise():
            return str(error), PROMISE_BROKEN
        case Truncated() | Corrupt():
            return str(error), DAMAGED
        case MocodecError():
            return str(error), BAD_INPUT
        case FileNotFoundError(filename=str() as path):
            return f"{path}: no such file or folder", BAD_INPUT
        case OSError():
            where = f"{error.filename}: " if error.filename else ""
            return f"{where}{error.strerror or error}", BAD_INPUT
        case MemoryError():
            return "not enough memory for this recording; cut it into parts", BAD_INPUT
        case _:
            return (
                f"a bug in mocodec, please report it: {type(error).__name__}: {error} (--debug shows the traceback)",
                BUG,
            )


def usage_message(error: click.UsageError) -> str:
    """What is wrong with the arguments, with a way out where click does not name one."""
    match error:
        case click.MissingParameter(param=click.Option(name="output", metavar=metavar)):
            return f"name the output: -o {metavar}"
        case click.NoSuchOption(ctx=click.Context(command=click.Group())):
            return f"no option {error.option_name} before the name of a command: options of a command stand behind it"
        case _:
            return error.format_message()


def printable(text: str) -> str:
    """The text without control characters, which files may put into names."""
    return "".join(character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in text)


def print_error(message: str, code: int) -> int:
    """Print one line on standard error, unless it is closed; returns the exit code."""
    line = " ".join(message.split())
    with suppress(OSError, ValueError):
        print(f"mocodec: {printable(line)}", file=sys.stderr, flush=True)
    return code


def silence_streams() -> None:
    """Discard buffered output, or Python reports the closed pipe or full disk again at exit."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


closed_streams: set[str] = set()
"""Names of the standard streams that were closed when the command began."""


def open_streams() -> None:
    """Standard streams that are closed become /dev/null, so that files do not take their numbers; what cannot be
    encoded is printed as escapes."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
        if getattr(sys, name) is None:
            closed_streams.add(name)
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115
        elif number:
            getattr(sys, name).reconfigure(errors="backslashreplace")


def main() -> None:
    """The `mocodec` command."""
    open_streams()
    interrupts.install()
    if not sys.warnoptions and "--debug" not in sys.argv:
        warnings.simplefilter("ignore")
    try:
        code = run(sys.argv[1:])
        with suppress(OSError):
            sys.stdout.flush()
    except KeyboardInterrupt:  # while an error was being printed
        code = interrupts.exit_code()
    interrupts.leave_quietly()
    try:
        sys.stdout.flush()
    except OSError:
        silence_streams()
    sys.exit(code)
