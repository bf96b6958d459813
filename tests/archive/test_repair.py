"""Damage of single bytes of a shard: what verify names, what extract gives, and what repair keeps and drops."""

from __future__ import annotations

from pathlib import Path

import pytest

import mocodec as mc
from mocodec import archive
from mocodec.archive import shards

from .test_trouble import contents

LAST = "08/FastWalk_02"


def flip(vault: Path, at: int) -> None:
    """Change one byte of the first shard."""
    path = vault / "db/shards/000001.mocs"
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


def damaged(vault: Path) -> list[str]:
    """The names that verify lists."""
    with mc.open_archive(vault / "db") as db:
        return [name for name, _ in archive.damage(db)]


def place(vault: Path, name: str) -> tuple[int, int]:
    """First byte and length of a recording's content."""
    with mc.open_archive(vault / "db") as db:
        row = db.entry(name).row
    return row.start, row.stored_bytes


def test_a_damaged_recording_is_named_and_dropped(vault: Path) -> None:
    name = "07/FastWalk_02"
    start, size = place(vault, name)
    expected = contents(vault / "db")
    flip(vault, start + size // 2)
    assert damaged(vault) == [name]
    report = archive.repair(vault / "db")
    assert [failed for failed, _ in report.failed] == [name]
    del expected[name]
    assert contents(vault / "db") == expected
    assert damaged(vault) == []
    assert archive.build(vault / "raw", vault / "db").added == [name]


def test_a_damaged_block_is_taken_from_the_catalogue(vault: Path) -> None:
    expected = contents(vault / "db")
    with mc.open_archive(vault / "db") as db:
        assert db.entry(LAST).row.block > 0
        rows = list(db.rows())
    flip(vault, len(shards.HEAD) + 20)
    assert damaged(vault) == []
    report = archive.repair(vault / "db")
    assert report.failed == []
    assert sorted(report.added) == sorted(expected)
    assert contents(vault / "db") == expected
    with mc.open_archive(vault / "db") as db:
        assert list(db.rows()) == rows
    (vault / "db/catalogue.sqlite").unlink()  # without its copy of the block, what needs it is lost, and named
    report = archive.repair(vault / "db")
    assert sorted([*report.added, *(name for name, _ in report.failed)]) == sorted(expected)
    assert report.failed


def test_recordings_behind_a_damaged_head_are_taken_from_the_catalogue(vault: Path) -> None:
    expected = contents(vault / "db")
    start, _ = place(vault, "07/FastWalk_02")
    flip(vault, start - 1)
    assert damaged(vault) == []
    for _ in range(2):  # the new catalogue serves as well as the old one
        report = archive.repair(vault / "db")
        assert [name for name, _ in report.failed] == ["000001.mocs"]
        assert contents(vault / "db") == expected
    assert len(archive.build(vault / "raw", vault / "db").unchanged) == 4
    assert archive.merge([vault / "db"], vault / "new").failed == []
    assert archive.repair(vault / "new").failed == []


def test_recordings_of_one_content_keep_their_names(vault: Path) -> None:
    (vault / "raw/copy.npz").write_bytes((vault / "raw/07/FastWalk_01.npz").read_bytes())
    archive.build(vault / "raw", vault / "db")
    expected = contents(vault / "db")
    assert len(expected) == 5
    assert place(vault, "copy") == place(vault, "07/FastWalk_01")
    archive.repair(vault / "db")
    assert contents(vault / "db") == expected


def test_a_missing_shard_is_named_with_its_recordings(vault: Path) -> None:
    names = sorted(contents(vault / "db"))
    (vault / "db/shards/000001.mocs").unlink()
    report = archive.repair(vault / "db")
    assert sorted(name for name, _ in report.failed) == names
    assert all("000001.mocs is missing" in reason for _, reason in report.failed)


def test_a_removed_recording_comes_back_until_a_merge(vault: Path) -> None:
    archive.remove(vault / "db", [LAST])
    archive.merge([vault / "db"], vault / "new")
    assert LAST in archive.repair(vault / "db").added
    assert LAST not in archive.repair(vault / "new").added
    with pytest.raises(mc.BadInput, match="no recording"):
        mc.open_archive(vault / "new").entry(LAST)
