"""Written GLB: skin and bones, names, units, sparse keys; motions of other formats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, Motion, Skeleton
from mocodec.formats import gltf
from mocodec.formats.gltf import bones
from mocodec.geometry import bone_frames, kinematics, rigid
from mocodec.testing import synthetic

from ..samples import AMC, ASF, BVH
from .build import parts


@pytest.fixture
def walk() -> Motion:
    return synthetic.joints(frames=240, seed=3)


def arrays(path) -> tuple[dict, list[np.ndarray]]:
    """The JSON of a GLB, and the float and integer arrays of its accessors."""
    content, blob = parts(path)
    types = {5126: "<f4", 5121: "u1", 5123: "<u2", 5125: "<u4"}
    widths = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
    found = []
    for accessor in content["accessors"]:
        view, width = content["bufferViews"][accessor["bufferView"]], widths[accessor["type"]]
        kind = np.dtype(types[accessor["componentType"]])
        flat = np.frombuffer(blob, kind, accessor["count"] * width, view["byteOffset"])
        found.append(flat.reshape(-1, width))
    return content, found


def test_joints_are_a_skin_whose_bind_pose_is_the_rest_pose(tmp_path, walk):
    gltf.write(tmp_path / "x.glb", walk)
    content, values = arrays(tmp_path / "x.glb")
    (skin,) = content["skins"]
    assert [content["nodes"][node]["name"] for node in skin["joints"]] == list(walk.names)
    world = {}
    for node in skin["joints"]:  # all turned by nothing at rest: matrices only translate
        above = next((world[p] for p in world if node in content["nodes"][p].get("children", [])), np.zeros(3))
        world[node] = above + content["nodes"][node]["translation"]
        inverse = values[skin["inverseBindMatrices"]][node].reshape(4, 4).T
        np.testing.assert_allclose(inverse @ [*world[node], 1], [0, 0, 0, 1], atol=1e-6)
    primitive = content["meshes"][0]["primitives"][0]
    weights = values[primitive["attributes"]["WEIGHTS_0"]]
    assert (weights.sum(axis=1) == 255).all()
    assert values[primitive["indices"]].max() == len(weights) - 1


def test_bones_are_closed_and_look_outwards():
    rest = np.array([[0.0, 0, 0], [0, 1, 0], [1, 1, 0], [0, 1, -2], [0, -1, 0]])
    mesh = bones.mesh(rest, (-1, 0, 1, 1, 0))
    assert mesh.joints[::6].tolist() == [0, 1, 1, 0, 2, 3, 4]  # four bones; joints 2, 3 and 4 have none
    for first in range(0, len(mesh.points), 6):
        corners = mesh.points[first : first + 6]
        triangles = corners[mesh.triangles[mesh.triangles[:, 0] // 6 == first // 6] - first]
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        outwards = triangles.mean(axis=1) - corners.mean(axis=0)
        assert (np.sum(normals * outwards, axis=1) > 0).all()
        assert np.abs(normals.sum(axis=0)).max() < 1e-12  # closed


@pytest.mark.parametrize("up", ["y", "z"])
def test_bvh_comes_back(tmp_path, up):
    (tmp_path / "x.bvh").write_text(BVH)
    motion = mc.read(tmp_path / "x.bvh", mc.Motion, up=up, unit="cm")
    mc.write(tmp_path / "x.glb", motion)
    back = mc.read(tmp_path / "x.glb", mc.Motion)
    assert back.names == motion.names
    assert motion.skeleton is not None
    assert back.skeleton is not None
    assert back.skeleton.parents == motion.skeleton.parents
    np.testing.assert_allclose(back.skeleton.offsets, motion.skeleton.offsets, atol=1e-6)
    np.testing.assert_allclose(back.positions, motion.positions, atol=1e-6)
    assert np.abs(np.sum(back.rotations * motion.rotations, axis=2)).min() > 1 - 1e-6


def test_joints_of_an_amc_are_at_the_starts_of_bones(tmp_path):
    (tmp_path / "x.amc").write_text(AMC)
    (tmp_path / "x.asf").write_text(ASF)
    motion = mc.read(tmp_path / "x.amc", mc.Motion)
    mc.write(tmp_path / "x.glb", motion)
    back = mc.read(tmp_path / "x.glb", mc.Motion)
    expected = bone_frames.to_starts(motion)
    assert back.names == expected.names
    np.testing.assert_allclose(back.positions, expected.positions, atol=1e-6)
    assert back.skeleton is not None
    assert back.rotations is not None
    moved = kinematics.forward(back.skeleton, back.rotations, back.positions[:, 0] - back.skeleton.offsets[0])
    np.testing.assert_allclose(moved, back.positions, atol=1e-6)


def test_two_roots_share_one_skin(tmp_path):
    """A skin's joints need a common node above them."""
    one = synthetic.joints(frames=20, seed=1)
    assert one.skeleton is not None
    n = one.points
    parents = (*one.skeleton.parents, *(p + n if p >= 0 else -1 for p in one.skeleton.parents))
    names = (*one.names, *(f"{name} B" for name in one.names))
    motion = Motion(
        np.concatenate([one.positions, one.positions + np.array([1.0, 0, 0])], axis=1),
        one.rate,
        names,
        "y",
        Skeleton(names, parents, np.tile(one.skeleton.offsets, (2, 1))),
        np.tile(one.rotations, (1, 2, 1)),
    )
    gltf.write(tmp_path / "x.glb", motion)
    content, _ = parts(tmp_path / "x.glb")
    assert [content["nodes"][node]["name"] for node in content["scenes"][0]["nodes"]] == ["y up", "bones"]
    back = gltf.read(tmp_path / "x.glb")
    assert back.names == names
    assert back.skeleton is not None
    assert back.skeleton.parents == parents
    np.testing.assert_allclose(back.positions, motion.positions, atol=1e-6)
    assert "gltf" not in back.extras


