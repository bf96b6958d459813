"""A prior of one's own people: trained from an archive, used for encoding, found for decoding."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import archive, cli
from mocodec.codecs.tempo import header, training
from mocodec.codecs.tempo.models import prior
from mocodec.testing.hinged_figures import figure


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `raw`, some takes of a figure, `db`, an archive of them, and `mine.prior`."""
    folder = tmp_path_factory.mktemp("prior")
    (folder / "raw").mkdir()
    for seed in range(4):
        mc.write(folder / f"raw/take_{seed}.bvh", figure(frames=120, seed=seed))
    archive.build(folder / "raw", folder / "db", archive.Options("lossless"))
    assert cli.run(["prior", "train", str(folder / "db"), "-o", str(folder / "priors/mine.prior")]) == 0
    return folder


def test_files_name_the_prior_and_need_it(trained: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    motion = replace(mc.read(trained / "raw/take_1.bvh", mc.Motion), rotations=None)
    with prior.used(str(trained / "priors/mine.prior")):
        blob = mc.encode(motion, max_error=0.005, model="points-prior")
    clear_folders(monkeypatch)
    with pytest.raises(mc.UnknownCodec, match="MOCODEC_PRIORS"):
        mc.decode(blob)
    monkeypatch.setenv("MOCODEC_PRIORS", str(trained / "priors"))
    assert np.linalg.norm(mc.decode(blob, mc.Motion).positions - motion.positions, axis=2).max() <= 0.005


def clear_folders(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a process that has not opened an archive, nor used a prior."""
    monkeypatch.setattr(prior, "_folders", [])
    monkeypatch.delenv("MOCODEC_PRIORS", raising=False)
    header._read_model.cache_clear()


def test_the_command_line(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine, source, coded = trained / "priors/mine.prior", trained / "raw/take_1.bvh", tmp_path / "take.mocz"
    assert cli.run(["encode", str(source), "-o", str(coded), "--max-error", "5mm", "--prior", str(mine)]) == 0
    monkeypatch.setenv("MOCODEC_PRIORS", str(trained / "priors"))
    assert cli.run(["verify", str(coded), "--against", str(source)]) == 0
    assert cli.run(["encode", str(source), "-o", str(coded), "--prior", str(source)]) == 3
    assert cli.run(["prior", "train", str(trained / "db"), "-o", str(tmp_path / "mine.npz")]) == 2


def test_an_archive_keeps_the_prior(trained: Path, tmp_path: Path) -> None:
    options = archive.Options(targets={"max_error": 0.01})
    mine = trained / "priors/mine.prior"
    report = archive.build(trained / "raw", tmp_path / "db", options, prior=mine)
    assert (len(report.added), report.failed) == (4, [])
    with mc.open_archive(tmp_path / "db") as db:
        assert list(archive.damage(db, decode=True)) == []
        assert {row.prior for row in db.rows()} == {path.stem for path in (tmp_path / "db/priors").iterdir()}
    assert len(archive.build(trained / "raw", tmp_path / "db").unchanged) == 4
    archive.merge([tmp_path / "db"], tmp_path / "other")
    assert [p.read_bytes() for p in (tmp_path / "other/priors").iterdir()] == [mine.read_bytes()]


def test_training_is_deterministic_and_needs_recordings(trained: Path) -> None:
    motions = [mc.read(path, mc.Motion) for path in sorted((trained / "raw").iterdir())]
    assert training.train(motions) == training.train(motions)
    with pytest.raises(mc.BadInput, match="at least 3 recordings"):
        training.train(motions[:2])


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04", b"text"])
def test_what_is_no_prior(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "bad.prior").write_bytes(data)
    with pytest.raises(mc.BadInput, match="not a prior"), prior.used(str(tmp_path / "bad.prior")):
        pass
    with pytest.raises(mc.BadInput), prior.used(str(tmp_path / "none.prior")):
        pass


def test_any_number_of_processes_learns_the_same(trained: Path) -> None:
    with mc.open_archive(trained / "db") as db:
        seen: list[tuple[int, int, str]] = []
        data, recordings, frames = archive.train_prior(db, workers=2, report_to=lambda *report: seen.append(report))
        assert (recordings, frames) == (4, 480)
        assert data == (trained / "priors/mine.prior").read_bytes()
        assert {name for _, _, name in seen} == set(db.names)
        assert [done for done, total, _ in seen if done == total] == [len(seen)]
        with pytest.raises(mc.BadInput, match="at least 3 recordings"):
            archive.train_prior(db.query("name in ('take_1', 'take_2')"))
        with ThreadPoolExecutor(1) as executor:
            assert archive.train_prior(db, executor=executor)[1] == 4
