"""Building an archive: what is read, what is done again, and what a name says."""

from __future__ import annotations

import os
import shutil
import sqlite3
import tarfile
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import mocodec as mc
from mocodec import archive
from mocodec.archive import names, sources
from mocodec.testing import synthetic
from mocodec.testing.hinged_figures import figure

from .conftest import write_sources

OPTIONS = archive.Options("liu2006", {"max_error": 0.005})


def test_a_second_build_finds_everything_done(vault: Path) -> None:
    before = (vault / "db/shards/000001.mocs").read_bytes()
    report = archive.build(vault / "raw", vault / "db")  # with the options of the last build
    assert len(report.unchanged) == 4
    assert report.added == report.replaced == report.failed == []
    assert (vault / "db/shards/000001.mocs").read_bytes() == before


def test_touched_sources_are_hashed_and_changed_ones_coded_again(vault: Path) -> None:
    touched, changed = vault / "raw/07/FastWalk_01.npz", vault / "raw/08/FastWalk_01.npz"
    os.utime(touched, (1, 1))
    mc.write(changed, synthetic.joints(frames=77, rate=60.0, seed=99))
    report = archive.build(vault / "raw", vault / "db")
    assert report.replaced == ["08/FastWalk_01"]
    assert len(report.unchanged) == 3
    with mc.open_archive(vault / "db") as db:
        assert len(db) == 4
        assert len(db["08/FastWalk_01"]) == 77
        assert archive.unused_bytes(db) > 0
    assert len(archive.build(vault / "raw", vault / "db").unchanged) == 4


def test_other_options_code_again(vault: Path) -> None:
    report = archive.build(vault / "raw", vault / "db", archive.Options("liu2006", {"max_error": 0.02}))
    assert len(report.replaced) == 4
    with mc.open_archive(vault / "db") as db:
        assert db["07/FastWalk_01"].encoded.promise == {"max_error": 0.02}


def test_equal_recordings_are_stored_once(tmp_path: Path) -> None:
    write_sources(tmp_path / "raw", 1, 1)
    source = tmp_path / "raw/07/FastWalk_01.npz"
    (tmp_path / "raw/07/copy.npz").write_bytes(source.read_bytes())
    archive.build(tmp_path / "raw", tmp_path / "db", OPTIONS)
    with mc.open_archive(tmp_path / "db") as db:
        one, two = db.rows()
        assert (one.shard, one.start) == (two.shard, two.start)
        assert archive.unused_bytes(db) == 0


def test_shards_are_of_limited_size(tmp_path: Path) -> None:
    write_sources(tmp_path / "raw")
    archive.build(tmp_path / "raw", tmp_path / "db", OPTIONS, shard_bytes=1000)
    assert len(list((tmp_path / "db/shards").iterdir())) > 1
    with mc.open_archive(tmp_path / "db") as db:
        assert list(archive.damage(db, decode=True)) == []


def test_same_stems_keep_their_suffixes(tmp_path: Path) -> None:
    walk = synthetic.markers(frames=40, seed=1)
    (tmp_path / "raw").mkdir()
    for suffix in ("c3d", "trc"):
        mc.write(tmp_path / f"raw/walk.{suffix}", walk)
    archive.build(tmp_path / "raw", tmp_path / "db", OPTIONS)
    assert len(archive.build(tmp_path / "raw", tmp_path / "db").unchanged) == 2
    with mc.open_archive(tmp_path / "db") as db:
        assert db.names == ["walk", "walk.trc"]


def test_a_name_from_elsewhere_is_not_replaced(vault: Path) -> None:
    other = vault / "other/07"
    other.mkdir(parents=True)
    for name in ("FastWalk_01.npz", "more.npz"):
        mc.write(other / name, synthetic.joints(frames=50, seed=3))
    report = archive.build(vault / "other", vault / "db")
    assert report.added == ["07/FastWalk_01.npz", "07/more"]
    (vault / "third/07").mkdir(parents=True)
    mc.write(vault / "third/07/FastWalk_01.npz", synthetic.joints(frames=51, seed=4))
    report = archive.build(vault / "third", vault / "db")
    assert "remove it, or choose a prefix" in report.failed[0][1]
    assert archive.build(vault / "third", vault / "db", prefix="third/").added == ["third/07/FastWalk_01"]


@pytest.mark.parametrize("suffix", ["zip", "tar", "tar.gz"])
def test_packed_sources(tmp_path: Path, suffix: str) -> None:
    write_sources(tmp_path / "raw", 1, 2)
    packed = tmp_path / f"all.{suffix}"
    files = sorted((tmp_path / "raw").rglob("*.npz"))
    if suffix == "zip":
        with zipfile.ZipFile(packed, "w") as z:
            for path in files:
                z.write(path, path.relative_to(tmp_path / "raw"))
    else:
        with tarfile.open(packed, "w:gz" if suffix.endswith("gz") else "w") as t:
            for path in files:
                t.add(path, path.relative_to(tmp_path / "raw"))
    report = archive.build(packed, tmp_path / "db", OPTIONS)
    assert report.added == ["07/FastWalk_01", "07/FastWalk_02"]
    assert len(archive.build(packed, tmp_path / "db").unchanged) == 2


def test_companions_come_along(tmp_path: Path) -> None:
    """The skeleton of an .amc is in another file, which a copy out of a .zip needs beside it."""
    motion = figure(frames=40)
    mc.write(tmp_path / "walk.amc", motion)
    with zipfile.ZipFile(tmp_path / "amc.zip", "w") as z:
        for path in (*tmp_path.glob("*.amc"), *tmp_path.glob("*.asf")):
            z.write(path, f"01/{path.name}")
    report = archive.build(tmp_path / "amc.zip", tmp_path / "db", OPTIONS)
    assert report.added == ["01/walk"]


