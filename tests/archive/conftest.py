"""A small archive of synthetic motion, made once."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import pytest

import mocodec as mc
from mocodec import archive
from mocodec.testing import synthetic

FRAMES = 60


def write_sources(folder: Path, people: int = 2, trials: int = 2) -> None:
    """One folder a person with NPZ files of walks: "07/FastWalk_01.npz", …"""
    for person in range(people):
        for trial in range(trials):
            path = folder / f"{person + 7:02}" / f"FastWalk_{trial + 1:02}.npz"
            path.parent.mkdir(parents=True, exist_ok=True)
            motion = synthetic.joints(frames=FRAMES + 30 * trial, rate=60.0, seed=10 * person + trial)
            mc.write(path, motion)


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `raw`, the sources, and `db`, an archive of them."""
    folder = tmp_path_factory.mktemp("archive")
    write_sources(folder / "raw")
    report = archive.build(folder / "raw", folder / "db", archive.Options("liu2006", {"max_error": 0.005}))
    assert len(report.added) == 4
    return folder


@pytest.fixture
def vault(made: Path, tmp_path: Path) -> Path:
    """A copy of `made` that a test may change, as if it had been built there."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    with sqlite3.connect(tmp_path / "db/catalogue.sqlite") as connection:
        connection.execute("UPDATE recordings SET origin = replace(origin, ?, ?)", [str(made), str(tmp_path)])
    connection.close()
    return tmp_path
