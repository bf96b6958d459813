"""Rotations at the command line: encoded, verified, cut, salvaged, and what is not kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocodec
from mocodec import Motion
from mocodec.testing import hinged_figures

from .conftest import Command


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "figure.bvh"
    mocodec.write(path, hinged_figures.figure(300))
    return path


def test_bvh_to_mocz_to_bvh(command: Command, source: Path, tmp_path: Path) -> None:
    packed, back = tmp_path / "figure.mocz", tmp_path / "back.bvh"
    assert command("encode", source, "-o", packed, "--max-error", "3mm", "--max-rotation", "4").code == 0
    assert "the promise is kept" in command("verify", packed, "--against", source).out
    assert command("decode", packed, "-o", back).code == 0
    assert mocodec.compare(mocodec.read(source, Motion), mocodec.read(back, Motion)).max_error <= 0.003 + 1e-5


def test_what_is_not_kept_is_said(command: Command, source: Path, tmp_path: Path) -> None:
    said = command("encode", source, "-o", tmp_path / "figure.mocz", "--codec", "hou2014").err
    assert "not kept: the rotations of the joints" in said
    assert "not kept" not in command("encode", source, "-o", tmp_path / "figure.mocz").err


def test_a_cut_keeps_rotations_and_grows_the_promise(command: Command, source: Path, tmp_path: Path) -> None:
    packed, part = tmp_path / "figure.mocz", tmp_path / "part.mocz"
    command("encode", source, "-o", packed, "--max-error", "4mm", "--max-rotation", "6")
    assert "max rotation now 9°" in command("cut", packed, "--from", "1s", "--to", "2s", "-o", part).err
    decoded = mocodec.decode(part, Motion)
    assert decoded.rotations is not None
    assert len(decoded) == 60


def test_salvage_keeps_the_rotations_of_undamaged_frames(command: Command, source: Path, tmp_path: Path) -> None:
    packed, whole = tmp_path / "figure.mocz", tmp_path / "whole.npz"
    command("encode", source, "-o", packed, "--chunk-seconds", "1")
    data = bytearray(packed.read_bytes())
    data[len(data) - 60] ^= 255
    packed.write_bytes(data)
    assert command("decode", packed, "-o", whole, "--salvage").code == 4
    salvaged = mocodec.read(whole, Motion)
    lost = salvaged.gaps.any(axis=1)
    assert 0 < lost.sum() < len(salvaged)
    assert salvaged.rotations is not None
    assert np.abs((salvaged.rotations**2).sum(axis=2) - 1).max() < 1e-9


def test_info_shows_the_bytes_of_positions_and_of_rotations(command: Command, source: Path, tmp_path: Path) -> None:
    packed = tmp_path / "figure.mocz"
    command("encode", source, "-o", packed)
    facts = json.loads(command("info", packed, "--json").out)
    uses, parts = facts["bytes_by_use"], facts["bytes_by_part"]
    assert uses["positions"] > uses["rotations"] > 0
    assert sum(uses.values()) >= parts["chunks"]
    assert "bytes by use" in command("info", packed).out
    data = bytearray(packed.read_bytes())
    data[len(data) - 60] ^= 255
    packed.write_bytes(data)
    assert "bytes by use" not in command("info", packed).out


def test_info_of_positions_alone_has_no_bytes_by_use(command: Command, tmp_path: Path) -> None:
    packed = tmp_path / "points.mocz"
    packed.write_bytes(mocodec.encode(replace(hinged_figures.figure(60), rotations=None)))
    assert "bytes_by_use" not in json.loads(command("info", packed, "--json").out)
