"""The page as one file, in a notebook, and from the server."""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest

import mocodec as mc
from mocodec import viewer
from mocodec.viewer import page, session
from mocodec.viewer.recording import Shown, of_file
from mocodec.viewer.server import MOST_CONNECTIONS, Server

HOSTILE = '</script><img src=x onerror="alert(1)"><!--'


def test_a_page_holds_its_session(original: mc.Motion) -> None:
    made = viewer.html(original, title="walk")
    (inside,) = re.findall(r'<script type="application/json" id="session">(.*?)</script>', made, re.DOTALL)
    assert json.loads(inside)["title"] == "walk"
    assert "https://" not in made.split("<script>")[0]


def test_names_cannot_leave_the_session(original: mc.Motion) -> None:
    named = mc.Motion(original.positions[:, :1], 60, (HOSTILE,))
    made = viewer.html(named, title=HOSTILE)
    assert HOSTILE not in made
    (inside,) = re.findall(r'id="session">(.*?)</script>', made, re.DOTALL)
    assert json.loads(inside)["recordings"][0]["names"] == [HOSTILE]
    frame = page.in_frame({"version": 1, "title": HOSTILE, "recordings": []})
    assert HOSTILE not in frame


def test_notebooks_show_motions(original: mc.Motion, blob: bytes, clouds: mc.PointClouds) -> None:
    with mc.open(blob) as f:
        for shown in (original, clouds, f):
            made = shown._repr_html_()
            assert made.startswith("<iframe")
            assert len(made) <= viewer.NOTEBOOK_BYTES
    document = html.unescape(re.findall(r'srcdoc="(.*?)"', original._repr_html_(), re.DOTALL)[0])
    data = base64.b64decode(re.findall(r'atob\("(.*?)"\)', document)[0])
    assert gzip.decompress(data).decode().startswith("<!doctype html>")


def test_long_motions_fit_a_notebook() -> None:
    noise = np.random.default_rng(1).normal(size=(20_000, 60, 3))
    made = mc.Motion(noise, 60)._repr_html_()
    assert len(made) <= viewer.NOTEBOOK_BYTES


def test_a_motion_without_frames_shows_its_repr() -> None:
    assert mc.Motion(np.zeros((0, 1, 3)), 60)._repr_html_().startswith("<code>&lt;Motion")


def test_other_suffixes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(mc.BadInput, match=r"\.html"):
        viewer.save(tmp_path / "x.txt", "")


@pytest.fixture
def server(original: mc.Motion, blob: bytes, clouds: mc.PointClouds) -> Iterator[Server]:
    with mc.open(blob, mc.Motion) as f:
        pairs = [session.matched(of_file("walk.mocz", f), Shown("walk", original)), (Shown("clouds", clouds), None)]
        with Server(pairs, "walk") as made:
            thread = threading.Thread(target=made.serve_forever)
            thread.start()
            yield made
            made.shutdown()
            thread.join()


def get(server: Server, place: str, host: str | None = None) -> bytes:
    base = server.url.partition("?")[0]
    request = Request(base + place, headers={} if host is None else {"Host": host})
    with urlopen(request, timeout=10) as answer:
        data: bytes = answer.read()
        return data


def test_the_server_gives_page_session_and_frames(server: Server, original: mc.Motion, blob: bytes) -> None:
    assert get(server, "").startswith(b"<!doctype html>")
    recordings = json.loads(get(server, "session.json"))["recordings"]
    assert [recording["name"] for recording in recordings] == ["walk.mocz", "clouds"]
    decoded = np.frombuffer(get(server, "r/0/decoded?from=10&to=20"), "<f4").reshape(10, 6, 3)
    np.testing.assert_allclose(decoded, mc.decode(blob, mc.Motion).positions[10:20], atol=1e-6)
    before = np.frombuffer(get(server, "r/0/original?from=90&to=110"), "<f4").reshape(20, 6, 3)
    np.testing.assert_allclose(before, original.positions[90:110], atol=1e-6)
    cloud = get(server, "r/1/decoded?from=2&to=3")
    assert int.from_bytes(cloud[:4], "little") == 70
    assert len(cloud) == 4 + 70 * 15 + 2
    assert len(get(server, "priors/b881876c.npz")) > 10_000


def status(server: Server, place: str, host: str | None = None) -> int:
    """The status of a refused request."""
    try:
        get(server, place, host)
    except HTTPError as error:
        with error:
            return error.code
    return 200


@pytest.mark.parametrize(
    "place",
    [
        "r/0/decoded?from=0&to=100000",
        "r/0/decoded?from=-1&to=3",
        "r/0/decoded?from=a&to=3",
        "r/0/decoded?from=3&to=3",
        "r/0/decoded",
        "r/9/decoded?from=0&to=1",
        "r/1/original?from=0&to=1",
        "../../etc/passwd",
        "static/viewer.html",
        "priors/00000000.npz",
    ],
)
def test_nothing_else_is_served(server: Server, place: str) -> None:
    assert status(server, place) == 404


def test_foreign_names_and_guessed_addresses_are_refused(server: Server) -> None:
    assert status(server, "session.json", host="evil.example") == 403
    assert status(server, "../guess/session.json") == 404
    assert server.server_address[0] == "127.0.0.1"


def test_connections_are_limited(server: Server) -> None:
    address = ("127.0.0.1", server.server_address[1])
    with ExitStack() as opened:
        idle = [opened.enter_context(socket.create_connection(address, 10)) for _ in range(MOST_CONNECTIONS)]
        over = opened.enter_context(socket.create_connection(address, 10))
        assert over.recv(1) == b""
        for connection in idle:
            connection.close()
    for _ in range(100):
        try:
            assert get(server, "").startswith(b"<!doctype html>")
            break
        except OSError:  # the threads of the closed connections have not ended yet
            time.sleep(0.05)
    else:
        pytest.fail("connections stay taken")
