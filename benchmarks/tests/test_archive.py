"""Measurements of archives, on a small archive of synthetic motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from benchmarks.archive import large, retrieval, tables, windows
from mocodec import archive, learning
from mocodec.testing import synthetic


@pytest.fixture(scope="module")
def vault(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("vault")
    for i, stem in enumerate(("16/16_01", "16/16_02", "64/64_01", "64/64_02", "118/118_01")):
        path = folder / f"raw/{stem}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        mc.write(path, synthetic.joints(frames=320, seed=i))
    archive.build(folder / "raw", folder / "db", archive.Options("liu2006", {"max_error": 0.005}))
    archive.index(folder / "db")
    return folder / "db"


def test_catalogues_have_the_rows_that_they_should(vault: Path, tmp_path: Path) -> None:
    rows = list(large.varied_rows(vault, count=90))
    assert len({row.name for row in rows}) == 90
    assert large.filled(tmp_path, iter(rows)) == 90
    with mc.open_archive(tmp_path) as db:
        assert [row.name for row in db.rows()] == sorted(row.name for row in rows)
    pytest.importorskip("pyarrow", reason="Parquet needs pyarrow")
    found = large.catalogues(vault, tmp_path, 50)
    assert found["rows"] == 50
    assert min(found.values()) > 0


def test_windows_are_the_same_from_every_source(vault: Path, tmp_path: Path) -> None:
    windows.plain(vault, tmp_path)
    places = windows.windows_of_all(vault)
    from_archive = learning.WindowSet(vault, windows.FRAMES, windows.STRIDE)
    assert len(places) == len(from_archive)
    for number in (0, 7, len(places) - 1):
        expected = from_archive[number]["positions"]
        np.testing.assert_allclose(windows.from_npy(tmp_path, *places[number]), expected, atol=1e-6)
        np.testing.assert_allclose(windows.from_npz(tmp_path, *places[number]), expected, atol=1e-6)


def test_retrieval_and_its_table(vault: Path, tmp_path: Path) -> None:
    assert retrieval.label("118_01", 118) == "jump"
    found = retrieval.measure(vault)
    assert {(row["method"], row["other_subjects"]) for row in found} == {
        (method, others) for method in ("index", "raw joints") for others in (False, True)
    }
    written = tables.write({"retrieval": found, "machine": {}}, tmp_path)
    assert [path.name for path in written] == ["archive_retrieval.md"]
    assert "raw joints" in written[0].read_text()
