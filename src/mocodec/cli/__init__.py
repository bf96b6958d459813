"""The command line: one command per file, in the order of a journey.

    encode → info → verify → decode → compare → cut        demo runs them on a small real recording

`main` is the entry point: it runs a command and turns every error into one line on standard error and an exit code.
A command's module is imported when that command is asked for, so that `mocodec --help` is quick.
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

COMMANDS = {
    "encode": "Compress a recording into a .mocz file.",
    "decode": "Write a .mocz file's motion in a format of the field.",
    "info": "Show what a file holds.",
    "verify": "Check a .mocz file: every checksum, and the promised error.",
    "compare": "Measure how far one recording is from another.",
    "cut": "Take a stretch of time out of a file.",
    "archive": "Keep many recordings in one place.",
    "view": "Look at a recording in the browser.",
    "demo": "Do all of it on the small real recording inside the package.",
}

DONE, PROMISE_BROKEN, USAGE, BAD_INPUT, DAMAGED = 0, 1, 2, 3, 4
BUG, INTERRUPTED, BROKEN_PIPE = 70, 130, 141  # the latter two as shells name SIGINT and SIGPIPE

EPILOG = """
\b
Exit codes:
  0  done
  1  the promise does not hold (verify)
  2  usage: an option or argument is wrong
  3  bad or unreadable input, or it cannot be coded as asked
  4  damaged file: cut short, or a checksum does not hold

"-" as a file is standard input or output. Lengths take a unit (2mm, 0.3cm, 0.002m), times too (12.5s, 1500f = frames).
"""


class Commands(click.Group):
    """The commands by name; each module holds a `command` and is imported when asked for."""

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
        """The list of commands from the table, so that help imports none of them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name]) for name in self.list_commands(ctx)])


def debug_option() -> click.Option:
    """--debug, on the group and on every command alike."""

    def remember(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        if value and isinstance(ctx.obj, dict):
            ctx.obj["debug"] = True

    return click.Option(
        ["--debug"], is_flag=True, expose_value=False, callback=remember, help="Show the traceback of an error."
    )


mocodec = Commands(
    "mocodec",
    params=[debug_option()],
    help="Compress human motion a hundredfold, with an error that is measured and guaranteed.",
    epilog=EPILOG,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    no_args_is_help=False,
)
click.version_option(__version__, prog_name="mocodec", message="%(prog)s %(version)s")(mocodec)


def run(arguments: Sequence[str]) -> int:
    """Run one command line; returns its exit code. Errors become one line on standard error, unless --debug."""
    asked: dict[str, Any] = {"debug": False}
    try:
        with mocodec.make_context("mocodec", list(arguments) or ["--help"], obj=asked) as ctx:
            result = mocodec.invoke(ctx)
            for note in asked.get("notes", ()):  # of the files that were read
                click.echo(note, err=True)
        sys.stdout.flush()
        return result if isinstance(result, int) else DONE
    except click.exceptions.Exit as done:
        return done.exit_code
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python complains once more at exit
        return BROKEN_PIPE
    except Exception as error:
        if asked["debug"]:
            raise
        return complain(*explain(error))


def explain(error: Exception) -> tuple[str, int]:
    """An error as one line and an exit code."""
    match error:
        case click.UsageError():
            path = error.ctx.command_path if error.ctx else "mocodec"
            return f"{error.format_message().rstrip('.')} (see '{path} --help')", USAGE
        case click.ClickException():
            return error.format_message(), BAD_INPUT
        case Truncated() | Corrupt():
            return str(error), DAMAGED
        case MocodecError():
            return str(error), BAD_INPUT
        case OSError():
            where = f"{error.filename}: " if error.filename else ""
            return f"{where}{error.strerror or error}", BAD_INPUT
        case MemoryError():
            return "not enough memory for this recording", BAD_INPUT
        case _:
            return f"a mistake in mocodec itself: {type(error).__name__}: {error} (--debug shows where)", BUG


def complain(message: str, code: int) -> int:
    """One line on standard error, if anyone still reads that."""
    with suppress(OSError):
        print("mocodec: " + " ".join(message.split()), file=sys.stderr, flush=True)
    return code


def main() -> None:
    """The `mocodec` command."""
    if not sys.warnoptions and "--debug" not in sys.argv:
        warnings.simplefilter("ignore")
    sys.exit(run(sys.argv[1:]))
