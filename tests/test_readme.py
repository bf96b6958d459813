"""The command lines and the Python of the README run, in order, in one folder."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from mocodec import cli

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```(console|python)\n(.*?)```", README, re.DOTALL)


def test_commands_and_code_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib", reason="drawing needs the [plot] extra")
    pytest.importorskip("av", reason="the surface of a person needs the [cloud] extra")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for language, block in BLOCKS:
        if language == "python":
            exec(compile(block, "README.md", "exec"), names)
            continue
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            assert words[:2] == ["$", "mocodec"], line
            assert cli.run(words[2:]) == 0, line
    assert (tmp_path / "turn.trc").exists()


def test_links_are_not_broken() -> None:
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\((?!https?://)([^)#]+)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_tables_agree_with_their_sources() -> None:
    done = subprocess.run([sys.executable, ROOT / "scripts" / "pages", "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
