"""The benchmark of clouds with other content than one person, on a small scene without recordings."""

from __future__ import annotations

from click.testing import CliRunner

from benchmarks.cloud import makehuman, object_scenes, objects
from benchmarks.results import read_json
from mocodec.testing import actors


def test_a_chair_without_recordings_and_again(tmp_path, monkeypatch):
    monkeypatch.setattr(makehuman, "find", actors.capsules)
    monkeypatch.setattr(object_scenes, "D1_MM", (2.0,))
    monkeypatch.setattr(objects, "PERSON_POINTS", 2000)
    monkeypatch.setattr(objects, "CHAIR_POINTS", 800)
    arguments = ["-o", str(tmp_path), "--frames", "6", "--scene", "chair"]
    CliRunner().invoke(object_scenes.command, arguments, catch_exceptions=False)
    results = read_json(tmp_path / "cloud_objects.json")
    monkeypatch.setattr(object_scenes, "measure_thing", None)  # stored results stay
    CliRunner().invoke(object_scenes.command, arguments, catch_exceptions=False)
    assert read_json(tmp_path / "cloud_objects.json")["scenes"] == results["scenes"]
    [chair], [thing] = results["scenes"], results["things"]
    assert chair["bodies"] == 0
    assert chair["points"] == 800
    assert 0 < chair["bits"] < chair["apart_bits"] + 1
    assert thing["alone_bits"] > 0
    assert "| chair | 2 | 800 | 0 |" in (tmp_path / "cloud_objects.md").read_text()
