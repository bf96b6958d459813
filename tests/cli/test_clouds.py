"""The command line on a folder of .ply: encode, info, decode to points and to a skeleton, compare."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace

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


def test_the_output_of_a_folder_stands_beside_it(folder, tmp_path, capsys):
    shutil.copytree(folder / "frames", tmp_path / "dancer.v2")
    run("encode", f"{tmp_path}/dancer.v2/")
    assert (tmp_path / "dancer.v2.mocz").exists()
    run("decode", tmp_path / "dancer.v2.mocz", "-o", tmp_path / "back")
    run("decode", tmp_path / "dancer.v2.mocz", "-o", tmp_path / "back", code=3)
    assert "already has 4 .ply files" in capsys.readouterr().err


def test_a_target_of_colours_that_are_not_there_is_refused(folder, tmp_path, capsys):
    clouds = mc.read(folder / "frames", mc.PointClouds)
    mc.write(tmp_path / "grey", replace(clouds, colours=None))
    run("encode", tmp_path / "grey", "--psnr", "40dB", code=3)
    assert "these points have none" in capsys.readouterr().err


def test_depth_images_without_intrinsics_are_named(tmp_path, capsys):
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth" / "0.png").write_bytes(b"")
    for where, what in ((tmp_path, "a camera.json with fx"), (tmp_path / "depth", "name that folder")):
        run("encode", where, code=2)
        assert what in capsys.readouterr().err


def test_a_rate_of_point_clouds_is_none_of_motions_beside_them(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "both")
    run("encode", tmp_path / "both", "-o", tmp_path / "out", "--fps", 20, "--max-error", "20mm")
    rates = [mc.read(tmp_path / "out" / f"{name}.mocz").rate for name in ("first", "frames")]
    assert rates == [15, 20]


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


def test_a_bound_is_promised_and_verified(folder, tmp_path, capsys):
    stored, first = tmp_path / "x.mocz", folder / "first.bvh"
    rate = ("--fps", 15)
    run("encode", folder / "frames", "-o", stored, *rate, "--skeleton", first, "--max-error", "4mm", "--psnr", "30dB")
    said = capsys.readouterr().err
    assert re.search(r"mean error 2\.\d+ mm", said)
    assert "D1" in said
    assert "dB" in said
    run("verify", stored, "--against", folder / "frames", *rate)
    assert "the promise is kept" in capsys.readouterr().out
    run("verify", stored, "--against", folder / "frames", "--json")  # at the rate of the file
    verified = json.loads(capsys.readouterr().out)
    run("compare", folder / "frames", stored, "--json")
    compared = json.loads(capsys.readouterr().out)
    assert (compared["d1_m"], compared["y_psnr_db"]) == (verified["d1"], verified["psnr"])
    run("info", stored)
    assert "4 mm" in capsys.readouterr().out
    with mc.open(stored) as opened:
        assert opened.encoded.promise == {"max_error": 0.004, "psnr": 30.0}
    run("compare", folder / "frames", stored, *rate, "--plot", tmp_path / "p.png", "--poses", tmp_path / "q.svg")
    out = capsys.readouterr().out
    assert "Hips" in out
    assert "floor" in out
    assert (tmp_path / "p.png").stat().st_size > 1000
    assert (tmp_path / "q.svg").stat().st_size > 1000


def test_a_cut_keeps_a_promise_that_holds(folder, tmp_path, capsys):
    stored, first = tmp_path / "x.mocz", folder / "first.bvh"
    run("encode", folder / "frames", "-o", stored, "--fps", 15, "--skeleton", first, "--max-error", "4mm", "--psnr", 30)
    run("cut", stored, "--from", "1f", "--to", "3f", "-o", tmp_path / "part.mocz")
    with mc.open(tmp_path / "part.mocz") as opened:
        assert opened.encoded.promise == {"max_error": pytest.approx(0.006)}
    mc.write(tmp_path / "middle", mc.read(folder / "frames", mc.PointClouds, fps=15)[1:3])
    run("verify", tmp_path / "part.mocz", "--against", tmp_path / "middle", "--fps", 15)
    assert "the promise is kept" in capsys.readouterr().out


def test_broken_promises_of_clouds_are_named(folder, tmp_path, capsys):
    moved = mc.read(folder / "frames", mc.PointClouds, fps=15)
    other = replace(moved, positions=[p + 0.05 for p in moved.positions])
    stored = tmp_path / "x.mocz"
    mc.write(stored, moved, max_error=0.01, skeleton=mc.read(folder / "first.bvh"))
    mc.write(tmp_path / "other", other)
    run("verify", stored, "--against", tmp_path / "other", "--fps", 15, code=1)
    assert "broken: max error is" in capsys.readouterr().out
    run("verify", stored, "--against", folder / "first.bvh", code=3)
    mc.write(tmp_path / "few", moved[:2])
    run("verify", stored, "--against", tmp_path / "few", "--fps", 15, code=1)
    assert "2 frames" in capsys.readouterr().out


def test_a_promise_that_cannot_be_kept_writes_nothing(folder, tmp_path, capsys):
    stored, first = tmp_path / "x.mocz", folder / "first.bvh"
    run("encode", folder / "frames", "-o", stored, "--fps", 15, "--skeleton", first, "--size", "300", code=3)
    assert "points within 40 mm take about" in capsys.readouterr().err
    assert not stored.exists()
    run("encode", folder / "frames", "-o", stored, "--psnr", "40mm", code=2)


def test_recordings_without_a_body_are_3(folder, tmp_path):
    run("compare", folder / "frames", folder / "first.bvh", code=3)
    run("encode", folder / "frames", "-o", tmp_path / "x.mocz", "--codec", "lien2006", "--skeleton", "no.bvh", code=3)
