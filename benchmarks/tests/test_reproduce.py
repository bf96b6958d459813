"""The stored tables agree with the stored results, and every command exists."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks import __main__, reproduce

STORED = Path(__file__).parents[2] / "docs" / "results"


@pytest.mark.skipif(not STORED.is_dir(), reason="no stored results")
def test_the_stored_tables_come_from_the_stored_results(tmp_path: Path) -> None:
    for path in (*STORED.glob("*.json"), *STORED.glob("*/*.json")):
        copy = tmp_path / path.relative_to(STORED)
        copy.parent.mkdir(exist_ok=True)
        shutil.copy(path, copy)
    paths = reproduce.write_tables(tmp_path)
    assert len(paths) >= 7
    for path in paths:
        assert path.read_text() == (STORED / path.relative_to(tmp_path)).read_text(), path.name


@pytest.mark.parametrize("name", __main__.COMMANDS)
def test_every_command_has_a_help_page(name: str) -> None:
    result = CliRunner().invoke(__main__.main, [name, "--help"])
    assert result.exit_code == 0, result.output


def test_every_command_is_on_the_page_on_evaluation() -> None:
    page = (Path(__file__).parents[2] / "docs" / "evaluation.md").read_text()
    assert [name for name in __main__.COMMANDS if not re.search(rf"`[^`]*\b{name}\b", page)] == []


def test_all_runs_known_commands() -> None:
    for arguments in reproduce.commands(Path("results")):
        assert arguments[0] in __main__.COMMANDS


def test_without_a_command_they_are_listed() -> None:
    output = CliRunner().invoke(__main__.main, []).output
    assert all(name in output for name in __main__.COMMANDS)
