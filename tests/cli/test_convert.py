"""`mocodec convert`, and the options of `convert` and `decode` that change a motion on its way out."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec.testing.skeletal import random_motion

from .conftest import Command

SKELETAL = ("bvh", "amc", "glb", "npz")


@pytest.fixture
def body(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> mc.Motion:
    """A body of nine joints with rotations; commands run in its folder."""
    monkeypatch.chdir(tmp_path)
    return random_motion(9, 30, seed=4)


def shared(motion: mc.Motion, other: mc.Motion) -> float:
    """How far the points of `motion` are from the nearest of `other`, over all frames, metres."""
    apart = np.abs(motion.positions[:, :, None] - other.positions[:, None]).max(axis=(0, 3))
    return float(apart.min(axis=1).max())


@pytest.mark.parametrize(("source", "target"), list(permutations(SKELETAL, 2)))
def test_rotations_go_from_any_skeletal_format_to_any_other_and_back(
    body: mc.Motion, command: Command, source: str, target: str
) -> None:
    mc.write(f"a.{source}", body)
    unit = ["--unit", "cm"]
    assert command("convert", f"a.{source}", f"b.{target}", *(unit if source == "bvh" else [])).code == 0
    back = command("convert", f"b.{target}", f"c.{source}", *(unit if target == "bvh" else []))
    assert back.code == 0, back.err
    for name in (f"b.{target}", f"c.{source}"):
        options = {"unit": "cm"} if name.endswith("bvh") else {}
        motion = mc.read(name, mc.Motion, **options)
        assert motion.rotations is not None
        assert shared(body, motion) < 1e-5  # a GLB has 32-bit floats


def test_joints_go_to_formats_of_markers_and_a_note_says_what_is_lost(body: mc.Motion, command: Command) -> None:
    mc.write("a.bvh", body)
    for suffix in ("c3d", "trc"):
        result = command("convert", "a.bvh", f"b.{suffix}", "--unit", "cm")
        assert result.code == 0
        assert f"note: .{suffix} cannot store skeleton, joint rotations" in result.err
        assert f"b.{suffix}: 30 frames of 9 points at 120 Hz" in result.err
        assert shared(body, mc.read(f"b.{suffix}", mc.Motion)) < 1e-6
    quiet = command("convert", "a.bvh", "b.trc", "--unit", "cm", "-q")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")


@pytest.mark.parametrize(("suffix", "word"), [("bvh", "a BVH"), ("amc", "an AMC")])
def test_points_without_rotations_do_not_become_a_skeleton(
    walk_trc: Path, command: Command, suffix: str, word: str
) -> None:
    result = command("convert", walk_trc, f"x.{suffix}")
    assert result.code == 3
    assert f"{word} needs a skeleton and rotations, and this motion has only positions of points" in result.err
    assert result.err.count("\n") == 1


def test_another_rate_unit_axis_and_fewer_points(walk_trc: Path, walk: mc.Motion, command: Command) -> None:
    options = ("--rate", 30, "--to-unit", "cm", "--to-up", "y", "--points", "LHEE, RKNE", "--points", "HEAD")
    result = command("convert", walk_trc, "x.trc", *options)
    assert result.code == 0, result.err
    motion = mc.read("x.trc", mc.Motion, up="y")
    assert (motion.rate, motion.names, len(motion)) == (30.0, ("LHEE", "RKNE", "HEAD"), 60)
    assert motion.source["units"] == "cm"
    x, y, z = np.moveaxis(walk.positions[::4][:, [0, 3, 6]], 2, 0)
    assert np.allclose(motion.positions, np.stack([x, z, -y], axis=2), atol=1e-8, equal_nan=True)


def test_options_of_reading_and_of_writing_are_apart(walk_trc: Path, command: Command) -> None:
    """--unit and --from-rate say how the file is read, --to-unit and --to-rate how it is written."""
    assert command("convert", walk_trc, "x.trc", "--unit", "m", "--from-rate", 60, "--to-rate", 20).code == 0
    plain, changed = mc.read(walk_trc, mc.Motion), mc.read("x.trc", mc.Motion)
    assert changed.seconds == pytest.approx(4.0)
    assert np.allclose(changed.positions, plain.positions[::3] * 1000, equal_nan=True)


def test_notes_name_the_options_of_this_command(body: mc.Motion, command: Command) -> None:
    mc.write("a.amc", body)
    assert "guessed: rate 120 Hz (--from-rate)" in command("convert", "a.amc", "a.bvh").err
    np.savez("b.npz", joints=body.positions)
    assert "(--from-rate)" in command("convert", "b.npz", "b.trc").err


def test_from_a_mocz(walk_mocz: Path, command: Command) -> None:
    assert command("convert", walk_mocz, "x.c3d", "--to-rate", 60).code == 0
    assert command("decode", walk_mocz, "-o", "y.c3d", "--to-rate", 60).code == 0
    assert Path("x.c3d").read_bytes() == Path("y.c3d").read_bytes()
    result = command("convert", walk_mocz, "x.c3d", "--unit", "mm", "--from-rate", 7)
    assert (result.code, "--from-rate, --unit" in result.err) == (2, True)


def test_decode_takes_the_same_options(walk_mocz: Path, command: Command) -> None:
    options = ("--rate", 40, "--to-unit", "m", "--to-up", "y", "--joints", "HEAD")
    assert command("decode", walk_mocz, "-o", "x.trc", *options).code == 0
    motion = mc.read("x.trc", mc.Motion)
    assert (motion.rate, motion.names, motion.source["units"]) == (40.0, ("HEAD",), "m")


def test_decode_of_many_files_takes_them_too(walk_mocz: Path, command: Command) -> None:
    Path("more").mkdir()
    for name in ("a", "b"):
        Path(f"more/{name}.mocz").write_bytes(walk_mocz.read_bytes())
    result = command("decode", "more", "-o", "out", "--format", "trc", "--to-rate", 30, "--points", "HEAD", "--jobs", 1)
    assert result.code == 0, result.err
    assert mc.read("out/a.trc", mc.Motion).rate == 30.0
    assert mc.read("out/b.trc", mc.Motion).names == ("HEAD",)


def test_standard_output_and_the_other_way_to_name_a_file(walk_trc: Path, command: Command) -> None:
    assert command("convert", walk_trc, "-o", "x.npz").code == 0
    assert Path("x.npz").exists()
    assert command("convert", walk_trc, "-", "--to-format", "trc").out.startswith("PathFileType")
    assert command("convert", walk_trc).code == 2
    assert command("convert", walk_trc, "x.npz", "-o", "y.npz").code == 2


def test_point_clouds_are_converted_and_not_changed(tmp_path: Path, command: Command) -> None:
    clouds = mc.PointClouds([np.zeros((3, 3)), np.ones((2, 3))], 15.0)
    mc.write(tmp_path / "a.npz", clouds)
    assert command("convert", tmp_path / "a.npz", tmp_path / "frames").code == 0
    assert len(list((tmp_path / "frames").glob("*.ply"))) == 2
    result = command("convert", tmp_path / "a.npz", tmp_path / "b.npz", "--to-rate", 30)
    assert (result.code, "holds point clouds" in result.err) == (3, True)


def test_a_c3d_at_another_rate_keeps_whole_frames_of_analog_samples(tmp_path: Path, command: Command) -> None:
    analog = mc.Signal(np.arange(200, dtype=np.int16)[:, None], 1200.0, ("Fx",), ("N",))
    positions = np.random.default_rng(1).normal(size=(20, 2, 3))
    mc.write(tmp_path / "a.c3d", mc.Motion(positions, 120.0, ("A", "B"), extras={"analog": analog}))
    result = command("convert", tmp_path / "a.c3d", tmp_path / "b.c3d", "--rate", 50)
    assert result.code == 0, result.err
    assert "left out, for a whole number of analog samples a frame: 8 analog samples after the last frame" in result.err
    motion = mc.read(tmp_path / "b.c3d", mc.Motion)
    assert (len(motion), len(motion.extras["analog"].values)) == (8, 192)
    short = command("convert", tmp_path / "a.c3d", tmp_path / "b.c3d", "--rate", 40)
    assert "the last 1 frame, 20 analog samples after the last frame" in short.err
    refused = command("convert", tmp_path / "a.c3d", tmp_path / "c.c3d", "--rate", 70)
    assert (refused.code, "1200 Hz is no multiple of 70 Hz" in refused.err) == (3, True)
    mc.write(tmp_path / "a.mocz", mc.read(tmp_path / "a.c3d"), codec="lossless")
    assert "8 analog samples" in command("decode", tmp_path / "a.mocz", "-o", tmp_path / "d.c3d", "--rate", 50).err


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("walk.trc", "x.mocz"), 2, "run `mocodec encode walk.trc -o x.mocz`"),
        (("walk.trc", "x.trc", "--to-rate", "0"), 2, "to-rate"),
        (("walk.trc", "x.trc", "--to-up", "w"), 2, "to-up"),
        (("walk.trc", "x.trc", "--to-unit", "furlong"), 3, "furlong"),
        (("walk.trc", "x.npz", "--to-unit", "mm"), 3, "has a unit of its own"),
        (("walk.trc", "x.trc", "--points", "HAED"), 3, "no point named 'HAED'"),
        (("walk.trc", "x.xyz"), 3, "unknown suffix"),
        (("walk.trc", "x.fbx"), 3, ".glb or .bvh"),
        (("walk.asf", "x.bvh"), 3, "name the .amc"),
        (("gone.trc", "x.c3d"), 3, "no such file"),
    ],
)
def test_what_is_wrong_is_one_line(
    walk_trc: Path, command: Command, arguments: tuple[str, ...], code: int, says: str
) -> None:
    result = command("convert", *arguments)
    assert (result.code, says in result.err) == (code, True), result.err
    assert result.err.count("\n") == 1
    assert not Path(arguments[1]).exists()


def test_the_wrong_verb_names_the_right_one(walk_trc: Path, command: Command) -> None:
    result = command("decode", walk_trc, "-o", "x.c3d")
    assert result.code == 2
    assert "`mocodec convert walk.trc x.c3d`" in result.err
