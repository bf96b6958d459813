"""Tables and figures of Hou et al. (2014): interpolation, choice of files, and a run without data."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.figures import pyplot
from benchmarks.papers import hou2014, hou2014_figures, hou2014_tables
from mocodec import formats
from mocodec.motion import Motion
from mocodec.testing import synthetic


def test_interpolation_between_points_of_a_curve():
    points = [{"ratio": 10.0, "mean_cm": 0.1}, {"ratio": 1000.0, "mean_cm": 10.0}]
    assert hou2014_tables.ratio_at(points, 1.0) == pytest.approx(100)
    assert hou2014_tables.error_at(points, 100) == pytest.approx(1.0)
    assert hou2014_tables.ratio_at(points, 0.05) is None
    assert hou2014_tables.error_at(points, 2000) is None


def test_recordings_by_cmu_names(tmp_path: Path):
    walk = synthetic.markers(frames=40, seed=0)
    positions = walk.positions.copy()
    positions[3:6, 2] = np.nan
    (tmp_path / "subjects" / "85").mkdir(parents=True)
    formats.write(tmp_path / "subjects" / "85" / "85_12.c3d", Motion(positions, walk.rate, walk.names))
    (tmp_path / "14_14.amc").write_text("not an AMC")
    found = hou2014.Recordings(tmp_path)
    motion = found.motion("85_12")
    assert motion is not None
    assert not motion.gaps.any()
    assert found.motion("14_14") is None
    assert found.path("15_04") is None
    assert found.of_subjects([14]) == ["14_14"]
    assert found.of_subjects([14, 85]) is None  # markers are not joints


def test_missing_sequences_are_listed(tmp_path: Path):
    results = hou2014.run(tmp_path, tmp_path / "results")
    assert set(results["missing"]) == {*hou2014.ANALYSED, *hou2014.SECTION_VI, *hou2014.COMPARED}
    assert (
        "Sequences without a recording, left out of the tables: 14_14"
        in (tmp_path / "results" / "hou2014.md").read_text()
    )
    assert json.loads((tmp_path / "results" / "hou2014.json").read_text())["sequences"] == []


def test_analysis_and_its_figures(tmp_path: Path):
    pytest.importorskip("matplotlib", reason="figures need the [plot] extra")
    plt = pyplot()
    found = hou2014.analyse(synthetic.markers(frames=400, seed=0))
    assert found["v_m"] < found["sigma_m"]
    assert found["coefficients_of_row"] < found["coefficients_of_column"]
    hou2014_figures.draw_analysis(plt, [{"sequence": "synthetic", **found}], tmp_path)
    assert (tmp_path / "hou2014_figures2_3.png").stat().st_size > 10_000
    points = [{"ratio": 10.0 * k, "mean_cm": 0.1 * k} for k in (1, 2, 3)]
    hou2014_figures.draw_setting(
        plt, [{"sequence": "a", "r": {"L = 1, r = 2": points}}], "r", "r", tmp_path / "closely.png"
    )
    hou2014_figures.draw_databases(
        plt,
        [{"database": "a", "files": 1, "frames": 9, "rows": [{"K": 1, **p} for p in points]}],
        tmp_path / "d.png",
    )
    assert (tmp_path / "closely.png").exists()
    assert (tmp_path / "d.png").exists()
