"""`mocodec view`: pages, pictures and films without a browser; the server and its address."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest

import mocodec as mc

from .conftest import LOSSY, Command, restore_sigint


@pytest.fixture
def files(walk: mc.Motion, tmp_path: Path) -> tuple[Path, Path]:
    """The walk as .npz, and within 2 mm as .mocz."""
    original, compressed = tmp_path / "walk.npz", tmp_path / "walk.mocz"
    mc.write(original, walk)
    mc.write(compressed, walk, codec=LOSSY, max_error=0.002)
    return original, compressed


def test_a_page_to_mail(command: Command, files: tuple[Path, Path], tmp_path: Path) -> None:
    original, compressed = files
    result = command("view", compressed, "--against", original, "--html", tmp_path / "walk.html")
    assert result.code == 0
    assert "without a network" in result.err
    assert "walk.mocz" in (tmp_path / "walk.html").read_text()


def test_any_readable_format_is_shown(command: Command, files: tuple[Path, Path], tmp_path: Path) -> None:
    original, compressed = files
    assert command("view", original, compressed, "--html", tmp_path / "two.html").code == 0


def test_pictures(command: Command, files: tuple[Path, Path], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    original, compressed = files
    assert command("view", compressed, "--against", original, "--png", tmp_path / "a.png").code == 0
    assert command("view", original, "--png", tmp_path / "b.png").code == 0
    assert (tmp_path / "b.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("clouds", [False, True])
def test_films(command: Command, files: tuple[Path, Path], tmp_path: Path, clouds: bool) -> None:
    av = pytest.importorskip("av")
    pytest.importorskip("PIL")
    original, compressed = files
    arguments = [compressed, "--against", original]
    if clouds:
        random = np.random.default_rng(1)
        frames = [random.normal(size=(n, 3)) for n in (40, 0, 30)]
        mc.write(tmp_path / "points", mc.PointClouds(frames, 10))
        arguments = [tmp_path / "points", "--fps", 10]
    result = command("view", *arguments, "--mp4", tmp_path / "film.mp4")
    assert result.code == 0, result.err
    with av.open(str(tmp_path / "film.mp4")) as film:
        assert sum(1 for _ in film.decode(video=0)) == (3 if clouds else 60)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--html", "x.txt"], "suffix of a page"),
        (["--png", "x.jpg"], "suffix of a picture"),
        (["--mp4", "x.avi"], "suffix of a film"),
    ],
)
def test_wrong_outputs(command: Command, files: tuple[Path, Path], arguments: list[str], says: str) -> None:
    result = command("view", files[1], *arguments)
    assert result.code == 2
    assert says in result.err


def test_recordings_that_do_not_match(command: Command, files: tuple[Path, Path], tmp_path: Path) -> None:
    mc.write(tmp_path / "short.npz", mc.read(files[0], mc.Motion)[:10])
    result = command("view", files[1], "--against", tmp_path / "short.npz", "--html", tmp_path / "x.html")
    assert result.code == 3
    assert "240 frames" in result.err
    assert not (tmp_path / "x.html").exists()


def test_a_port_that_is_taken_is_one_line(command: Command, files: tuple[Path, Path]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        result = command("view", files[1], "--no-browser", "--port", port)
    assert result.code == 3
    assert f"port {port} cannot be used" in result.err


def test_standard_input_is_refused(command: Command) -> None:
    assert command("view", "-").code == 2


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_it_serves_until_interrupted(files: tuple[Path, Path]) -> None:
    arguments = [sys.executable, "-m", "mocodec", "view", str(files[1]), "--no-browser"]
    with subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=restore_sigint
    ) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        with urlopen(address, timeout=30) as answer:
            assert b"mocodec" in answer.read()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
        assert "Traceback" not in err
        assert process.returncode in (0, 130)
