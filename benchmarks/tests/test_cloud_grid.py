"""The tracking grid, long sequences and the summary page, on small inputs."""

from __future__ import annotations

import json

import pytest

from benchmarks.cloud import grid, long, makehuman, summary, tracking
from mocodec.testing import actors, sequences


@pytest.fixture(autouse=True)
def _capsule_body(monkeypatch):
    monkeypatch.setattr(makehuman, "find", actors.capsules)


def test_the_grid_and_its_quick_part():
    assert len(grid.conditions()) == 8 * 2 * 4 * 4 * 3
    quick = grid.conditions(quick=True)
    assert len(quick) == 8 * (1 + 1 + 3 + 3 + 2)
    assert grid.Condition("01_01", 15, 0.5, 100, 0) in quick
    assert grid.Condition("01_01", 15, 0.5, 25, 0) not in quick


def test_an_interrupted_grid_continues(tmp_path, monkeypatch):
    wanted = [grid.Condition("jumping jacks"), grid.Condition("jumping jacks", 15, 1.0, 25, 3), grid.Condition("01_01")]
    monkeypatch.setattr(grid, "conditions", lambda quick=False: wanted)
    json_path, page = grid.measure(tmp_path, False, 4, False, tmp_path)
    results = grid.load(json_path)
    assert [r.clip for r in results] == ["jumping jacks"] * 2  # the other clip has no recording
    assert results[0].mean_cm < 3
    assert "jumping jacks | 15" in page.read_text()
    monkeypatch.setattr(tracking, "perform", None)  # so that a new measurement would fail
    wanted.pop()
    assert grid.load(grid.measure(tmp_path, False, 4, False, tmp_path)[0]) == results


def test_thinning_is_deterministic():
    clouds = sequences.record(sequences.jumping_jacks(actors.capsules(), 2), 400)
    condition = grid.Condition("x", 15, 1.0, 25, 0)
    one, again = grid.thinned(clouds, condition), grid.thinned(clouds, condition)
    assert [len(p) for p in one.positions] == [100, 100]
    assert (one.positions[1] == again.positions[1]).all()


def test_the_summary_shows_the_results_that_exist(tmp_path, monkeypatch):
    assert "| 3000 | 8000 |" in summary.markdown(tmp_path)
    pytest.importorskip("PIL")
    pytest.importorskip("av")
    monkeypatch.setattr(long, "POINTS", 800)
    monkeypatch.setattr(long, "RUNS", (("jumping jacks", "bodycast", 0, 30), ("jumping jacks", "lien2006", 25, 30)))
    runs = json.loads(long.measure(tmp_path, True, tmp_path).read_text())["runs"]
    assert [run["frames"] for run in runs] == [3, 3]
    assert runs[0]["bytes"] > runs[0]["once_bytes"] > 0
    found = {
        "person": "p",
        "pose": "T",
        "recording": "clean",
        "points": 9,
        "mean_m": 0.03,
        "max_m": 0.05,
        "problem": "",
    }
    (tmp_path / "first_poses.json").write_text(json.dumps({"frames": [found]}))
    page = summary.markdown(tmp_path)
    assert "jumping jacks, bodycast 0 %, 3 frames" in page
    assert "1 of 1 frames found" in page
