"""STO, MOT and CSV: tables with columns of points and signals, in the headers that programs write."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, Motion, Signal, formats
from mocodec.formats.columns import find_points
from mocodec.formats.conventions import start_s

from .samples import markers, same_tree


def read_text(tmp_path, name: str, text: str, **options) -> Motion:
    (tmp_path / name).write_text(text)
    motion = formats.read(tmp_path / name, **options)
    assert isinstance(motion, Motion)
    return motion


def back(tmp_path, motion: Motion, name: str) -> Motion:
    formats.write(tmp_path / name, motion)
    again = formats.read(tmp_path / name)
    assert isinstance(again, Motion)
    return again


def sto(labels: list[str], rows: int = 5, header: str = "inDegrees=yes\n", declared: int | None = None) -> str:
    lines = ["Coordinates", "version=1", f"nRows={rows if declared is None else declared}"]
    lines += [f"nColumns={1 + len(labels)}", header + "endheader", "\t".join(["time", *labels])]
    for row in range(rows):
        cells = [f"{0.123456789012345 * (row + 1) * (i + 1):.17g}" for i in range(len(labels))]
        lines.append("\t".join([f"{2.5 + row / 100:.8f}", *cells]))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        (["A.x", "A.y", "A.z"], ["A"]),
        (["A_x", "A_y", "A_z", "B_X", "B_Y", "B_Z"], ["A", "B"]),
        (["S:A:X", "S:A:Y", "S:A:Z"], ["S:A"]),
        (["A[x]", "A[y]", "A[z]"], ["A"]),
        (["A_1", "A_2", "A_3"], ["A"]),
        (["A X", "A Y", "A Z"], ["A"]),
        (["A_px", "A_py", "A_pz"], ["A"]),
        (["grf_vx", "grf_vy", "grf_vz", "grf_px", "grf_py", "grf_pz"], []),
        (["ground_force_vx", "ground_force_px", "ground_force_py", "ground_force_pz", "ground_torque_x"], []),
        (["ground_torque_x", "ground_torque_y", "ground_torque_z"], []),
        (["pelvis_tx", "pelvis_ty", "pelvis_tz", "pelvis_tilt"], []),
        (["pelvis_X", "pelvis_Y", "pelvis_Z", "pelvis_Ox", "pelvis_Oy", "pelvis_Oz"], ["pelvis"]),
        (["A_x", "A_y"], []),
        (["A_z", "Fz", "A_x", "A_y"], ["A"]),
        (["X_A", "Y_A", "Z_A", "X_B", "Y_B", "Z_B"], ["A", "B"]),
        (["x.A", "y.A", "z.A"], ["A"]),
        (["X:S:A", "Y:S:A", "Z:S:A"], ["S:A"]),
        (["X_1", "Y_1", "Z_1", "X_2", "Y_2", "Z_2", "X_3", "Y_3", "Z_3"], ["1", "2", "3"]),
        (["X_x", "X_y", "X_z", "Y_x", "Y_y", "Y_z", "Z_x", "Z_y", "Z_z"], ["X", "Y", "Z"]),
        (["X_A", "Y_A"], []),
        (["x_force", "y_force", "z_force"], []),
    ],
)
def test_columns_of_positions_are_found(labels, expected):
    assert [point.name for point in find_points(labels)] == expected


@pytest.mark.parametrize("suffix", [".sto", ".mot"])
def test_coordinates_are_signals_and_nothing_is_lost(tmp_path, suffix):
    text = sto(["pelvis_tilt", "pelvis_tx", "ground_force_vx", "ground_force_px", "knee_angle_r"])
    motion = read_text(tmp_path, f"a{suffix}", text)
    signal = motion.extras["signals"]
    assert (motion.points, motion.rate, len(motion)) == (0, 100.0, 5)
    assert start_s(motion.source, motion.rate) == pytest.approx(2.5)
    assert signal.units == ("deg", "m", "N", "m", "deg")
    again = back(tmp_path, mc.decode(mc.encode(motion)), f"b{suffix}")
    assert same_tree(again.extras["signals"], signal)
    assert again.source == motion.source
    assert (again.rate, again.points) == (motion.rate, 0)


def test_points_among_signals_come_back_in_their_columns(tmp_path):
    labels = ["Fx", "LASI_x", "LASI_y", "LASI_z", "knee", "RASI_x", "RASI_y", "RASI_z"]
    motion = read_text(tmp_path, "a.sto", sto(labels))
    assert motion.names == ("LASI", "RASI")
    assert motion.extras["signals"].labels == ("Fx", "knee")
    again = back(tmp_path, motion, "b.sto")
    assert np.array_equal(again.positions, motion.positions)
    assert same_tree(dict(again.extras), dict(motion.extras))
    assert (tmp_path / "b.sto").read_text().split("endheader\n")[1].split("\n")[0].split("\t") == ["time", *labels]


def test_a_part_has_its_own_counts(tmp_path):
    motion = read_text(tmp_path, "a.mot", sto(["LASI_x", "LASI_y", "LASI_z", "knee"]))
    again = back(tmp_path, motion[1:4], "b.mot")
    assert formats.notes(again) == formats.notes(motion)
    assert len(again) == 3
    assert start_s(again.source, again.rate) == pytest.approx(2.51)
    assert "nRows=3" in (tmp_path / "b.mot").read_text()


def test_cells_of_vectors(tmp_path):
    text = "x\nDataType=Vec3\nversion=3\nendheader\ntime\tA\tB\n0\t1,2,3\t4,5,6\n0.01\t~[1,2,4]\t4,5,7\n"
    motion = read_text(tmp_path, "a.sto", text)
    assert motion.names == ("A", "B")
    assert motion.positions[1, 0].tolist() == [1, 2, 4]
    assert np.array_equal(back(tmp_path, motion, "b.sto").positions, motion.positions)


def test_the_older_header_of_simm(tmp_path):
    text = "name a.mot\ndatacolumns 3\ndatarows 2\nrange 0 0.02\nendheader\ntime a b\n0 1 2\n 0.02  3  4\n"
    motion = read_text(tmp_path, "a.mot", text)
    assert (motion.rate, motion.extras["signals"].values.tolist()) == (50.0, [[1, 2], [3, 4]])


def test_contradictions_of_a_sto(tmp_path):
    with pytest.raises(BadInput, match="declares 9 rows, the file has 5"):
        read_text(tmp_path, "a.sto", sto(["a"], declared=9))
    salvaged = read_text(tmp_path, "a.sto", sto(["a"], declared=9), salvage=True)
    assert any("5 of 9 declared rows" in note for note in formats.notes(salvaged))
    more = read_text(tmp_path, "a.sto", sto(["a"], declared=3))
    assert (len(more), any("declares 3 rows" in note for note in formats.notes(more))) == (5, True)
    whole = sto(["a", "b"])
    with pytest.raises(BadInput):
        read_text(tmp_path, "a.sto", whole[: whole.rindex("\t")])
    assert len(read_text(tmp_path, "a.sto", whole[: whole.rindex("\t")], salvage=True)) == 4
    with pytest.raises(BadInput, match="endheader"):
        read_text(tmp_path, "a.sto", whole[:30])


def test_times_that_skip_and_times_that_are_irregular(tmp_path):
    head = "a\nendheader\ntime\tA_x\tA_y\tA_z\tf\n"
    rows = [f"{t}\t1\t2\t3\t{i}\n" for i, t in enumerate((0, 0.01, 0.02, 0.05, 0.06))]
    motion = read_text(tmp_path, "a.sto", head + "".join(rows))
    assert (len(motion), motion.rate, motion.gaps.sum()) == (7, 100.0, 2)
    assert any("2 frames are missing" in note for note in formats.notes(motion))
    rows = [f"{t}\t1\t2\t3\t{i}\n" for i, t in enumerate((0, 0.01, 0.013, 0.0217, 0.06))]
    motion = read_text(tmp_path, "a.sto", head + "".join(rows))
    assert any("equally spaced" in note for note in formats.notes(motion))
    again = back(tmp_path, motion, "b.sto")
    assert again.extras["times"].values.tolist() == [0, 0.01, 0.013, 0.0217, 0.06]


CSV = {
    "labels": "time,A.x,A.y,A.z,F\n0,1,2,3,9\n0.01,4,5,6,8\n",
    "semicolons": "time;A.x;A.y;A.z;F\n0;1,0;2,0;3,0;9,0\n0,01;4;5;6;8\n",
    "tabs": "Time (s)\tA_X\tA_Y\tA_Z\tF\n0\t1\t2\t3\t9\n0.01\t4\t5\t6\t8\n",
    "two rows": "time,A,,,F\n,X,Y,Z,\n0,1,2,3,9\n0.01,4,5,6,8\n",
    "names repeated": "Frame,time,A,A,A,F\n,,x,y,z,\n1,0,1,2,3,9\n2,0.01,4,5,6,8\n",
    "units": "time,A.x,A.y,A.z,F\ns,m,m,m,N\n0,1,2,3,9\n0.01,4,5,6,8\n",
    "units in labels": "time [s],A.x [m],A.y [m],A.z [m],F [N]\n0,1,2,3,9\n0.01,4,5,6,8\n",
    "milliseconds": "Time (ms),A.x,A.y,A.z,F\n0,1,2,3,9\n10,4,5,6,8\n",
    "byte-order mark": "\ufefftime,A.x,A.y,A.z,F\r\n0,1,2,3,9\r\n0.01,4,5,6,8\r\n",
    "quotes": '"time","A.x","A.y","A.z","F"\n"0","1","2","3","9"\n"0.01","4","5","6","8"\n',
}


@pytest.mark.parametrize("form", CSV)
def test_forms_of_csv(tmp_path, form):
    motion = read_text(tmp_path, "a.csv", CSV[form])
    assert (motion.names, motion.rate) == (("A",), 100.0)
    assert motion.positions[:, 0].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert motion.extras["signals"].labels == ("F",)
    assert motion.extras["signals"].values.ravel().tolist() == [9, 8]


def test_units_of_a_csv(tmp_path):
    motion = read_text(tmp_path, "a.csv", "time,A.x,A.y,A.z\ns,mm,mm,mm\n0,1000,0,3\n0.01,1000,0,4\n")
    assert (motion.positions[0, 0, 0], motion.source["units"]) == (1.0, "mm")
    assert not any("unit" in note for note in formats.notes(motion))
    assert any("unit m (--unit)" in note for note in formats.notes(read_text(tmp_path, "a.csv", CSV["labels"])))
    with pytest.raises(BadInput, match="different units"):
        read_text(tmp_path, "a.csv", "time,A.x,A.y,A.z\ns,mm,mm,m\n0,1000,0,3\n0.01,1000,0,4\n")


NEXUS = """Trajectories
120
,,S:LASI,,,S:RASI,,
Frame,Sub Frame,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm
31,0,1,2,3,4,5,6
32,0,1.5,2,3,,,
33,0,1,2,3,4,5,7

