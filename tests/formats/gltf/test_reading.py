"""GLB and glTF of other programs: every feature of the standard that carries motion, read to the right positions."""

from __future__ import annotations

import base64
import json
from dataclasses import replace

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, Motion, formats
from mocodec.formats import gltf
from mocodec.formats.conventions import start_s
from mocodec.geometry import kinematics

from ..samples import SHARED
from .build import Build, about, leg, packed, parts

TIMES = np.arange(30) / 30
SWING = about("x", 40 * np.sin(TIMES * 5))
PATH = np.stack([0.3 * TIMES, np.ones(30), 0.1 * np.sin(TIMES)], axis=1)
CASES = SHARED.parent / "cases" / "glb"
SKIN = [{"joints": [0, 1, 2, 3]}]


def walking(**changes) -> Build:
    """A leg whose hip travels and whose thigh swings."""
    build = Build(leg(**changes), SKIN).animation("Walk")
    return build.move(0, "translation", TIMES, PATH).move(1, "rotation", TIMES, SWING)


def product(locals_: list[list[np.ndarray]]) -> np.ndarray:
    """Positions (frames, nodes, 3) of a chain of nodes, each given by its factors (frames or 1, 4, 4)."""
    world, result = np.eye(4)[None], []
    for factors in locals_:
        for factor in factors:
            world = world @ factor
        result.append(np.broadcast_to(world[:, :3, 3], (30, 3)))
    return np.stack(result, axis=1)


