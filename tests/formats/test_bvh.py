"""BVH: positions of joints, guesses of unit and up, rates, and writing."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from mocodec import BadInput, Motion, Skeleton, formats

from .samples import BVH, SHARED, markers, needs_shared


def read(tmp_path, text: str = BVH, **options) -> Motion:
    (tmp_path / "x.bvh").write_text(text)
    motion = formats.read(tmp_path / "x.bvh", **options)
    assert isinstance(motion, Motion)
    return motion


def channels(path) -> np.ndarray:
    """The numbers of a file's MOTION."""
    rows = path.read_text().partition("Frame Time:")[2].split("\n")[1:]
    return np.array([row.split() for row in rows if row.strip()], float)


def test_joints_of_a_still_pose(tmp_path):
    motion = read(tmp_path, unit="cm")
    assert motion.names == ("Hips", "Chest", "Left Arm", "Left Arm_end", "Head", "Head_end")
    assert motion.skeleton is not None
    assert motion.skeleton.parents == (-1, 0, 1, 2, 1, 4)
    expected = [[0, 0.9, 0], [0, 1.4, 0], [0.2, 1.5, 0], [0.8, 1.5, 0], [0, 1.7, 0], [0, 1.9, 0]]
    assert np.allclose(motion.positions[0], expected)
    assert (motion.rate, motion.up, motion.source["unit_m"]) == (120.0, "y", 0.01)


def test_turns_and_slides(tmp_path):
    motion = read(tmp_path, unit="cm")
    hips, chest, arm, end, head, _ = motion.positions[1] * 100
    assert np.allclose(hips, [5, 91, 1])
    assert np.allclose(chest - hips, [-50, 0, 0])  # 90° about z: up becomes −x
    assert np.allclose(arm - chest, [-10, 20, 0])
    assert np.allclose(end - arm, [0, 60, 0])
    assert np.allclose(head - chest, [-31, 2, 1])  # positions z y x in the place of the OFFSET: (2, 31, 1)


def test_writing_restores_the_file(tmp_path):
    motion = read(tmp_path)
    formats.write(tmp_path / "y.bvh", motion)
    assert np.abs(channels(tmp_path / "y.bvh") - channels(tmp_path / "x.bvh")).max() < 1e-6

    def words(path):  # numbers as numbers, layout aside
        text = path.read_text().partition("MOTION")[0]
        return [float(w) if re.fullmatch(r"[-\d.]+", w) else w for w in text.split()]

    assert words(tmp_path / "y.bvh") == words(tmp_path / "x.bvh")
    again = formats.read(tmp_path / "y.bvh")
    assert np.allclose(again.positions, motion.positions, atol=1e-8)
    assert again.source == motion.source
    assert again.names == motion.names


def test_angles_beyond_half_a_turn_make_the_same_motion(tmp_path):
    motion = read(tmp_path, BVH.replace("10 -20 170", "370 -120 530"))
    formats.write(tmp_path / "y.bvh", motion)
    assert np.allclose(formats.read(tmp_path / "y.bvh").positions, motion.positions, atol=1e-8)


@pytest.mark.parametrize(
    ("height", "units"), [(170, "cm"), (1.7, "m"), (1700, "mm"), (28, "ASF"), (66, "in"), (9000, "cm"), (0, "cm")]
)
def test_the_unit_is_the_one_that_makes_a_person(tmp_path, height, units):
    text = re.sub(r"OFFSET .*", f"OFFSET 0 {height / 3} 0", BVH)
    assert read(tmp_path, text).source["units"] == units


@pytest.mark.parametrize(("unit", "unit_m"), [("in", 0.0254), ("0.02", 0.02), (0.5, 0.5)])
def test_the_unit_option(tmp_path, unit, unit_m):
    assert read(tmp_path, unit=unit).source["unit_m"] == unit_m


