"""C3D: round trips, also as an independent reader (ezc3d) sees them; contradictions, unusual and damaged files."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, Motion, Signal, formats
from mocodec.formats import c3d
from mocodec.formats.c3d.parameters import Parameters, counts, pack, padded, text

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


def test_the_second_round_trip_changes_no_byte(tmp_path):
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
    with pytest.raises(BadInput, match="cut off: its header declares 200 frames, the file has 129 complete ones"):
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


def test_residuals_are_kept_if_small_or_requested(tmp_path):
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
def test_damage_raises_one_line(tmp_path, spoil, says):
    formats.write(tmp_path / "x.c3d", markers(200))
    (tmp_path / "x.c3d").write_bytes(spoil((tmp_path / "x.c3d").read_bytes()))
    with pytest.raises(BadInput, match=says) as error:
        formats.read(tmp_path / "x.c3d")
    assert "\n" not in str(error.value)


def test_motions_that_a_c3d_cannot_hold_are_refused(tmp_path):
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
        labels = seen["parameters"]["POINT"]["LABELS"]["value"]
        outputs = c3d.model_outputs(motion)
        values = seen["data"]["points"][:3].transpose(2, 1, 0)
        for at, label in enumerate(labels):
            assert label not in outputs or np.array_equal(values[:, at], outputs[label], equal_nan=True)
        points = values[:, [label not in outputs for label in labels]] * motion.source["unit_m"]
        assert np.array_equal(np.isnan(points[..., 0]), motion.gaps)
        assert np.nanmax(np.abs(points - motion.positions)) < 2e-7
        if seen["data"]["analogs"].size:
            assert np.allclose(seen["data"]["analogs"][0].T, c3d.analog(motion), rtol=1e-6)


@needs_shared
def test_cut_files_are_refused_and_files_without_points_are_carried():
    with pytest.raises(BadInput, match="cut off"):
        formats.read(SHARED / "field-c3d" / "Optotrak.c3d")
    for name, extra in (("Kistler", "analog"), ("C3DRotationExample", "rotations")):
        motion = formats.read(SHARED / "field-c3d" / f"{name}.c3d")
        assert motion.points == 0
        assert len(motion.extras[extra].values) >= len(motion) > 0


def f4(*values: float) -> np.ndarray:
    return np.array(values, np.float32)


def built(
    frames=20, points=3, channels=4, per_frame=10, header: dict[int, int] | None = None, change=None, table=None
) -> bytes:
    """A C3D of floats at 100 Hz. header: words of the header to replace; change(groups): changes the parameters."""
    groups: dict[str, dict[str, Any]] = {
        "POINT": {
            "USED": counts(points), "FRAMES": counts(min(frames, 0xFFFF)), "DATA_START": counts(0), "SCALE": f4(-0.1),
            "RATE": f4(100), "UNITS": ["mm"], "LABELS": [f"M{i}" for i in range(points)],
        },
        "ANALOG": {
            "USED": counts(channels), "RATE": f4(100 * per_frame), "GEN_SCALE": f4(1), "SCALE": f4(*[1] * channels),
            "OFFSET": counts(*[0] * channels), "LABELS": [f"A{i}" for i in range(channels)],
        },
    }  # fmt: skip
    if change is not None:
        change(groups)
    section = pack(Parameters(groups))
    start = 2 + len(section) // 512
    groups["POINT"]["DATA_START"] = counts(start)
    section = pack(Parameters(groups))
    if table is None:
        table = np.arange(frames * (4 * points + channels * per_frame)).reshape(frames, -1) % 1000 + 1.0
        table[:, 3 : 4 * points : 4] = 0
    head = bytearray(512)
    last = min(frames, 0xFFFF)
    struct.pack_into("<BBHHHHHfHHf", head, 0, 2, 0x50, points, channels * per_frame, 1, last, 0, -0.1, start,
                     per_frame, 100.0)  # fmt: skip
    for word, value in (header or {}).items():
        struct.pack_into("<H", head, 2 * word, value)
    return bytes(head) + section + padded(table.astype("<f4").tobytes())


def read_bytes(tmp_path, data: bytes, **options) -> Motion:
    (tmp_path / "b.c3d").write_bytes(data)
    motion = formats.read(tmp_path / "b.c3d", **options)
    assert isinstance(motion, Motion)
    return motion


def set_parameter(group: str, name: str, value: Any):
    def change(groups):
        groups[group][name] = value

    return change


@pytest.mark.parametrize(
    ("header", "change"),
    [
        ({9: 0}, None),  # ezc3d issue 307
        ({2: 0, 9: 0}, None),
        ({2: 80}, None),
        ({1: 5}, None),
        ({}, set_parameter("POINT", "USED", counts(2))),
        ({}, set_parameter("ANALOG", "USED", counts(0))),
        ({}, set_parameter("ANALOG", "RATE", f4(500))),
        ({}, set_parameter("POINT", "SCALE", f4(0.1))),
    ],
)
def test_the_size_of_the_file_settles_contradictions_of_header_and_parameters(tmp_path, header, change):
    right = read_bytes(tmp_path, built())
    motion = read_bytes(tmp_path, built(header=header, change=change))
    assert np.array_equal(motion.positions, right.positions)
    assert np.array_equal(motion.extras["analog"].values, right.extras["analog"].values)
    assert motion.extras["analog"].rate == 1000
    assert any("the size of the file" in note for note in formats.notes(motion))


def test_another_rate_of_analog_samples_is_noted(tmp_path):
    motion = read_bytes(tmp_path, built(change=set_parameter("ANALOG", "RATE", f4(1003))))
    assert motion.extras["analog"].rate == 1000
    assert any("ANALOG:RATE is 1003 Hz" in note for note in formats.notes(motion))
    assert not any("ANALOG:RATE" in note for note in formats.notes(read_bytes(tmp_path, built())))


def test_a_contradiction_that_the_size_allows_both_ways_is_refused(tmp_path):
    table = np.ones((3, 13))
    table[:, 3:12:4] = table[-1] = 0
    with pytest.raises(BadInput, match="contradict each other"):
        read_bytes(tmp_path, built(3, 3, 1, 1, header={2: 0, 9: 0}, table=table))


@pytest.mark.parametrize(
    ("frames", "stated"), [(70000, 0xFFFF), (70000, 70000 & 0xFFFF), (65535, 0xFFFF), (65536, 0xFFFF)]
)
def test_more_frames_than_16_bits_count(tmp_path, frames, stated):
    table = np.zeros((frames, 4))
    table[:, 0] = np.arange(frames) % 5000 + 1
    data = built(frames, 1, 0, 0, change=set_parameter("POINT", "FRAMES", counts(stated)), table=table)
    motion = read_bytes(tmp_path, data)
    assert len(motion) == frames
    assert any(f"gives {frames} frames" in note for note in formats.notes(motion)) == (frames > 65535)


def test_data_behind_the_declared_frames_are_noted(tmp_path):
    data = built()
    assert "more bytes" not in " ".join(formats.notes(read_bytes(tmp_path, data + bytes(5000))))
    notes = formats.notes(read_bytes(tmp_path, data + b"x" * 5000))
    assert f"{5000 + -(20 * 52 * 4) % 512} more bytes" in " ".join(notes)


@pytest.mark.parametrize(
    ("times", "labels", "used", "expected"),
    [
        (f4(0, 0.6), ["a"], 1, [0.6]),  # ezc3d issue 326
        (f4(0, 0.6), ["a"], None, [0.6]),
        (np.array(0.6, np.float32), ["a"], None, [0.6]),
        (f4(0.25), ["a"], 1, [0.25]),
        (f4(0.25, 0.5, 0.75), ["a", "b", "c"], None, [0.25, 0.5, 0.75]),
        (np.array([[0, 1], [0.5, 2]], np.float32), ["a", "b"], None, [0.5, 62]),  # ezc3d issue 224
        (np.array([[0, 0], [0.5, 2]], np.float32), ["a", "b"], 1, [0.5]),
        (np.array([[0, 0.5], [0, 0.75], [0, 1]], np.float32), ["a", "b", "c"], None, [0.5, 0.75, 1]),
    ],
)
def test_events_in_every_shape(tmp_path, times, labels, used, expected):
    def change(groups):
        groups["EVENT"] = {"TIMES": times, "LABELS": labels, "GENERIC_FLAGS": np.zeros(len(labels), np.int8)}
        if used is not None:
            groups["EVENT"]["USED"] = counts(used)

    motion = read_bytes(tmp_path, built(change=change))
    assert [event["time_s"] for event in motion.extras["events"]] == pytest.approx(expected)
    assert [event["label"] for event in motion.extras["events"]] == labels[: len(expected)]
    again = back(motion, tmp_path)
    assert [event["time_s"] for event in again.extras["events"]] == pytest.approx(expected)


def test_events_that_are_not_understood_stay_in_the_parameters(tmp_path):
    def change(groups):
        groups["EVENT"] = {"TIMES": np.zeros((2, 2, 2), np.float32), "LABELS": ["a"]}

    motion = read_bytes(tmp_path, built(change=change))
    assert "events" not in motion.extras
    assert motion.extras["parameters"]["EVENT"]["LABELS"] == ["a"]
    assert back(motion, tmp_path).extras["parameters"]["EVENT"]["TIMES"].shape == (2, 2, 2)


def test_more_events_than_one_parameter_holds(tmp_path):
    events = [{"label": f"e{i}", "time_s": i / 1000, "icon_id": i % 3} for i in range(600)]
    again = back(replace(markers(), extras={"events": events}), tmp_path)
    assert [e["label"] for e in again.extras["events"]] == [e["label"] for e in events]
    assert [e["time_s"] for e in again.extras["events"]] == pytest.approx([e["time_s"] for e in events], abs=1e-6)
    assert not again.extras["parameters"]["EVENT"]


def test_more_analog_channels_than_one_parameter_holds(tmp_path):
    channels = 300
    scale, offset = np.arange(1, channels + 1), np.arange(channels) % 7

    def change(groups):
        groups["ANALOG"] |= {
            "SCALE": f4(*scale[:255]), "SCALE2": f4(*scale[255:]), "OFFSET": counts(*offset[:255]),
            "OFFSET2": counts(*offset[255:]), "LABELS": [f"A{i}" for i in range(255)],
            "LABELS2": [f"A{i}" for i in range(255, channels)],
        }  # fmt: skip

    motion = read_bytes(tmp_path, built(channels=channels, per_frame=1, change=change))
    signal = motion.extras["analog"]
    assert signal.labels[-1] == "A299"
    assert np.array_equal(c3d.analog(motion), (signal.values.astype(float) - offset) * scale)
    assert np.array_equal(c3d.analog(back(motion, tmp_path)), c3d.analog(motion))
    plain = replace(markers(), extras={"analog": Signal(signal.values, 120.0)})
    assert np.array_equal(c3d.analog(back(plain, tmp_path)), signal.values)


def test_the_offset_of_the_last_parameter_may_point_anywhere(tmp_path):
    data = bytearray(built())
    at, last = 512 + 4, 0
    while data[at + 1]:  # the step of the record that the end follows
        last = at + 2 + abs(struct.unpack_from("b", data, at)[0])
        at = last + struct.unpack_from("<H", data, last)[0]
    right = read_bytes(tmp_path, bytes(data))
    for step in (5000, 0xFFFF, 700):
        struct.pack_into("<H", data, last, step)
        motion = read_bytes(tmp_path, bytes(data))
        assert np.array_equal(motion.positions, right.positions)
        assert motion.extras["analog"].labels == right.extras["analog"].labels


def test_labels_are_unique_inside_and_restored_outside(tmp_path):
    labels = ["", "P1", "LASI", "LASI", "", "LASI_2", ""]
    motion = read_bytes(tmp_path, built(points=7, change=set_parameter("POINT", "LABELS", labels)))
    assert motion.names == ("P1_2", "P1", "LASI", "LASI_3", "P5", "LASI_2", "P7")
    formats.write(tmp_path / "y.c3d", motion.select(["LASI_3", "P5", "P1"]))
    data = (tmp_path / "y.c3d").read_bytes()
    assert c3d.read(tmp_path / "y.c3d").names == ("LASI", "P2", "P1")
    assert b"LASI_3" not in data
    coded = mc.decode(mc.encode(motion, codec="lossless"))
    again = back(coded, tmp_path)
    assert (again.names, again.source["labels"]) == (motion.names, motion.source["labels"])


@pytest.mark.parametrize(("units", "unit_m"), [("meters", 1.0), ("millimeters", 1e-3), ("mete", 1.0), ("MM", 1e-3)])
def test_spelled_out_units(tmp_path, units, unit_m):
    data = built(change=set_parameter("POINT", "UNITS", [units]))
    motion = read_bytes(tmp_path, data)
    assert motion.positions[0, 0, 0] == unit_m
    assert back(motion, tmp_path).source["units"] == units
    odd = built(change=set_parameter("POINT", "UNITS", ["furlong"]))
    with pytest.raises(BadInput, match="--unit"):
        read_bytes(tmp_path, odd)
    assert read_bytes(tmp_path, odd, unit="cm", rate=50.0).positions[0, 0, 0] == 0.01
    unnamed = read_bytes(tmp_path, built(change=set_parameter("POINT", "UNITS", np.array(0, np.int16))))
    assert any("unit mm (--unit)" in note for note in formats.notes(unnamed))


def test_analog_without_points(tmp_path):
    motion = read_bytes(tmp_path, built(points=0))
    assert motion.positions.shape == (20, 0, 3)
    assert (motion.extras["analog"].values.shape, motion.extras["analog"].rate) == ((200, 4), 1000.0)
    again = back(motion, tmp_path)
    assert np.array_equal(again.extras["analog"].values, motion.extras["analog"].values)
    assert again.positions.shape == motion.positions.shape


def zeros_file(negative_residual: bool) -> tuple[bytes, np.ndarray]:
    table = np.zeros((30, 12))
    table[:, [0, 1, 2, 4, 5, 6]] = np.random.default_rng(0).normal(900, 10, (30, 6)).astype(np.float32)
    table[:, 8] = np.arange(-15, 15)  # a marker that passes through the origin
    table[5:12, :3] = 0
    table[25:, 4:7] = 0
    if negative_residual:
        table[20, [4, 5, 6]], table[20, 7] = 0, -1
    return built(30, 3, 0, 0, table=table), table


@pytest.mark.parametrize("negative_residual", [False, True])
def test_samples_parked_at_the_origin_are_gaps_and_are_written_as_they_were(tmp_path, negative_residual):
    data, table = zeros_file(negative_residual)
    motion = read_bytes(tmp_path, data)
    expected = np.zeros((30, 3), bool)
    expected[5:12, 0] = expected[25:, 1] = True
    expected[20, 1] = negative_residual
    assert np.array_equal(motion.gaps, expected)
    assert any("12 samples at exactly (0, 0, 0) are gaps" in note for note in formats.notes(motion))
    assert read_bytes(tmp_path, data, gaps="keep").gaps.sum() == negative_residual
    for same in (motion, mc.decode(mc.encode(motion, codec="lossless"))):
        formats.write(tmp_path / "y.c3d", same)
        written = (tmp_path / "y.c3d").read_bytes()
        block = struct.unpack_from("<H", written, 16)[0]
        again = np.frombuffer(written, "<f4", table.size, (block - 1) * 512).reshape(table.shape)
        np.testing.assert_allclose(again, table, rtol=1e-6)
    cut = motion[4:12]
    formats.write(tmp_path / "y.c3d", cut)
    assert np.array_equal(formats.read(tmp_path / "y.c3d").gaps, cut.gaps)


def test_zeros_everywhere_are_positions(tmp_path):
    assert not read_bytes(tmp_path, built(5, 2, 0, 0, table=np.zeros((5, 8)))).gaps.any()


def test_salvage_reads_the_complete_frames_of_a_truncated_file(tmp_path):
    whole = read_bytes(tmp_path, built(frames=200))
    data = built(frames=200)[:-9000]
    with pytest.raises(BadInput, match="--salvage"):
        read_bytes(tmp_path, data)
    part = read_bytes(tmp_path, data, salvage=True)
    assert 0 < len(part) < 200
    assert np.array_equal(part.positions, whole.positions[: len(part)])
    assert np.array_equal(part.extras["analog"].values, whole.extras["analog"].values[: 10 * len(part)])
    assert any(f"{len(part)} of 200 declared frames" in note for note in formats.notes(part))
    again = read_bytes(tmp_path, built(frames=200), salvage=True)
    assert np.array_equal(again.positions, whole.positions)
    assert not any("cut off" in note for note in formats.notes(again))


def test_salvage_fills_lost_rotations(tmp_path):
    motion = replace(markers(), extras={"rotations": Signal(np.ones((20, 2, 17), np.float32), 120.0)})
    formats.write(tmp_path / "x.c3d", motion)
    data = (tmp_path / "x.c3d").read_bytes()[:-1500]
    with pytest.raises(BadInput, match="rotations"):
        read_bytes(tmp_path, data)
    part = read_bytes(tmp_path, data, salvage=True)
    assert np.array_equal(part.positions, motion.positions, equal_nan=True)
    assert np.isnan(part.extras["rotations"].values[-1]).all()
    assert (part.extras["rotations"].values[0] == 1).all()


def test_floats_under_a_scale_of_integers(tmp_path):
    """Some programs store floats and forget the sign of POINT:SCALE, in parameters and header alike."""
    right = read_bytes(tmp_path, built())
    data = bytearray(built(change=set_parameter("POINT", "SCALE", f4(0.1))))
    data[12:16] = struct.pack("<f", 0.1)
    motion = read_bytes(tmp_path, bytes(data))
    assert np.array_equal(motion.positions, right.positions)
    assert any("as floats" in note for note in formats.notes(motion))


@pytest.mark.parametrize("frames", [np.array([-1], np.int16), f4(-1), f4(0)])
def test_frames_that_are_not_counted_follow_from_the_size(tmp_path, frames):
    motion = read_bytes(tmp_path, built(header={4: 0}, change=set_parameter("POINT", "FRAMES", frames)))
    assert len(motion) == 20


@pytest.mark.parametrize(
    ("group", "name", "value"),
    [
        ("POINT", "USED", f4(3)),
        ("POINT", "USED", np.array(3, np.int8)),
        ("POINT", "RATE", np.array([100], np.int16)),
        ("ANALOG", "USED", f4(4)),
        ("ANALOG", "RATE", np.array([1000], np.int16)),
        ("POINT", "FRAMES", f4(20)),
        ("POINT", "UNITS", ["mm", "mm", "mm"]),
        ("POINT", "UNITS", "mm mm mm"),
        ("POINT", "LABELS", "M0"),
        ("ANALOG", "LABELS", ["only one"]),
    ],
)
def test_parameters_of_unusual_types(tmp_path, group, name, value):
    right = read_bytes(tmp_path, built())
    motion = read_bytes(tmp_path, built(change=set_parameter(group, name, value)))
    assert np.array_equal(motion.positions, right.positions)
    assert np.array_equal(motion.extras["analog"].values, right.extras["analog"].values)
    assert (motion.rate, motion.extras["analog"].rate) == (100.0, 1000.0)
    again = back(motion, tmp_path)
    assert np.array_equal(again.positions, motion.positions)


def test_axes_of_different_units_are_refused(tmp_path):
    data = built(change=set_parameter("POINT", "UNITS", ["mm", "mm", "m"]))
    with pytest.raises(BadInput, match="different units"):
        read_bytes(tmp_path, data)
    assert read_bytes(tmp_path, data, unit="mm").source["unit_m"] == 1e-3


def test_samples_that_are_no_numbers_are_gaps_whatever_their_residual(tmp_path):
    table = np.ones((20, 12))
    table[:, 3::4] = 0
    table[3, 0], table[5, 5], table[7, 3], table[9, 11] = np.nan, np.nan, np.nan, -1
    motion = read_bytes(tmp_path, built(channels=0, per_frame=0, table=table))
    assert np.argwhere(motion.gaps).tolist() == [[3, 0], [5, 1], [7, 0], [9, 2]]


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        ("Fußgelenk".encode(), "Fußgelenk"),
        ("Fußgelenk".encode("latin-1"), "Fußgelenk"),
        ("cheville é".encode("latin-1"), "cheville é"),
        ("左膝マーカ".encode("cp932"), "左膝マーカ"),
        ("左膝".encode(), "左膝"),
        ("左膝".encode()[:-1], "左"),
    ],
)
def test_text_in_other_encodings(raw, expected):
    assert text(raw + b"   ") == expected
