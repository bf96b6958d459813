"""Archives on a web server and in a store of fsspec."""

from __future__ import annotations

import pickle
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import archive
from mocodec.archive import similarity
from mocodec.archive.catalogue import NAME
from mocodec.archive.encoding import prior_path
from mocodec.testing import synthetic
from tests.container.web_server import NGINX, serving


def same_as(local: mc.Archive, remote: mc.Archive) -> None:
    assert remote.names == local.names
    for name in local.names:
        with local[name] as here, remote[name] as there:
            np.testing.assert_array_equal(there[10:20].positions, here[10:20].positions)
    assert remote.query("seconds > 1").names == local.query("seconds > 1").names


@pytest.mark.skipif(NGINX is None, reason="nginx is not installed")
def test_an_archive_on_a_web_server(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "db", tmp_path / "root" / "db")
    (tmp_path / "nginx").mkdir()
    with (
        serving(tmp_path / "root", tmp_path / "nginx") as web,
        mc.open_archive(made / "db") as local,
        mc.open_archive(f"{web.url}/db/") as remote,
    ):
        assert len(web.requests()) <= 2
        same_as(local, remote)
        assert len(web.requests()) == len(local)
        with pickle.loads(pickle.dumps(remote)) as again:
            assert again.names == local.names
        with pytest.raises(mc.BadInput, match="no archive here"):
            mc.open_archive(f"{web.url}/other")


def test_an_archive_in_a_store(made: Path) -> None:
    fsspec: Any = pytest.importorskip("fsspec", reason="needs the [remote] extra")
    files = fsspec.filesystem("memory")
    files.put(str(made / "db"), "/mocodec-db", recursive=True)
    with mc.open_archive(made / "db") as local, mc.open_archive("memory://mocodec-db") as remote:
        same_as(local, remote)
        copy = remote._folder()
        assert (copy / NAME).is_file()
    del remote
    assert not copy.exists()
    files.rm("/mocodec-db", recursive=True)


def test_priors_come_with_the_catalogue(vault: Path) -> None:
    fsspec: Any = pytest.importorskip("fsspec", reason="needs the [remote] extra")
    with sqlite3.connect(vault / "db" / NAME) as connection:
        connection.execute("UPDATE recordings SET prior = 'ab12' WHERE stem = 'FastWalk_01'")
    connection.close()
    there = prior_path(vault / "db", "ab12")
    there.parent.mkdir()
    there.write_bytes(b"learned")
    files = fsspec.filesystem("memory")
    files.put(str(vault / "db"), "/mocodec-db", recursive=True)
    with mc.open_archive("memory://mocodec-db") as vault_there:
        copy = vault_there._folder()
    assert prior_path(copy, "ab12").read_bytes() == b"learned"  # also after closing: open recordings need it
    files.rm("/mocodec-db/priors", recursive=True)
    with pytest.raises(mc.BadInput, match="ab12"):
        mc.open_archive("memory://mocodec-db")
    files.rm("/mocodec-db", recursive=True)


def test_a_catalogue_that_is_none(tmp_path: Path) -> None:
    fsspec: Any = pytest.importorskip("fsspec", reason="needs the [remote] extra")
    files = fsspec.filesystem("memory")
    files.pipe_file(f"/mocodec-db/{NAME}", b"<html>not found</html>")
    with pytest.raises(mc.Corrupt):
        mc.open_archive("memory://mocodec-db")
    files.rm("/mocodec-db", recursive=True)


def test_changes_and_searches_need_a_local_archive(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    url = "http://127.0.0.1:1/db"
    for change in (
        lambda: archive.build(made / "raw", url),
        lambda: archive.remove(url, ["a"]),
        lambda: archive.merge([made / "db"], url),
        lambda: archive.repair(url),
        lambda: archive.index(url),
    ):
        with pytest.raises(mc.BadInput, match="needs the archive on this machine"):
            change()
    assert list(tmp_path.iterdir()) == []


def similar_clips(folder: Path) -> Path:
    """An archive of three clips of two people, with its index, and one of other points."""
    for seed in range(3):
        mc.write(folder / f"walk_{seed}.npz", synthetic.joints(frames=180, rate=60.0, seed=seed))
    mc.write(folder / "other.npz", synthetic.joints(frames=180, rate=60.0, seed=9).select(["Hips", "Head"]))
    (folder / "again.npz").write_bytes((folder / "walk_1.npz").read_bytes())
    archive.build(folder, folder / "db", archive.Options("liu2006", {"max_error": 0.005}))
    archive.index(folder / "db")
    return folder / "db"


def test_a_search_in_a_store_fetches_one_index(tmp_path: Path) -> None:
    fsspec: Any = pytest.importorskip("fsspec", reason="needs the [remote] extra")
    folder = similar_clips(tmp_path)
    files = fsspec.filesystem("memory")
    files.put(str(folder), "/mocodec-db", recursive=True)
    with mc.open_archive(folder) as local, mc.open_archive("memory://mocodec-db") as remote:
        query = local["walk_1"][:]
        assert archive.search(remote, query) == archive.search(local, query)
        assert len(list((remote._folder() / similarity.FOLDER).iterdir())) == 1
        assert archive.duplicates(remote) == archive.duplicates(local)
        with pytest.raises(mc.BadInput, match="no index of recordings with the points of the query"):
            archive.search(remote, query.select(["Hips"]))
    files.rm("/mocodec-db", recursive=True)


@pytest.mark.skipif(NGINX is None, reason="nginx is not installed")
def test_a_search_on_a_web_server(tmp_path: Path) -> None:
    folder = similar_clips(tmp_path)
    shutil.copytree(folder, tmp_path / "root" / "db")
    (tmp_path / "nginx").mkdir()
    with serving(tmp_path / "root", tmp_path / "nginx") as web, mc.open_archive(f"{web.url}/db") as remote:
        opening = len(web.requests())
        with mc.open_archive(folder) as local:
            query = local["walk_1"][:]
            expected = archive.search(local, query)
        assert archive.search(remote, query) == expected
        assert archive.search(remote, query) == expected
        assert len(web.requests()) - opening <= 2
