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
from mocodec.archive.catalogue import NAME
from mocodec.archive.encoding import prior_path
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
