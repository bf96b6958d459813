"""Help, and arguments in the wrong place. Help imports no slow module: a command imports those when it needs them."""

from __future__ import annotations

import subprocess
import sys

import pytest

from .conftest import Command

HEAVY = ("scipy", "rich", "matplotlib", "ezc3d", "asyncio")


def test_help_imports_nothing_heavy() -> None:
    code = f"import sys, mocodec.cli as c; c.run(['encode', '--help']); print([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_help_has_a_heading_for_each_section(command: Command) -> None:
    text = command("encode", "--help").out
    headings = [line for line in text.splitlines() if line.endswith(":") and not line.startswith((" ", "Usage"))]
    assert [heading.partition(":")[0] for heading in headings] == [
        "Options", "Target", "For point clouds", "For many files", "How the input is read",
    ]  # fmt: skip
    assert "IN..." not in text.partition("Options:")[2]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("decode", "walk.mocz"), "name the output: -o OUT"),
        (("encode", "a.c3d", "b.c3d"), "name the folder for the .mocz files of these recordings: -o OUT"),
        (("encode", "-"), "name the output: -o OUT"),
        (("--max-error", "2mm", "encode", "walk.bvh"), "no option --max-error before the name of a command"),
        (("archive", "--json", "list", "vault"), "no option --json before the name of a command"),
    ],
)
def test_arguments_that_are_missing_or_misplaced(command: Command, arguments: tuple[str, ...], says: str) -> None:
    result = command(*arguments)
    assert (result.code, says in result.err) == (2, True), result.err
