"""An archive in the viewer: its list, conditions, and recordings."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from urllib.error import HTTPError
from urllib.parse import quote
from urllib.request import urlopen

import numpy as np
import pytest

import mocodec as mc
from mocodec import viewer
from mocodec.archive import Options, build, in_archive, open_archive
from mocodec.testing import synthetic
from mocodec.viewer.server import ArchiveServer

STRANGE = "a b & <c>"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[ArchiveServer]:
    for name in ("07_01", "07_02", STRANGE):
        path = tmp_path / "raw" / f"{name}.npz"
        path.parent.mkdir(exist_ok=True)
        mc.write(path, synthetic.joints(frames=60, rate=60.0, seed=len(name)))
    build(tmp_path / "raw", tmp_path / "vault", Options(targets={"max_error": 0.01}))
    with open_archive(tmp_path / "vault") as archive, ArchiveServer(archive, "vault") as made:
        thread = threading.Thread(target=made.serve_forever)
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def get(server: ArchiveServer, place: str) -> bytes:
    with urlopen(server.url.partition("?")[0] + place, timeout=30) as answer:
        data: bytes = answer.read()
        return data


def test_recordings_are_found(server: ArchiveServer) -> None:
    everything = json.loads(get(server, "clips.json?text=&query="))
    assert [clip["name"] for clip in everything["clips"]] == ["07_01", "07_02", STRANGE]
    assert everything["total"] == 3
    some = json.loads(get(server, "clips.json?text=02&query=" + quote("subject == 7")))
    assert [clip["name"] for clip in some["clips"]] == ["07_02"]
    none = json.loads(get(server, "clips.json?text=" + quote('it\'s "nothing" \\') + "&query="))
    assert none["clips"] == []


def test_recordings_are_shown(server: ArchiveServer) -> None:
    place = f"clip/{quote(STRANGE, safe='')}/"
    (facts,) = json.loads(get(server, place + "session.json"))["recordings"]
    assert facts["name"] == STRANGE
    frames = np.frombuffer(get(server, facts["decoded"]["url"] + "?from=0&to=10"), "<f4")
    assert frames.size == 10 * facts["points"] * 3
    pose = json.loads(get(server, place + "pose.json"))
    assert len(pose["points"]) == facts["points"]
    assert len(pose["links"]) == facts["points"] - 1
    assert all(0 <= x <= 1 and 0 <= y <= 1 for x, y in pose["points"])


@pytest.mark.parametrize("place", ["clips.json?query=subject+%2B", "clip/none/session.json", "clip/07_01/else"])
def test_wrong_questions_get_one_line(server: ArchiveServer, place: str) -> None:
    with pytest.raises(HTTPError) as error:
        get(server, place)
    with error.value as answer:
        assert answer.code in (404, 500)
        assert b"Traceback" not in answer.read()


def test_one_recording_of_an_archive(server: ArchiveServer) -> None:
    folder = Path(server.archive.path)
    with ExitStack() as opened:
        shown = viewer.shown(folder / "07_02", opened)
        assert (shown.name, shown.frames, shown.codec) == ("07_02", 60, "tempo")
    with pytest.raises(mc.BadInput, match="no recording named 09_01"), ExitStack() as opened:
        viewer.shown(folder / "09_01", opened)
    assert in_archive(folder / "catalogue.sqlite") is None
    assert in_archive(folder.parent / "raw" / "x") is None
