"""GLB at the command line: conversion with sparse keys."""

from __future__ import annotations

import json

import numpy as np
import pytest

import mocodec as mc
from mocodec.cli import run
from mocodec.formats import gltf
from mocodec.testing import synthetic

from ..samples import AMC, ASF, BVH
from .test_reading import SWING, TIMES, two_people


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_convert_to_glb_with_few_keys(tmp_path, capsys, suffix):
    gltf.write(tmp_path / "walk.glb", synthetic.joints(frames=120, seed=3))
    out = tmp_path / f"out{suffix}"
    assert run(["convert", str(tmp_path / "walk.glb"), str(out), "--keys", "5mm"]) == 0
    walk, back = gltf.read(tmp_path / "walk.glb"), gltf.read(out)
    assert np.linalg.norm(back.positions - walk.positions, axis=2).max() <= 0.005 + 1e-5
    assert run(["convert", str(tmp_path / "walk.glb"), str(tmp_path / "x.bvh"), "--keys", "5mm"]) != 0
    assert "keys" in capsys.readouterr().err


def test_convert_bvh_and_amc_and_back(tmp_path):
    (tmp_path / "x.bvh").write_text(BVH)
    (tmp_path / "y.amc").write_text(AMC)
    (tmp_path / "y.asf").write_text(ASF)
    for name in ("x.bvh", "y.amc"):
        assert run(["convert", str(tmp_path / name), str(tmp_path / "x.glb"), "-q"]) == 0
        assert run(["convert", str(tmp_path / "x.glb"), str(tmp_path / "back.bvh"), "-q"]) == 0
        there, back = mc.read(tmp_path / "x.glb", mc.Motion), mc.read(tmp_path / "back.bvh", mc.Motion, unit="cm")
        joints = [back.names.index(name) for name in there.names]
        np.testing.assert_allclose(back.positions[:, joints], there.positions, atol=1e-6)


@pytest.mark.parametrize("option", ["--animation", "--skin"])
def test_options_at_the_command_line(tmp_path, capsys, option):
    build = two_people()
    build.json["animations"][0]["name"] = "Both"
    build.animation("Right").move(5, "rotation", TIMES / 2, SWING)
    path = build.glb(tmp_path / "x.glb")
    value = {"--animation": "Right", "--skin": "right"}[option]
    assert run(["info", str(path), option, value, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["points"] == 3
    assert run(["info", str(path), option, "none of them"]) != 0
    assert "it has: 0" in capsys.readouterr().err
