"""Tables and figures of Liu and McMillan (2006), on a synthetic sequence with a known number of frames."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.papers import liu2006
from mocodec import formats
from mocodec.testing import synthetic


def test_sequences_are_found_by_their_length_and_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(liu2006, "PUBLISHED", {360: liu2006.PUBLISHED[4499]})
    monkeypatch.setattr(liu2006, "REPEATS", 1)
    (tmp_path / "data").mkdir()
    formats.write(tmp_path / "data/some.c3d", synthetic.markers(360, seed=1))
    formats.write(tmp_path / "data/other.c3d", synthetic.markers(359, seed=1))
    liu2006.run(tmp_path / "data", tmp_path / "results")
    results = json.loads((tmp_path / "results/liu2006.json").read_text())
    (row,) = results["rows"]
    assert row["file"] == "some.c3d"
    assert row["ours"]["segments"] >= 1
    assert 0 < row["ours"]["d_world"] < row["ours"]["d_normalised"] < 100
    assert "18.4" in (tmp_path / "results/liu2006.md").read_text()
    for figure in (3, 4):
        assert (tmp_path / f"results/liu2006_figure{figure}_sequence2.png").stat().st_size > 5000


def test_no_sequence_is_an_empty_table(tmp_path: Path) -> None:
    assert liu2006.run(tmp_path)["rows"] == []
