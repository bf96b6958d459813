"""The search of a rival's knob, the report, data sets and folds."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from benchmarks import datasets, fetch, folds
from benchmarks.machine import machine_description
from benchmarks.motion import records, report, rivals, runner, tables
from mocodec import Motion
from mocodec.errors import BadInput, Corrupt
from mocodec.testing import synthetic


def wave(frames: int = 240, points: int = 4) -> Motion:
    t = np.arange(frames)[:, None, None] / 60
    phase = np.arange(points * 3).reshape(1, points, 3)
    return Motion(positions=0.4 * np.sin(2 * t + phase), rate=60)


def grid(motion: Motion, knob: float) -> runner.Outcome:
    """A coder that rounds to a step; larger steps take fewer bytes."""
    decoded = np.round(motion.positions / knob) * knob
    return runner.Outcome(int(1000 - 50 * np.log(knob)), decoded, 0.01, 0.01, {"knob": knob}, {"stream": 1})


@pytest.mark.parametrize("wanted", [0.0005, 0.003, 0.02])
@pytest.mark.parametrize("guess", [1e-5, 0.01, 0.3])
def test_the_search_meets_a_mean_error(wanted: float, guess: float) -> None:
    motion = wave()
    outcome = runner.search(lambda knob: grid(motion, knob), motion, "mean_error", wanted, guess)
    assert outcome is not None
    assert runner.measured("mean_error", motion, outcome) == pytest.approx(wanted, rel=0.02)


@pytest.mark.parametrize("wanted", [0.0005, 0.003, 0.02])
def test_the_search_keeps_a_maximum(wanted: float) -> None:
    motion = wave()
    outcome = runner.search(lambda knob: grid(motion, knob), motion, "max_error", wanted, wanted)
    assert outcome is not None
    assert 0.8 * wanted < runner.measured("max_error", motion, outcome) <= wanted


def example_records() -> list[records.Record]:
    made = []
    for file in ("a", "b"):
        for codec, size in (("tempo", 50), ("hou2014", 100), ("sz3", 200)):
            for target in ("mean_error", "max_error"):
                for wanted in (0.001, 0.01):
                    made.append(
                        records.Record(
                            codec=codec,
                            ours=codec != "sz3",
                            settings={},
                            target=target,
                            target_m=wanted,
                            file=file,
                            content=file,
                            frames=100,
                            points=3,
                            rate=60.0,
                            bytes=size,
                            bytes_by_part={"chunks": size},
                            ratio=3600 / size,
                            mean_error_m=wanted,
                            encode_fps=1e4,
                            decode_fps=1e5,
                            version="1",
                        )
                    )
    return made


def test_bjontegaard_difference() -> None:
    factor, count = tables.bjontegaard(example_records(), "tempo", "sz3")
    assert factor == pytest.approx(0.25)
    assert count == 2


def test_the_report_depends_only_on_its_records(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    problem = replace(example_records()[0], file="broken.c3d", frames=0, bytes=0, problem="not a C3D file")
    made = [*example_records(), problem]
    records.save(tmp_path / "results.json", made)
    again = records.load(tmp_path / "results.json")
    assert sorted(json.dumps(asdict(r)) for r in again) == sorted(json.dumps(asdict(r)) for r in made)
    machine = machine_description()
    assert report.markdown(again, machine) == report.markdown(records.load(tmp_path / "results.json"), machine)
    html = report.page(again, machine)
    assert html == report.page(records.load(tmp_path / "results.json"), machine)
    assert "not a C3D file" in html
    assert "<svg" in html
    assert "72.0" in report.markdown(again, machine)  # 3600 / 50, tempo's ratio


def test_a_folder_with_an_unreadable_file_still_gives_records(tmp_path: Path) -> None:
    (tmp_path / "broken.trc").write_text("this is no TRC file")
    np.savez(tmp_path / "good.npz", positions=wave().positions, rate=60.0)
    found = datasets.recordings(tmp_path)
    assert [r.label for r in found] == ["broken.trc", "good.npz"]
    motion, problem = datasets.loaded(found[0])
    assert motion is None
    assert problem
    motion, problem = datasets.loaded(found[1])
    assert motion is not None
    assert not problem


def test_content_hash_and_unknown_data_sets() -> None:
    assert datasets.content_hash(wave()) == datasets.content_hash(wave())
    assert datasets.content_hash(wave()) != datasets.content_hash(wave(frames=239))
    with pytest.raises(BadInput, match="no data set"):
        datasets.recordings("nowhere")


PAGES = {
    "http://mocap.cs.cmu.edu/search.php?subjectnumber=14": b"subjects/14/14_01.amc, subjects/14/14_02.amc",
    "http://mocap.cs.cmu.edu/subjects/14/14.asf": b"skeleton",
    "http://mocap.cs.cmu.edu/subjects/14/14_01.amc": b"one",
    "http://mocap.cs.cmu.edu/subjects/14/14_02.amc": b"two",
}


def test_fetching_writes_checksums_and_checks_them(tmp_path: Path) -> None:
    paths = fetch.cmu(["14"], tmp_path, PAGES.__getitem__)
    assert [p.name for p in paths] == ["14.asf", "14_01.amc", "14_02.amc"]
    assert len(fetch.read_sums(tmp_path / "subjects/14/SHA256SUMS")) == 3
    fetch.cmu(["14"], tmp_path, PAGES.__getitem__)
    (tmp_path / "subjects/14/14_01.amc").write_bytes(b"other")
    with pytest.raises(Corrupt, match="checksum"):
        fetch.cmu(["14"], tmp_path, PAGES.__getitem__)


def test_without_a_network_the_error_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_network(*_: object, **__: object) -> None:
        raise OSError("no network")

    monkeypatch.setattr("urllib.request.urlopen", no_network)
    with pytest.raises(BadInput, match=r"all_asfamc\.zip"):
        fetch.get("http://mocap.cs.cmu.edu/subjects/14/14.asf")


def test_people_are_coded_with_a_prior_that_has_not_seen_them(tmp_path: Path) -> None:
    seen = datasets.Recording("118_20.amc", Path("118/118_20.amc"), "amc")
    stranger = datasets.Recording("77_01.amc", Path("77/77_01.amc"), "amc")
    assert folds.fold_of(seen) == folds.FOLDS[1]
    assert folds.fold_of(stranger) is None
    tempo, sz3 = runner.tasks([seen], ["tempo", "sz3"], tmp_path)
    assert tempo.prior == tmp_path / "prior-without-02-10-16-49-64-118-131"
    assert sz3.prior is None
    assert runner.tasks([stranger], ["tempo"], tmp_path)[0].prior is None


def test_bytes_by_part_add_up_to_the_file() -> None:
    motion = synthetic.markers(frames=300, seed=5)
    for codec in ("hou2014", "liu2006", "lossless"):
        outcome = runner.run_codec(codec, motion)
        assert sum(outcome.parts.values()) == outcome.data_bytes


@pytest.mark.skipif(not datasets.SHARED.is_dir(), reason="needs ../shared/data")
def test_lossless_is_smaller_than_pcodec() -> None:
    pytest.importorskip("pcodec")
    motion = mc.read(datasets.SHARED / "cmu/c3d/85_02.c3d")
    assert isinstance(motion, Motion)
    ours = len(mc.encode(motion, codec="lossless"))
    assert ours < 0.95 * len(rivals.PcodecLossless().encode(motion.positions, 0.0))
