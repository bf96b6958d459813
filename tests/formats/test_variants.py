"""C3D, TRC, BVH and AMC as other programs write them: contradictions, spellings, decimal commas, missing fields."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from mocodec import BadInput, Motion, PointClouds, formats
from mocodec.formats.bvh.reading import rate_of
from mocodec.formats.c3d.parameters import counts
from mocodec.formats.conventions import metres_in

from .samples import AMC, ASF, BVH
from .test_c3d import built, f4, read_bytes, set_parameter

KEYS = "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits"
HEAD = (
    "PathFileType\t4\t(X/Y/Z)\tx.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n"
    "100\t100\t4\t2\tmm\n"
    "Frame#\tTime\tA\t\t\tB\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)
ROWS = [f"{i + 1}\t{i / 100:.2f}\t{i}.5\t2.5\t3.5\t{i}.25\t5.5\t6.5" for i in range(4)]
TRC = HEAD + "\n" + "\n".join(ROWS) + "\n"


def trc(tmp_path, text: str | bytes, **options) -> Motion:
    (tmp_path / "x.trc").write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    motion = formats.read(tmp_path / "x.trc", **options)
    assert isinstance(motion, Motion)
    return motion


def bvh(tmp_path, text: str, **options) -> Motion:
    (tmp_path / "x.bvh").write_text(text)
    motion = formats.read(tmp_path / "x.bvh", **options)
    assert isinstance(motion, Motion)
    return motion


def amc(tmp_path, text: str, asf: str = ASF, **options) -> Motion:
    (tmp_path / "x.amc").write_text(text)
    (tmp_path / "x.asf").write_text(asf)
    motion = formats.read(tmp_path / "x.amc", **options)
    assert isinstance(motion, Motion)
    return motion


def notes(recording: Motion | PointClouds) -> str:
    return " ".join(formats.notes(recording))


@pytest.mark.parametrize(
    ("spelling", "metres"),
    [
        ("millimètres", 1e-3), ("Millimetri", 1e-3), ("milímetros", 1e-3), ("мм", 1e-3), ("毫米", 1e-3), ("㎜", 1e-3),
        ('"mm"', 1e-3), ("Zentimeter", 1e-2), ("metros", 1.0), ("Zoll", 0.0254), ("pouces", 0.0254), ("µm", 1e-6),
        ("micron", 1e-6), ("Fuß", 0.3048), ("m/s", None), ("N mm", None), ("degrees", None), ("none", None),
    ],
)  # fmt: skip
def test_units_in_many_languages(spelling, metres):
    assert metres_in(spelling) == metres


@pytest.mark.parametrize("where", ["header", "parameters"])
def test_a_wrong_start_of_the_data_is_settled_by_the_size(tmp_path, where):
    right = read_bytes(tmp_path, built())
    data = bytearray(built())
    (start,) = struct.unpack_from("<H", data, 16)
    for wrong in (2, start + 4):
        if where == "header":
            struct.pack_into("<H", data, 16, wrong)
        else:
            at = data.index(b"DATA_START") + len("DATA_START") + 5
            struct.pack_into("<H", data, at, wrong)
        motion = read_bytes(tmp_path, bytes(data))
        assert np.array_equal(motion.positions, right.positions)
        assert f"begin at block {start}" in notes(motion)


def test_a_start_of_the_data_without_evidence_is_refused(tmp_path):
    data = bytearray(built(frames=4000))
    (start,) = struct.unpack_from("<H", data, 16)
    struct.pack_into("<H", data, 16, start + 1)
    at = data.index(b"DATA_START") + len("DATA_START") + 5
    struct.pack_into("<H", data, at, start + 5)
    with pytest.raises(BadInput, match="where its data begin"):
        read_bytes(tmp_path, bytes(data))


def integers(scale: float, scale_in_header: float) -> bytes:
    """Points whose coordinates are integers of 0.5 mm, under these scales."""
    data = built(channels=0, change=set_parameter("POINT", "SCALE", f4(scale)))
    (start,) = struct.unpack_from("<H", data, 16)
    table = np.arange(20 * 12).reshape(20, 12) * 20 - 2000
    table[:, 3::4] = 0
    body = table.astype("<i2").tobytes()
    head = bytearray(data[: 512 * (start - 1)])
    struct.pack_into("<f", head, 12, scale_in_header)
    return bytes(head) + body + bytes(-len(body) % 512)


def test_integers_under_a_scale_of_floats(tmp_path):
    right = read_bytes(tmp_path, integers(0.5, 0.5))
    motion = read_bytes(tmp_path, integers(-0.5, -0.5))
    assert np.array_equal(motion.positions, right.positions)
    assert "integers, not" in notes(motion)


def test_half_of_a_file_of_floats_is_cut_off_and_no_integers(tmp_path):
    data = built(frames=200, channels=0)
    (start,) = struct.unpack_from("<H", data, 16)
    begin = 512 * (start - 1)
    with pytest.raises(BadInput, match="cut off"):
        read_bytes(tmp_path, data[: begin + (len(data) - begin) // 2])


def test_scales_that_differ_are_noted(tmp_path):
    assert "POINT:SCALE is 0.5, the header's scale 0.25" in notes(read_bytes(tmp_path, integers(0.5, 0.25)))
    motion = read_bytes(tmp_path, integers(float("nan"), 0.5))
    assert np.array_equal(motion.positions, read_bytes(tmp_path, integers(0.5, 0.5)).positions)


@pytest.mark.parametrize(("in_header", "in_point"), [(21, 20), (20, 21), (20, 1), (7, 20)])
def test_one_wrong_count_of_frames_is_noted(tmp_path, in_header, in_point):
    """20 frames of 48 bytes leave 64 bytes of padding: room for a frame of zeros that is none."""
    data = built(channels=0, header={4: in_header}, change=set_parameter("POINT", "FRAMES", counts(in_point)))
    motion = read_bytes(tmp_path, data)
    assert len(motion) == 20
    assert "counts of frames" in notes(motion)


@pytest.mark.parametrize(
    ("times", "used", "expected"),
    [
        (f4(0, 0.1, 0, 0.2, 1, 0.3), 3, [0.1, 0.2, 60.3]),
        (np.array([[0, 0.2], [0, 0.4]], np.float32), 2, [0.2, 0.4]),
        (np.array([[0, 0], [0.2, 0.4]], np.float32), 2, [0.2, 0.4]),
        (np.array([[0, 0], [0.2, 0.4]], np.float32)[:, :, None], 2, [0.2, 0.4]),
    ],
)
def test_times_of_events_in_more_shapes(tmp_path, times, used, expected):
    def change(groups):
        groups["EVENT"] = {"USED": counts(used), "TIMES": times, "LABELS": [f"e{i}" for i in range(used)]}

    motion = read_bytes(tmp_path, built(change=change))
    assert [event["time_s"] for event in motion.extras["events"]] == pytest.approx(expected)


@pytest.mark.parametrize("used", [0, 1])
def test_events_beyond_those_in_use_are_noted(tmp_path, used):
    def change(groups):
        times = np.array([[0, 0], [0.2, 0.4]], np.float32)
        groups["EVENT"] = {"USED": counts(used), "TIMES": times, "LABELS": ["a", "b"]}

    assert f"EVENT:USED is {used}" in notes(read_bytes(tmp_path, built(change=change)))


@pytest.mark.parametrize(
    "text",
    [
        TRC.replace("\n", "\r\n").encode(),
        TRC.encode("utf-16"),
        (TRC + "\x1a\r\n").encode(),
        TRC.replace(".", ",").replace("x,trc", "x.trc"),
        TRC.replace(KEYS, KEYS.lower()),
        TRC.replace("\t4\t2\tmm", "\t4.0\t2.0\tmm"),
        TRC.replace("NumFrames\tNumMarkers\t", "").replace("100\t4\t2\t", "100\t"),
        TRC.replace("Frame#", "Frame"),
        TRC.replace("Frame#\tTime", "FRAME#\tTIME"),
        HEAD.replace("\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n", "") + "\n".join(ROWS) + "\n",
        TRC.replace("\tA\t\t\tB\t\t", '\t"A"\t\t\t"B"\t\t').replace("PathFileType", '"PathFileType"'),
        TRC.replace("\tA\t\t\tB\t\t", "\tA\tA\tA\tB\tB\tB"),
        TRC.replace("DataRate\t", "DataRate\t\t").replace("100\t100", "100\t\t100"),
        HEAD + "\n".join("\t" + row.partition("\t")[2] for row in ROWS) + "\n",
    ],
    ids=[
        "crlf", "utf16", "eof", "comma", "lower", "floats", "uncounted", "frame", "capitals", "axes", "quotes",
        "repeated", "tabs", "numbers",
    ],
)  # fmt: skip
def test_trc_as_other_programs_write_it(tmp_path, text):
    right = trc(tmp_path, TRC)
    motion = trc(tmp_path, text)
    assert np.array_equal(motion.positions, right.positions)
    assert (motion.names, motion.rate, motion.source["unit_m"]) == (("A", "B"), 100.0, 1e-3)


@pytest.mark.parametrize(
    "word", ["NaN", "-nan", "NA", "N/A", "#N/A", "null", "-", "1.#QNAN", "-1.#IND", "-nan(ind)", "1.#QNAN0"]
)
def test_words_for_gaps(tmp_path, word):
    motion = trc(tmp_path, TRC.replace("1.25\t5.5\t6.5", f"{word}\t{word}\t{word}"))
    assert motion.gaps.sum() == 1
    assert motion.gaps[1, 1]


def test_an_empty_unit_is_a_guess_and_a_number_is_none(tmp_path):
    keys = HEAD.replace("Units\n", "Units\tOrigDataRate\n")
    motion = trc(tmp_path, keys.replace("\t2\tmm\n", "\t2\t\t100\n") + "\n".join(ROWS) + "\n")
    assert motion.source["unit_m"] == 1e-3
    assert motion.source["unit_guessed"]
    with pytest.raises(BadInput, match="unknown unit '25'"):
        trc(tmp_path, TRC.replace("\tmm\n", "\t25\n"))


def test_milliseconds_and_missing_rates_follow_from_the_times(tmp_path):
    text = HEAD + "\n".join(f"{i + 1}\t{10 * i}.0\t1\t2\t3\t4\t5\t6" for i in range(4)) + "\n"
    motion = trc(tmp_path, text)
    assert motion.rate == 100
    assert "milliseconds" in notes(motion)
    motion = trc(tmp_path, TRC.replace("100\t100", "0\t100"))
    assert motion.rate == 100
    assert "time column" in notes(motion)


def test_repeated_names_are_unique_inside_and_restored_outside(tmp_path):
    motion = trc(tmp_path, TRC.replace("\tB\t", "\tA\t"))
    assert motion.names == ("A", "A_2")
    formats.write(tmp_path / "y.trc", motion)
    assert "\tA\t\t\tA\t" in (tmp_path / "y.trc").read_text()


def test_more_names_than_columns_are_refused_and_other_counts_are_noted(tmp_path):
    with pytest.raises(BadInput, match="names 4 markers"):
        trc(tmp_path, TRC.replace("\tA\t\t\tB\t\t", "\tA\t\t\tB\t\t\tC\t\t\tD\t\t"))
    assert "declares 5 markers" in notes(trc(tmp_path, TRC.replace("\t4\t2\t", "\t4\t5\t")))


@pytest.mark.parametrize("encoding", ["utf-8", "cp932", "utf-16"])
def test_japanese_names(tmp_path, encoding):
    assert trc(tmp_path, TRC.replace("\tA\t", "\t左膝\t").encode(encoding)).names == ("左膝", "B")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("MOTION\n", "Motion\n"),
        ("Frames: 3", "Frames 3"),
        ("Frames: 3", "Frames :  3.0"),
        ("Frame Time: 0.0083333", "FrameTime:0.0083333"),
        ("Frames: 3\nFrame Time: 0.0083333", "Frame Time: 0.0083333\nFrames: 3"),
        ("HIERARCHY", "# made for a test\nHIERARCHY"),
        ("ROOT", "// the root\nROOT"),
        ("0 90 0 0", "# first frame\n0 90 0 0"),
        ("End Site", "EndSite"),
        ("0.0083333", "0,0083333"),
        (".", ","),
    ],
)
def test_bvh_as_other_programs_write_it(tmp_path, before, after):
    right = bvh(tmp_path, BVH)
    motion = bvh(tmp_path, BVH.replace(before, after))
    assert np.array_equal(motion.positions, right.positions)
    assert (motion.names, motion.rate) == (right.names, right.rate)


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        ("0.016", 60),
        ("0.017", 60),
        ("0.033", 30),
        ("0.0625", 16),
        ("0.041", 24),
        ("0.0166", 60),
        ("0.016666", 60),
        ("0.0416", 24),
        ("0.0083", 120),
    ],
)
def test_digits_of_frame_time_may_be_cut_off(text, rate):
    assert rate_of(text, "x.bvh") == rate


def test_frame_times_that_cannot_be_right(tmp_path):
    with pytest.raises(BadInput, match="use rate="):
        bvh(tmp_path, BVH.replace("0.0083333", "0"))
    assert bvh(tmp_path, BVH.replace("0.0083333", "0"), rate=60).rate == 60
    assert "30 seconds" in notes(bvh(tmp_path, BVH.replace("0.0083333", "30")))


def test_more_frames_than_declared_are_salvaged(tmp_path):
    text = BVH.replace("Frames: 3", "Frames: 1")
    with pytest.raises(BadInput, match="--salvage"):
        bvh(tmp_path, text)
    motion = bvh(tmp_path, text, salvage=True)
    assert len(motion) == 3
    assert "declares 1 frames" in notes(motion)


def amc_frames(numbers: list[int]) -> str:
    """The AMC of the samples, its first frame repeated under these numbers."""
    head, _, rest = AMC.partition("\n7\n")
    frame = rest.partition("\n8\n")[0]
    return head + "\n" + "".join(f"{number}\n{frame}\n" for number in numbers)


def test_frame_numbers_of_an_amc(tmp_path):
    assert not notes(amc(tmp_path, amc_frames([5, 6, 7]), rate=60))
    assert "step by 2" in notes(amc(tmp_path, amc_frames([1, 3, 5])))
    assert "do not increase" in notes(amc(tmp_path, amc_frames([1, 2, 2, 3])))
    with pytest.raises(BadInput, match=r"2 frames are missing .* after frame 2"):
        amc(tmp_path, amc_frames([1, 2, 5, 6]))
    motion = amc(tmp_path, amc_frames([1, 2, 5, 6]), salvage=True)
    assert len(motion) == 4
    assert "2 frames are missing" in notes(motion)


@pytest.mark.parametrize(
    ("line", "rate"), [(":FRAMES-PER-SECOND 30", 30), (":frame-rate 60", 60), (":SAMPLES_PER_SECOND 50", 50)]
)
def test_keywords_for_the_rate_of_an_amc(tmp_path, line, rate):
    assert amc(tmp_path, AMC.replace(":DEGREES", f"{line}\n:DEGREES")).rate == rate


def test_comments_and_decimal_commas_in_an_amc(tmp_path):
    right = amc(tmp_path, AMC)
    head, _, frames = AMC.partition("\n7\n")
    commented = f"{head}\n7\n# a comment\n{frames}"
    assert np.array_equal(amc(tmp_path, commented).positions, right.positions)


def test_the_length_unit_of_an_asf_by_its_name(tmp_path):
    by_number = amc(tmp_path, AMC, ASF.replace("length 0.45", "length 2.54"))
    by_name = amc(tmp_path, AMC, ASF.replace("length 0.45", "length cm"))
    assert np.allclose(by_name.positions, by_number.positions)
    with pytest.raises(BadInput, match="name of a unit"):
        amc(tmp_path, AMC, ASF.replace("length 0.45", "length cubit"))


def test_units_and_names_of_an_npz(tmp_path):
    positions = np.random.default_rng(1).normal(size=(5, 4, 3))
    np.savez(tmp_path / "x.npz", positions=positions, rate=60, unit=np.array(b"mm"), names=np.array(["a", "b"]))
    motion = formats.read(tmp_path / "x.npz")
    assert np.allclose(motion.positions, positions / 1000)
    assert "no list of 4 names" in notes(motion)
    np.savez(tmp_path / "x.npz", positions=positions, rate=60)
    assert "unit m (--unit)" in notes(formats.read(tmp_path / "x.npz"))


@pytest.mark.parametrize(("scale", "noted"), [(1, True), (257, False)])
def test_colours_of_16_bits_in_either_range(tmp_path, scale, noted):
    colours = [(10, 200, 255), (0, 1, 2)]
    head = "ply\nformat ascii 1.0\nelement vertex 2\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "".join(f"property ushort {name}\n" for name in ("red", "green", "blue")) + "end_header\n"
    rows = [f"0 0 {i} " + " ".join(str(scale * value) for value in colour) for i, colour in enumerate(colours)]
    (tmp_path / "1.ply").write_text(head + "\n".join(rows) + "\n")
    clouds = formats.read(tmp_path, rate=15)
    assert isinstance(clouds, PointClouds)
    assert clouds.colours is not None
    assert clouds.colours[0].tolist() == [list(colour) for colour in colours]
    assert ("16-bit" in notes(clouds)) == noted


TABLE = "time\tA_x\tA_y\tA_z\tB_x\tB_y\tB_z\n" + "\n".join(
    f"{i / 100:.2f}\t{i}.5\t1.5\t2.5\t3.5\t4.5\t{i}.25" for i in range(5)
)


def table(tmp_path, name: str, text: str, **options) -> Motion:
    (tmp_path / name).write_text(text)
    motion = formats.read(tmp_path / name, **options)
    assert isinstance(motion, Motion)
    return motion


@pytest.mark.parametrize("word", ["NA", "null", "-", "-nan(ind)", "1.#QNAN"])
def test_words_for_gaps_in_tables(tmp_path, word):
    gappy = TABLE.replace("0.5\t1.5\t2.5", f"{word}\t{word}\t{word}", 1)
    for name, text in (("x.sto", f"x\nendheader\n{gappy}\n"), ("x.csv", gappy.replace("\t", ",") + "\n")):
        motion = table(tmp_path, name, text)
        assert motion.gaps.sum() == 1
        assert motion.gaps[0, 0]


def test_decimal_commas_in_a_sto(tmp_path):
    right = table(tmp_path, "x.sto", f"x\nendheader\n{TABLE}\n")
    motion = table(tmp_path, "x.sto", f"x\nendheader\n{TABLE.replace('.', ',')}\n")
    assert np.array_equal(motion.positions, right.positions)


def test_quaternions_of_a_sto_are_no_points(tmp_path):
    rows = "\n".join(f"{i / 100}\t1,0,0,0\t0.6,0.8,0,0" for i in range(5))
    motion = table(tmp_path, "x.sto", f"x\nDataType=Quaternion\nendheader\ntime\tpelvis\ttorso\n{rows}\n")
    assert motion.points == 0
    assert motion.extras["signals"].values.shape == (5, 8)
    assert motion.extras["signals"].values[0].tolist() == [1, 0, 0, 0, 0.6, 0.8, 0, 0]
    formats.write(tmp_path / "y.sto", motion)
    assert table(tmp_path, "z.sto", (tmp_path / "y.sto").read_text()).points == 0


def test_csv_of_spreadsheets(tmp_path):
    right = table(tmp_path, "x.csv", TABLE.replace("\t", ",") + "\n")
    lines = TABLE.replace("\t", ";").split("\n")
    for text in (
        "sep=;\n" + "\n".join(lines).replace(".", ",") + "\n",
        "\n".join(f"{line};" for line in lines) + "\n",
        "\n".join([";" + lines[0], *(f"{i};{line}" for i, line in enumerate(lines[1:]))]) + "\n",
    ):
        motion = table(tmp_path, "x.csv", text)
        assert np.array_equal(motion.positions, right.positions)
        formats.write(tmp_path / "y.csv", motion)
        assert np.array_equal(formats.read(tmp_path / "y.csv").positions, right.positions)
