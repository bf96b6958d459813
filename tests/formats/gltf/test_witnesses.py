"""What other programs make of our GLB: the Khronos validator, three.js' own loader, pygltflib and trimesh.

The validator and three.js need node and a folder of packages: `npm install gltf-validator three` in any folder, and
MOCODEC_NODE_MODULES=…/node_modules. The others need `pip install pygltflib trimesh`. Without them these tests skip.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import Motion
from mocodec.formats import gltf
from mocodec.geometry import bone_frames
from mocodec.testing import synthetic

from ..samples import AMC, ASF, BVH
from .test_reading import PATH, SKIN, SWING, TIMES, Build, leg, two_people, walking

WITNESS = Path(__file__).with_name("witness.mjs")
MODULES = Path(os.environ.get("MOCODEC_NODE_MODULES", Path(__file__).parents[3] / "node_modules"))


def ask(package: str, *arguments: str) -> Any:
    """The answer of witness.mjs; skips the test if node or the package is missing."""
    node = shutil.which("node")
    if node is None or not (MODULES / package).is_dir():
        pytest.skip(f"needs node, and {package} in MOCODEC_NODE_MODULES")
    done = subprocess.run(
        [node, WITNESS, MODULES, *arguments], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def stretched() -> Motion:
    sizes = 1 + 0.3 * np.sin(TIMES * 4)[:, None] * [1, 0.5, 0]
    return read_build(walking(hip={"scale": [-1, 1.2, 1]}).move(1, "scale", TIMES, sizes))


def read_build(build: Build, **options: Any) -> Motion:
    with tempfile.TemporaryDirectory() as folder:
        return gltf.read(build.glb(Path(folder) / "x.glb"), **options)


def sample(kind: str, folder: Path) -> Motion:
    """A motion of each kind that a GLB is written from."""
    if kind == "amc":
        (folder / "x.asf").write_text(ASF)
    texts = {"bvh": BVH, "amc": AMC}
    if kind in texts:
        (folder / f"x.{kind}").write_text(texts[kind])
        return mc.read(folder / f"x.{kind}", mc.Motion)
    return {
        "joints": lambda: synthetic.joints(frames=60, seed=3),
        "markers": lambda: synthetic.markers(frames=20, seed=1),
        "one frame": lambda: synthetic.joints(frames=1),
        "one joint": lambda: read_build(Build(leg(), [{"joints": [0]}]).animation().move(0, "rotation", TIMES, SWING)),
        "stretched": stretched,
        "two people": lambda: read_build(two_people(), skin="all"),
        "late": lambda: read_build(Build(leg(), SKIN).animation().move(0, "translation", TIMES + 2, PATH)),
        "z up": lambda: replace(read_build(walking()), up="z"),
    }[kind]()


KINDS = ["joints", "markers", "one frame", "one joint", "bvh", "amc", "stretched", "two people", "late", "z up"]


@pytest.mark.parametrize("keys", [None, 0.005])
@pytest.mark.parametrize("kind", KINDS)
def test_the_khronos_validator_finds_no_fault(tmp_path, kind, keys):
    for suffix in (".glb", ".gltf"):
        gltf.write(tmp_path / f"out{suffix}", sample(kind, tmp_path), keys=keys)
        issues = ask("gltf-validator", "validate", str(tmp_path / f"out{suffix}"))
        assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]


def test_the_khronos_validator_accepts_a_surface(tmp_path):
    walk = synthetic.joints(frames=10, seed=3)
    rest, some = walk.positions[0], np.arange(walk.points)[:, None]
    shades = np.full((walk.points, 3), 99, np.uint8)
    gltf.write(tmp_path / "s.glb", walk, gltf.Surface(rest, shades, some, np.ones((walk.points, 1)), rest))
    issues = ask("gltf-validator", "validate", str(tmp_path / "s.glb"))
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]


@pytest.mark.parametrize("keys", [None, 0.005])
@pytest.mark.parametrize("kind", KINDS)
def test_three_js_plays_it(tmp_path, kind, keys):
    motion = bone_frames.to_starts(sample(kind, tmp_path))
    gltf.write(tmp_path / "out.glb", motion, keys=keys)
    frames = sorted({0, len(motion) // 3, len(motion) - 1})
    times = [2.0 * (kind == "late") + frame / motion.rate for frame in frames]
    played = ask("three", "play", str(tmp_path / "out.glb"), ",".join(map(str, times)))
    assert played["skinned"] == ([motion.points] if motion.rotations is not None else [])
    for frame, places in zip(frames, played["frames"], strict=True):
        for name, (x, y, z) in zip(motion.names, motion.positions[frame], strict=True):
            if kind == "two people" and name.endswith("_2"):
                continue  # three.js names nodes of one name in its own way
            expected = (x, y, z) if motion.up == "y" else (x, z, -y)
            known = name if name in places else re.sub(r"[\[\].:/]", "", name.replace(" ", "_"))
            np.testing.assert_allclose(places[known], expected, atol=1e-5 if keys is None else keys + 1e-5)


def test_pygltflib_and_trimesh_read_it(tmp_path):
    pygltflib = pytest.importorskip("pygltflib")
    trimesh = pytest.importorskip("trimesh")
    walk = synthetic.joints(frames=10, seed=3)
    gltf.write(tmp_path / "x.glb", walk)
    loaded = pygltflib.GLTF2().load(str(tmp_path / "x.glb"))
    assert [loaded.nodes[joint].name for joint in loaded.skins[0].joints] == list(walk.names)
    assert len(loaded.animations[0].channels) >= walk.points
    scene = trimesh.load(tmp_path / "x.glb")
    (mesh,) = scene.geometry.values()
    assert mesh.is_watertight
    assert mesh.volume > 0