@pytest.mark.parametrize(
    ("frame_time", "rate"),
    [
        ("0.0083333", 120.0),
        (".0166667", 60.0),
        ("0.033333", 30.0),
        ("0.04", 25.0),
        ("0.0333667", 30000 / 1001),
        ("0.017", 60.0),
        ("0.0333", 30.0),
        ("1.6667e-02", 60.0),
        ("0.008342", 120000 / 1001),
        ("0.016683", 60000 / 1001),
        ("0.041708", 24000 / 1001),
        ("0.0123", 81.0),
        ("0.1", 10.0),
        ("0.012345678", 1 / 0.012345678),
    ],
)
def test_rates_that_were_rounded(tmp_path, frame_time, rate):
    assert read(tmp_path, BVH.replace("0.0083333", frame_time)).rate == rate


def test_motion_may_be_part_of_a_name(tmp_path):
    expected = read(tmp_path)
    for name in ("LOCOMOTION", "MOTION", "MOTION Frames", "a MOTION"):
        motion = read(tmp_path, BVH.replace("ROOT Hips", f"ROOT {name}"))
        assert motion.names[0] == name
        assert np.array_equal(motion.positions, expected.positions)


@pytest.mark.parametrize(("declared", "frames"), [(4, 3), (2, 3)])
def test_one_frame_more_or_fewer_than_declared_is_noted(tmp_path, declared, frames):
    motion = read(tmp_path, BVH.replace("Frames: 3", f"Frames: {declared}"))
    assert len(motion) == frames
    assert any(f"declares {declared} frames, the file has {frames}" in note for note in formats.notes(motion))


def standing(up: str, rest_up: str, unit: float) -> str:
    """A body 1.7 m tall that walks; the rest pose stands along `rest_up`, the motion along `up`."""
    bones = {"Hips": (0, 0, 0), "Head": (0, 0.75, 0.05), "LeftFoot": (0.1, -0.95, 0), "RightFoot": (-0.1, -0.95, 0)}
    bones |= {"LeftHand": (0.8, 0.5, 0), "RightHand": (-0.8, 0.5, 0)}

    def text(vector, axis) -> str:
        x, y, z = (v / unit for v in vector)
        return f"{x:.4f} {y:.4f} {z:.4f}" if axis == "y" else f"{x:.4f} {-z:.4f} {y:.4f}"

    lines = ["HIERARCHY", "ROOT Hips", "{", "OFFSET 0 0 0", "CHANNELS 6 Xposition Yposition Zposition"]
    lines[-1] += " Xrotation Yrotation Zrotation"
    for name, offset in list(bones.items())[1:]:
        lines += [f"JOINT {name}", "{", f"OFFSET {text(offset, rest_up)}", "CHANNELS 1 Xrotation", "End Site", "{"]
        lines += [f"OFFSET {text((0, 0.02, 0), rest_up)}", "}", "}"]
    lines += ["}", "MOTION", "Frames: 40", "Frame Time: 0.0333333"]
    turn = {"yy": 0, "zz": 0, "zy": 90, "yz": -90}[up + rest_up]
    for i in range(40):
        lines.append(f"{text((0, 0.95, i * 0.1), up)} {turn} 0 0 {np.sin(i)} 0 0 0 0")
    return "\n".join(lines)


@pytest.mark.parametrize("unit", [0.01, 1.0, 0.001, 0.0254 / 0.45])
@pytest.mark.parametrize(("up", "rest_up"), [("y", "y"), ("z", "z"), ("z", "y")])
def test_up_and_unit_are_guessed_from_the_motion_and_said(tmp_path, up, rest_up, unit):
    text = standing(up, rest_up, unit)
    motion = read(tmp_path, text)
    assert (motion.up, motion.source["unit_m"]) == (up, unit)
    assert formats.notes(motion) == [f"guessed: up {up} (--up), unit {motion.source['units']} (--unit)"]
    given = read(tmp_path, text, up="x", unit=0.5)
    assert (given.up, formats.notes(given)) == ("x", [])


