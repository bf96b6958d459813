"""Every script in examples/ runs and prints something."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

SCRIPTS = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_example_runs(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if "plot" in script.stem:
        pytest.importorskip("matplotlib", reason="drawing needs the [plot] extra")
    if "person" in script.stem:
        pytest.importorskip("av", reason="the surface of a person needs the [cloud] extra")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="__main__")
    assert capsys.readouterr().out


def test_examples_are_listed_in_order() -> None:
    listed = (SCRIPTS[0].parent / "README.md").read_text()
    places = [listed.index(f"`{script.name}` |") for script in SCRIPTS]
    assert places == sorted(places)
