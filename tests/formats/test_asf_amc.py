"""ASF/AMC: positions of the ends of bones, rates, units of angle, limits, and writing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, Motion, formats
from mocodec.formats import asf_amc
from mocodec.geometry import rigid
from mocodec.testing import synthetic

from .samples import AMC, ASF, SHARED, markers, needs_shared

UNIT_M = 0.0254 / 0.45


def pair(tmp_path, amc: str = AMC, asf: str = ASF, name: str = "tiny"):
    (tmp_path / f"{name}.asf").write_text(asf)
    (tmp_path / "tiny_01.amc").write_text(amc)
    return tmp_path / "tiny_01.amc"


def angles(path) -> np.ndarray:
    return np.array([float(w) for w in path.read_text().split("DEGREES")[1].split() if not w[0].isalpha()])


def turn(axis: str, degrees: float) -> np.ndarray:
    """A rotation matrix, by its textbook entries."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    m = np.eye(3)
    m[i, i] = m[j, j] = c
    m[i, j], m[j, i] = -s, s
    return m


def xyz(x: float, y: float, z: float) -> np.ndarray:
    """Order XYZ: x is turned first."""
    return turn("z", z) @ turn("y", y) @ turn("x", x)


def test_a_still_pose(tmp_path):
    motion = formats.read(pair(tmp_path))
    assert motion.names == ("root", "spine", "femur", "tibia", "foot")
    assert np.allclose(motion.positions[0] / UNIT_M, [[0, 17, 0], [0, 26, 0], [0, 10, 0], [0, 2, 0], [0, 2, 2]])
    assert (motion.rate, motion.up, motion.source["first_frame"]) == (120.0, "y", 7)
    assert formats.read(tmp_path / "tiny_01.amc", rate=60.0).rate == 60.0


def test_a_moving_pose_against_plain_matrices(tmp_path):
    positions = formats.read(pair(tmp_path)).positions[1] / UNIT_M
    root = xyz(10, -20, 100)
    c_leg, c_foot = xyz(0, 0, 20), xyz(-90, 0, 20)
    femur = root @ c_leg @ xyz(-50, 5, 1e-3) @ c_leg.T
    tibia = femur @ c_leg @ xyz(90, 0, 0) @ c_leg.T
    foot = tibia @ c_foot @ xyz(-100, 0, 20) @ c_foot.T
    start = np.array([1.0, 17, 2])
    knee = start + femur @ [0, -7, 0]
    ankle = knee + tibia @ [0, -8, 0]
    expected = [start, start + root @ xyz(1, 2, 3) @ [0, 9, 0], knee, ankle, ankle + foot @ [0, 0, 2]]
    assert np.allclose(positions, expected)


def test_writing_restores_the_file(tmp_path):
    path = pair(tmp_path)
    motion = formats.read(path)
    formats.write(tmp_path / "tiny_02.amc", motion)
    assert np.abs(angles(tmp_path / "tiny_02.amc") - angles(path)).max() < 1e-6


def test_a_missing_skeleton_is_written(tmp_path):
    motion = formats.read(pair(tmp_path))
    (tmp_path / "new").mkdir()
    formats.write(tmp_path / "new" / "walk.amc", motion)
    again = formats.read(tmp_path / "new" / "walk.amc")
    assert np.allclose(again.positions, motion.positions, atol=1e-7)
    assert again.names == motion.names


def test_radians_and_other_orders(tmp_path):
    asf = ASF.replace("angle deg", "angle rad").replace("axis 0 0 20", "axis 0 0 0.3")
    asf = asf.replace("-90 0 20 XYZ", "0 0 0 ZYX")
    amc = AMC.replace(":DEGREES", ":RADIANS").replace("-50 5 1e-3", "-1 0.5 0.2").replace("10 -20 100", "1 -1 2")
    amc = amc.replace("tibia 90", "tibia 1.5").replace("foot -100 20", "foot -1.2 0.3")
    path = pair(tmp_path, amc, asf.replace("order TX TY TZ RX RY RZ", "order RZ TY RX TX TZ RY"))
    motion = formats.read(path)
    formats.write(tmp_path / "tiny_02.amc", motion)
    assert np.allclose(formats.read(tmp_path / "tiny_02.amc").positions, motion.positions, atol=1e-7)