def test_nesting_is_bounded(tmp_path):
    ends = "End Site {\nOFFSET 0 1 0\n" * 2
    with pytest.raises(BadInput, match="End Site"):
        read(tmp_path, BVH.replace("End Site\n      {\n        OFFSET 60.0 0.0 0.0\n", ends + "}\n", 1))
    deep = "".join(f"JOINT j{i} {{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n" for i in range(100_000))
    with pytest.raises(BadInput, match="1000 deep"):
        read(
            tmp_path,
            f"HIERARCHY\nROOT r {{\nOFFSET 0 0 0\n{deep}\nMOTION\nFrames: 0\n",
        )


def test_a_skeleton_from_elsewhere(tmp_path):
    skeleton = Skeleton(("a", "b", "c"), (-1, 0, 1), np.array([[0, 1, 0], [0, 0.5, 0], [0, 0.4, 0]]))
    rotations = np.zeros((4, 3, 4))
    rotations[..., 0] = 1
    positions = np.cumsum(np.tile(skeleton.offsets, (4, 1, 1)), axis=1)
    motion = Motion(positions, 60.0, skeleton.names, "y", skeleton, rotations)
    formats.write(tmp_path / "x.bvh", motion)
    assert np.allclose(formats.read(tmp_path / "x.bvh", unit="cm").positions, positions)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("HIERARCHY", "", "does not begin with HIERARCHY"),
        ("MOTION", "", "no MOTION"),
        ("}\nMOTION", "MOTION", "brace is not closed"),
        ("}\nMOTION", "}\n}\nMOTION", "a } without a {"),
        ("Zrotation Yrotation Xrotation", "Zrotation Yrotation Wrotation", "unreadable channels"),
        ("CHANNELS 6", "CHANNELS 5", "unreadable channels"),
        ("CHANNELS 6", "CHANNELS six", "cannot be read"),
        ("OFFSET 1.0 2.0 3.0", "OFFSET 1.0 nan 3.0", "three numbers"),
        ("OFFSET 1.0 2.0 3.0", "OFFSET 1.0", "three numbers"),
        ("ROOT", "BRANCH", "unknown word"),
        ("JOINT Head", "ROOT Head", "inside"),
        ("0.0083333", "0", "Frame Time"),
        ("0.0083333", "-1", "Frame Time"),
        ("Frames: 3", "Frames: 5", "cut off"),
        ("Frames: 3", "Frames: 1", "1 frames of"),
        ("Frames: 3", "Frames: many", "Frames:"),
        ("9 92", "9 inf", "'inf'"),
        ("9 92", "9 x", "'x'"),
    ],
)
def test_damage_raises_one_line(tmp_path, old, new, says):
    with pytest.raises(BadInput, match=says):
        read(tmp_path, BVH.replace(old, new, 1))


def test_an_unknown_unit(tmp_path):
    for unit in ("furlong", -1.0):
        with pytest.raises(BadInput, match="unit"):
            read(tmp_path, unit=unit)


def test_motions_that_a_bvh_cannot_hold_are_refused(tmp_path):
    motion = read(tmp_path)
    with pytest.raises(BadInput, match=r"needs a skeleton and rotations, .* only positions on a skeleton"):
        formats.write(tmp_path / "y.bvh", replace(motion, rotations=None))
    with pytest.raises(BadInput, match="only positions of points; write a"):
        formats.write(tmp_path / "y.bvh", markers())
    gappy = np.array(motion.positions)
    gappy[1, 2] = np.nan
    with pytest.raises(BadInput, match="gaps"):
        formats.write(tmp_path / "y.bvh", replace(motion, positions=gappy))


@needs_shared
@pytest.mark.parametrize("name", ["131_01", "salsa_28"])
def test_real_files_go_round(tmp_path, name):
    motion = formats.read(SHARED / "cmu" / "bvh" / f"{name}.bvh")
    assert motion.rate == 120.0
    formats.write(tmp_path / "x.bvh", motion)
    assert np.abs(formats.read(tmp_path / "x.bvh").positions - motion.positions).max() < 1e-8