def test_globs_and_files(vault: Path) -> None:
    report = archive.build(str(vault / "raw/*/FastWalk_01.npz"), vault / "new", OPTIONS)
    assert report.added == ["07/FastWalk_01", "08/FastWalk_01"]
    report = archive.build([vault / "raw/07/FastWalk_02.npz"], vault / "new")
    assert report.added == ["FastWalk_02"]


def test_urls_of_fsspec(tmp_path: Path) -> None:
    fsspec = pytest.importorskip("fsspec", reason="URLs need the [remote] extra")
    write_sources(tmp_path / "raw", 1, 2)
    files = fsspec.filesystem("memory")
    for path in (tmp_path / "raw").rglob("*.npz"):
        files.pipe_file(f"/vault/{path.relative_to(tmp_path / 'raw').as_posix()}", path.read_bytes())
    try:
        report = archive.build("memory://vault", tmp_path / "db", OPTIONS)
        assert report.added == ["07/FastWalk_01", "07/FastWalk_02"]
        assert len(archive.build("memory://vault", tmp_path / "db").unchanged) == 2
        assert len(archive.build("memory://vault/*/*_02.npz", tmp_path / "new", OPTIONS).added) == 1
        with pytest.raises(mc.BadInput, match="memory://nowhere"):
            archive.build("memory://nowhere", tmp_path / "none")
    finally:
        files.rm("/vault", recursive=True)


def test_mocz_are_taken_as_they_are(made: Path, tmp_path: Path) -> None:
    blob = mc.encode(synthetic.joints(frames=50, seed=5), max_error=0.01)
    (tmp_path / "clip.mocz").write_bytes(blob)
    archive.build(tmp_path / "clip.mocz", tmp_path / "db", OPTIONS)
    with mc.open_archive(tmp_path / "db") as db:
        assert db.entry("clip").read() == blob


def test_merge_copies_and_leaves_out_what_was_removed(vault: Path) -> None:
    assert archive.remove(vault / "db", ["08/FastWalk_01"]) == ["08/FastWalk_01"]
    with pytest.raises(mc.BadInput, match="no recording"):
        archive.remove(vault / "db", ["07/FastWalk_01", "nobody"])
    report = archive.merge([vault / "db"], vault / "both")
    assert len(report.added) == 3
    mc.write(vault / "jump.npz", synthetic.joints(frames=40, seed=8))
    archive.build(vault / "jump.npz", vault / "second", OPTIONS)
    report = archive.merge([vault / "db", vault / "second"], vault / "both")
    assert (report.added, len(report.unchanged)) == (["jump"], 3)
    with mc.open_archive(vault / "db") as old, mc.open_archive(vault / "both") as both:
        assert len(both) == 4
        assert archive.unused_bytes(old) > 0 == archive.unused_bytes(both)
        assert both.entry("07/FastWalk_01").read() == old.entry("07/FastWalk_01").read()
        assert list(archive.damage(both)) == []
    with pytest.raises(mc.BadInput, match="into itself"):
        archive.merge([vault / "db"], vault / "db")


def test_merge_lists_other_recordings_of_one_name(vault: Path) -> None:
    mc.write(vault / "raw/07/FastWalk_01.npz", synthetic.joints(frames=40, seed=8))
    archive.build(vault / "raw", vault / "second", OPTIONS)
    report = archive.merge([vault / "second"], vault / "db")
    assert [name for name, _ in report.failed] == ["07/FastWalk_01"]
    assert len(report.unchanged) == 3


def test_sources_that_moved_are_the_same(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    assert len(archive.build(tmp_path / "raw", tmp_path / "db").unchanged) == 4
    assert _rows(tmp_path / "db")["07/FastWalk_01"].origin == str(tmp_path / "raw/07/FastWalk_01.npz")


def test_any_executor(made: Path, tmp_path: Path) -> None:
    expected = {name: row.content for name, row in _rows(made / "db").items()}
    with ThreadPoolExecutor(2) as executor:
        archive.build(made / "raw", tmp_path / "threads", OPTIONS, executor=executor)
    assert {name: row.content for name, row in _rows(tmp_path / "threads").items()} == expected


def _rows(folder: Path) -> dict[str, archive.Row]:
    with mc.open_archive(folder) as db:
        return {row.name: row for row in db.rows()}


@pytest.mark.parametrize(
    ("name", "subject", "trial", "labels"),
    [
        ("cmu/86/86_02", 86, 2, ("cmu",)),
        ("sub-07/FastWalk_003", 7, 3, ("fast", "walk")),
        ("S12_jump_forward", 12, None, ("jump", "forward")),
        ("lab/monday/turn left 4", None, 4, ("lab", "monday", "turn", "left")),
        ("131/salsa", 131, None, ("salsa",)),
        ("Subject 3/dance", 3, None, ("dance",)),
        ("walk", None, None, ("walk",)),
    ],
)
def test_names_say_subject_trial_and_labels(
    name: str, subject: int | None, trial: int | None, labels: tuple[str, ...]
) -> None:
    assert names.parse(name) == names.Parsed(subject, trial, labels)


def test_nothing_to_read(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(mc.BadInput, match="nothing here"):
        sources.find([str(tmp_path / "empty")])
    with pytest.raises(mc.BadInput, match="no such file"):
        sources.find([str(tmp_path / "nowhere")])


def test_the_catalogue_is_plain_sqlite(made: Path) -> None:
    connection = sqlite3.connect(made / "db/catalogue.sqlite")
    assert connection.execute("SELECT count(*) FROM recordings WHERE subject = 7").fetchone() == (2,)
    connection.close()
