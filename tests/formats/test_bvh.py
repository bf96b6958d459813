"""BVH: joints where the hierarchy and its channels put them; the file again from the motion just read."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import mocodec as mc
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


def test_written_back_as_it_came(tmp_path):
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
def test_the_unit_as_told(tmp_path, unit, unit_m):
    assert read(tmp_path, unit=unit).source["unit_m"] == unit_m


@pytest.mark.parametrize(
    ("frame_time", "rate"),
    [("0.0083333", 120.0), (".0166667", 60.0), ("0.033333", 30.0), ("0.04", 25.0), ("0.0333667", 1 / 0.0333667)],
)
def test_rates_that_were_rounded(tmp_path, frame_time, rate):
    assert read(tmp_path, BVH.replace("0.0083333", frame_time)).rate == rate


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
        ("Zrotation Yrotation Xrotation", "Zrotation Yrotation Wrotation", "unreadable channels"),
        ("CHANNELS 6", "CHANNELS 5", "unreadable channels"),
        ("CHANNELS 6", "CHANNELS six", "cannot be read"),
        ("OFFSET 1.0 2.0 3.0", "OFFSET 1.0 nan 3.0", "three numbers"),
        ("OFFSET 1.0 2.0 3.0", "OFFSET 1.0", "three numbers"),
        ("ROOT", "BRANCH", "unknown word"),
        ("JOINT Head", "ROOT Head", "inside"),
        ("0.0083333", "0", "Frame Time"),
        ("0.0083333", "-1", "Frame Time"),
        ("Frames: 3", "Frames: 4", "cut off"),
        ("Frames: 3", "Frames: 2", "2 frames of"),
        ("Frames: 3", "Frames: many", "Frames:"),
        ("9 92", "9 inf", "'inf'"),
        ("9 92", "9 x", "'x'"),
    ],
)
def test_damage_is_one_clear_line(tmp_path, old, new, says):
    with pytest.raises(BadInput, match=says):
        read(tmp_path, BVH.replace(old, new, 1))


def test_an_unknown_unit(tmp_path):
    for unit in ("furlong", -1.0):
        with pytest.raises(BadInput, match="unit"):
            read(tmp_path, unit=unit)


def test_what_a_bvh_cannot_hold_is_refused(tmp_path):
    motion = read(tmp_path)
    with pytest.raises(BadInput, match="does not store rotations yet"):
        formats.write(tmp_path / "y.bvh", mc.decode(mc.encode(motion, codec="lossless")))
    with pytest.raises(BadInput, match="skeleton and rotations"):
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
