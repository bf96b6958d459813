"""ASF/AMC: the skeleton file that is written beside an AMC equals the one that was read; bones of other skeletons."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from mocodec import BadInput, Motion, formats
from mocodec.formats.asf import read_asf
from mocodec.geometry import rigid
from mocodec.testing.skeletal import random_motion

from .samples import AMC, ASF, BVH

UNLIMITED = ASF.replace("limits (-20 20)", "").replace("(-20 20)", "")
OTHER_ORDER = ASF.replace("dof rx rz", "dof rz rx").replace("axis -90 0 20 XYZ", "axis -90 0 20 YZX")
ROOT_ORDER = ASF.replace("order TX TY TZ RX RY RZ", "order RZ TY RX TX TZ RY").replace("axis XYZ", "axis ZXY")
RADIANS = (
    ASF.replace("angle deg", "angle rad")
    .replace("axis 0 0 20", "axis 0 0 0.35")
    .replace("axis -90 0 20", "axis -1.5 0 0.35")
)
RADIANS = RADIANS.replace("(-20 20)", "(-0.5 0.5)")
MOVED = (
    ASF.replace("position 0 0 0", "position 1 2 3")
    .replace("orientation 0 0 0", "orientation 10 20 30")
    .replace("length 0.45", "length 2.54")
)


def read(tmp_path, asf: str, amc: str = AMC) -> Motion:
    (tmp_path / "in").mkdir(exist_ok=True)
    (tmp_path / "in" / "tiny.asf").write_text(asf)
    (tmp_path / "in" / "tiny.amc").write_text(amc)
    motion = formats.read(tmp_path / "in" / "tiny.amc")
    assert isinstance(motion, Motion)
    return motion


def coded(motion: Motion, degrees: float = 0.05) -> Motion:
    """What a .mocz gives back: rotations a little off, offsets in steps of 10 µm, the source as JSON."""
    rng = np.random.default_rng(1)
    off = rigid.from_euler("xyz", np.radians(rng.normal(0, degrees, (len(motion), motion.points, 3))))
    skeleton = replace(motion.skeleton, offsets=np.rint(motion.skeleton.offsets / 1e-5) * 1e-5)
    source = json.loads(json.dumps(dict(motion.source)))
    return replace(motion, rotations=rigid.multiply(motion.rotations, off), skeleton=skeleton, source=source)


@pytest.mark.parametrize("asf", [ASF, UNLIMITED, OTHER_ORDER, ROOT_ORDER, RADIANS, MOVED])
def test_the_skeleton_file_comes_back(tmp_path, asf):
    is_radians = "angle rad" in asf
    amc = AMC.replace(":DEGREES", ":RADIANS") if is_radians else AMC
    if is_radians:
        amc = re.sub(r"(-50|90|-100|-20|100)\b", "1", amc)
    motion = read(tmp_path, asf, amc)
    before = read_asf(tmp_path / "in" / "tiny.asf")
    for number, again in enumerate((motion, coded(motion))):
        folder = tmp_path / f"out{number}"
        folder.mkdir()
        formats.write(folder / "walk.amc", again)
        after = read_asf(folder / "walk.asf")
        assert (after.parents, after.degrees) == (before.parents, before.degrees)
        assert after.length == pytest.approx(before.length, rel=1e-9)
        for new, old in zip(after.bones, before.bones, strict=True):
            assert (new.name, new.dof, new.order) == (old.name, old.dof, old.order)
            assert np.allclose(new.offset, old.offset, atol=1e-8 if number == 0 else 2e-3)
            assert np.allclose(new.axis, old.axis, atol=1e-7)
            assert np.allclose(new.limits, old.limits)
        read_back = formats.read(folder / "walk.amc")
        assert read_back.source == motion.source
        assert np.abs(read_back.positions - again.positions).max() < (1e-7 if number == 0 else 2e-3)


def test_only_degrees_of_freedom_of_the_skeleton_are_written(tmp_path):
    motion = coded(read(tmp_path, ASF))
    (tmp_path / "out").mkdir()
    formats.write(tmp_path / "out" / "walk.amc", motion)
    frames = (tmp_path / "out" / "walk.amc").read_text().split("\n")
    assert [len(line.split()) for line in frames[2:8]] == [1, 7, 4, 4, 2, 3]
    assert not any(word in "".join(frames) for word in ("nan", "e+"))


@pytest.mark.parametrize(("rate", "said"), [(120.0, False), (60.0, True), (119.88, True)])
def test_the_rate_is_written_where_it_is_not_cmus(tmp_path, rate, said):
    motion = replace(read(tmp_path, ASF), rate=rate)
    formats.write(tmp_path / "walk.amc", motion)
    assert (":SAMPLES-PER-SECOND" in (tmp_path / "walk.amc").read_text()) == said
    assert formats.read(tmp_path / "walk.amc").rate == rate


def test_the_skeleton_of_another_trial_in_the_folder_is_left_alone(tmp_path):
    motion = read(tmp_path, ASF)
    other = ASF.replace("length 7", "length 9")
    (tmp_path / "01.asf").write_text(other)
    formats.write(tmp_path / "walk.amc", motion)
    assert (tmp_path / "01.asf").read_text() == other
    formats.write(tmp_path / "01_01.amc", motion)
    assert np.allclose(formats.read(tmp_path / "01_01.amc").positions, motion.positions, atol=1e-7)
    (tmp_path / "02.asf").write_text(other)
    with pytest.raises(BadInput, match="another skeleton's"):
        formats.write(tmp_path / "02.amc", motion)


def test_another_unit(tmp_path):
    motion = read(tmp_path, ASF)
    for _ in range(2):  # the second time the skeleton is there
        formats.write(tmp_path / "walk.amc", motion, unit="cm")
        assert read_asf(tmp_path / "walk.asf").unit_m == pytest.approx(0.01)
        assert np.allclose(formats.read(tmp_path / "walk.amc").positions, motion.positions, atol=1e-7)
    with pytest.raises(BadInput, match="in another unit"):
        formats.write(tmp_path / "walk.amc", motion, unit="m")


@pytest.mark.parametrize("seed", range(4))
def test_bones_of_any_skeleton(tmp_path, seed):
    motion = random_motion(10, seed=seed, zeros=0.2)
    names = ("Hips", "a b", "begin", "1st", "end", "x#y", "root", "a_b", "Ende", "k:l")
    motion = replace(motion, names=names, skeleton=replace(motion.skeleton, names=names))
    formats.write(tmp_path / "walk.amc", motion)
    again = formats.read(tmp_path / "walk.amc")
    distances = np.abs(again.positions[:, :, None] - motion.positions[:, None]).max(axis=(0, 3))
    assert distances.min(axis=0).max() < 1e-6


def test_a_bvh_becomes_an_amc_and_a_bvh_again(tmp_path):
    text = BVH.replace("90   1 31 2", "90   0 30 0").replace("-45  2 29 3", "-45  0 30 0")  # the head keeps its place
    (tmp_path / "x.bvh").write_text(text)
    motion = formats.read(tmp_path / "x.bvh", unit="cm")
    formats.write(tmp_path / "x.amc", motion)
    formats.write(tmp_path / "y.bvh", formats.read(tmp_path / "x.amc"))
    again = formats.read(tmp_path / "y.bvh", unit="cm")
    distances = np.abs(again.positions[:, :, None] - motion.positions[:, None]).max(axis=(0, 3))
    assert distances.min(axis=0).max() < 1e-6
    assert {"Chest", "Left_Arm", "Head"} <= set(again.names)


def test_what_has_no_bones_is_one_line(tmp_path):
    (tmp_path / "x.bvh").write_text(BVH)
    with pytest.raises(BadInput, match=r"x.amc: joint Head moves against its parent .* one length"):
        formats.write(tmp_path / "x.amc", formats.read(tmp_path / "x.bvh", unit="cm"))
    motion = random_motion(4)
    two = replace(motion, skeleton=replace(motion.skeleton, parents=(-1, 0, -1, 2)))
    with pytest.raises(BadInput, match="one root, this skeleton has 2"):
        formats.write(tmp_path / "x.amc", two)
    assert not (tmp_path / "x.asf").exists()


def test_a_part_of_the_bones(tmp_path):
    motion = read(tmp_path, ASF)
    for number, names in enumerate((["root", "femur", "tibia"], ["femur", "tibia", "foot"])):
        part = motion.select(names)
        formats.write(tmp_path / f"part{number}.amc", part)
        again = formats.read(tmp_path / f"part{number}.amc")
        assert np.allclose(again.positions, part.positions, atol=1e-7)


@pytest.mark.parametrize(
    ("entry", "value"), [("channels", "xyz"), ("channels", [1]), ("axes", ["0 0 XYZ"]), ("axes", 3)]
)
def test_a_damaged_memory_is_one_line(tmp_path, entry, value):
    motion = read(tmp_path, UNLIMITED)
    with pytest.raises(BadInput, match="source"):
        formats.write(tmp_path / "walk.amc", replace(motion, source={**motion.source, entry: value}))


@pytest.mark.parametrize("in_degrees", [True, False])
def test_an_amc_in_another_unit_of_angle_than_its_asf_stays_so(tmp_path, in_degrees):
    asf, amc = (RADIANS, AMC) if in_degrees else (ASF, AMC.replace(":DEGREES", ":RADIANS"))
    amc = amc if in_degrees else re.sub(r"(-50|90|-100|-20|100)\b", "1", amc)
    motion = read(tmp_path, asf, amc)
    formats.write(tmp_path / "walk.amc", motion)
    assert (":DEGREES" in (tmp_path / "walk.amc").read_text()) == in_degrees
    assert read_asf(tmp_path / "walk.asf").degrees != in_degrees
    assert np.allclose(formats.read(tmp_path / "walk.amc").positions, motion.positions, atol=1e-6)


def test_a_still_body_keeps_its_degrees_of_freedom(tmp_path):
    motion = random_motion(30)
    still = np.broadcast_to([1.0, 0, 0, 0], motion.rotations.shape)
    motion = replace(motion, rotations=still, positions=np.broadcast_to(_rest(motion.skeleton), motion.positions.shape))
    formats.write(tmp_path / "walk.amc", motion)
    again = formats.read(tmp_path / "walk.amc")
    assert np.allclose(again.positions[:, 0], motion.positions[:, 0], atol=1e-7)
    assert sum(bone.dof == ("rx", "ry", "rz") for bone in read_asf(tmp_path / "walk.asf").bones) > 10


def _rest(skeleton) -> np.ndarray:
    """Positions (joints, 3) of the rest pose."""
    places = skeleton.offsets.copy()
    for joint, parent in enumerate(skeleton.parents):
        places[joint] += places[parent] if parent >= 0 else 0.0
    return places