Devices
1200
,,Force Plate - Force,,
Frame,Sub Frame,Fx,Fy,Fz
,,N,N,N
31,0,1,2,3
31,1,1,2,3
"""


def test_an_export_of_vicon_nexus(tmp_path):
    motion = read_text(tmp_path, "a.csv", NEXUS)
    assert (motion.names, motion.rate, motion.source["units"]) == (("S:LASI", "S:RASI"), 120.0, "mm")
    assert motion.positions[1, 0].tolist() == pytest.approx([0.0015, 0.002, 0.003])
    assert np.argwhere(motion.gaps).tolist() == [[1, 1]]
    assert start_s(motion.source, motion.rate) == pytest.approx(30 / 120)
    plate = motion.extras["sections"]["devices"]
    assert (plate.rate, plate.values.shape, plate.units) == (1200.0, (30, 3), ("N", "N", "N"))
    assert plate.labels == tuple(f"Force Plate - Force.{axis}" for axis in ("Fx", "Fy", "Fz"))
    assert plate.values[:2].tolist() == [[1, 2, 3], [1, 2, 3]]
    assert np.isnan(plate.values[2:]).all()
    assert motion[1:].extras["sections"]["devices"].values.shape == (20, 3)
    assert formats.dropped("x.csv", motion) == ["devices and model outputs of a Nexus export"]
    devices = read_text(tmp_path, "a.csv", NEXUS[NEXUS.index("Devices") :])
    assert (devices.points, devices.rate, len(devices)) == (0, 1200.0, 2)
    assert devices.extras["signals"].units == ("N", "N", "N")


def test_other_sections_of_nexus(tmp_path):
    outputs = "Model Outputs\n120\n,,S:LKneeAngles,,\nFrame,Sub Frame,X,Y,Z\n,,deg,deg,deg\n30,0,9,9,9\n32,0,4,,6\n"
    events = "\nEvents\n120\nSubject,Context,Name,Time (s),Description\nS,Left,Foot Strike,0.3,\n"
    motion = read_text(tmp_path, "a.csv", NEXUS + "\n" + outputs + events)
    angles = motion.extras["sections"]["model outputs"]
    assert (angles.rate, angles.labels[0], angles.units[0]) == (120.0, "S:LKneeAngles.X", "deg")
    assert np.isnan(angles.values[[0, 2]]).all()
    assert np.array_equal(angles.values[1], [4, np.nan, 6], equal_nan=True)
    notes = formats.notes(motion)
    assert any("1 rows of the section model outputs" in note for note in notes)
    assert any("section events is not read" in note for note in notes)
    again = mc.decode(mc.encode(motion, codec="lossless"), mc.Motion)
    assert np.array_equal(again.extras["sections"]["model outputs"].values, angles.values, equal_nan=True)
    alone = read_text(tmp_path, "a.csv", NEXUS[NEXUS.index("Devices") :] + "\n" + outputs)
    assert (alone.rate, alone.extras["sections"]["devices"].rate) == (120.0, 1200.0)
    odd = read_text(tmp_path, "a.csv", NEXUS + "\n" + outputs.replace("120", "130", 1))
    assert any("130 Hz is no multiple" in note for note in formats.notes(odd))
    with pytest.raises(BadInput, match="do not fit its rate"):
        read_text(tmp_path, "a.csv", NEXUS.replace("31,1,1,2,3", "31,15,1,2,3"))


MOTIVE = """Format Version,1.23,Capture Frame Rate,120.000000,Export Frame Rate,120.000000,Length Units,Meters

