"""The types of the public interface, as a type checker shows them to a user."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import mocodec

SCRIPT = Path(__file__).parent / "typing" / "user_script.py"
SOURCE = Path(mocodec.__file__).parent.parent


@pytest.mark.skipif(importlib.util.find_spec("pyright") is None, reason="needs pyright: the [dev] extra")
def test_a_users_script_has_the_types_that_it_asserts(tmp_path: Path) -> None:
    """Lines with `# error` are the only ones that pyright reports."""
    shutil.copy(SCRIPT, tmp_path)
    settings = {"include": [SCRIPT.name], "extraPaths": [str(SOURCE)], "typeCheckingMode": "standard"}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    command = [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable, "-p", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode not in (0, 1) or not done.stdout.startswith("{"):
        pytest.skip(f"pyright does not run here: {(done.stderr or done.stdout)[:200]}")
    found = {
        problem["range"]["start"]["line"] + 1: problem["message"]
        for problem in json.loads(done.stdout)["generalDiagnostics"]
        if problem["severity"] == "error"
    }
    expected = {number for number, line in enumerate(SCRIPT.read_text().splitlines(), 1) if "# error" in line}
    assert found.keys() == expected, found


def test_codecs_are_listed_and_imported_on_first_use() -> None:
    for name in mocodec.__all__:
        assert name in dir(mocodec)
        assert getattr(mocodec, name) is not None