def test_what_does_not_move_takes_one_key(tmp_path, walk):
    rotations = walk.rotations.copy()
    rotations[:, 3] = rigid.about_axis("x", np.array(0.3))
    rotations[:, 4] = [1, 0, 0, 0]
    positions = kinematics.forward(walk.skeleton, rotations, walk.positions[:, 0])
    gltf.write(tmp_path / "x.glb", replace(walk, positions=positions, rotations=rotations))
    content, values = arrays(tmp_path / "x.glb")
    animation = content["animations"][0]
    keys = {
        (c["target"]["node"], c["target"]["path"]): len(values[animation["samplers"][c["sampler"]]["input"]])
        for c in animation["channels"]
    }
    assert keys[3, "rotation"] == 1
    assert (4, "rotation") not in keys
    assert keys[0, "translation"] == keys[2, "rotation"] == 240
    np.testing.assert_allclose(gltf.read(tmp_path / "x.glb").positions, positions, atol=1e-5)


@pytest.mark.parametrize("tolerance", [0.001, 0.01, 0.05])
def test_sparse_keys_hold_the_tolerance(tmp_path, walk, tolerance):
    gltf.write(tmp_path / "x.glb", walk, keys=tolerance)
    back = gltf.read(tmp_path / "x.glb")
    assert (back.rate, len(back), back.names) == (walk.rate, len(walk), walk.names)
    assert walk.skeleton is not None
    worst = [np.linalg.norm(back.positions - walk.positions, axis=2).max()]
    world = [kinematics.world_rotations(m.skeleton, m.rotations) for m in (back, walk)]
    for axis in np.eye(3) * 0.03:
        made, true = (m.positions + rigid.rotate(w, axis) for m, w in zip((back, walk), world, strict=True))
        worst.append(np.linalg.norm(made - true, axis=2).max())
    assert 0.3 * tolerance < max(worst) <= tolerance + 1e-5
    content, _ = parts(tmp_path / "x.glb")
    samplers = content["animations"][0]["samplers"]
    assert sum(s["interpolation"] == "CUBICSPLINE" for s in samplers) > len(samplers) / 2
    keys = sum(content["accessors"][s["input"]]["count"] for s in samplers)
    assert keys < {0.001: 0.25, 0.01: 0.1, 0.05: 0.06}[tolerance] * walk.points * len(walk)


def test_looser_tolerances_need_fewer_keys(tmp_path, walk):
    sizes = []
    for number, tolerance in enumerate((0.0005, 0.002, 0.008, 0.03, 0.1)):
        gltf.write(tmp_path / f"{number}.glb", walk, keys=tolerance)
        sizes.append((tmp_path / f"{number}.glb").stat().st_size)
    assert sizes == sorted(sizes, reverse=True)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_sparse_keys_of_few_frames(tmp_path, walk, frames):
    for recording in (walk[:frames], replace(walk[:frames], rotations=None, skeleton=None)):
        gltf.write(tmp_path / "x.glb", recording, keys=0.001)
        back = gltf.read(tmp_path / "x.glb")
        assert len(back) == frames
        assert np.linalg.norm(back.positions - recording.positions, axis=2).max() <= 0.001 + 1e-6


def test_a_still_motion_keeps_its_frames(tmp_path, walk):
    still = replace(
        walk, positions=np.repeat(walk.positions[:1], 50, 0), rotations=np.repeat(walk.rotations[:1], 50, 0)
    )
    for options in ({}, {"keys": 0.001}):
        gltf.write(tmp_path / "x.glb", still, **options)
        back = gltf.read(tmp_path / "x.glb")
        assert len(back) == 50
        np.testing.assert_allclose(back.positions, still.positions, atol=1e-3)


def test_markers_that_stand_still_are_kept(tmp_path):
    positions = synthetic.markers(frames=20, seed=1).positions.copy()
    positions[:, 7] = [1, 2, 3]
    for options in ({}, {"keys": 0.001}):
        gltf.write(tmp_path / "x.glb", Motion(positions, 100), **options)
        np.testing.assert_allclose(gltf.read(tmp_path / "x.glb").positions, positions, atol=0.00101)


@pytest.mark.parametrize("keys", [0.0, -1.0, float("nan"), float("inf")])
def test_keys_is_a_distance(tmp_path, walk, keys):
    with pytest.raises(BadInput, match="keys is a distance"):
        gltf.write(tmp_path / "x.glb", walk, keys=keys)


def test_units_are_metres_in_the_file(tmp_path, walk):
    gltf.write(tmp_path / "x.glb", walk)
    in_decimetres = gltf.read(tmp_path / "x.glb", unit="dm")
    np.testing.assert_allclose(in_decimetres.positions, walk.positions * 0.1, atol=1e-6)
    gltf.write(tmp_path / "y.glb", in_decimetres)
    np.testing.assert_allclose(gltf.read(tmp_path / "y.glb").positions, walk.positions * 0.1, atol=1e-6)
