"""Shards: recordings that share their heads, and archives of version 1."""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import pytest

import mocodec as mc
from mocodec import archive, data
from mocodec.archive import encoding, shards
from mocodec.container import compact
from mocodec.testing import synthetic

from .conftest import write_sources
from .test_trouble import contents

VERSION_1 = Path(__file__).parent / "version_1"
HASHES = {
    "07/walk_01": "5ae2a126785e48ee3d583bdcaf3d75d9ef775f1c1b0c46a8278e7f5b87a000aa",
    "07/walk_02": "7955c50331a725dfcf6c900ec61eae75af1b2b31cabda8496fab4e50c5217aea",
}


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A copy of an archive of version 1."""
    return Path(shutil.copytree(VERSION_1, tmp_path / "old"))


def hashes(folder: Path) -> dict[str, str]:
    return {name: hashlib.sha256(blob).hexdigest() for name, blob in contents(folder).items()}


def test_recordings_share_their_head(tmp_path: Path) -> None:
    motion = mc.decode(data.RECORDING, mc.Motion)
    for number in range(4):
        mc.write(tmp_path / f"{number}.npz", motion[120 * number : 120 * number + 40])
    archive.build(tmp_path, tmp_path / "db", archive.Options(targets={"max_error": 0.01}, bare=True))
    with mc.open_archive(tmp_path / "db") as db:
        (block,), sums = db.catalogue.blocks(1), db.sums()
        assert [entry.row.block for entry in db] == [1] * 4
        assert sums["stored_bytes"] < sums["bytes"] - 2 * len(block)
        for entry in db:
            assert len(entry.read()) == entry.row.bytes
            assert entry.place.size == entry.row.stored_bytes < entry.row.bytes - len(block)
    again: list[bytes] = []
    found = list(shards.entries(tmp_path / "db/shards/000001.mocs", again))
    assert again == [block]
    assert {one.name: encoding.bytes_of(one.bytes) for one in found} == contents(tmp_path / "db")


def test_a_long_recording_stays_whole(tmp_path: Path) -> None:
    motion = synthetic.joints(frames=2000, rate=60.0)
    mc.write(tmp_path / "raw/long.npz" if (tmp_path / "raw").mkdir() is None else "", motion)
    archive.build(tmp_path / "raw", tmp_path / "db", archive.Options("lossless"))
    with mc.open_archive(tmp_path / "db") as db:
        entry = db.entry("long")
        assert entry.row.bytes > compact.MOST_BYTES
        assert (entry.row.block, entry.row.stored_bytes) == (0, entry.row.bytes)
        assert len(db["long"][5:9]) == 4


def test_a_head_that_differs_a_little_needs_no_block(tmp_path: Path) -> None:
    motion = synthetic.joints(frames=40, rate=60.0)
    blobs = []
    for first in (1, 7, 1000):
        blobs.append(mc.encode(replace(motion, source={"first_frame": first}), max_error=0.01))
    blocks: dict[int, list[bytes]] = {}
    appender = shards.Appender(tmp_path, {}, blocks)
    places = [appender.append(f"{n}", blob) for n, blob in enumerate(blobs)]
    appender.close()
    assert len(blocks[1]) == 1
    assert [place.block for place in places] == [1, 1, 1]
    found = list(shards.entries(tmp_path / "shards/000001.mocs", []))
    assert [one.place for one in found] == places
    assert [len(mc.open(one.bytes)) for one in found] == [40] * 3


def test_a_wrong_block_damages_its_recordings(vault: Path) -> None:
    expected = contents(vault / "db")
    for change in (
        "UPDATE blocks SET bytes = bytes || x'00'",
        "UPDATE blocks SET number = number + 9",
        "DELETE FROM blocks",
    ):
        with sqlite3.connect(vault / "db/catalogue.sqlite") as connection:
            connection.execute(change)
        connection.close()
        with mc.open_archive(vault / "db") as db:
            assert len(list(archive.damage(db))) == 4
            with pytest.raises(mc.Corrupt):
                db["07/FastWalk_01"]
        archive.repair(vault / "db")
        assert contents(vault / "db") == expected


def test_an_archive_of_version_1_is_read(old: Path) -> None:
    assert hashes(old) == HASHES
    with mc.open_archive(old) as db:
        assert list(archive.damage(db, decode=True)) == []
        assert len(db.query("seconds > 0.7 and stored_bytes > 0")["07/walk_02"][10:20]) == 10
        assert db.sums()["stored_bytes"] == db.sums()["bytes"]
        assert archive.unused_bytes(db) == 0


def test_an_archive_of_version_1_is_continued_in_another_shard(old: Path, tmp_path: Path) -> None:
    before = (old / "shards/000001.mocs").read_bytes()
    write_sources(tmp_path / "raw", 1, 2)
    assert len(archive.build(tmp_path / "raw", old).added) == 2
    assert (old / "shards/000001.mocs").read_bytes() == before
    assert hashes(old).items() > HASHES.items()
    with mc.open_archive(old) as db:
        assert list(archive.damage(db)) == []
        assert archive.unused_bytes(db) == 0
    expected = contents(old)
    assert len(archive.repair(old).added) == 4
    assert contents(old) == expected
    archive.merge([old], tmp_path / "new")
    assert contents(tmp_path / "new") == expected


def test_a_recording_of_version_1_can_be_removed(old: Path) -> None:
    archive.remove(old, ["walk_01"])
    assert list(contents(old)) == ["07/walk_02"]


@pytest.mark.parametrize("value", ["zeroblob(65537)", "NULL", "'text'", "7"])
def test_a_block_that_is_no_head_damages_the_catalogue(vault: Path, value: str) -> None:
    with sqlite3.connect(vault / "db/catalogue.sqlite") as connection:
        connection.execute(f"UPDATE blocks SET bytes = {value} WHERE number = 0")
    connection.close()
    with mc.open_archive(vault / "db") as db, pytest.raises(mc.Corrupt, match="blocks of shard 1"):
        db["07/FastWalk_01"]
    archive.repair(vault / "db")
    with mc.open_archive(vault / "db") as db:
        assert len(db["07/FastWalk_01"]) == 60
