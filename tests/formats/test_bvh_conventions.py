"""BVH: what a file looks like comes back, also after a codec has changed its rotations a little."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from mocodec import BadInput, Motion, Skeleton, formats
from mocodec.geometry import kinematics, rigid
from mocodec.testing.skeletal import random_motion

from .samples import BVH

ODD = """HIERARCHY
ROOT Hips
{
\tOFFSET 0.00 0.00 0.00
\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
\tJOINT Leg
\t{
\t\tOFFSET 10.123456 -0.654321 0.000001
\t\tCHANNELS 3 Zrotation Xrotation Yrotation
\t\tJOINT Knee
\t\t{
\t\t\tOFFSET 0.5 -42.000007 0.25
\t\t\tCHANNELS 3 Zrotation Xrotation Yrotation
\t\t\tEnd Site
\t\t\t{
\t\t\t\tOFFSET 0 -40 0
\t\t\t}
\t\t\tEnd Site
\t\t\t{
\t\t\t\tOFFSET 0 -41 0
\t\t\t}
\t\t}
\t}
\tJOINT Leg
\t{
\t\tOFFSET -10.1 0 0
\t\tCHANNELS 0
\t\tJOINT My Knee
\t\t{
\t\t\tOFFSET 0 -42 0
\t\t\tCHANNELS 4 Xrotation Yposition Zrotation Yrotation
\t\t}
\t}
\tJOINT Plate_end
\t{
\t\tOFFSET 0 0 0
\t\tCHANNELS 0
\t}
}
ROOT Hips
{
\tOFFSET 1 2 3
\tCHANNELS 1 Yposition
\tEnd Site
\t{
\t\tOFFSET 0 80 0
\t}
}
MOTION
Frames: 40
Frame Time: .0166667
"""


def odd_text(frames: int = 40) -> str:
    """A file with two roots, repeated names, joints without channels, constants and angles of several turns."""
    rows = []
    for f in range(frames):
        t = f / 10
        hips = [10 * t, 90 + t, -5.5, 350 + 20 * t, 3 * t, 100 * np.sin(t)]
        leg = [0, 95 + 5 * np.sin(t), 0]
        knee = [-10 * t, 12.5, 0]
        slide = [5 * t, -42 + np.sin(t), 180 + t, 400 - 3 * t]
        rows.append(" ".join(f"{v:.6f}" for v in [*hips, *leg, *knee, *slide, 80]))
    return ODD + "\n".join(rows) + "\n"


def read(tmp_path, text: str, **options) -> Motion:
    (tmp_path / "x.bvh").write_text(text)
    motion = formats.read(tmp_path / "x.bvh", **options)
    assert isinstance(motion, Motion)
    return motion


def coded(motion: Motion, degrees: float = 0.05) -> Motion:
    """What a .mocz gives back: rotations a little off, offsets in steps of 10 µm, the source as JSON."""
    rng = np.random.default_rng(1)
    off = rigid.from_euler("xyz", np.radians(rng.normal(0, degrees, (len(motion), motion.points, 3))))
    rotations = rigid.multiply(motion.rotations, off)
    skeleton = replace(motion.skeleton, offsets=np.rint(motion.skeleton.offsets / 1e-5) * 1e-5)
    signs = np.sign(rng.normal(size=rotations.shape[:2]))[..., None]
    source = json.loads(json.dumps(dict(motion.source)))
    positions = motion.positions + rng.normal(0, 1e-5, motion.positions.shape)
    return replace(motion, positions=positions, rotations=rotations * signs, skeleton=skeleton, source=source)


def halves(path) -> tuple[list[str], np.ndarray]:
    """The lines above the frames, without indents, and the numbers of the frames."""
    head, _, rows = re.split(r"(Frame Time:.*\n)", path.read_text())
    lines = [" ".join(line.split()) for line in path.read_text().split("\n")[: head.count("\n") + 1]]
    return lines, np.array([row.split() for row in rows.strip().split("\n")], float)


def test_the_hierarchy_comes_back_to_the_digits(tmp_path):
    text = odd_text()
    motion = read(tmp_path, text, unit="cm")
    assert motion.names[:5] == ("Hips", "Leg", "Knee", "Knee_end", "Knee_end2")
    assert len(set(motion.names)) == motion.points
    before, _ = halves(tmp_path / "x.bvh")
    for again in (motion, coded(motion)):
        formats.write(tmp_path / "y.bvh", again)
        after, _ = halves(tmp_path / "y.bvh")

        def numbers(line: str) -> list[str]:
            return [f"{float(w):.6f}" if re.fullmatch(r"-?[\d.]+", w) else w for w in line.split()]

        assert [numbers(line) for line in after] == [numbers(line) for line in before]


def test_angles_come_back_in_their_own_turns_and_constants_to_the_digit(tmp_path):
    motion = read(tmp_path, odd_text(), unit="cm")
    _, before = halves(tmp_path / "x.bvh")
    formats.write(tmp_path / "y.bvh", motion)
    _, exact = halves(tmp_path / "y.bvh")
    assert np.abs(exact - before).max() < 2e-6
    formats.write(tmp_path / "y.bvh", coded(motion))
    _, after = halves(tmp_path / "y.bvh")
    assert np.abs(after - before).max() < 1.5
    constant = (before == before[:1]).all(axis=0)
    assert constant.sum() == 6
    assert np.array_equal(after[:, constant], before[:, constant])
    assert np.abs(np.diff(after, axis=0)).max() < 30


def test_channels_of_a_motion_that_was_changed_since_are_not_forced(tmp_path):
    motion = read(tmp_path, odd_text(), unit="cm")
    turned = motion.rotations.copy()
    turned[:, 2] = rigid.from_euler("zxy", np.radians([20.0, 30, 40]))
    skeleton = motion.skeleton
    motion = replace(motion, rotations=turned)
    formats.write(tmp_path / "y.bvh", motion)
    again = formats.read(tmp_path / "y.bvh", unit="cm")
    assert np.allclose(rigid.to_matrix(again.rotations[:, 2]), rigid.to_matrix(turned[:, 2]), atol=1e-7)
    assert again.skeleton.names == skeleton.names


def test_the_frame_time_keeps_its_digits_while_it_holds(tmp_path):
    motion = read(tmp_path, odd_text(), unit="cm")
    assert motion.rate == 60.0
    formats.write(tmp_path / "y.bvh", motion)
    assert "Frame Time: .0166667\n" in (tmp_path / "y.bvh").read_text()
    formats.write(tmp_path / "y.bvh", motion.resample(30.0))
    assert "Frame Time: 0.03333333333\n" in (tmp_path / "y.bvh").read_text()


def test_another_unit(tmp_path):
    motion = read(tmp_path, odd_text(), unit="cm")
    formats.write(tmp_path / "y.bvh", motion, unit="m")
    assert "OFFSET 0.1012346 -0.0065432" in (tmp_path / "y.bvh").read_text()
    again = formats.read(tmp_path / "y.bvh", unit="m")
    assert np.abs(again.positions - motion.positions).max() < 2e-7


def test_a_part_of_the_joints(tmp_path):
    motion = read(tmp_path, BVH, unit="cm")
    formats.write(tmp_path / "y.bvh", motion.select(["Hips", "Chest", "Head", "Head_end"]))
    again = formats.read(tmp_path / "y.bvh", unit="cm")
    assert again.names == ("Hips", "Chest", "Head", "Head_end")
    assert np.allclose(again.positions, motion.positions[:, [0, 1, 4, 5]], atol=1e-8)
    formats.write(tmp_path / "z.bvh", motion.select(["Head", "Head_end"]))  # a limb alone, its root in the world
    assert np.allclose(formats.read(tmp_path / "z.bvh", unit="cm").positions, motion.positions[:, 4:], atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_motions_from_elsewhere(tmp_path, seed):
    """Any order of joints, joints that slide, leaves that rotate."""
    motion = random_motion(12, seed=seed)
    shuffled = sorted(range(12), key=lambda j: (_depth(motion.skeleton, j), -j))
    motion = motion.select([motion.names[j] for j in shuffled])
    positions = motion.positions.copy()
    positions[:, -1] += np.linspace(0, 0.2, len(motion))[:, None]
    motion = replace(motion, positions=positions)
    formats.write(tmp_path / "x.bvh", motion)
    again = formats.read(tmp_path / "x.bvh", unit="cm")
    assert set(again.names) == set(motion.names)
    columns = [again.names.index(name) for name in motion.names]
    assert np.abs(again.positions[:, columns] - motion.positions).max() < 1e-8
    dots = np.abs(np.sum(again.rotations[:, columns] * motion.rotations, axis=2))
    assert np.abs(dots - 1).max() < 1e-12
    formats.write(tmp_path / "y.bvh", again)
    assert (tmp_path / "y.bvh").read_text() == (tmp_path / "x.bvh").read_text()


def _depth(skeleton: Skeleton, joint: int) -> int:
    return 0 if skeleton.parents[joint] < 0 else 1 + _depth(skeleton, skeleton.parents[joint])


def test_bones_of_an_asf(tmp_path):
    motion = random_motion(8, own_frame=True)
    formats.write(tmp_path / "x.bvh", motion)
    again = formats.read(tmp_path / "x.bvh", unit="cm")
    assert set(motion.names) <= set(again.names)
    distances = np.abs(again.positions[:, :, None] - motion.positions[:, None]).max(axis=(0, 3))
    assert distances.min(axis=0).max() < 1e-8


@pytest.mark.parametrize(("joints", "frames"), [(300, 1), (300, 3), (1, 1), (1, 5)])
def test_sizes(tmp_path, joints, frames):
    motion = random_motion(joints, frames)
    formats.write(tmp_path / "x.bvh", motion)
    again = formats.read(tmp_path / "x.bvh", unit="cm")
    root = again.positions[:, 0] - again.skeleton.offsets[0]
    assert (len(again), again.points) == (frames, joints)
    assert np.allclose(again.positions, kinematics.forward(again.skeleton, again.rotations, root), atol=1e-6)


def test_zero_length_bones_and_nan_angles(tmp_path):
    motion = read(tmp_path, re.sub(r"OFFSET .*", "OFFSET 0 0 0", BVH), unit="cm")
    formats.write(tmp_path / "y.bvh", motion)
    assert np.allclose(formats.read(tmp_path / "y.bvh", unit="cm").rotations[:2], motion.rotations[:2])
    with pytest.raises(BadInput, match="'nan' is not a number"):
        read(tmp_path, BVH.replace("9 92", "9 nan"))
    with pytest.raises(BadInput, match="'NaN' is not a number"):
        read(tmp_path, BVH.replace("-30 40 100", "-30 NaN 100"))


def test_no_channels_at_all(tmp_path):
    text = re.sub(r"CHANNELS .*", "", BVH).partition("Frame Time: 0.0083333")
    with pytest.raises(BadInput, match="its joints have no channels"):
        read(tmp_path, "".join(text[:2]) + "\n\n")


@pytest.mark.parametrize("name", ["", "a{b", "a}b", "a  b", " a", "a\nb"])
def test_names_that_a_bvh_cannot_hold(tmp_path, name):
    motion = random_motion(3)
    skeleton = replace(motion.skeleton, names=("j0", name, "j2"))
    with pytest.raises(BadInput, match="joint name"):
        formats.write(tmp_path / "x.bvh", replace(motion, names=skeleton.names, skeleton=skeleton))


def test_rotations_that_the_channels_cannot_make(tmp_path):
    motion = read(tmp_path, BVH, unit="cm")
    rotations = motion.rotations.copy()
    rotations[:, 2] = rigid.about_axis("y", np.array(1.0))  # the arm has Xrotation only
    with pytest.raises(BadInput, match="joint Left Arm has the rotation channels X, which"):
        formats.write(tmp_path / "y.bvh", replace(motion, rotations=rotations))


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("constant", [7]),
        ("constant", ["q"]),
        ("constant", ["x x=1e"]),
        ("channels", ["zyx*17", 3]),
        ("channels", "zyx"),
    ],
)
def test_a_damaged_memory_is_one_line(tmp_path, entry, value):
    motion = read(tmp_path, BVH, unit="cm")
    if value == ["x x=1e"]:
        value = ["x x=1e", *[""] * 3]
    with pytest.raises(BadInput, match="source"):
        formats.write(tmp_path / "y.bvh", replace(motion, source={**motion.source, entry: value}))


@pytest.mark.parametrize("digits", [None, [], [99], [4, 3, "!"], [4, 60, "AAAA"], [4, 3], ["4"], 7])
def test_damaged_digits_do_no_harm(tmp_path, digits):
    motion = read(tmp_path, BVH, unit="cm")
    formats.write(tmp_path / "y.bvh", replace(motion, source={**motion.source, "offset_digits": digits}))
    again = formats.read(tmp_path / "y.bvh", unit="cm")
    assert np.allclose(again.positions, motion.positions, atol=1e-8)


def test_offsets_of_more_digits_than_doubles_hold(tmp_path):
    motion = read(tmp_path, BVH.replace("OFFSET 60.0", "OFFSET 1e-320", 1), unit="cm")
    assert "offset_digits" not in motion.source


@pytest.mark.parametrize("channels", ["CHANNELS 3 Xrotation Yrotation Zrotation", "CHANNELS 0", ""])
def test_a_joint_that_is_named_as_an_end_site(tmp_path, channels):
    text = BVH.replace("End Site", "JOINT Left Arm_end", 1).replace("OFFSET 60.0 0.0 0.0", f"OFFSET 60 0 0\n{channels}")
    if "3" in channels:
        text = text.replace(" 0    0 30", " 0 1 2 3 0 30").replace("90   1 31", "90 4 5 6  1 31")
        text = text.replace("-45  2", "-45 7 8 9  2")
    motion = read(tmp_path, text, unit="cm")
    formats.write(tmp_path / "y.bvh", motion)
    assert (tmp_path / "y.bvh").read_text().count("End Site") == 1
    again = formats.read(tmp_path / "y.bvh", unit="cm")
    assert again.names == motion.names
    assert np.allclose(again.positions, motion.positions, atol=1e-8)
    assert again.source["channels"] == motion.source["channels"]
