"""A small motion with a gap, written as files that commands can work on."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import cli

LOSSY = "liu2006"  # a codec that takes max_error


@dataclass(frozen=True)
class Result:
    """What a command line did."""

    code: int
    out: str
    err: str


Command = Callable[..., Result]


def restore_sigint() -> None:
    """Tests that run in the background of a shell inherit that SIGINT is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture
def command(capfd: pytest.CaptureFixture[str]) -> Command:
    """Run a command line in this process."""

    def run(*arguments: object) -> Result:
        capfd.readouterr()
        code = cli.run([str(a) for a in arguments])
        captured = capfd.readouterr()
        return Result(code, captured.out, captured.err)

    return run


@pytest.fixture
def walk() -> mc.Motion:
    """Two seconds of seven points that move together, one of them missing for a while."""
    t = np.linspace(0, 2, 240, endpoint=False)
    sway = np.stack([0.4 * t, 0.05 * np.sin(6 * t), 0.02 * np.sin(12 * t)], axis=1)
    body = np.array(
        [[0, 0, 0.1], [0.1, 0, 0.1], [0, 0, 0.5], [0.1, 0, 0.5], [0.05, 0.1, 1.0], [0, 0, 1.4], [0.1, 0, 1.7]]
    )
    swing = 0.1 * np.sin(6 * t + np.arange(7)[:, None]).T[:, :, None] * [1, 0.2, 0.1]
    positions = np.round(sway[:, None] + body + swing, 6)
    positions[100:130, 3] = np.nan
    return mc.Motion(positions, 120, ("LHEE", "RHEE", "LKNE", "RKNE", "STRN", "CLAV", "HEAD"))


@pytest.fixture
def walk_trc(walk: mc.Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The walk as walk.trc in the folder in which commands then run."""
    monkeypatch.chdir(tmp_path)
    mc.write("walk.trc", walk)
    return Path("walk.trc")


@pytest.fixture
def walk_mocz(walk_trc: Path, command: Command) -> Path:
    """The walk as walk.mocz, promised to 2 mm."""
    result = command("encode", walk_trc, "-o", "walk.mocz", "--codec", LOSSY, "--max-error", "2mm")
    assert result.code == 0, result.err
    return Path("walk.mocz")
