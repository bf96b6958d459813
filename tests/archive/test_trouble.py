"""Everything that can go wrong with an archive has a clear outcome, and nothing is lost."""

from __future__ import annotations

import errno
import multiprocessing
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

import mocodec as mc
from mocodec import archive
from mocodec.archive import pool, shards
from mocodec.archive.catalogue import Catalogue
from mocodec.archive.lock import only_builder

from .conftest import write_sources

OPTIONS = archive.Options("liu2006", {"max_error": 0.005})


def contents(folder: Path) -> dict[str, bytes]:
    with mc.open_archive(folder) as db:
        return {entry.row.name: entry.read() for entry in db}


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system cannot kill")
def test_a_killed_build_goes_on(made: Path, tmp_path: Path) -> None:
    """Killed at four moments: the archive is in order each time, and in the end has what an undisturbed build has."""
    code = (
        "import sys; from mocodec import archive; from mocodec.archive import building; "
        "building.COMMIT_SECONDS = 0.05; "
        "print('ready', flush=True); "
        "archive.build(sys.argv[1], sys.argv[2], archive.Options('liu2006', {'max_error': 0.005}))"
    )
    choice = random.Random(3)
    for _ in range(4):
        process = subprocess.Popen(
            [sys.executable, "-c", code, str(made / "raw"), str(tmp_path / "db")], stdout=subprocess.PIPE
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(choice.uniform(0.02, 0.6))
        process.kill()
        process.wait()
        process.stdout.close()
        if (tmp_path / "db/catalogue.sqlite").exists() and _has_tables(tmp_path / "db"):
            with mc.open_archive(tmp_path / "db") as db:
                assert list(archive.damage(db)) == []
    archive.build(made / "raw", tmp_path / "db", OPTIONS)
    assert contents(tmp_path / "db") == contents(made / "db")
    with mc.open_archive(tmp_path / "db") as db:
        assert archive.unused_bytes(db) == 0


def _has_tables(folder: Path) -> bool:
    connection = sqlite3.connect(folder / "catalogue.sqlite")
    (count,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    connection.close()
    return count > 0


def test_uncommitted_bytes_and_shards_stay(vault: Path) -> None:
    shard, other = vault / "db/shards/000001.mocs", vault / "db/shards/000002.mocs"
    with shard.open("ab") as file:
        file.write(b"half a recording")
    other.write_bytes(b"mocs")
    before = contents(vault / "db")
    sizes = shard.stat().st_size, other.stat().st_size
    archive.build(vault / "raw", vault / "db", archive.Options("liu2006", {"max_error": 0.01}), prefix="more/")
    assert (shard.stat().st_size, other.stat().st_size) == sizes
    assert (vault / "db/shards/000003.mocs").exists()
    after = contents(vault / "db")
    assert len(after) == 8
    assert before.items() <= after.items()


def test_an_old_catalogue_does_not_cost_later_recordings(vault: Path) -> None:
    """A catalogue that is restored from a copy: a build keeps what it does not count, and a repair finds it."""
    old = (vault / "db/catalogue.sqlite").read_bytes()
    archive.build(vault / "raw", vault / "db", archive.Options("liu2006", {"max_error": 0.01}), prefix="later/")
    expected = contents(vault / "db")
    (vault / "db/catalogue.sqlite").write_bytes(old)
    archive.build(vault / "raw", vault / "db", archive.Options("liu2006", {"max_error": 0.02}), prefix="last/")
    expected |= contents(vault / "db")
    assert archive.repair(vault / "db").failed == []
    assert contents(vault / "db") == expected
    assert len(expected) == 12


@pytest.mark.parametrize(
    "change", ["UPDATE shards SET bytes = 5", "DELETE FROM shards", "UPDATE shards SET bytes = 'x'"]
)
def test_a_wrong_table_of_shards_costs_no_recordings(vault: Path, change: str) -> None:
    before = contents(vault / "db")
    with sqlite3.connect(vault / "db/catalogue.sqlite") as connection:
        connection.execute(change)
    connection.close()
    with pytest.raises(mc.Corrupt, match="archive repair"):
        archive.build(vault / "raw", vault / "db", prefix="more/")
    assert contents(vault / "db") == before
    assert len(archive.repair(vault / "db").added) == 4
    assert contents(vault / "db") == before


def test_a_short_shard_is_not_appended_to(vault: Path) -> None:
    shard = vault / "db/shards/000001.mocs"
    os.truncate(shard, shard.stat().st_size - 10)
    archive.build(vault / "raw", vault / "db", archive.Options("liu2006", {"max_error": 0.01}), prefix="more/")
    with mc.open_archive(vault / "db") as db:
        assert [name for name, _ in archive.damage(db)] == ["08/FastWalk_02"]


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_a_shard_that_is_a_link_is_not_written_to(vault: Path) -> None:
    shard, elsewhere = vault / "db/shards/000001.mocs", vault / "elsewhere"
    shard.rename(elsewhere)
    shard.symlink_to(elsewhere)
    before = elsewhere.read_bytes()
    with pytest.raises(mc.Corrupt, match="a shard must be a file, not a link"):
        archive.build(vault / "raw", vault / "db", prefix="more/")
    assert elsewhere.read_bytes() == before
    assert [name for name, _ in archive.repair(vault / "db").failed] == ["000001.mocs"]


def test_two_builders_at_once(vault: Path) -> None:
    with only_builder(vault / "db"):
        with pytest.raises(mc.BadInput, match="another process is changing this archive"):
            archive.build(vault / "raw", vault / "db")
        with pytest.raises(mc.BadInput, match="another process"):
            archive.remove(vault / "db", ["07/FastWalk_01"])
        assert len(contents(vault / "db")) == 4  # readers are not disturbed
    assert len(archive.build(vault / "raw", vault / "db").unchanged) == 4


def test_a_full_disk_loses_nothing(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    append, calls = shards.Appender.append, []

    def full(self: shards.Appender, name: str, blob: bytes) -> shards.Place:
        calls.append(name)
        if len(calls) == 3:
            assert self.file is not None
            self.file.write(blob[:50])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        place = append(self, name, blob)
        return place

    monkeypatch.setattr(shards.Appender, "append", full)
    monkeypatch.setattr("mocodec.archive.building.COMMIT_SECONDS", 0.0)
    with pytest.raises(mc.BadInput, match=r"No space left on device.*goes on from there"):
        archive.build(made / "raw", tmp_path / "db", OPTIONS)
    assert len(contents(tmp_path / "db")) == 2
    report = archive.build(made / "raw", tmp_path / "db", OPTIONS)
    assert (len(report.unchanged), len(report.added)) == (2, 2)
    assert contents(tmp_path / "db") == contents(made / "db")


def test_a_full_disk_in_the_catalogue(vault: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put, calls = Catalogue.put, []

    def full(self: Catalogue, row: archive.Row) -> None:
        calls.append(row)
        if len(calls) == 2:
            raise sqlite3.OperationalError("database or disk is full")
        put(self, row)

    before = contents(vault / "db")
    monkeypatch.setattr(Catalogue, "put", full)
    with pytest.raises(mc.BadInput, match="full"):
        archive.build(vault / "raw", vault / "db", prefix="more/")
    assert contents(vault / "db") == before
    assert len(archive.build(vault / "raw", vault / "db", prefix="more/").added) == 4


def test_unreadable_sources_are_listed_and_tried_again(tmp_path: Path) -> None:
    write_sources(tmp_path / "raw", 1, 2)
    bad = tmp_path / "raw/07/broken.c3d"
    bad.write_bytes(b"no C3D at all")
    report = archive.build(tmp_path / "raw", tmp_path / "db", OPTIONS)
    assert len(report.added) == 2
    assert [path for path, _ in report.failed] == ["07/broken.c3d"]
    with mc.open_archive(tmp_path / "db") as db:
        assert [path for path, _ in db.failures] == ["07/broken.c3d"]
    bad.write_bytes((tmp_path / "raw/07/FastWalk_01.npz").read_bytes())
    bad.rename(tmp_path / "raw/07/mended.npz")
    report = archive.build(tmp_path / "raw", tmp_path / "db")
    assert report.added == ["07/mended"]


def test_a_later_version_says_so(vault: Path) -> None:
    connection = sqlite3.connect(vault / "db/catalogue.sqlite")
    connection.execute("PRAGMA user_version = 3")
    connection.close()
    for call in (lambda: mc.open_archive(vault / "db"), lambda: archive.build(vault / "raw", vault / "db")):
        with pytest.raises(mc.TooNew, match=r"version 3.*upgrade"):
            call()


def test_another_database_is_not_written_to(tmp_path: Path) -> None:
    connection = sqlite3.connect(tmp_path / "catalogue.sqlite")
    connection.execute("CREATE TABLE photos (name TEXT)")
    connection.close()
    before = (tmp_path / "catalogue.sqlite").read_bytes()
    with pytest.raises(mc.Corrupt, match="not the catalogue of an archive"):
        mc.open_archive(tmp_path)
    assert (tmp_path / "catalogue.sqlite").read_bytes() == before


def test_a_folder_of_other_things_is_refused(tmp_path: Path, made: Path) -> None:
    (tmp_path / "holiday.jpg").write_bytes(b"")
    with pytest.raises(mc.BadInput, match="holds other things"):
        archive.build(made / "raw", tmp_path, OPTIONS)


def test_a_damaged_shard_costs_its_own_clips(vault: Path) -> None:
    with mc.open_archive(vault / "db") as db:
        place = db.entry("07/FastWalk_02").place
    damaged = bytearray(Path(place.path).read_bytes())
    damaged[place.start + place.size - 40] ^= 1
    Path(place.path).write_bytes(damaged)
    with mc.open_archive(vault / "db") as db:
        assert [name for name, _ in archive.damage(db)] == ["07/FastWalk_02"]
        assert len(db["07/FastWalk_01"][:]) == 60
        with pytest.raises(mc.Corrupt, match="07/FastWalk_02"):
            db["07/FastWalk_02"][:]


def test_a_truncated_or_missing_shard_names_its_clips(vault: Path) -> None:
    with mc.open_archive(vault / "db") as db:
        place = db.entry("08/FastWalk_01").place
        os.truncate(place.path, place.start + 10)
        assert [name for name, _ in archive.damage(db)] == ["08/FastWalk_01", "08/FastWalk_02"]
        Path(place.path).unlink()
        assert len(list(archive.damage(db))) == 4


def test_a_damaged_catalogue_is_repaired_from_the_shards(vault: Path) -> None:
    before = contents(vault / "db")
    catalogue = vault / "db/catalogue.sqlite"
    catalogue.write_bytes(b"\0" * 100 + catalogue.read_bytes()[100:])
    with pytest.raises(mc.Corrupt, match="archive repair"):
        mc.open_archive(vault / "db")
    report = archive.repair(vault / "db")
    assert len(report.added) == 4
    assert contents(vault / "db") == before
    with mc.open_archive(vault / "db") as db:
        assert len(db.query("subject == 7 and 'walk' in labels")) == 2
    report = archive.build(vault / "raw", vault / "db", OPTIONS)  # errors are measured again, bytes are known
    assert len(report.replaced) == 4
    assert (vault / "db/catalogue.damaged").exists()
    with mc.open_archive(vault / "db") as db:
        assert archive.unused_bytes(db) == 0


@pytest.mark.parametrize("left", [None, b""])
def test_a_lost_catalogue_does_not_cost_the_shards(vault: Path, left: bytes | None) -> None:
    before = contents(vault / "db")
    (vault / "db/catalogue.sqlite").unlink()
    if left is not None:
        (vault / "db/catalogue.sqlite").write_bytes(left)
    with pytest.raises(mc.Corrupt, match="archive repair"):
        archive.build(vault / "raw", vault / "db", OPTIONS)
    assert len(archive.repair(vault / "db").added) == 4
    assert contents(vault / "db") == before


def test_an_error_of_sqlite_that_is_no_utf_8(vault: Path) -> None:
    """SQLite quotes the name of a damaged table."""
    catalogue = vault / "db/catalogue.sqlite"
    catalogue.write_bytes(catalogue.read_bytes().replace(b"CREATE TABLE recordings", b"CREATE TABL\xff recordings"))
    with pytest.raises(mc.Corrupt, match="archive repair"):
        mc.open_archive(vault / "db")


def test_a_lock_that_is_another_file(vault: Path) -> None:
    (vault / "db/building.lock").write_bytes(b"notes of somebody, which are no database" * 30)
    with pytest.raises(mc.BadInput, match=r"building\.lock: this is no lock"):
        archive.build(vault / "raw", vault / "db", OPTIONS)


def test_options_that_no_codec_has(made: Path, tmp_path: Path) -> None:
    with pytest.raises(mc.BadInput, match="no setting 'colour'"):
        archive.build(made / "raw", tmp_path / "db", archive.Options(settings={"colour": 1}))
    assert not (tmp_path / "db").exists()


def test_a_dead_worker_costs_its_own_task(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "get_context", multiprocessing.get_context)  # workers as users have them
    deadly, wrong = "__import__('os')._exit(1)", "1 / 0"
    tasks = ["1", "2", deadly, "4", wrong, "6", "7"]
    found = dict(pool.results(eval, tasks, lambda reason: reason, workers=2))
    assert found.pop(deadly) == "its process ended unexpectedly; memory may not suffice"
    assert found.pop(wrong) == "ZeroDivisionError: division by zero"
    assert found == {task: int(task) for task in ("1", "2", "4", "6", "7")}


@pytest.mark.parametrize(
    "change",
    [
        "shard = '../../elsewhere'", "shard = 0", "shard = -1", "start = -5", "start = 'x'", "bytes = 1 << 62",
        "frames = 'many'", "frames = -1", "rate = 9e999", "rate = 0", "rate = NULL", "seconds = 9e999",
        "labels = 3 || char(0)", "labels = NULL", "path = CAST(x'ff' AS TEXT)", "kind = 'film'", "prior = '../x'",
        "mean_error = 9e999", "ratio = 'x'", "side_bytes = bytes + 1", "content = x'00'", "frames = 59", "rate = 61",
        "points = points + 1", "codec = 'raw'", "points = x'00'",
    ],
)  # fmt: skip
def test_a_wrong_row_is_damaged_and_the_others_are_not(vault: Path, change: str) -> None:
    with sqlite3.connect(vault / "db/catalogue.sqlite") as connection:
        connection.execute(f"UPDATE recordings SET {change} WHERE name = '07/FastWalk_01'")
    connection.close()
    with mc.open_archive(vault / "db") as db:
        assert [name for name, _ in archive.damage(db)] == ["07/FastWalk_01"]
        if change not in ("frames = 59", "rate = 61", "points = points + 1", "codec = 'raw'"):
            with pytest.raises(mc.Corrupt, match=r"catalogue is damaged \(wrong .* of recording 07/FastWalk_01"):
                list(db)
            with pytest.raises(mc.Corrupt, match="catalogue is damaged"):
                db["07/FastWalk_01"]
        assert len(db["08/FastWalk_01"]) == 60


@pytest.mark.parametrize("column", ["frames", "seconds", "bytes", "max_error"])
def test_sums_of_what_is_no_number(vault: Path, column: str) -> None:
    with sqlite3.connect(vault / "db/catalogue.sqlite") as connection:
        connection.execute(f"UPDATE recordings SET {column} = 9e999 WHERE name = '07/FastWalk_01'")
    connection.close()
    with mc.open_archive(vault / "db") as db:
        with pytest.raises(mc.Corrupt, match="catalogue is damaged"):
            db.sums()
        assert db.query("subject == 8").sums()["recordings"] == 2
        assert db.query("subject == 99").sums()["recordings"] == 0


@pytest.mark.parametrize(
    "change",
    [
        ("ALTER TABLE recordings RENAME TO r", "CREATE VIEW recordings AS SELECT * FROM r"),
        ("DROP TABLE shards",),
        ("CREATE TRIGGER t AFTER DELETE ON recordings BEGIN DELETE FROM shards; END",),
    ],
)
def test_tables_that_are_none(vault: Path, change: tuple[str, ...]) -> None:
    with sqlite3.connect(vault / "db/catalogue.sqlite") as connection:
        for statement in change:
            connection.execute(statement)
    connection.close()
    with pytest.raises(mc.Corrupt, match="archive repair"):
        mc.open_archive(vault / "db")
    assert len(archive.repair(vault / "db").added) == 4


def test_a_repair_of_a_sound_catalogue_keeps_errors_and_sources(vault: Path) -> None:
    with mc.open_archive(vault / "db") as db:
        before = list(db.rows())
    assert all(row.max_error for row in before)
    assert len(archive.repair(vault / "db").added) == 4
    with mc.open_archive(vault / "db") as db:
        assert list(db.rows()) == before
    assert len(archive.build(vault / "raw", vault / "db", OPTIONS).unchanged) == 4


@pytest.mark.parametrize("text", ["{", "5", '{"colour": 1}', None])
def test_options_that_are_none(vault: Path, text: str | None) -> None:
    with sqlite3.connect(vault / "db/catalogue.sqlite") as connection:
        connection.execute("UPDATE options SET text = ?", [text])
    connection.close()
    with pytest.raises(mc.Corrupt, match="its options 1"):
        archive.build(vault / "raw", vault / "db", prefix="more/")


@pytest.mark.parametrize("content", [None, b"no prior"])
def test_a_lost_prior_costs_its_own_recordings_in_a_merge(vault: Path, content: bytes | None) -> None:
    with sqlite3.connect(vault / "db/catalogue.sqlite") as connection:
        connection.execute("UPDATE recordings SET prior = 'ab12' WHERE name = '07/FastWalk_01'")
    connection.close()
    if content is not None:
        (vault / "db/priors").mkdir()
        (vault / "db/priors/ab12.prior").write_bytes(content)
    report = archive.merge([vault / "db"], vault / "merged")
    assert len(report.added) == 3
    [(name, reason)] = report.failed
    assert name == "07/FastWalk_01"
    assert "its prior ab12 cannot be read" in reason
