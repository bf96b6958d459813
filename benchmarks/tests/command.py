"""`scripts/bench test`: runs the tests of the benchmarks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import click


@click.command("test", context_settings={"ignore_unknown_options": True})
@click.argument("pytest_arguments", nargs=-1, type=click.UNPROCESSED)
def command(pytest_arguments: tuple[str, ...]) -> None:
    """Test the benchmarks on small inputs. Arguments go to pytest."""
    arguments = [sys.executable, "-m", "pytest", Path(__file__).parent, *pytest_arguments]
    sys.exit(subprocess.run(arguments).returncode)