def test_the_rate_of_the_header(tmp_path):
    plain = formats.read(pair(tmp_path))
    assert formats.notes(plain) == ["guessed: rate 120 Hz (--rate)"]
    for text, rate in (("60", 60.0), ("120", 120.0)):
        motion = formats.read(pair(tmp_path, AMC.replace(":FULLY", f":SAMPLES-PER-SECOND {text}\n:FULLY")))
        assert (motion.rate, formats.notes(motion)) == (rate, [])
    assert formats.read(tmp_path / "tiny_01.amc", rate=50.0).rate == 50.0


def test_angles_of_skeleton_and_motion_in_different_units(tmp_path):
    expected = formats.read(pair(tmp_path)).positions
    radians = ASF.replace("angle deg", "angle rad").replace("axis 0 0 20", f"axis 0 0 {np.radians(20)}")
    radians = radians.replace("axis -90 0 20", f"axis {np.radians(-90)} 0 {np.radians(20)}")
    assert np.allclose(formats.read(pair(tmp_path, asf=radians)).positions, expected)
    lines = []
    for line in AMC.replace(":DEGREES", ":RADIANS").split("\n"):
        words = line.split()
        first = 4 if words[:1] == ["root"] else 1 if words and words[0].isalpha() else len(words)
        lines.append(" ".join(words[:first] + [f"{np.radians(float(w)):.12g}" for w in words[first:]]))
    assert np.allclose(formats.read(pair(tmp_path, "\n".join(lines))).positions, expected)


def test_blank_lines_take_no_time(tmp_path):
    expected = formats.read(pair(tmp_path)).positions
    amc = AMC.replace(":FULLY", "\n" * 300_000 + ":FULLY").replace("8\n", "8\n" + "\n" * 300_000)
    assert np.array_equal(formats.read(pair(tmp_path, amc)).positions, expected)


def limits_of(tmp_path, asf: str = ASF):
    limits = formats.read(pair(tmp_path, asf=asf)).skeleton.limits
    assert limits is not None
    return limits


def test_limits_stand_in_the_order_of_the_turns_and_in_the_axis_frame(tmp_path):
    asf = ASF.replace("(-20 20)", "(-20 20) # of three", 1).replace("dof rx\n", "dof rx\n limits ( -10,170.0 )\n")
    asf = asf.replace("dof rx rz", "dof rx rz\nlimits (-45 90)\n(-inf 20)\nbodymass 3")
    limits = limits_of(tmp_path, asf)
    assert limits.orders == ("zyx",) * 5
    assert limits.ranges[0].tolist() == [[-np.inf, np.inf]] * 3  # the root
    assert np.allclose(np.degrees(limits.ranges[1]), [[-20, 20]] * 3)
    assert limits.ranges[2].tolist() == [[-np.inf, np.inf]] * 3  # moves, and nothing is said of it
    assert np.allclose(np.degrees(limits.ranges[3]), [[0, 0], [0, 0], [-10, 170]])
    assert np.allclose(np.degrees(limits.ranges[4]), [[-np.inf, 20], [0, 0], [-45, 90]])
    for joint, frame in ((3, xyz(0, 0, 20)), (4, xyz(-90, 0, 20))):
        assert np.allclose(rigid.to_matrix(limits.axes[joint]), frame)


def test_a_written_skeleton_keeps_its_limits(tmp_path):
    asf = ASF.replace("dof rx rz", "dof rx rz\nlimits (-45 90)\n(-inf 20)").replace("-90 0 20 XYZ", "-90 7 20 ZYX")
    limits = limits_of(tmp_path, asf)
    motion = formats.read(tmp_path / "tiny_01.amc")
    (tmp_path / "new").mkdir()
    formats.write(tmp_path / "new" / "walk.amc", motion)
    again = formats.read(tmp_path / "new" / "walk.amc")
    assert np.allclose(again.positions, motion.positions, atol=1e-7)
    assert again.skeleton.limits.orders[1:] == limits.orders[1:]
    assert np.allclose(again.skeleton.limits.ranges, limits.ranges)
    assert np.allclose(again.skeleton.limits.axes[1:], limits.axes[1:])


