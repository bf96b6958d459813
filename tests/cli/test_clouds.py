"""The command line on a folder of .ply: encode, info, decode to points and to a skeleton, compare."""

from __future__ import annotations

import json

import pytest

import mocodec as mc
from mocodec import cli
from mocodec.testing import actors, sequences

pytest.importorskip("PIL")
pytest.importorskip("av")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("clouds")
    performance = sequences.jumping_jacks(actors.capsules(), 4)
    mc.write(root / "frames", sequences.record(performance, 1500))
    mc.write(root / "first.bvh", performance.skeleton()[:1])
    return root


def run(*arguments: object, code: int = 0) -> None:
    assert cli.run([str(a) for a in arguments]) == code


@pytest.mark.parametrize("codec", ["lien2006", "bodycast"])
def test_encode_and_decode(folder, codec, tmp_path, capsys):
    stored = tmp_path / "x.mocz"
    first = folder / "first.bvh"
    run("encode", folder / "frames", "-o", stored, "--codec", codec, "--fps", 15, "--skeleton", first, "--residual", 25)
    run("info", stored)
    assert codec in capsys.readouterr().out
    run("decode", stored, "-o", tmp_path / "back")
    assert len(mc.read(tmp_path / "back")) == 4
    run("decode", stored, "-o", tmp_path / "motion.bvh")
    motion = mc.read(tmp_path / "motion.bvh")
    assert isinstance(motion, mc.Motion)
    assert len(motion) == 4
    run("compare", folder / "frames", stored, "--json")
    result = json.loads(capsys.readouterr().out)
    assert result["d1_m"] < 0.05
    assert result["ratio"] > 5
    run("compare", folder / "frames", stored)
    assert "dB" in capsys.readouterr().out


def test_recordings_without_a_body_are_3(folder, tmp_path):
    run("compare", folder / "frames", folder / "first.bvh", code=3)
    run("encode", folder / "frames", "-o", tmp_path / "x.mocz", "--codec", "lien2006", "--skeleton", "no.bvh", code=3)
