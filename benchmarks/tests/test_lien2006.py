"""Tables and figures of Lien and Bajcsy (2006), on motions that need no recordings."""

from __future__ import annotations

import importlib
import inspect
import json

import pytest

from benchmarks.cloud import makehuman
from benchmarks.papers import lien2006
from mocodec.testing import actors

pytest.importorskip("PIL")
pytest.importorskip("av")
pytest.importorskip("matplotlib")


def test_tables_and_figures(tmp_path, monkeypatch):
    monkeypatch.setattr(lien2006, "POINTS", 1200)
    monkeypatch.setattr(lien2006, "LEVELS", (0, 25, 100))
    monkeypatch.setattr(lien2006, "KEPT_SHARES", (1.0,))
    monkeypatch.setattr(lien2006, "NOISES_M", (0.0,))
    monkeypatch.setattr(lien2006, "TELE_IMMERSION", {"tai-chi master": "turning"})
    monkeypatch.setattr(makehuman, "find", actors.capsules)
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
def test_every_paper_has_the_same_entry_point(paper: str) -> None:
    module = importlib.import_module(f"benchmarks.papers.{paper}")
    assert list(inspect.signature(module.run).parameters)[:2] == ["data", "output"]
