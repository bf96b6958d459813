"""C3D: what goes in comes out, here and as an independent reader (ezc3d) sees it; damage is one clear line."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, Motion, Signal, formats
from mocodec.formats import c3d

from .samples import SHARED, capture, markers, needs_shared, same_tree


def back(motion, tmp_path, **options):
    formats.write(tmp_path / "x.c3d", motion)
    return formats.read(tmp_path / "x.c3d", **options)


def test_everything_survives(tmp_path):
    motion = capture()
    again = back(motion, tmp_path)
    assert np.array_equal(again.positions, motion.positions, equal_nan=True)
    assert (again.names, again.rate, again.up) == (motion.names, motion.rate, motion.up)
    assert again.source == motion.source
    events = [{k: v for k, v in event.items() if v} for event in again.extras["events"]]
    for event, kept in zip(motion.extras["events"], events, strict=True):
        assert kept["time_s"] == pytest.approx(event["time_s"], abs=1e-7)
        assert {k: v for k, v in kept.items() if k != "time_s"} == {
            k: v for k, v in event.items() if k != "time_s" and v
        }
    for group, values in motion.extras["parameters"].items():
        for name, value in values.items():
            assert same_tree(again.extras["parameters"].get(group, {}).get(name), value), (group, name)
    for what in ("analog", "parameter_notes", "parameters_locked"):
        assert same_tree(again.extras[what], motion.extras[what])


def test_reading_and_writing_settle(tmp_path):
    first = back(back(capture(), tmp_path), tmp_path)
    data = (tmp_path / "x.c3d").read_bytes()
    second = back(first, tmp_path)
    assert (tmp_path / "x.c3d").read_bytes() == data
    assert same_tree(dict(first.extras), dict(second.extras))


def test_as_ezc3d_sees_it(tmp_path):
    ezc3d = pytest.importorskip("ezc3d")
    motion = capture()
    formats.write(tmp_path / "x.c3d", motion)
    seen = ezc3d.c3d(str(tmp_path / "x.c3d"))
    points = seen["data"]["points"][:3].transpose(2, 1, 0) * 1e-3
    assert np.array_equal(points, motion.positions, equal_nan=True)
    assert seen["parameters"]["POINT"]["LABELS"]["value"] == list(motion.names)
    assert seen["header"]["points"]["first_frame"] == 30  # counted from 0 there
    assert np.allclose(seen["data"]["analogs"][0].T, c3d.analog(motion))
    assert seen["parameters"]["EVENT"]["LABELS"]["value"] == ["Foot Strike", "Foot Off"]
    assert seen["parameters"]["EVENT"]["TIMES"]["value"][1] == pytest.approx([0.3, 0.35])
    assert seen["parameters"]["FORCE_PLATFORM"]["CORNERS"]["value"].shape == (3, 4, 1)


def test_why_ezc3d_is_not_what_reads_here(tmp_path):
    """Holds what docs/architecture.md says of ezc3d. Where this fails after an upgrade, think about that page again."""
    ezc3d = pytest.importorskip("ezc3d")
    path, again = tmp_path / "a.c3d", tmp_path / "b.c3d"
    formats.write(path, markers(200))
    path.write_bytes(path.read_bytes()[:-6000])
    assert ezc3d.c3d(str(path))["data"]["points"].shape[2] == 129  # and no word of the 71 that are missing
    with pytest.raises(BadInput, match="cut off: its header promises 200 frames, the file holds 129 whole ones"):
        formats.read(path)

    motion = capture()
    mine = {"BYTES": np.array([1, -2, 3], np.int8), "TABLE": [["a", "b", "c"], ["d", "e", "f"]]}
    formats.write(
        path, replace(motion, extras={**motion.extras, "parameters": {"MINE": mine, **motion.extras["parameters"]}})
    )
    ezc3d.c3d(str(path)).write(str(again))
    ours, theirs = formats.read(path), formats.read(again)
    assert ours.extras["parameters"]["ANALOG"]["OFFSET"].tolist() == [4, 0, 12]
    assert theirs.extras["parameters"]["ANALOG"]["OFFSET"].tolist() == [0, 0, 0]
    assert np.array_equal(ours.extras["analog"].values - [4, 0, 12], theirs.extras["analog"].values)
    assert np.allclose(c3d.analog(ours), c3d.analog(theirs))
    assert same_tree(ours.extras["parameters"]["MINE"], mine)
    assert theirs.extras["parameters"]["MINE"]["BYTES"].dtype == np.int16
    assert theirs.extras["parameters"]["MINE"]["TABLE"] == ["a", "b", "c", "d", "e", "f"]


@pytest.mark.parametrize("sign", ["SIGNED", "UNSIGNED"])
def test_offsets_have_a_sign_where_samples_have_one(tmp_path, sign):
    """ANALOG:FORMAT says whether; a file of floats stores such samples as floats (c3d.org, ANALOG:FORMAT)."""
    counts = np.array([[0, 40000], [65535, 3]]).astype(np.uint16)
    values = counts if sign == "UNSIGNED" else counts.view(np.int16)
    analog = {"SCALE": np.ones(2, np.float32), "OFFSET": np.array([-2, 5], np.int16), "FORMAT": sign}
    motion = replace(
        markers(2), extras={"analog": Signal(values, 120.0, ("Fx", "Fz")), "parameters": {"ANALOG": analog}}
    )
    physical = c3d.analog(motion)
    assert physical[0, 0] == (2 if sign == "SIGNED" else -65534)
    again = back(motion, tmp_path)
    assert again.extras["analog"].values.dtype == values.dtype
    assert np.array_equal(again.extras["analog"].values, values)
    assert np.array_equal(c3d.analog(again), physical)


def test_numbers_keep_their_shape(tmp_path):
    for shape in ((), (1,)):
        point = {"SCALE": np.full(shape, -0.05, np.float32), "LONG_FRAMES": np.full(shape, 20, np.float32)}
        again = back(replace(markers(), extras={"parameters": {"POINT": point}}), tmp_path)
        for name, value in point.items():
            assert same_tree(again.extras["parameters"]["POINT"][name], value)


@pytest.mark.parametrize("points", [1, 255, 256, 700])
def test_any_number_of_labels(tmp_path, points):
    motion = markers(2, points) if points > 1 else markers(20, 2).select(["Subject:M000"])
    assert back(motion, tmp_path).names == motion.names


@pytest.mark.parametrize(("frames", "first"), [(1, 1), (65535, 1), (65536, 1), (70001, 1), (10, 70000)])
def test_any_number_of_frames(tmp_path, frames, first):
    positions = np.zeros((frames, 1, 3))
    positions[:, 0, 0] = np.arange(frames) * 1e-3
    source = {"format": "c3d", "units": "mm", "unit_m": 1e-3, "first_frame": first}
    again = back(Motion(positions, 100.0, up="z", source=source), tmp_path)
    assert np.array_equal(again.positions, positions)
    assert again.source["first_frame"] == first


def test_a_slice_keeps_frames_events_and_analog_together(tmp_path):
    again = back(capture()[5:15], tmp_path)
    assert again.source["first_frame"] == 36
    assert again.extras["events"][0]["time_s"] == pytest.approx(0.05 - 5 / 120, abs=1e-7)
    assert again.extras["analog"].values.shape == (100, 3)


def test_other_units_and_axes(tmp_path):
    motion = replace(markers(), source={"format": "c3d", "units": "m", "unit_m": 1.0})
    again = back(motion, tmp_path)
    assert again.source["units"] == "m"
    assert np.nanmax(np.abs(again.positions - motion.positions)) < 1e-7
    standing = replace(markers(), up="y", source={"format": "trc"})
    assert back(standing, tmp_path).up == "y"


def test_residuals_are_kept_where_they_say_little_or_when_asked(tmp_path):
    motion = markers(300, 5)
    word = np.where(motion.gaps, -1, np.random.default_rng(3).integers(1, 2**15, (300, 5))).astype(np.int16)
    noisy = replace(motion, extras={"residuals": Signal(word, 120.0)})
    assert np.array_equal(back(noisy, tmp_path, residuals=True).extras["residuals"].values, word)
    left_out = back(noisy, tmp_path)
    assert "residuals" not in left_out.extras
    assert left_out.source["residuals"] == "left out"
    constant = replace(motion, source={"residual_word": 257.0})
    again = back(constant, tmp_path)
    assert again.source["residual_word"] == 257.0
    assert "residuals" not in again.extras
    assert np.array_equal(again.gaps, motion.gaps)


def integer_file(order: str, processor: int, dec: bool = False) -> bytes:
    """Two points, three frames of 16-bit integers, scale 0.5 mm, 50 Hz, as old machines wrote them."""

    def real(value: float) -> bytes:
        if dec:
            low, high = struct.unpack("<HH", struct.pack("<f", value * 4))
            return struct.pack("<HH", high, low)
        return struct.pack(order + "f", value)

    header = struct.pack("<BB", 2, 0x50) + struct.pack(order + "5H", 2, 1, 1, 3, 0) + real(0.5)
    header += struct.pack(order + "HH", 3, 1) + real(50.0)
    groups = struct.pack("bb", 5, -1) + b"POINT" + struct.pack(order + "H", 3) + b"\0"
    body = struct.pack("bB2B", -1, 2, 4, 2) + b"LASIRASI" + b"\0"
    groups += struct.pack("bb", 6, 1) + b"LABELS" + struct.pack(order + "H", 0) + body
    section = bytes([1, 0x50, 1, processor]) + groups
    frames = [struct.pack(order + "9h", 100 + f, -200, 300, 0, 7, 8, 9, -1 if f == 1 else 0, 40 + f) for f in range(3)]
    return header.ljust(512, b"\0") + section.ljust(512, b"\0") + b"".join(frames).ljust(512, b"\0")


@pytest.mark.parametrize(("order", "processor", "dec"), [("<", 84, False), ("<", 85, True), (">", 86, False)])
def test_integers_of_three_machines(tmp_path, order, processor, dec):
    (tmp_path / "old.c3d").write_bytes(integer_file(order, processor, dec))
    motion = formats.read(tmp_path / "old.c3d")
    assert motion.names == ("LASI", "RASI")
    assert motion.rate == 50.0
    assert motion.positions[2, 0].tolist() == pytest.approx([0.051, -0.1, 0.15])
    assert motion.gaps.tolist() == [[False, False], [False, True], [False, False]]
    assert motion.extras["analog"].values.ravel().tolist() == [40, 41, 42]


def test_events_of_the_header(tmp_path):
    data = bytearray(integer_file("<", 84))
    struct.pack_into("<HH", data, 298, 12345, 1)
    struct.pack_into("<f", data, 304, 0.04)
    data[376] = 1
    data[396:400] = b"RHS "
    (tmp_path / "old.c3d").write_bytes(data)
    motion = formats.read(tmp_path / "old.c3d")
    assert motion.extras["events"] == [{"label": "RHS", "time_s": pytest.approx(0.04), "in_header": 1}]
    assert back(motion, tmp_path).extras["events"][0]["label"] == "RHS"


def test_survives_a_mocz(tmp_path):
    motion = back(capture(), tmp_path)
    again = mc.decode(mc.encode(motion, codec="lossless"))
    formats.write(tmp_path / "y.c3d", again)
    formats.write(tmp_path / "z.c3d", motion)
    assert (tmp_path / "y.c3d").read_bytes() == (tmp_path / "z.c3d").read_bytes()


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda d: b"", "fewer than"),
        (lambda d: d[:700], "fewer than"),
        (lambda d: d[:-600], "cut off"),
        (lambda d: b"\2\0" + d[2:], "0x50"),
        (lambda d: d[:515] + b"\x11" + d[516:], "processor"),
        (lambda d: b"\xff" + d[1:], "cut off"),
    ],
)
def test_damage_is_one_clear_line(tmp_path, spoil, says):
    formats.write(tmp_path / "x.c3d", markers(200))
    (tmp_path / "x.c3d").write_bytes(spoil((tmp_path / "x.c3d").read_bytes()))
    with pytest.raises(BadInput, match=says) as error:
        formats.read(tmp_path / "x.c3d")
    assert "\n" not in str(error.value)


def test_what_a_c3d_cannot_hold_is_refused(tmp_path):
    with pytest.raises(BadInput, match="at least one frame"):
        back(markers()[:0], tmp_path)
    with pytest.raises(BadInput, match="points"):
        back(markers().select([]), tmp_path)
    with pytest.raises(BadInput, match="do not fit"):
        back(replace(markers(), extras={"analog": Signal(np.zeros((7, 1)), 120.0)}), tmp_path)
    with pytest.raises(BadInput, match="longer"):
        back(replace(markers(), names=("n" * 300, "b", "c", "d", "e")), tmp_path)
    assert not list(tmp_path.iterdir())


def test_analog_of_a_motion_without_any():
    with pytest.raises(BadInput, match="no analog"):
        c3d.analog(markers())


@needs_shared
@pytest.mark.parametrize("name", ["Vicon", "Qualisys", "BTS", "FP_Type1", "Movement_trial", "read_NOTworking2"])
def test_field_files_as_ezc3d_reads_them(tmp_path, name):
    ezc3d = pytest.importorskip("ezc3d")
    path = SHARED / "field-c3d" / f"{name}.c3d"
    motion = formats.read(path)
    formats.write(tmp_path / "x.c3d", motion)
    for file in (path, tmp_path / "x.c3d"):
        seen = ezc3d.c3d(str(file))
        points = seen["data"]["points"][:3].transpose(2, 1, 0) * motion.source["unit_m"]
        assert np.array_equal(np.isnan(points[..., 0]), motion.gaps)
        assert np.nanmax(np.abs(points - motion.positions)) < 2e-7
        if seen["data"]["analogs"].size:
            assert np.allclose(seen["data"]["analogs"][0].T, c3d.analog(motion), rtol=1e-6)


@needs_shared
def test_the_cut_and_the_empty_ones_say_so():
    for name, says in (("Optotrak", "cut off"), ("Kistler", "no points"), ("C3DRotationExample", "no points")):
        with pytest.raises(BadInput, match=says):
            formats.read(SHARED / "field-c3d" / f"{name}.c3d")