def test_limits_that_are_odd(tmp_path):
    exchanged = limits_of(tmp_path, ASF.replace("(-20 20)", "(20 -20)"))
    assert np.array_equal(exchanged.ranges, limits_of(tmp_path).ranges)
    radians = limits_of(tmp_path, ASF.replace("angle deg", "angle rad").replace("(-20 20)", "(-0.5 0.25)"))
    assert radians.ranges[1].tolist() == [[-0.5, 0.25]] * 3
    none = ASF.replace("limits (-20 20)", "").replace("(-20 20)", "")
    assert formats.read(pair(tmp_path, asf=none)).skeleton.limits is None


@pytest.mark.parametrize("odd", ["(-20 nan)", "(-20)", "(-20 20) (0 1)", "(-20 wide)", "(inf inf)"])
def test_limits_that_cannot_be_read_are_ignored(tmp_path, odd):
    """The bone is unlimited; the other bones keep their limits."""
    asf = ASF.replace("dof rx rz", "dof rx rz\nlimits (-45 90)\n(-10 20)")
    odd_one = ASF.index("(-20 20)")
    limits = limits_of(tmp_path, asf[:odd_one] + odd + asf[odd_one + len("(-20 20)") :])
    assert np.isinf(limits.ranges[1]).all()
    assert np.allclose(np.degrees(limits.ranges[4]), [[-10, 20], [0, 0], [-45, 90]])


def test_limits_stay_with_a_part_of_a_motion_and_in_npz(tmp_path):
    limits = limits_of(tmp_path)
    motion = formats.read(tmp_path / "tiny_01.amc")
    assert motion[1:].skeleton is motion.skeleton
    formats.write(tmp_path / "x.npz", motion)
    again = formats.read(tmp_path / "x.npz").skeleton.limits
    assert again.orders == limits.orders
    assert np.array_equal(again.axes, limits.axes)
    assert np.array_equal(again.ranges, limits.ranges)


def test_a_mocz_keeps_limits_with_the_rotations(tmp_path):
    limits = limits_of(tmp_path)
    motion = formats.read(tmp_path / "tiny_01.amc")
    for codec in ("lossless", "tempo"):
        again = mc.decode(mc.encode(motion, codec=codec))
        assert again.skeleton.limits.orders == limits.orders
        np.testing.assert_allclose(again.skeleton.limits.ranges, limits.ranges, atol=1e-4)
        assert again.skeleton.names == motion.skeleton.names


