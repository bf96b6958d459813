"""NPY: joints by shape, and HumanML3D's feature vectors against an encoder written from the data set's definition."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, Motion, formats
from mocodec.formats import smpl
from mocodec.geometry import kinematics, rotation_vectors


def body(frames: int = 40) -> np.ndarray:
    """22 joints of a body that walks along a curve, y up; (frames, 22, 3)."""
    rng = np.random.default_rng(0)
    t = np.arange(frames) / 20
    vectors = 0.4 * np.sin(3 * t[:, None, None] + rng.uniform(0, 6, (22, 3)))
    vectors[:, 0] = np.stack([0 * t, 0.7 * t, 0 * t], axis=1)
    root = np.stack([np.sin(t), 0.9 + 0.02 * np.cos(6 * t), t], axis=1)
    return kinematics.forward(smpl.trees()[22].stock, rotation_vectors.to_quaternions(vectors), root)


def features(positions: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """HumanML3D's vectors of positions whose root looks along `heading` (frames,), radians about y; the root starts at
    the origin looking along z. What follows from the joints is left at zero.
    """

    def seen(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
        turn = np.zeros((len(angle), 3, 3))
        turn[:, 0, 0], turn[:, 0, 2], turn[:, 1, 1] = np.cos(angle), -np.sin(angle), 1
        turn[:, 2, 0], turn[:, 2, 2] = np.sin(angle), np.cos(angle)
        return np.einsum("fab,f...b->f...a", turn.swapaxes(1, 2), vectors)

    result = np.zeros((len(positions), 263))
    result[:-1, 0] = np.diff(heading) / 2
    velocity = np.diff(positions[:, 0], axis=0)
    result[:-1, 1:3] = seen(velocity, heading[1:])[:, [0, 2]]
    result[:, 3] = positions[:, 0, 1]
    local = positions[:, 1:] - positions[:, :1] * [1, 0, 1]
    result[:, 4:67] = seen(local, heading).reshape(len(positions), -1)
    return result


def test_joints_of_humanml3d(tmp_path: Path) -> None:
    positions = body().astype(np.float32)
    np.save(tmp_path / "000001.npy", positions)
    motion = mc.read(tmp_path / "000001.npy", Motion)
    assert (motion.rate, motion.up, motion.names[21]) == (20.0, "y", "right_wrist")
    assert motion.skeleton is not None
    assert np.array_equal(motion.positions, positions.astype(np.float64))
    assert any("rate 20 Hz (--rate)" in note for note in formats.notes(motion))
    assert mc.read(tmp_path / "000001.npy", rate=30).rate == 30
    assert formats.dropped("x.npy", motion)[:2] == ["frame rate", "names"]
    mc.write(tmp_path / "back.npy", motion)
    back = np.load(tmp_path / "back.npy")
    assert (back.dtype, back.shape) == (np.float32, positions.shape)
    assert np.array_equal(back, positions)


def test_joints_that_are_no_body_have_no_names(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.random.default_rng(0).normal(size=(5, 22, 3)))
    motion = mc.read(tmp_path / "a.npy", Motion)
    assert (motion.names[0], motion.up, motion.skeleton) == ("P1", "y", None)
    np.savez(tmp_path / "b.npz", joints3d=body(), fps=20)
    named = mc.read(tmp_path / "b.npz", Motion)
    assert named.names[0] == "pelvis"


def test_other_numbers_of_joints_need_a_rate(tmp_path: Path) -> None:
    positions = np.random.default_rng(0).normal(size=(5, 17, 3))
    positions[2, 3, 1] = np.nan
    np.save(tmp_path / "a.npy", positions * 1000)
    with pytest.raises(BadInput, match="--rate"):
        mc.read(tmp_path / "a.npy")
    motion = mc.read(tmp_path / "a.npy", Motion, rate=50, unit="mm", up="y")
    assert motion.gaps.sum() == 1
    np.testing.assert_allclose(motion.positions[0], positions[0])
    mc.write(tmp_path / "b.npy", motion)
    assert np.isnan(np.load(tmp_path / "b.npy")).sum() == 3


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "m"), (50.0, "m"), (1000.0, "mm")])
def test_the_unit_is_guessed_by_the_extent_of_a_frame(tmp_path: Path, scale: float, unit: str) -> None:
    """Millimetres are recognised; a playing field of 90 m stays in metres, and what mocodec writes is in metres."""
    positions = body() * scale
    np.save(tmp_path / "a.npy", positions)
    np.savez(tmp_path / "b.npz", joints3d=positions, fps=20)
    for name in ("a.npy", "b.npz"):
        motion = mc.read(tmp_path / name, Motion)
        assert motion.source["units"] == unit
        assert any(f"unit {unit} (--unit)" in note for note in formats.notes(motion))
        np.testing.assert_allclose(motion.positions, positions * motion.source["unit_m"])
    wide = Motion(positions, 20.0)
    mc.write(tmp_path / "c.npz", wide)
    np.testing.assert_array_equal(mc.read(tmp_path / "c.npz", Motion).positions, positions)


def test_feature_vectors_are_decoded(tmp_path: Path) -> None:
    positions = body()
    positions = positions - positions[0, 0] * [1, 0, 1]
    heading = 0.7 * np.arange(len(positions)) / 20
    np.save(tmp_path / "a.npy", features(positions, heading).astype(np.float32))
    motion = mc.read(tmp_path / "a.npy", Motion)
    np.testing.assert_allclose(motion.positions, positions, atol=2e-5)
    assert motion.names[0] == "pelvis"
    assert any("feature vectors" in note for note in formats.notes(motion))
    normalised = (features(positions, heading) - 0.1) / np.random.default_rng(0).uniform(0.05, 3, 263)
    np.save(tmp_path / "b.npy", normalised)
    with pytest.raises(BadInput, match="normalised"):
        mc.read(tmp_path / "b.npy")


@pytest.mark.parametrize(
    ("array", "says"),
    [
        (np.zeros((4, 251)), "KIT-ML"),
        (np.zeros((4, 7)), r"\(frames, joints, 3\)"),
        (np.zeros(3), r"\(frames, joints, 3\)"),
        (np.zeros((0, 41, 3)), "has no frames"),
        (np.array([[["a", "b", "c"]]]), "must be numbers"),
        (np.full((4, 22, 3), np.inf), r"a\.npy: .*infinite"),
    ],
)
def test_other_arrays_are_named(tmp_path: Path, array: np.ndarray, says: str) -> None:
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(BadInput, match=says):
        mc.read(tmp_path / "a.npy")


def test_in_pieces_errors_name_the_file_and_the_frames(tmp_path: Path) -> None:
    path, positions = tmp_path / "long.npy", np.zeros((7000, 41, 3))
    np.save(path, positions[:0])
    with pytest.raises(BadInput, match=r"long\.npy: has no frames"):
        mc.read_blocks(path, rate=120)
    positions[6500, 1, 2] = np.inf
    np.save(path, positions)
    blocks = mc.read_blocks(path, rate=120)
    begin = len(next(iter(blocks)))
    with pytest.raises(BadInput, match=rf"long\.npy: in the frames from {begin:,} on, .* frame {6500 - begin} of them"):
        list(blocks)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300])
def test_feature_vectors_that_are_no_numbers_are_one_line(tmp_path: Path, value: float) -> None:
    np.save(tmp_path / "x.npy", np.full((5, 263), value))
    with pytest.raises(BadInput, match="feature vectors"):
        formats.read(tmp_path / "x.npy")


def test_objects_and_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(BadInput, match="pickle"):
        mc.read(path)
    np.save(path, body())
    whole = path.read_bytes()
    for cut in (0, 5, 60, 200, len(whole) - 1):
        path.write_bytes(whole[:cut])
        with pytest.raises(BadInput):
            mc.read(path)
    path.write_bytes(whole.replace(b"(40, 22, 3)", b"(4000000000000, 22, 3)"[:11]))
    with pytest.raises(BadInput):
        mc.read(path)
