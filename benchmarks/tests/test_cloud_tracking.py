"""Tracking and recovery of a body, on a motion that needs no recordings."""

from __future__ import annotations

from benchmarks.cloud import makehuman, tracking
from mocodec.testing import actors, sequences


def test_tracking_without_recordings(tmp_path, monkeypatch):
    monkeypatch.setattr(makehuman, "find", actors.capsules)
    few = {name: tracking.CONDITIONS[name] for name in ("2,500 points", "2,500 points, 0.5 cm noise")}
    results = tracking.run(tmp_path, 4, few)
    assert results["motions"].keys() == {"jumping jacks"}
    found = results["motions"]["jumping jacks"]
    assert found.keys() == {*few, "2,500 points, NumPy alone"}
    for measured in found.values():
        assert measured["mean_cm"] < 3
        assert measured["lost_frames"] == measured["longest_loss"] == 0
    act = sequences.jumping_jacks(actors.capsules(), 14)
    recovery_frames = tracking.recovery(act, at=(3,))
    assert len(recovery_frames) == 4
    assert max(recovery_frames) <= 10


def test_faults_of_cameras_without_recordings(tmp_path, monkeypatch):
    monkeypatch.setattr(makehuman, "find", actors.capsules)
    few = {name: tracking.FAULTS[name] for name in ("whole surface, no faults", "four, no depth at the head")}
    monkeypatch.setattr(tracking, "FAULTS", few)
    results = tracking.run_faults(tmp_path, 4)
    assert results["motions"].keys() == {"jumping jacks"}
    page = tracking.faults_page(results)
    assert page.count("\n| ") == 1 + len(few)
    assert all(name in page for name in few)