def test_choice_of_the_skeleton(tmp_path):
    path = pair(tmp_path, name="other")
    assert formats.read(path).points == 5  # the only one there
    (tmp_path / "third.asf").write_text(ASF)
    with pytest.raises(BadInput, match="asf="):
        formats.read(path)
    assert formats.read(path, asf=tmp_path / "third.asf").points == 5
    with pytest.raises(BadInput, match="no such skeleton"):
        formats.read(path, asf=tmp_path / "gone.asf")
    for file in tmp_path.glob("*.asf"):
        file.unlink()
    with pytest.raises(BadInput, match=r"no \.asf beside it"):
        formats.read(path)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("8\n", "", "numbers"),
        ("tibia 90\n", "", "do not all name"),
        ("foot -100 20\n", "foot -100\n", "numbers"),
        ("tibia 90", "tibia x", "'x'"),
        ("tibia 90", "tibia nan", "'nan'"),
        ("tibia", "shin", "not in its skeleton"),
        (":DEGREES", ":RADIANS", "radians"),
        (AMC, "7\n8\n", "not an AMC"),
        ("\n7\n", "\n-7\n", "a frame before frame 8"),
        ("\n7\n", "\n7.0\n", "a frame before frame 8"),
    ],
)
def test_damage_of_the_motion(tmp_path, old, new, says):
    with pytest.raises(BadInput, match=says):
        formats.read(pair(tmp_path, AMC.replace(old, new)))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (":bonedata", ":bones", "no :bonedata"),
        ("length 0.45", "length 0", "length unit"),
        ("name foot", "name tibia", "twice"),
        ("tibia foot", "", "connected to the root"),
        ("tibia foot", "foot tibia", "hierarchy"),
        ("femur tibia", "femur shin", "hierarchy"),
        ("dof rx rz", "dof rx l", "rx ry rz"),
        ("length 7", "length nan", "length is nan"),
        ("length 7", "length long", "not an ASF"),
        ("direction 0 1 0", "direction 0 inf 0", "three numbers"),
        ("axis XYZ", "axis XXZ", "axis order"),
        ("order TX", "order TW", "root's order"),
    ],
)
def test_damage_of_the_skeleton(tmp_path, old, new, says):
    with pytest.raises(BadInput, match=says):
        formats.read(pair(tmp_path, asf=ASF.replace(old, new, 1)))


def test_gaps_are_refused_before_anything_is_written(tmp_path):
    motion = synthetic.joints(3)
    positions = motion.positions.copy()
    positions[1, 2] = np.nan
    skeleton = replace(motion.skeleton, names=("root", *motion.names[1:]))
    source = {"format": "amc", "unit_m": 0.0564}
    gappy = replace(motion, positions=positions, names=skeleton.names, skeleton=skeleton, source=source)
    with pytest.raises(BadInput, match="gaps"):
        formats.write(tmp_path / "x.amc", gappy)
    assert not list(tmp_path.iterdir())


def test_no_skeleton_is_left_without_its_motion(tmp_path, monkeypatch):
    motion = formats.read(pair(tmp_path))
    (tmp_path / "new").mkdir()
    real = asf_amc.replace_whole

    def full(path, data):
        if path.suffix == ".amc":
            raise BadInput(f"{path}: cannot be written (No space left on device)")
        real(path, data)

    monkeypatch.setattr(asf_amc, "replace_whole", full)
    with pytest.raises(BadInput, match="No space left"):
        formats.write(tmp_path / "new/x.amc", motion)
    assert not list((tmp_path / "new").iterdir())


def test_motions_that_an_amc_cannot_hold_are_refused(tmp_path):
    motion = formats.read(pair(tmp_path))
    assert isinstance(motion, Motion)
    with pytest.raises(BadInput, match=r"needs a skeleton and rotations, .* only positions on a skeleton"):
        formats.write(tmp_path / "x.amc", replace(motion, rotations=None))
    with pytest.raises(BadInput, match="only positions of points; write a"):
        formats.write(tmp_path / "x.amc", markers())
    (tmp_path / "long.asf").write_text(ASF.replace("length 7", "length 7.5"))
    with pytest.raises(BadInput, match="differs from this"):
        formats.write(tmp_path / "x.amc", motion, asf=tmp_path / "long.asf")
    (tmp_path / "stiff.asf").write_text(ASF.replace("dof rx rz", "dof rx"))
    with pytest.raises(BadInput, match="bone foot"):
        formats.write(tmp_path / "x.amc", motion, asf=tmp_path / "stiff.asf")


@needs_shared
@pytest.mark.parametrize("name", ["02/02_03", "118/118_04", "64/64_03"])
def test_cmu(tmp_path, name):
    path = SHARED / "cmu" / "asfamc" / f"{name}.amc"
    motion = formats.read(path)
    assert motion.points == 31
    assert -0.15 < motion.positions[:, :, 1].min() < 0.1  # feet on the floor
    asf = asf_amc.find_asf(path)
    formats.write(tmp_path / "x.amc", motion, asf=asf)
    assert np.abs(formats.read(tmp_path / "x.amc", asf=asf).positions - motion.positions).max() < 1e-7