,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker
,Name,Hip,Hip,Hip,Hip,Hip,Hip,Hip,LASI,LASI,LASI
,ID,1,1,1,1,1,1,1,2,2,2
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Position,Position,Position
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,X,Y,Z
0,0.000000,0,0,0,1,0.1,0.9,0.2,1,2,3
1,0.008333,0,0,0,1,0.1,0.9,0.3,,,
2,0.016667,0,0,0,1,0.1,0.9,0.4,1,2,4
"""


def test_an_export_of_optitrack_motive(tmp_path):
    motion = read_text(tmp_path, "a.csv", MOTIVE)
    assert (motion.names, motion.rate, motion.source["units"]) == (("Hip", "LASI"), 120.0, "Meters")
    assert motion.positions[2].tolist() == [[0.1, 0.9, 0.4], [1, 2, 4]]
    assert np.argwhere(motion.gaps).tolist() == [[1, 1]]
    assert motion.extras["signals"].values.shape == (3, 4)
    assert start_s(motion.source, motion.rate) == 0


@pytest.mark.parametrize("name", ["x.csv", "x.sto", "x.mot"])
def test_motions_of_other_formats_are_written(tmp_path, name):
    motion = markers()
    again = back(tmp_path, motion, name)
    assert (again.names, again.rate) == (motion.names, motion.rate)
    assert np.array_equal(again.positions, motion.positions, equal_nan=True)


def test_signals_and_zeros_of_a_csv_come_back(tmp_path):
    values = np.random.default_rng(1).normal(size=(30, 2))
    motion = replace(markers(30), extras={"signals": Signal(values, 120.0, ("a", "b,c"), ("N", "deg"))})
    again = back(tmp_path, motion, "x.csv")
    assert same_tree(again.extras["signals"], motion.extras["signals"])
    text = "time,A.x,A.y,A.z\ns,m,m,m\n0,0,0,0\n0.01,5,5,5\n0.02,5,5,6\n"
    zeros = read_text(tmp_path, "a.csv", text)
    assert zeros.gaps.ravel().tolist() == [True, False, False]
    formats.write(tmp_path / "b.csv", zeros)
    assert "\n0,0,0,0\n" in (tmp_path / "b.csv").read_text()
    assert not read_text(tmp_path, "a.csv", text, gaps="keep").gaps.any()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no rows"),
        ("a,b\n", "--rate"),
        ("1,2,3\n4,5,6\n", "labels"),
        ("time,A.x,A.y,A.z\n0,1,2,3\n0.01,4,5\n", "cut off"),
        ("time,A.x,A.y,A.z\n0,1,2,3\n0.01,4,5,6,7\n", "5 cells"),
        ("time,A.x,A.y,A.z\n0,1,2,3\n0.01,4,5,x\n", "not a number"),
        ("time,A.x,A.y,A.z\n0,1,2,x\n0.01,4,5,6\n", "'x' in a row of numbers"),
        ("time,A.x,A.y,A.z\n0,1,2,3,9\n0.01,4,5,6\n", "5 cells"),
        ("A.x,A.y,A.z\n1,2,3\n4,5,6\n", "--rate"),
        ("time,A.x,A.y,A.z\n0.01,1,2,3\n0,4,5,6\n", "do not increase"),
    ],
)
def test_csv_files_that_cannot_be_read(tmp_path, text, says):
    with pytest.raises(BadInput, match=says) as error:
        read_text(tmp_path, "a.csv", text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("numbers", [(1, 2, 5), (1, 4, 5, 9), (1, 4, 7, 10)])
def test_frame_numbers_of_nexus_that_skip(tmp_path, numbers):
    head = "Trajectories\n100\n,,S:A,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n"
    motion = read_text(tmp_path, "a.csv", head + "".join(f"{number},0,1,2,3\n" for number in numbers))
    assert (len(motion), motion.rate) == (numbers[-1], 100)
    assert np.flatnonzero(~motion.gaps[:, 0]).tolist() == [number - 1 for number in numbers]
    assert "are missing from the file's frame numbers" in formats.notes(motion)[1]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time,A1,A2,A3\n0,1,2,3\n0.1,4,5,6\n", "no columns are positions"),
        ("time,A.x,A.y,A.z,A.x\n0,1,2,3,4\n0.1,4,5,6,7\n", "all but the first are signals: A.x"),
        (NEXUS + "\n" + NEXUS[: NEXUS.index("Devices")], "another section trajectories is not read"),
    ],
)
def test_columns_and_sections_that_become_no_points_are_noted(tmp_path, text, says):
    assert says in " ".join(formats.notes(read_text(tmp_path, "a.csv", text)))


def test_times_since_1970(tmp_path):
    motion = read_text(tmp_path, "a.csv", "time,A.x,A.y,A.z\n1700000000.0,1,2,3\n1700000000.01,4,5,6\n")
    assert (motion.rate, start_s(motion.source, motion.rate)) == (100, 1.7e9)


def test_motive_without_words_beside_its_rows(tmp_path):
    rows = [
        "Format Version,1.23,Take Name,Walk,Export Frame Rate,100,Length Units,Meters",
        *(f",,{cells}" for cells in ("Marker,Marker,Marker", "Anna:hip,Anna:hip,Anna:hip", "7,7,7")),
        ",,Position,Position,Position",
        "Frame,Time (Seconds),X,Y,Z",
        "0,0.00,1,2,3",
        "1,0.01,2,3,4",
    ]
    path = tmp_path / "take.csv"
    path.write_text("\n".join(rows) + "\n")
    motion = formats.read(path)
    assert motion.names == ("Anna:hip",)
    assert motion.positions[1, 0].tolist() == [2, 3, 4]
