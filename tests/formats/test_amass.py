"""AMASS and its relatives: every array comes back, on the bones of a stock body or of a model file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, Motion, Signal, formats
from mocodec.cli import run, verify
from mocodec.formats import amass, smpl

FRAMES = 24


def poses(numbers: int, frames: int = FRAMES, dtype: Any = np.float64) -> np.ndarray:
    """Smooth rotation vectors; the root turns once about the vertical, as a body with z up does."""
    rng = np.random.default_rng(numbers)
    t = np.linspace(0, 2 * np.pi, frames)
    values = 0.5 * np.sin(t[:, None] + rng.uniform(0, 6, numbers)) * rng.uniform(0, 1, numbers)
    values[:, :3] = np.stack([np.pi / 2 + 0.1 * np.sin(t), 0.2 * np.cos(t), 1.5 + t / 2], axis=1)
    return values.astype(dtype)


def trans(frames: int = FRAMES) -> np.ndarray:
    t = np.arange(frames) / 30
    return np.stack([t, 0.1 * np.sin(t), 0.9 + 0.02 * np.cos(5 * t)], axis=1)


def amass_arrays(numbers: int = 156, **more: Any) -> dict[str, Any]:
    rate = {"mocap_frame_rate" if numbers == 165 else "mocap_framerate": np.array(120.0)}
    arrays = {"trans": trans(), "gender": np.array("female"), **rate, "betas": np.linspace(-1, 1, 16)}
    return {**arrays, "dmpls": np.ones((FRAMES, 8)), "poses": poses(numbers), **more}


def save(path: Path, arrays: dict[str, Any]) -> Path:
    np.savez(path, **arrays)
    return path


def read(path: Path, **options: Any) -> Motion:
    return mc.read(path, Motion, **options)


def same_arrays(path: Path, arrays: dict[str, Any], atol: float = 1e-12) -> None:
    """An .npz has these arrays: names, order, shapes, types and values."""
    with np.load(path) as found:
        assert found.files == list(arrays)
        for name, value in arrays.items():
            expected = np.asarray(value)
            assert (found[name].dtype, found[name].shape) == (expected.dtype, expected.shape), name
            if expected.dtype.kind == "f":
                np.testing.assert_allclose(found[name], expected, atol=atol, err_msg=name)
            else:
                assert np.array_equal(found[name], expected)


@pytest.mark.parametrize(("numbers", "model"), [(66, "body"), (72, "smpl"), (156, "smplh"), (165, "smplx")])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_every_array_comes_back(tmp_path: Path, numbers: int, model: str, dtype: Any) -> None:
    arrays = amass_arrays(numbers, poses=poses(numbers, dtype=dtype))
    motion = read(save(tmp_path / "a.npz", arrays))
    assert (motion.points, motion.rate, motion.up, len(motion)) == (numbers // 3, 120.0, "z", FRAMES)
    assert motion.source["model"] == model
    assert motion.names[:3] == ("pelvis", "left_hip", "right_hip")
    np.testing.assert_allclose(motion.positions[:, 0], trans())
    assert motion.rotations is not None
    assert np.allclose(np.linalg.norm(motion.rotations, axis=-1), 1, atol=1e-15)
    assert formats.dropped("b.npz", motion) == []
    mc.write(tmp_path / "b.npz", motion)
    same_arrays(tmp_path / "b.npz", arrays, 1e-12 if dtype == np.float64 else 1e-6)


def test_rotation_vectors_keep_their_length_after_errors_of_the_rotations(tmp_path: Path) -> None:
    arrays = amass_arrays()
    motion = read(save(tmp_path / "a.npz", arrays))
    assert motion.rotations is not None
    noisy = motion.rotations + 1e-3 * np.random.default_rng(0).normal(size=motion.rotations.shape)
    noisy *= -1 / np.linalg.norm(noisy, axis=-1, keepdims=True)
    mc.write(
        tmp_path / "b.npz",
        Motion(motion.positions, 120, motion.names, "z", motion.skeleton, noisy, motion.source, motion.extras),
    )
    same_arrays(tmp_path / "b.npz", arrays, atol=0.05)


def test_a_slice_has_its_own_rows(tmp_path: Path) -> None:
    dmpls = np.random.default_rng(0).normal(size=(FRAMES, 8))
    arrays = amass_arrays(dmpls=dmpls, betas=np.zeros(FRAMES))
    motion = read(save(tmp_path / "a.npz", arrays))
    mc.write(tmp_path / "b.npz", motion[10:15])
    cut = {name: arrays[name][10:15] for name in ("trans", "dmpls", "poses")}
    same_arrays(tmp_path / "b.npz", {**arrays, **cut})
    mc.write(tmp_path / "c.npz", motion[::2])
    cut = {name: arrays[name][::2] for name in ("trans", "dmpls", "poses")}
    same_arrays(tmp_path / "c.npz", {**arrays, **cut, "mocap_framerate": np.array(60.0)})


def test_parts_of_the_poses_apart_or_beside_them(tmp_path: Path) -> None:
    whole = poses(165)
    parts = {
        name: whole[:, slice(*amass.parts_of("smplx")[name])]
        for name in ("root_orient", "pose_body", "pose_hand", "pose_jaw", "pose_eye")
    }
    common = {"surface_model_type": np.array("smplx"), "mocap_frame_rate": np.array(30), "trans": trans()}
    for arrays in ({**common, **parts}, {**common, "poses": whole, **parts}):
        motion = read(save(tmp_path / "a.npz", arrays))
        assert motion.points == 55
        same = read(save(tmp_path / "c.npz", {**common, "poses": whole}))
        np.testing.assert_allclose(motion.positions, same.positions)
        mc.write(tmp_path / "b.npz", motion)
        same_arrays(tmp_path / "b.npz", arrays)
    body = {"global_orient": whole[:, :3], "body_pose": np.zeros((FRAMES, 23, 3)), "transl": trans(), "fps": 25}
    motion = read(save(tmp_path / "a.npz", body))
    assert motion.points == 24
    mc.write(tmp_path / "b.npz", motion)
    same_arrays(tmp_path / "b.npz", body)


def test_a_part_that_contradicts_the_poses_is_kept_as_it_is(tmp_path: Path) -> None:
    arrays = amass_arrays(pose_body=np.ones((FRAMES, 63)))
    mc.write(tmp_path / "b.npz", read(save(tmp_path / "a.npz", arrays)))
    same_arrays(tmp_path / "b.npz", arrays)


def test_dance_sequences_in_units_of_the_body(tmp_path: Path) -> None:
    arrays = {"smpl_poses": poses(72), "smpl_trans": trans() * 90, "smpl_scaling": np.array([90.0])}
    motion = read(save(tmp_path / "a.npz", arrays))
    assert (motion.rate, motion.up) == (60.0, "y")
    assert any("rate 60 Hz (--rate)" in note for note in formats.notes(motion))
    np.testing.assert_allclose(motion.positions[:, 0], trans())
    mc.write(tmp_path / "b.npz", motion)
    same_arrays(tmp_path / "b.npz", arrays)


def test_python_objects_are_never_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pickle

    arrays = amass_arrays(
        165, gender=np.array("neutral", dtype=object), markers_latent_vids=np.array({"a": 1}, dtype=object)
    )
    path = save(tmp_path / "a.npz", arrays)
    monkeypatch.setattr(pickle, "load", None)
    motion = read(path)
    assert any("gender, markers_latent_vids" in note for note in formats.notes(motion))
    mc.write(tmp_path / "b.npz", mc.read(path))
    monkeypatch.undo()
    with np.load(tmp_path / "b.npz", allow_pickle=True) as found:
        assert found["gender"].item() == "neutral"
        assert found["markers_latent_vids"].item() == {"a": 1}


def model_file(path: Path, joints: int, seed: int = 0) -> tuple[Path, np.ndarray]:
    """A model of few vertices; returns its joints for the betas of `amass_arrays`."""
    rng = np.random.default_rng(seed)
    tree = smpl.trees()[joints]
    kintree = np.array([[4294967295, *tree.parents[1:]], range(joints)], np.uint32)
    regressor, vertices = rng.uniform(0, 1, (joints, 70)), rng.normal(size=(70, 3))
    directions = rng.normal(size=(70, 3, 10))
    np.savez(path, J_regressor=regressor, v_template=vertices, shapedirs=directions, kintree_table=kintree)
    return path, regressor @ (vertices + directions @ np.linspace(-1, 1, 16)[:10])


def test_bones_of_a_model_file_with_the_shape_of_the_person(tmp_path: Path) -> None:
    arrays = amass_arrays()
    model, joints = model_file(tmp_path / "model.npz", 52)
    path = save(tmp_path / "a.npz", arrays)
    motion = read(path, smplx=str(model))
    assert motion.skeleton is not None
    np.testing.assert_allclose(motion.positions[:, 0], joints[0] + trans())
    np.testing.assert_allclose(motion.skeleton.offsets[4], joints[4] - joints[1])
    mc.write(tmp_path / "b.npz", motion)
    same_arrays(tmp_path / "b.npz", arrays)
    assert run(["info", str(path), "--smplx", str(model)]) == 0
    for wrong, says in (
        (model_file(tmp_path / "other.npz", 55)[0], "a model of 55 joints"),
        (path, "not a model of the SMPL family"),
        (tmp_path / "none.npz", "no such file"),
        (tmp_path / "model.pkl", "pickle"),
    ):
        with pytest.raises(BadInput, match=says):
            read(path, smplx=str(wrong))
    np.savez(tmp_path / "x.npz", positions=np.zeros((5, 2, 3)), rate=1.0)
    with pytest.raises(BadInput, match="smplx="):
        read(tmp_path / "x.npz", smplx=str(model))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"poses": poses(99)}, "99 numbers a frame; known are 66"),
        ({"poses": np.full((FRAMES, 156), np.nan)}, "'poses' is not finite at frame 0"),
        ({"poses": np.full((FRAMES, 156), 5e3)}, "radians"),
        ({"poses": np.zeros(156)}, "numbers for each frame"),
        ({"poses": np.array([["a"] * 156])}, "numbers for each frame"),
        ({"poses": np.zeros((0, 156))}, "numbers for each frame"),
        ({"poses": np.array([[None] * 156])}, "Python objects"),
        ({"trans": np.zeros((3, 3))}, "'trans' must be numbers for each frame"),
        ({"trans": np.zeros((FRAMES, 2))}, "3 numbers a frame"),
        ({"mocap_framerate": np.array(-1.0)}, "rate must be"),
        ({"mocap_framerate": np.array(60 + 1j)}, "rate must be"),
        ({"up": np.array("up")}, "up must be"),
    ],
)
def test_invalid_arrays_raise_one_line(tmp_path: Path, change: dict[str, Any], says: str) -> None:
    with pytest.raises(BadInput, match=says):
        read(save(tmp_path / "a.npz", amass_arrays(**change)))


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    arrays = amass_arrays()
    del arrays["mocap_framerate"]
    path = save(tmp_path / "a.npz", arrays)
    with pytest.raises(BadInput, match="--rate"):
        read(path)
    assert read(path, rate=60).rate == 60
    del arrays["trans"]
    motion = read(save(tmp_path / "b.npz", arrays), rate=60)
    assert any("stays at the origin" in note for note in formats.notes(motion))
    with pytest.raises(BadInput, match="shape of a body"):
        mc.read(save(tmp_path / "shape.npz", {"betas": np.zeros(16), "gender": np.array("male")}))
    (tmp_path / "x.pkl").write_bytes(b"x")
    with pytest.raises(BadInput, match="pickle runs code"):
        mc.read(tmp_path / "x.pkl")


def test_layouts_of_the_writer(tmp_path: Path) -> None:
    motion = read(save(tmp_path / "a.npz", amass_arrays()))
    mc.write(tmp_path / "own.npz", motion, layout="mocodec")
    own = read(tmp_path / "own.npz")
    assert np.array_equal(own.positions, motion.positions)
    assert formats.dropped("b.npz", Motion(motion.positions, 120, source=motion.source, extras=motion.extras)) == [
        "body model parameters beside the poses (betas, gender, …)"
    ]
    other = Motion(own.positions, 120, own.names, "y", own.skeleton, own.rotations)
    mc.write(tmp_path / "c.npz", other, layout="amass")
    with np.load(tmp_path / "c.npz") as found:
        assert found.files == ["trans", "mocap_framerate", "poses", "up"]
    again = read(tmp_path / "c.npz")
    assert again.up == "y"
    np.testing.assert_allclose(again.positions, other.positions, atol=1e-12)
    with pytest.raises(BadInput, match="rotations of the joints"):
        mc.write(tmp_path / "d.npz", Motion(np.zeros((2, 3, 3)), 10), layout="amass")
    with pytest.raises(BadInput, match="layout is one of"):
        mc.write(tmp_path / "d.npz", motion, layout="x")


@pytest.mark.parametrize(
    "layout",
    [5, [5], [["poses", "O", [156]]], [["poses", "<f8", [10**9]]], [["poses", "<f8", [7]]], [["trans", "<f8"]]],
)
def test_a_forged_layout_does_no_harm(tmp_path: Path, layout: Any) -> None:
    motion = read(save(tmp_path / "a.npz", amass_arrays()))
    forged = {**motion.source, "layout": layout}
    branches = {"branches": Signal(np.zeros((FRAMES, 1), np.int8), 120.0, ("pelvis",)), "arrays": 7}
    motion = Motion(
        motion.positions, 120, motion.names, "z", motion.skeleton, motion.rotations, forged, {"amass": branches}
    )
    mc.write(tmp_path / "b.npz", motion)
    with np.load(tmp_path / "b.npz") as found:
        assert "poses" not in found.files or found["poses"].shape == (FRAMES, 156)


def test_the_stock_body_is_an_adult_of_about_170_cm() -> None:
    skeleton = smpl.trees()[55].stock
    heights = np.zeros((55, 3))
    for joint, parent in enumerate(skeleton.parents):
        heights[joint] = skeleton.offsets[joint] + (heights[parent] if parent >= 0 else 0)
    assert 1.4 < np.ptp(heights[:, 1]) < 1.75
    left = [j for j, name in enumerate(skeleton.names) if name.startswith("left")]
    right = [skeleton.names.index(skeleton.names[j].replace("left", "right")) for j in left]
    np.testing.assert_allclose(heights[right], heights[left] * [-1, 1, 1])
    assert np.array_equal(skeleton.offsets, np.round(skeleton.offsets, 5))
    assert set(smpl.trees()) == {22, 24, 52, 55}


@pytest.mark.parametrize("numbers", [72, 156, 165])
def test_a_mocz_between(tmp_path: Path, numbers: int) -> None:
    arrays = amass_arrays(numbers, gender=np.array("male", dtype=object) if numbers == 165 else np.array("male"))
    motion = read(save(tmp_path / "a.npz", arrays))
    decoded = mc.decode(mc.encode(motion, max_error=0.002), Motion)
    assert dict(decoded.source) == dict(motion.source)
    assert verify.differing(motion.extras, decoded.extras) == []
    errors = mc.compare(motion, decoded)
    assert errors.skeletal is not None
    assert errors.skeletal.joints_and_shell.largest <= 0.002 * (1 + 1e-9)
    mc.write(tmp_path / "b.npz", decoded)
    arrays["gender"] = np.array("male")
    if numbers == 165:
        with np.load(tmp_path / "b.npz", allow_pickle=True) as found:
            assert found["gender"].item() == "male"
            np.testing.assert_allclose(found["poses"], arrays["poses"], atol=0.2)
        return
    same_arrays(tmp_path / "b.npz", arrays, atol=0.2)
    cut = mc.open(mc.encode(motion, max_error=0.002))[5:11]
    mc.write(tmp_path / "c.npz", cut)
    with np.load(tmp_path / "c.npz") as found:
        np.testing.assert_allclose(found["poses"], arrays["poses"][5:11], atol=0.2)
        assert found["dmpls"].shape == (6, 8)
