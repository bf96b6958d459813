"""GLB: round trips, a surface, files of other programs, damage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, Motion
from mocodec.formats import gltf
from mocodec.geometry import kinematics
from mocodec.testing import corruption, synthetic

from .build import packed, parts


@pytest.fixture
def walk() -> Motion:
    return synthetic.joints(frames=30, seed=3)


def test_round_trip(tmp_path, walk):
    mc.write(tmp_path / "walk.glb", walk)
    back = mc.read(tmp_path / "walk.glb")
    assert isinstance(back, Motion)
    assert back.names == walk.names
    assert (back.rate, back.up) == (walk.rate, walk.up)
    assert np.abs(back.positions - walk.positions).max() < 1e-5
    assert walk.skeleton is not None
    assert back.skeleton is not None
    assert back.skeleton.parents == walk.skeleton.parents
    assert np.abs(back.skeleton.offsets[1:] - walk.skeleton.offsets[1:]).max() < 1e-6
    assert walk.rotations is not None
    assert back.rotations is not None
    same = np.abs(np.sum(back.rotations * walk.rotations, axis=2))
    assert same.min() > 1 - 1e-6
    moved = kinematics.forward(back.skeleton, back.rotations, back.positions[:, 0] - back.skeleton.offsets[0])
    assert np.abs(moved - walk.positions).max() < 1e-4


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_y_is_up_in_the_file(tmp_path, walk, up):
    turned = replace(walk, up=up)
    gltf.write(tmp_path / "a.glb", turned)
    back = gltf.read(tmp_path / "a.glb")
    assert back.up == up
    assert np.abs(back.positions - walk.positions).max() < 1e-5
    content, blob = parts(tmp_path / "a.glb")
    content["asset"]["generator"] = "another"  # whose axes are y up
    (tmp_path / "b.glb").write_bytes(packed(content, blob))
    foreign = gltf.read(tmp_path / "b.glb")
    axis = "xyz".index(up)
    assert np.abs(foreign.positions[:, :, 1] - walk.positions[:, :, axis]).max() < 1e-5


def test_markers_slide(tmp_path):
    motion = synthetic.markers(frames=20, seed=1)
    gltf.write(tmp_path / "m.glb", motion)
    back = gltf.read(tmp_path / "m.glb")
    assert back.names == motion.names
    assert np.abs(back.positions - motion.positions).max() < 1e-5
    assert back.skeleton is None
    assert back.rotations is None
    gapped = motion.positions.copy()
    gapped[3, 2] = np.nan
    with pytest.raises(BadInput, match="gaps"):
        gltf.write(tmp_path / "g.glb", replace(motion, positions=gapped))


def test_a_surface_follows_the_joints(tmp_path, walk):
    assert walk.skeleton is not None
    rest = np.zeros((walk.points, 3))
    for joint, parent in enumerate(walk.skeleton.parents):
        rest[joint] = walk.skeleton.offsets[joint] + (rest[parent] if parent >= 0 else 0)
    some = np.arange(walk.points)[:, None]
    shades = np.full((walk.points, 3), 99, np.uint8)
    gltf.write(tmp_path / "s.glb", walk, gltf.Surface(rest, shades, some, np.ones((walk.points, 1)), rest))
    content, _ = parts(tmp_path / "s.glb")
    primitive = content["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    assert set(primitive["attributes"]) == {"POSITION", "JOINTS_0", "WEIGHTS_0", "COLOR_0"}
    assert len(content["skins"][0]["joints"]) == walk.points
    assert np.abs(gltf.read(tmp_path / "s.glb").positions - walk.positions).max() < 1e-5


def test_a_file_of_another_program(tmp_path):
    """Nodes in any order, scaled, keys that are not of one rate, a cubic path, rotations at rest."""
    half = float(np.sqrt(0.5))
    times = np.array([0.0, 0.1, 0.4], "<f4")
    turns = np.array([[0, 0, 0, 1], [0, 0, half, half], [0, 0, 1, 0]], "<f4")
    path = np.array([[0] * 3, [0, 0, 0], [0] * 3, [0] * 3, [0, 1, 0], [0] * 3], "<f4")
    ends = np.array([0.0, 0.4], "<f4")
    blob, views, accessors = b"", [], []
    for values, kind in ((times, "SCALAR"), (turns, "VEC4"), (ends, "SCALAR"), (path, "VEC3")):
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": values.nbytes})
        accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": len(values), "type": kind})
        blob += values.tobytes()
    content = {
        "asset": {"version": "2.0"},
        "nodes": [
            {"name": "hand", "translation": [1, 0, 0]},
            {"name": "arm", "translation": [0, 1, 0], "rotation": [0, 0, half, half], "children": [0]},
            {"name": "all", "scale": [2, 2, 2], "children": [1]},
        ],
        "animations": [
            {
                "samplers": [{"input": 0, "output": 1}, {"input": 2, "output": 3, "interpolation": "CUBICSPLINE"}],
                "channels": [
                    {"sampler": 0, "target": {"node": 1, "path": "rotation"}},
                    {"sampler": 1, "target": {"node": 2, "path": "translation"}},
                ],
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    (tmp_path / "o.glb").write_bytes(packed(content, blob))
    motion = gltf.read(tmp_path / "o.glb", rate=10)
    assert motion.names == ("all", "arm", "hand")
    assert len(motion) == 5
    np.testing.assert_allclose(motion.positions[0], [[0, 0, 0], [0, 2, 0], [2, 2, 0]], atol=1e-6)
    np.testing.assert_allclose(motion.positions[1, 2] - motion.positions[1, 1], [0, 2, 0], atol=1e-6)
    np.testing.assert_allclose(motion.positions[4], [[0, 1, 0], [0, 3, 0], [-2, 3, 0]], atol=1e-6)
    np.testing.assert_allclose(motion.positions[2, 0], [0, 0.5, 0], atol=1e-6)
    assert motion.skeleton is not None
    np.testing.assert_allclose(motion.skeleton.offsets, [[0, 0, 0], [0, 2, 0], [0, 2, 0]], atol=1e-6)


def test_damage_raises_one_line(tmp_path, walk):
    gltf.write(tmp_path / "walk.glb", walk[:3])
    data = (tmp_path / "walk.glb").read_bytes()
    path = tmp_path / "x.glb"
    for bad in (*corruption.prefixes(data, every=97), *corruption.damaged(data, 300, seed=2)):
        path.write_bytes(bad)
        try:
            motion = mc.read(path)
        except BadInput:
            continue
        assert isinstance(motion, Motion)


@pytest.mark.parametrize(
    "nodes", [[{"children": [0]}], [{"children": [1]}, {"children": [0]}], [{"children": [7]}], "nodes"]
)
def test_nodes_that_do_not_form_a_tree(tmp_path, nodes):
    (tmp_path / "x.glb").write_bytes(packed({"asset": {"version": "2.0"}, "nodes": nodes, "animations": [{}]}, b""))
    with pytest.raises(BadInput):
        gltf.read(tmp_path / "x.glb")
