"""The paper's command runs where no recordings are, on motions that need none, and its tables name what they show."""

from __future__ import annotations

import importlib
import inspect
import json

import pytest

from mocodec.evaluation.cloud import actors
from mocodec.evaluation.papers import lien2006

pytest.importorskip("PIL")
pytest.importorskip("av")
pytest.importorskip("matplotlib")


def test_tables_and_figures(tmp_path, monkeypatch):
    monkeypatch.setattr(lien2006, "POINTS", 1200)
    monkeypatch.setattr(lien2006, "LEVELS", (0, 25, 100))
    monkeypatch.setattr(lien2006, "KEEPS", (1.0,))
    monkeypatch.setattr(lien2006, "NOISES", (0.0,))
    monkeypatch.setattr(lien2006, "TELE_IMMERSION", {"tai-chi master": "turning"})
    monkeypatch.setattr(actors, "find", actors.capsules)
    results = lien2006.run(tmp_path / "nothing", tmp_path, 4)
    assert json.loads((tmp_path / "lien2006.json").read_text())["synthetic"].keys() == {"turn"}
    text = (tmp_path / "lien2006.md").read_text()
    assert "Table 2" in text
    assert "5664" in text or "5665" in text
    for number in (6, 7, 8, 9):
        assert (tmp_path / f"lien2006_figure{number}.png").stat().st_size > 1000
    assert (tmp_path / "lien2006_side_by_side.png").exists()
    assert results["tele_immersion"]["tai-chi master"]["bodycast 0"]["psnr_db"] > 15


@pytest.mark.parametrize("paper", ["liu2006", "hou2014", "lien2006"])
def test_every_paper_is_run_in_the_same_way(paper: str) -> None:
    module = importlib.import_module(f"mocodec.evaluation.papers.{paper}")
    assert list(inspect.signature(module.run).parameters)[:2] == ["data", "output"]
