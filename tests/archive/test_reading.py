"""Recordings of an archive by name and by condition."""

from __future__ import annotations

import multiprocessing
import os
import pickle
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec.archive.expressions import to_sql

from .conftest import FRAMES


def test_recordings_by_name(made: Path) -> None:
    with mc.open_archive(made / "db") as db:
        assert db.names == ["07/FastWalk_01", "07/FastWalk_02", "08/FastWalk_01", "08/FastWalk_02"]
        assert len(db) == 4
        motion = mc.read(made / "raw/07/FastWalk_02.npz", mc.Motion)
        part = db["07/FastWalk_02"][10:50]
        error = np.linalg.norm(part.positions - motion.positions[10:50], axis=2)
        assert error.max() <= 0.005
        assert "07/FastWalk_02" in db
        assert "nobody" not in db
        with pytest.raises(mc.BadInput, match="no recording named nobody"):
            db["nobody"]
        with pytest.raises(mc.BadInput, match="2 recordings named FastWalk_01: 07/FastWalk_01, 08/FastWalk_01"):
            db["FastWalk_01"]
        assert len(db.query("subject == 7")["FastWalk_01"]) == FRAMES


def test_rows_tell_what_was_measured(made: Path) -> None:
    with mc.open_archive(made / "db") as db:
        row = db.entry("08/FastWalk_02").row
        assert (row.subject, row.trial, row.labels) == (8, 2, " fast walk ")
        assert (row.frames, row.rate, row.kind, row.codec) == (FRAMES + 30, 60.0, "motion", "liu2006")
        assert row.seconds == row.frames / 60
        assert row.mean_error is not None
        assert 0 < row.mean_error < (row.max_error or 0) <= 0.005
        assert row.raw_bytes == row.frames * row.points * 12
        assert row.ratio == row.raw_bytes / (row.bytes - row.side_bytes)
        entry = db.entry("08/FastWalk_02")
        assert entry.seconds == row.seconds
        assert len(entry.read()) == row.bytes
        with pytest.raises(AttributeError, match="no 'nothing'"):
            _ = entry.nothing


@pytest.mark.parametrize(
    ("condition", "count"),
    [
        ("subject == 7", 2),
        ("subject == 7 and frames > 70", 1),
        ("not subject == 7", 2),
        ("subject in (7, 9) or trial in [2]", 3),
        ("'walk' in labels", 4),
        ("'wal' in labels", 0),
        ("'08/' in name", 2),
        ("like(name, '07/*')", 2),
        ("60 <= frames < 90", 2),
        ("frames / rate > 1.2", 2),
        ("max_error is not None", 4),
        ("prior == None", 0),
        ("subject not in (7,)", 2),
        ("frames == -(-60)", 2),
    ],
)
def test_queries(made: Path, condition: str, count: int) -> None:
    with mc.open_archive(made / "db") as db:
        found = db.query(condition)
        assert len(found) == count == len(list(found)) == len(found.names)


@pytest.mark.parametrize(
    "condition",
    [
        "__import__('os').system('true')",
        "subject == 1; DROP TABLE recordings",
        "nobody == 1",
        "name.upper() == 'A'",
        "(lambda: 1)()",
        "[x for x in name]",
        "like(name)",
        "subject ==",
        "1 in labels",
        f"frames == {10**40}",
        "(" * 3000 + ")" * 3000,
        "frames == 1" + " or frames == 1" * 1000,
        "-" * 2000 + "1",
        "f'{name}'",
    ],
)
def test_what_is_no_condition_is_refused(made: Path, condition: str) -> None:
    with mc.open_archive(made / "db") as db, pytest.raises(mc.BadInput):
        len(db.query(condition))


def test_constants_never_become_sql() -> None:
    assert to_sql("""name == "x' OR 1 --" """, ["name"]) == ('("name" = ?)', ["x' OR 1 --"])


def test_handles_are_pickled_and_opened_again(made: Path) -> None:
    with mc.open_archive(made / "db") as db:
        assert len(pickle.loads(pickle.dumps(db))) == 4
        assert pickle.loads(pickle.dumps(db.query("subject == 8"))).names == ["08/FastWalk_01", "08/FastWalk_02"]
        file = pickle.loads(pickle.dumps(db["07/FastWalk_01"]))
        np.testing.assert_array_equal(file[3].positions, db["07/FastWalk_01"][3].positions)
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as processes:
            assert processes.submit(len, db).result(60) == 4


def test_sums(made: Path) -> None:
    with mc.open_archive(made / "db") as db:
        sums = db.sums()
        rows = list(db.rows())
        assert sums["recordings"] == 4
        assert sums["frames"] == sum(row.frames for row in rows)
        weights = [row.raw_bytes for row in rows]
        assert sums["mean_error"] == pytest.approx(np.average([row.mean_error or 0 for row in rows], weights=weights))
        assert "4 recordings" in repr(db)


def test_no_archive_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(mc.BadInput, match="there is no archive here"):
        mc.open_archive(tmp_path)


@pytest.mark.skipif(os.name == "nt", reason="Windows reports a folder as a file that may not be read")
def test_a_folder_is_no_file(made: Path) -> None:
    with pytest.raises(mc.BadInput, match="open_archive"):
        mc.open(made / "db")