def shift(x) -> np.ndarray:
    matrix = np.tile(np.eye(4), (np.size(x) // 3, 1, 1))
    matrix[:, :3, 3] = x
    return matrix


def stretch(x) -> np.ndarray:
    matrix = np.tile(np.eye(4), (np.size(x) // 3, 1, 1))
    matrix[:, [0, 1, 2], [0, 1, 2]] = x
    return matrix


def turn(quaternions: np.ndarray) -> np.ndarray:
    x, y, z, w = np.atleast_2d(quaternions).T
    matrix = np.tile(np.eye(4), (x.size, 1, 1))
    matrix[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1)
    matrix[:, 1, :3] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1)
    matrix[:, 2, :3] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
    return matrix


HIP, THIGH, SHIN, FOOT = ([0, 1, 0], [0.1, -0.05, 0], [0, -0.45, 0], [0, -0.4, 0.1])


def test_a_bone_that_is_stretched_carries_a_bone_that_turns(tmp_path):
    build = Build(leg(thigh={"scale": [1, 1.5, 1]}), SKIN).animation().move(2, "rotation", TIMES, SWING)
    motion = gltf.read(build.glb(tmp_path / "x.glb"))
    expected = product([[shift(HIP)], [shift(THIGH), stretch([1, 1.5, 1])], [shift(SHIN), turn(SWING)], [shift(FOOT)]])
    np.testing.assert_allclose(motion.positions, expected, atol=1e-6)


def test_a_sheared_matrix_is_multiplied_as_a_matrix(tmp_path):
    matrix = np.eye(4)
    matrix[:3] = [[1, 0.4, 0, 0.1], [0, 1.2, 0.3, -0.05], [0.1, 0, 0.9, 0]]
    nodes = leg(thigh={"matrix": matrix.T.reshape(-1).tolist()})
    del nodes[1]["translation"]
    motion = gltf.read(Build(nodes, SKIN).animation().move(2, "rotation", TIMES, SWING).glb(tmp_path / "x.glb"))
    expected = product([[shift(HIP)], [matrix[None]], [shift(SHIN), turn(SWING)], [shift(FOOT)]])
    np.testing.assert_allclose(motion.positions, expected, atol=1e-6)
    gltf.write(tmp_path / "y.glb", motion)
    np.testing.assert_allclose(gltf.read(tmp_path / "y.glb").positions, expected, atol=1e-6)


def test_a_mirrored_skeleton_has_rotations_that_move_its_joints(tmp_path):
    nodes = leg(hip={"scale": [-2, 2, 2]})
    swing = about("z", 40 * np.sin(TIMES * 5))
    motion = gltf.read(Build(nodes, SKIN).animation().move(1, "rotation", TIMES, swing).glb(tmp_path / "x.glb"))
    expected = product([[shift(HIP), stretch([-2, 2, 2])], [shift(THIGH), turn(swing)], [shift(SHIN)], [shift(FOOT)]])
    np.testing.assert_allclose(motion.positions, expected, atol=1e-6)
    assert motion.skeleton is not None
    assert motion.rotations is not None
    root = motion.positions[:, 0] - motion.skeleton.offsets[0]
    moved = kinematics.forward(motion.skeleton, motion.rotations, root)
    np.testing.assert_allclose(moved, expected, atol=1e-6)
    gltf.write(tmp_path / "y.glb", motion)
    again = gltf.read(tmp_path / "y.glb")
    np.testing.assert_allclose(again.positions, expected, atol=1e-6)
    assert np.abs(np.sum(again.rotations * motion.rotations, axis=2)).min() > 1 - 1e-6


def test_animated_scale_moves_joints_and_is_kept(tmp_path):
    sizes = 1 + 0.3 * np.sin(TIMES * 4)[:, None] * [1, 0.5, 0]
    build = walking().move(1, "scale", TIMES, sizes)
    motion = gltf.read(build.glb(tmp_path / "x.glb"))
    expected = product([[shift(PATH)], [shift(THIGH), turn(SWING), stretch(sizes)], [shift(SHIN)], [shift(FOOT)]])
    np.testing.assert_allclose(motion.positions, expected, atol=1e-6)
    back = mc.decode(mc.encode(motion, codec="lossless"), mc.Motion)
    np.testing.assert_array_equal(back.extras["gltf"]["scales"].values[:, 0], sizes.astype(np.float32))
    assert len(back[5:20].extras["gltf"]["scales"].values) == 15
    for name, recording in (("y.glb", motion), ("z.glb", motion[5:20])):
        gltf.write(tmp_path / name, recording)
        again = gltf.read(tmp_path / name)
        np.testing.assert_allclose(again.positions, recording.positions, atol=1e-6)
        np.testing.assert_array_equal(again.extras["gltf"]["scales"].values, recording.extras["gltf"]["scales"].values)


def test_a_parent_scaled_to_nothing(tmp_path):
    sizes = np.maximum(1 - 2 * TIMES, 0)[:, None] * [1, 1, 1]
    motion = gltf.read(walking().move(1, "scale", TIMES, sizes).glb(tmp_path / "x.glb"))
    gltf.write(tmp_path / "y.glb", motion)
    np.testing.assert_allclose(gltf.read(tmp_path / "y.glb").positions, motion.positions, atol=1e-5)


@pytest.mark.parametrize("kind", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_sparse_keys_are_sampled_at_a_usual_rate_and_noted(tmp_path, kind):
    keys, places = np.array([0.0, 1.0, 1.5]), np.array([[0, 1, 0], [0.5, 1, 0], [0.5, 2, 0]])
    values = places
    if kind == "CUBICSPLINE":
        values = np.zeros((9, 3))
        values[1::3], values[5] = places, [1, 0, 0]
    motion = gltf.read(
        Build(leg(), SKIN).animation().move(0, "translation", keys, values, kind).glb(tmp_path / "x.glb")
    )
    assert (motion.rate, len(motion)) == (30, 46)
    assert any("sampled at 30 Hz (--rate)" in note for note in formats.notes(motion))
    middle = {"LINEAR": [0.25, 1, 0], "STEP": [0, 1, 0], "CUBICSPLINE": [0.25, 1, 0]}[kind]
    np.testing.assert_allclose(motion.positions[15, 0], middle, atol=1e-6)
    np.testing.assert_allclose(motion.positions[[30, 45], 0], places[1:], atol=1e-6)
    if kind == "STEP":
        np.testing.assert_array_equal(motion.positions[29, 0], motion.positions[0, 0])
    if kind == "CUBICSPLINE":  # leaves the second key with slope 1 along x
        t = 0.5
        np.testing.assert_allclose(motion.positions[37, 0, 0], 0.5 + 0.5 * (t**3 - 2 * t**2 + t), atol=0.01)


@pytest.mark.parametrize(
    ("times", "rate", "is_noted"),
    [
        (np.arange(200) / 30, 30, False),
        (np.arange(2000) * 1001 / 30000, 30000 / 1001, False),
        (np.arange(2000) / 59.94, 59.94, False),
        (np.arange(30) / 12.5, 12.5, False),
        (np.arange(20000) / 120, 120, False),
        (np.array([0, 3, 4, 10, 24, 25, 48]) / 24, 48, True),
        (np.array([0, 3, 4, 10, 24, 25, 48]) / 25, 50, True),
        (np.array([0, 1, 3, 4, 9]) / 60, 60, True),
        (np.cumsum(np.random.default_rng(1).uniform(0.015, 0.018, 300)), 60, True),
        (np.array([0.0, 7.0]), 30, True),
        (np.array([2.0]), 30, False),
    ],
)
def test_the_rate_follows_from_the_keys(tmp_path, times, rate, is_noted):
    values = np.zeros((len(times), 3))
    motion = gltf.read(Build(leg(), SKIN).animation().move(0, "translation", times, values).glb(tmp_path / "x.glb"))
    assert motion.rate == pytest.approx(rate, abs=1e-9 if rate != 59.94 else 1e-3)
    assert any("sampled at" in note for note in formats.notes(motion)) == is_noted
    assert abs((len(motion) - 1) / motion.rate - (times[-1] - times[0])) < 0.51 / motion.rate


def test_the_longest_animation_is_read_and_the_others_are_named(tmp_path):
    build = Build(leg(), SKIN).animation("TPose").move(1, "rotation", [0.0], about("x", 90.0))
    build.animation("Walk").move(0, "translation", TIMES, PATH).animation().move(2, "rotation", [0.0, 0.5], SWING[:2])
    path = build.glb(tmp_path / "x.glb")
    motion = gltf.read(path)
    assert len(motion) == 30
    assert motion.source["animation"] == "Walk"
    assert formats.notes(motion)[0].startswith('animation 1 "Walk" is read, the longest of 3')
    assert '"TPose", 2 (--animation)' in formats.notes(motion)[0]
    for wanted in ("TPose", 0, "0"):
        pose = gltf.read(path, animation=wanted)
        assert len(pose) == 1
        np.testing.assert_allclose(pose.positions[0, 2], [0.1, 0.95, -0.45], atol=1e-6)
        assert formats.notes(pose) == []
    for wanted in ("Run", 3, -1, "-1"):
        with pytest.raises(BadInput, match='it has: 0 "TPose", 1 "Walk"'):
            gltf.read(path, animation=wanted)


def two_people() -> Build:
    """Two legs, each with a skin; the second has a joint less. Both have a joint named foot."""
    other = [{**node, "children": [c + 4 for c in node["children"]]} if "children" in node else node for node in leg()]
    other[0] = {**other[0], "name": "hip2", "translation": [1, 1, 0]}
    skins = [{"name": "left", "joints": [0, 1, 2, 3]}, {"name": "right", "joints": [4, 5, 7]}]
    build = Build(leg() + other, skins).animation()
    return build.move(0, "translation", TIMES, PATH).move(6, "rotation", TIMES, SWING)


def test_skins_by_name_number_and_all(tmp_path):
    path = two_people().glb(tmp_path / "x.glb")
    motion = gltf.read(path)
    assert motion.names == ("hip", "thigh", "shin", "foot")
    assert formats.notes(motion) == [
        'skin 0 "left" is read, the one with most joints; --skin all reads all; not read: "right" (--skin)'
    ]
    for wanted in ("right", 1):
        right = gltf.read(path, skin=wanted)
        assert right.names == ("hip2", "thigh", "foot")
        assert right.skeleton is not None
        assert right.skeleton.parents == (-1, 0, 1)
        expected = product([[shift([1, 1, 0])], [shift(THIGH)], [shift(SHIN), turn(SWING)], [shift(FOOT)]])
        np.testing.assert_allclose(right.positions, expected[:, [0, 1, 3]], atol=1e-6)
    both = gltf.read(path, skin="all")
    assert both.names == ("hip", "thigh", "shin", "foot", "hip2", "thigh_2", "foot_2")
    assert both.source["labels"] == {"thigh_2": "thigh", "foot_2": "foot"}
    assert both.skeleton is not None
    assert both.skeleton.parents == (-1, 0, 1, 2, -1, 4, 5)
    gltf.write(tmp_path / "y.glb", both)
    again = gltf.read(tmp_path / "y.glb")
    assert again.names == both.names
    np.testing.assert_allclose(again.positions, both.positions, atol=1e-6)


def test_the_nodes_above_and_between_joints_come_back(tmp_path):
    nodes = [
        {"name": "Armature", "rotation": about("x", -90.0)[0].tolist(), "scale": [0.01] * 3, "children": [1]},
        {"name": "hip", "translation": [0, 0, 100], "rotation": about("z", 30.0)[0].tolist(), "children": [2]},
        {"name": "between", "translation": [5, 0, 0], "children": [3]},
        {"name": "knee", "translation": [5, 0, -45], "rotation": about("y", 20.0)[0].tolist(), "children": [4]},
        {"name": "foot", "translation": [0, 0, -40]},
    ]
    build = Build(nodes, [{"joints": [1, 3, 4]}]).animation("Walk")
    build.move(1, "translation", TIMES, PATH * 100).move(3, "rotation", TIMES, SWING)
    motion = gltf.read(build.glb(tmp_path / "x.glb"))
    assert motion.skeleton is not None
    assert motion.rotations is not None
    assert motion.skeleton.parents == (-1, 0, 1)
    root = motion.positions[:, 0] - motion.skeleton.offsets[0]
    np.testing.assert_allclose(kinematics.forward(motion.skeleton, motion.rotations, root), motion.positions, atol=1e-6)
    gltf.write(tmp_path / "y.glb", motion)
    content, _ = parts(tmp_path / "y.glb")
    for before, after in zip(nodes, content["nodes"], strict=False):
        assert before["name"] == after["name"]
        assert before.get("children") == after.get("children")
        for entry in ("translation", "rotation", "scale"):
            np.testing.assert_allclose(after.get(entry, 0), before.get(entry, after.get(entry, 0)), atol=1e-6)
    assert content["animations"][0]["name"] == "Walk"
    moved = {(c["target"]["node"], c["target"]["path"]) for c in content["animations"][0]["channels"]}
    assert moved == {(1, "translation"), (3, "rotation")}
    again = gltf.read(tmp_path / "y.glb")
    np.testing.assert_allclose(again.positions, motion.positions, atol=1e-6)


def armature() -> Build:
    """A leg in centimetres, lying, under a node that turns and scales it, with nodes that are turned at rest."""
    nodes = [
        {"name": "Armature", "rotation": about("x", -90.0)[0].tolist(), "scale": [0.01] * 3, "children": [1]},
        {"name": "hip", "translation": [0, 0, 100], "rotation": about("z", 30.0)[0].tolist(), "children": [2]},
        {"name": "knee", "translation": [5, 0, -45], "rotation": about("y", 20.0)[0].tolist(), "children": [3]},
        {"name": "foot", "translation": [0, 0, -40]},
    ]
    build = Build(nodes, [{"joints": [1, 2, 3]}]).animation("Walk")
    return build.move(1, "translation", TIMES, PATH * 100).move(2, "rotation", TIMES, SWING)


@pytest.mark.parametrize(
    ("change", "is_same_tree"),
    [
        (lambda m: m.turned("z"), True),
        (lambda m: m.turned("x"), True),
        (lambda m: mc.decode(mc.encode(m, codec="lossless"), mc.Motion), True),
        (lambda m: m[7:19], True),
        (lambda m: m[::3], True),
        (lambda m: m.resample(24), True),
        (lambda m: m.select(["hip", "knee"]), False),
        (lambda m: replace(m, skeleton=replace(m.skeleton, offsets=m.skeleton.offsets * 1.1)), False),
        (lambda m: replace(m, extras={"gltf": {**m.extras["gltf"], "parents": [0, 1, 2, 3]}}), False),
        (lambda m: replace(m, extras={"gltf": {"names": 7}}), False),
    ],
)
def test_a_motion_that_was_changed_is_written_right(tmp_path, change, is_same_tree):
    motion = change(gltf.read(armature().glb(tmp_path / "x.glb")))
    gltf.write(tmp_path / "y.glb", motion)
    again = gltf.read(tmp_path / "y.glb")
    assert again.up == motion.up
    np.testing.assert_allclose(again.positions, motion.positions, atol=2e-6)
    if motion.rotations is not None:
        assert np.abs(np.sum(again.rotations * motion.rotations, axis=2)).min() > 1 - 1e-6
        names = [node["name"] for node in parts(tmp_path / "y.glb")[0]["nodes"]]
        assert ("Armature" in names) == is_same_tree


def test_a_node_above_the_joints_may_move_them(tmp_path):
    nodes = [*leg(), {"name": "Armature", "children": [0], "rotation": about("y", 90.0)[0].tolist()}]
    build = Build(nodes, SKIN).animation().move(4, "translation", TIMES, PATH).move(4, "rotation", TIMES, SWING)
    motion = gltf.read(build.glb(tmp_path / "x.glb"))
    expected = product([[shift(PATH), turn(SWING), shift(HIP)], [shift(THIGH)], [shift(SHIN)], [shift(FOOT)]])
    np.testing.assert_allclose(motion.positions, expected, atol=1e-6)
    gltf.write(tmp_path / "y.glb", motion)
    np.testing.assert_allclose(gltf.read(tmp_path / "y.glb").positions, expected, atol=1e-6)


def test_integers_that_are_normalised(tmp_path):
    build = Build(leg(), SKIN).animation().move(0, "translation", TIMES, PATH)
    build.move(1, "rotation", TIMES, build.accessor(np.rint(SWING * 32767), "<i2", normalized=True))
    motion = gltf.read(build.glb(tmp_path / "x.glb"))
    np.testing.assert_allclose(motion.positions, gltf.read(walking().glb(tmp_path / "y.glb")).positions, atol=1e-4)


def test_sparse_accessors(tmp_path):
    build = walking()
    places = np.tile([0.0, 0.0, 0.0], (30, 1))
    places[[3, 7, 20]] = [[0, -0.4, 0.1], [0, -0.5, 0], [1, 2, 3]]
    indices = build.view(np.array([3, 7, 20], "<u2").tobytes())
    values = build.view(places[[3, 7, 20]].astype("<f4").tobytes())
    sparse = {
        "count": 3,
        "indices": {"bufferView": indices, "componentType": 5123},
        "values": {"bufferView": values},
    }
    build.move(3, "translation", TIMES, build.accessor(places, sparse=sparse))
    on_top = build.accessor(PATH, sparse=sparse, bufferView=build.view(PATH.astype("<f4").tobytes()))
    build.move(2, "translation", TIMES, on_top)
    motion = gltf.read(build.glb(tmp_path / "x.glb"))
    shins = PATH.copy()
    shins[[3, 7, 20]] = places[[3, 7, 20]]
    expected = product([[shift(PATH)], [shift(THIGH), turn(SWING)], [shift(shins)], [shift(places)]])
    np.testing.assert_allclose(motion.positions, expected, atol=1e-6)


def test_buffers_beside_the_file_and_in_it(tmp_path):
    build = walking()
    expected = gltf.read(build.glb(tmp_path / "x.glb")).positions
    (tmp_path / "walk cycle.bin").write_bytes(build.blob)
    inside = "data:application/octet-stream;base64," + base64.b64encode(build.blob).decode()
    for uri in ("walk%20cycle.bin", inside):
        content = {**build.json, "buffers": [{"uri": uri, "byteLength": len(build.blob)}]}
        (tmp_path / "x.gltf").write_text(json.dumps(content))
        (tmp_path / "y.glb").write_bytes(packed(content, None))
        for name in ("x.gltf", "y.glb"):
            motion = mc.read(tmp_path / name, mc.Motion)
            np.testing.assert_array_equal(motion.positions, expected)
    for uri in ("gone.bin", "../x.bin", "https://example.org/x.bin", "/etc/hostname"):
        content = {**build.json, "buffers": [{"uri": uri, "byteLength": len(build.blob)}]}
        (tmp_path / "x.gltf").write_text(json.dumps(content))
        with pytest.raises(BadInput, match=r"is missing|is not in its folder"):
            mc.read(tmp_path / "x.gltf")
    (tmp_path / "walk cycle.bin").write_bytes(build.blob[:-4])
    content = {**build.json, "buffers": [{"uri": "walk%20cycle.bin", "byteLength": len(build.blob)}]}
    (tmp_path / "x.gltf").write_text(json.dumps(content))
    with pytest.raises(BadInput, match="cut off"):
        mc.read(tmp_path / "x.gltf")


def test_required_extensions(tmp_path):
    build = walking()
    build.json["extensionsRequired"] = ["KHR_mesh_quantization", "KHR_materials_unlit", "KHR_draco_mesh_compression"]
    assert len(gltf.read(build.glb(tmp_path / "x.glb"))) == 30
    build.json["extensionsRequired"] = ["KHR_materials_unlit", "ACME_bones"]
    with pytest.raises(BadInput, match="requires the extension ACME_bones"):
        gltf.read(build.glb(tmp_path / "x.glb"))


def test_the_start_time_is_kept(tmp_path):
    build = Build(leg(), SKIN).animation().move(0, "translation", TIMES + 2.5, PATH)
    motion = gltf.read(build.glb(tmp_path / "x.glb"))
    assert start_s(motion.source, motion.rate) == pytest.approx(2.5)
    for recording, start in ((motion, 2.5), (motion[6:], 2.7)):
        gltf.write(tmp_path / "y.glb", recording)
        again = gltf.read(tmp_path / "y.glb")
        assert start_s(again.source, again.rate) == pytest.approx(start)


def test_morph_weights_are_noted(tmp_path):
    build = walking()
    build.json["animations"][0]["channels"].append({"sampler": 0, "target": {"node": 0, "path": "weights"}})
    (note,) = formats.notes(gltf.read(build.glb(tmp_path / "x.glb")))
    assert "1 channel of its animation" in note


def test_without_a_skin_animated_nodes_are_joints(tmp_path):
    nodes = [*leg(shin={"mesh": 0}, foot={"mesh": 0}), {"name": "camera", "camera": 0}]
    build = Build(nodes).animation().move(1, "rotation", TIMES, SWING).move(2, "rotation", TIMES, SWING)
    assert gltf.read(build.glb(tmp_path / "x.glb")).names == ("thigh", "shin")


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases in ../shared/cases are not here")
def test_the_shared_cases():
    frames = {"cubic.glb": 30, "ext.gltf": 30, "extbin.glb": 30, "nonuniform.glb": 30, "sparse.glb": 30}
    for name, count in {**frames, "twoanims.glb": 30, "uscale.glb": 30}.items():
        assert len(mc.read(CASES / name)) == count
    np.testing.assert_array_equal(
        mc.read(CASES / "ext.gltf", Motion).positions, mc.read(CASES / "extbin.glb", Motion).positions
    )
    for name, problem in {"meshopt.glb": "EXT_meshopt_compression", "long.glb": "too many"}.items():
        with pytest.raises(BadInput, match=problem):
            mc.read(CASES / name)
