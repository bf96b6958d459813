"""Shell points, angles and forward kinematics on numbers worked out by hand, and against mocodec's own kinematics."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import Motion, Skeleton, cli, metrics
from mocodec.cli import verify
from mocodec.geometry import kinematics, rigid
from mocodec.metrics import skeletal

ARM = Skeleton(("shoulder", "elbow", "hand"), (-1, 0, 1), np.array([[0, 0, 1.0], [0.3, 0, 0], [0.25, 0, 0]]))


def arm(frames: int = 4, twist: float = 0.0, bend: float = 0.0) -> Motion:
    """An arm along x; the shoulder twists about the bone, the elbow bends about y; radians."""
    rotations = np.zeros((frames, 3, 4))
    rotations[..., 0] = 1
    rotations[:, 0] = rigid.about_axis("x", np.full(frames, twist))
    rotations[:, 1] = rigid.about_axis("y", np.full(frames, bend))
    positions = kinematics.forward(ARM, rotations, np.zeros((frames, 3)))
    return Motion(positions, 60, ARM.names, "z", ARM, rotations)


def random_motion(seed: int = 0, frames: int = 5, own_frame: bool = False) -> Motion:
    """A tree of nine joints with two roots in random poses."""
    rng = np.random.default_rng(seed)
    tree = Skeleton(tuple("abcdefghi"), (-1, 0, 1, 1, 3, -1, 5, 5, 0), rng.normal(size=(9, 3)))
    rotations = rng.normal(size=(frames, 9, 4))
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    positions = kinematics.forward(tree, rotations, rng.normal(size=(frames, 3)), own_frame=own_frame)
    return Motion(positions, 60, tree.names, "z", tree, rotations, {"format": "amc"} if own_frame else {})


def test_a_twist_moves_no_joint_but_shell_points_and_frames() -> None:
    result = metrics.compare(arm(), arm(twist=np.radians(10))).skeletal
    assert result is not None
    chord = 2 * 0.03 * np.sin(np.radians(5))  # of the points along y and z; the one along x stays
    assert result.shell.largest == pytest.approx(chord)
    assert result.shell.mean == pytest.approx(chord * 2 / 3)
    assert result.joints_and_shell.mean == pytest.approx(chord / 2)
    assert result.world_degrees.mean == pytest.approx(10)
    assert result.local_degrees.mean == pytest.approx(10 / 3)
    assert result.local_degrees.at == (0, "shoulder")
    assert result.per_joint["hand"]["local_degrees_max"] == pytest.approx(0, abs=1e-9)


def test_a_bend_is_measured_where_it_shows() -> None:
    result = metrics.compare(arm(), arm(bend=np.radians(2)), shell=0.1)
    assert result.max_error == pytest.approx(2 * 0.25 * np.sin(np.radians(1)))
    assert result.max_at is not None
    assert result.max_at[1] == "hand"
    assert result.skeletal is not None
    assert result.skeletal.per_joint["elbow"]["shell_max"] == pytest.approx(2 * 0.1 * np.sin(np.radians(1)))
    assert result.skeletal.world_degrees.largest == pytest.approx(2)


@pytest.mark.parametrize("degrees", [0, 1e-7, 1e-3, 1, 90, 179.999, 180])
def test_angles_small_and_large(degrees: float) -> None:
    a, b = np.eye(3), skeletal.matrices(rigid.about_axis("y", np.radians(degrees)))
    assert skeletal.angles(a, b) == pytest.approx(degrees, rel=1e-6, abs=1e-12)


def test_a_quaternion_and_its_negative_are_the_same_rotation() -> None:
    motion = random_motion()
    assert motion.rotations is not None
    signs = np.random.default_rng(1).choice([-1.0, 1.0], motion.rotations.shape[:2])[..., None]
    result = metrics.compare(motion, replace(motion, rotations=signs * motion.rotations)).skeletal
    assert result is not None
    assert result.world_degrees.largest == 0.0
    assert result.shell.largest == 0.0
    assert result.shell.at is not None


@pytest.mark.parametrize("own_frame", [False, True])
def test_forward_kinematics_agrees_with_the_other_implementation(own_frame: bool) -> None:
    motion = random_motion(own_frame=own_frame)
    assert motion.rotations is not None
    assert motion.skeleton is not None
    np.testing.assert_allclose(skeletal.forward(motion), motion.positions, atol=1e-12)
    world = skeletal.world_matrices(motion.skeleton.parents, skeletal.matrices(motion.rotations))
    np.testing.assert_allclose(
        world, rigid.to_matrix(kinematics.world_rotations(motion.skeleton, motion.rotations)), atol=1e-12
    )
    moved = motion.positions.copy()
    moved[2, 4] += [0, 0.05, 0]
    result = metrics.compare(motion, replace(motion, positions=moved)).skeletal
    assert result is not None
    assert result.kinematic_gap_m == pytest.approx(0.05)


def test_joints_are_matched_by_name_and_gaps_left_out() -> None:
    motion = random_motion(frames=3)
    assert motion.skeleton is not None
    assert motion.rotations is not None
    order = [5, 6, 0, 1, 8, 3, 4, 2, 7]
    tree = Skeleton(
        tuple(motion.names[j] for j in order),
        tuple(order.index(p) if (p := motion.skeleton.parents[j]) >= 0 else -1 for j in order),
        motion.skeleton.offsets[order],
    )
    positions = motion.positions[:, order].copy()
    positions[1, 0] = np.nan
    other = Motion(positions, 60, tree.names, "z", tree, motion.rotations[:, order])
    result = metrics.compare(motion, other).skeletal
    assert result is not None
    assert result.world_degrees.largest < 1e-5
    assert result.joints_and_shell.largest < 1e-12
    assert result.kinematic_gap_m < 1e-12


def test_blocks_of_frames_give_the_same_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = random_motion(1, 23), random_motion(2, 23)
    whole = metrics.compare(a, b)
    monkeypatch.setattr(skeletal, "BLOCK_VALUES", 5 * 9)
    assert metrics.compare(a, b) == whole


def test_motions_without_rotations_or_of_other_conventions_have_no_pose_errors() -> None:
    motion = random_motion()
    assert metrics.compare(motion, replace(motion, rotations=None)).skeletal is None
    assert metrics.compare(motion, replace(motion, source={"format": "amc"})).skeletal is None
    assert metrics.compare(motion[:0], motion[:0]).skeletal is not None


def test_the_command_shows_shell_points_and_angles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    mc.write("a.npz", arm())
    mc.write("b.npz", arm(twist=np.radians(10)))
    assert cli.run(["compare", "a.npz", "b.npz"]) == 0
    text = capsys.readouterr().out
    assert "shell points, 30 mm off" in text
    assert "10.0°" in text
    assert "angle max" in text
    assert cli.run(["compare", "a.npz", "b.npz", "--json", "--shell", "1cm"]) == 0
    pose = json.loads(capsys.readouterr().out)["skeletal"]
    assert pose["shell_m"] == 0.01
    assert pose["world_degrees"]["largest"] == pytest.approx(10)
    assert cli.run(["compare", "a.npz", "b.npz", "--plot", "a.png", "--poses", "b.png"]) == 0


def test_a_promise_covers_shell_points_and_angles_of_files_that_keep_rotations() -> None:
    motion, twisted = arm(), arm(twist=np.radians(10))
    facts = {"bytes": 100, "bytes_by_part": {"extras": 0}}
    chord = 2 * 0.03 * np.sin(np.radians(5))
    for promise, words in (
        ({"max_error": chord * 0.99}, ["max error over joints and shell points 30 mm off is 5.23 mm"]),
        ({"max_error": chord * 1.01, "mean_error": chord * 0.51}, []),
        ({"mean_error": chord * 0.49}, ["mean error over joints and shell points"]),
        ({"max_rotation": 9.9}, ["max rotation is 10.0°, promised 9.9°"]),
        ({"max_rotation": 10.1}, []),
    ):
        _, broken = verify.check(promise, motion, twisted, facts)
        assert len(broken) == len(words)
        assert all(part in whole for part, whole in zip(words, broken, strict=True))
    assert verify.check({"max_error": 1e-6}, motion, replace(twisted, rotations=None), facts)[1] == []
    assert verify.check({"max_error": chord * 0.99}, motion, twisted, facts, shell=0.02)[1] == []
    assert verify.shell_of({"shell": 0.02}) == 0.02
