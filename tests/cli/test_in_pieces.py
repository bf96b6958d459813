"""`mocodec encode` block by block."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import in_pieces
from mocodec.testing import synthetic

from .conftest import Command


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An .npz of some seconds, in blocks of 500 frames, of which four seconds are the sample."""
    monkeypatch.setattr(in_pieces, "SAMPLED_SECONDS", 4.0)
    motion = synthetic.markers(frames=1500, seed=4)
    monkeypatch.setattr("mocodec.formats.blocks.BLOCK_SAMPLES", 500 * motion.points)
    path = tmp_path / "day.npz"
    mc.write(path, motion)
    return path


def test_pieces_when_asked_for(command: Command, recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "day.mocz"
    done = command("encode", recording, "-o", out, "--max-error", "3mm", "--in-pieces", "--json")
    assert done.code == 0, done.err
    record = json.loads(done.out)
    assert record["frames"] == 1500
    assert record["bytes"] == out.stat().st_size
    assert 0 < record["max_error"] <= 0.003
    assert command("verify", out, "--against", recording).code == 0


def test_large_files_without_asking(
    command: Command, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mocodec.cli.in_pieces.LARGE_BYTES", recording.stat().st_size + 1)  # less than its arrays
    out, whole = tmp_path / "day.mocz", tmp_path / "whole.mocz"
    assert command("encode", recording, "-o", out).code == 0
    assert command("encode", recording, "-o", whole, "--at-once").code == 0
    assert out.read_bytes() != whole.read_bytes()
    np.testing.assert_allclose(mc.read(out, mc.Motion).positions, mc.read(whole, mc.Motion).positions, atol=0.011)
    assert command("encode", recording, "-o", out, "--codec", "liu2006").code == 0
    with mc.open(out) as f:
        assert f.encoded.codec == "liu2006"


def test_what_is_refused(command: Command, recording: Path, tmp_path: Path) -> None:
    done = command("encode", recording, "-o", tmp_path / "x.mocz", "--in-pieces", "--at-once")
    assert done.code == 2
    assert "exclude each other" in done.err
    for arguments in (("--codec", "hou2014"), ("--signal-error", "12bit")):
        done = command("encode", recording, "-o", tmp_path / "x.mocz", "--in-pieces", *arguments)
        assert done.code == 2
        assert "--in-pieces takes" in done.err
    done = command("encode", recording, "-o", tmp_path / "x.mocz", "--in-pieces", "--set", "model=hou2014")
    assert done.code == 3
    assert "whole recording at once" in done.err
    assert not (tmp_path / "x.mocz").exists()


def test_a_c3d_loses_nothing_in_pieces_unless_bare(command: Command, tmp_path: Path) -> None:
    lab, out = tmp_path / "lab.c3d", tmp_path / "lab.mocz"
    motion = synthetic.markers(frames=900, seed=3)
    signal = mc.Signal(np.random.default_rng(1).integers(-99, 99, (1800, 2), np.int16), 240.0, ("Fx", "Fy"), ("N", "N"))
    mc.write(lab, replace(motion, extras={"analog": signal}))
    done = command("encode", lab, "-o", out, "--in-pieces", "--json")
    assert done.code == 0, done.err
    record = json.loads(done.out)
    assert record["motion"] + record["signals"] + record["extras"] == record["bytes"] == out.stat().st_size
    assert record["signals"] > 0
    np.testing.assert_array_equal(mc.read(out, mc.Motion).extras["analog"].values, signal.values)
    assert command("verify", out, "--against", lab).code == 0
    assert command("encode", lab, "-o", out, "--in-pieces", "--bare").code == 0
    bare = mc.read(out, mc.Motion)
    assert not bare.extras
    assert mc.compare(motion, bare).max_error <= 0.005


@pytest.mark.parametrize("words", ["all zero", "all equal", "small", "large", "one late"])
def test_residuals_of_a_bare_c3d_are_as_at_once(
    command: Command, tmp_path: Path, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    motion, lab = synthetic.markers(frames=900, seed=3), tmp_path / "lab.c3d"
    motion = motion.select(["C7", "LSHO", "RSHO", "LKNE", "LHEE"])
    monkeypatch.setattr("mocodec.formats.blocks.BLOCK_SAMPLES", 300 * motion.points)
    monkeypatch.setattr(in_pieces, "SAMPLED_SECONDS", 2.0)
    shape = motion.positions.shape[:2]
    word = np.full(shape, 0 if words == "all zero" else 247, np.int16)
    if words == "small":
        word[10:20] = 5
    if words == "one late":
        word[-1, -1] = 5
    if words == "large":
        word = np.random.default_rng(1).integers(1, 2**15, shape).astype(np.int16)
    mc.write(lab, replace(motion, extras={"residuals": mc.Signal(word, motion.rate)}))
    notes, sources = [], []
    for how in ("--in-pieces", "--at-once"):
        out = tmp_path / f"lab{how}.mocz"
        done = command("encode", lab, "-o", out, "--bare", how)
        assert done.code == 0, done.err
        notes.append([line for line in done.err.splitlines() if line.startswith("note: ")])
        sources.append(mc.read(out, mc.Motion).source)
        assert command("verify", out, "--against", lab).code == 0
    assert notes[0] == notes[1]
    assert sources[0] == sources[1]
    assert sources[0].get("residual_word") == (247 if words == "all equal" else None)
    assert ("residuals" in sources[0]) == (words in ("small", "large", "one late"))


def test_guesses_are_said_as_without_pieces(command: Command, recording: Path, tmp_path: Path) -> None:
    guessed = tmp_path / "plain.npy"
    np.save(guessed, mc.read(recording, mc.Motion).positions)
    done = [
        command("encode", guessed, "-o", tmp_path / "x.mocz", "--rate", "120", how)
        for how in ("--in-pieces", "--at-once")
    ]
    notes = [[line for line in one.err.splitlines() if line.startswith("note: ")] for one in done]
    assert notes[0] == notes[1]
    assert "guessed: up" in notes[0][0]


def test_files_of_a_folder(command: Command, tmp_path: Path) -> None:
    """Short files, which the workers encode as at once."""
    folder, out, whole = tmp_path / "days", tmp_path / "out", tmp_path / "whole"
    folder.mkdir()
    mc.write(folder / "day.npz", synthetic.markers(frames=60, seed=4))
    mc.write(folder / "walk.c3d", synthetic.markers(frames=20, seed=4))
    assert command("encode", folder, "-o", out, "--max-error", "3mm", "--in-pieces").code == 0
    assert command("encode", folder, "-o", whole, "--max-error", "3mm").code == 0
    for name in ("day.mocz", "walk.mocz"):
        assert (out / name).read_bytes() == (whole / name).read_bytes()
    assert command("verify", out / "walk.mocz", "--against", folder / "walk.c3d").code == 0
