"""Model outputs of a C3D: angles, forces, moments and powers in the columns of points are kept apart, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, Motion, Signal, formats
from mocodec.formats import c3d
from mocodec.formats.c3d.parameters import parse

from .samples import SHARED, markers, needs_shared, same_tree
from .test_c3d import built, read_bytes

LABELS = ["LKneeAngles", "S:LASI", "S:LKneeMoment", "S:RASI", "LKneePower", "S:CentreOfMass", "S:Load"]
OUTPUTS = [0, 2, 4, 6]


def outputs_table(frames: int = 20) -> np.ndarray:
    """Samples of seven points, four of which are outputs; one output is missing in two frames."""
    rng = np.random.default_rng(3)
    table = rng.normal(size=(frames, 7, 4)).astype(np.float32) * 100
    table[:, :, 3] = 0
    table[4:6, 2] = 7, 8, 9, -1
    table[8, 1, 3] = -1
    return table.reshape(frames, -1)


def change(groups: dict[str, Any]) -> None:
    groups["POINT"] |= {
        "LABELS": LABELS,
        "ANGLES": ["LKneeAngles"],
        "ANGLE_UNITS": "deg",
        "MOMENTS": ["LKneeMoment"],  # without the subject's prefix
        "POWERS": ["LKneePower"],
        "MODELED_MARKERS": ["S:CentreOfMass"],
        "MODELED_MARKER_UNITS": "mm",
        "LOADS": ["S:Load"],
        "LOAD_UNITS": ["kg"],
        "TYPE_GROUPS": [["ANGLES", "ANGLE"], ["MODELED_MARKERS", "MODELED_MARKER"], ["LOADS", "LOAD"]],
    }


def file_with_outputs(frames: int = 20) -> bytes:
    return built(frames, 7, 0, 0, change=change, table=outputs_table(frames))


def columns_of(path: Path) -> tuple[np.ndarray, list[str]]:
    """(frames, points, 4) and labels of a C3D without analog channels, by its header alone."""
    data = path.read_bytes()
    points, first, last, block = (int.from_bytes(data[i : i + 2], "little") for i in (2, 6, 8, 16))
    labels = parse(data, 512, 84).texts("POINT", "LABELS")
    table = np.frombuffer(data, "<f4", (last - first + 1) * 4 * points, (block - 1) * 512)
    return table.reshape(-1, points, 4), labels


def test_outputs_are_signals_and_markers_are_points(tmp_path):
    motion = read_bytes(tmp_path, file_with_outputs())
    assert motion.names == ("S:LASI", "S:RASI", "S:CentreOfMass")
    signals = motion.extras["model_outputs"]["signals"]
    found = {kind: (signal.labels, signal.units, signal.rate) for kind, signal in signals.items()}
    assert found == {
        "ANGLES": (("LKneeAngles",), ("deg",), 100.0),
        "MOMENTS": (("S:LKneeMoment",), ("Nmm",), 100.0),
        "POWERS": (("LKneePower",), ("W",), 100.0),
        "LOADS": (("S:Load",), ("kg",), 100.0),
    }
    table = outputs_table().reshape(20, 7, 4)
    assert np.array_equal(signals["ANGLES"].values[:, 0], table[:, 0, :3])
    moments = c3d.model_outputs(motion)["S:LKneeMoment"]
    assert np.isnan(moments[4:6]).all()
    assert np.array_equal(moments[6:], table[6:, 2, :3])
    assert motion.gaps.sum() == 1
    assert any("1 moments (Nmm)" in note for note in formats.notes(motion))


def test_they_come_back_in_their_columns_bit_for_bit(tmp_path):
    motion = mc.decode(mc.encode(read_bytes(tmp_path, file_with_outputs()), codec="lossless"))
    formats.write(tmp_path / "x.c3d", motion)
    values, labels = columns_of(tmp_path / "x.c3d")
    assert labels == LABELS
    table = outputs_table().reshape(20, 7, 4)
    assert values[:, OUTPUTS].tobytes() == table[:, OUTPUTS].tobytes()
    again = formats.read(tmp_path / "x.c3d")
    assert same_tree(again.extras["model_outputs"], motion.extras["model_outputs"])
    assert same_tree(again.extras["parameters"]["POINT"], motion.extras["parameters"]["POINT"])


def test_a_slice_cuts_them(tmp_path):
    part = read_bytes(tmp_path, file_with_outputs())[5:15]
    assert c3d.model_outputs(part)["LKneeAngles"].shape == (10, 3)
    formats.write(tmp_path / "x.c3d", part)
    values, _ = columns_of(tmp_path / "x.c3d")
    assert values[:, OUTPUTS].tobytes() == outputs_table().reshape(20, 7, 4)[5:15, OUTPUTS].tobytes()


def test_fewer_markers_leave_the_outputs_whole(tmp_path):
    motion = read_bytes(tmp_path, file_with_outputs())
    formats.write(tmp_path / "x.c3d", motion.select(["S:RASI"]))
    values, labels = columns_of(tmp_path / "x.c3d")
    assert labels == ["LKneeAngles", "S:RASI", "S:LKneeMoment", "S:Load", "LKneePower"]
    assert values[:, 3].tobytes() == outputs_table().reshape(20, 7, 4)[:, 6].tobytes()
    assert set(c3d.model_outputs(formats.read(tmp_path / "x.c3d"))) == {*labels} - {"S:RASI"}


def test_a_file_of_outputs_only(tmp_path):
    def only_angles(groups: dict[str, Any]) -> None:
        groups["POINT"] |= {"LABELS": ["a", "b"], "ANGLES": ["a", "b"]}

    table = np.ones((20, 8))
    motion = read_bytes(tmp_path, built(20, 2, 0, 0, change=only_angles, table=table))
    assert motion.points == 0
    formats.write(tmp_path / "x.c3d", motion)
    assert columns_of(tmp_path / "x.c3d")[1] == ["a", "b"]


def test_lists_of_labels_are_written_where_the_parameters_lack_them(tmp_path):
    values = np.arange(120, dtype=np.float32).reshape(20, 2, 3)
    signals = {
        "ANGLES": Signal(values, 120.0, ("a", "b"), ("rad", "rad")),
        "TORSION": Signal(values, 120.0, ("c", "d"), ("N", "N")),
    }
    extras = {"model_outputs": {"signals": signals, "columns": np.array([0, 1, 7, 8], np.uint16)}}
    formats.write(tmp_path / "x.c3d", replace(markers(), extras=extras))
    again = formats.read(tmp_path / "x.c3d")
    assert isinstance(again, Motion)
    assert same_tree(again.extras["model_outputs"]["signals"], signals)
    with pytest.raises(BadInput, match="do not fit"):
        formats.write(tmp_path / "y.c3d", replace(markers(5), extras=extras))


@pytest.mark.parametrize(
    "groups", [["ANGLES", "ANGLE"], [["ANGLES", "MOMENTS", "POWERS"], ["ANGLE", "MOMENT", "POWER"]]]
)
def test_type_groups_in_other_shapes(tmp_path, groups):
    def with_groups(tree: dict[str, Any]) -> None:
        tree["POINT"] |= {"ANGLES": ["M1"], "TYPE_GROUPS": groups, "ANGLE_UNITS": "rad"}

    motion = read_bytes(tmp_path, built(change=with_groups))
    assert motion.extras["model_outputs"]["signals"]["ANGLES"].units == ("rad",)
    assert motion.names == ("M0", "M2")


@needs_shared
@pytest.mark.parametrize("name", ["59993_Frame_Static", "Movement_trial", "RoboStatic"])
def test_outputs_of_field_files(tmp_path, name):
    path = SHARED / "field-c3d" / f"{name}.c3d"
    motion = formats.read(path)
    formats.write(tmp_path / "x.c3d", motion)
    again = formats.read(tmp_path / "x.c3d")
    assert len(motion.extras["model_outputs"]["columns"]) >= 26
    assert same_tree(again.extras["model_outputs"], motion.extras["model_outputs"])
    assert again.names == motion.names


def with_labels(groups: dict[str, Any]) -> None:
    groups["POINT"]["LABELS"] = ["A:LASI", "A:LKneeAngles", "A:RHipMoment", "A:LAnklePower"]


def labelled_table(far: float, power: bool, frames: int = 20) -> np.ndarray:
    """A marker near (1, 1, 1) m; angles and moments this far from it, millimetres; a power with or without zeros."""
    rng = np.random.default_rng(5)
    table = np.zeros((frames, 4, 4), np.float32)
    table[:, :, :3] = 1000 + rng.normal(size=(frames, 4, 3))
    table[:, 1:3, :3] += far
    if power:
        table[:, 3, :2] = 0
    return table.reshape(frames, -1)


@pytest.mark.parametrize(("far", "power", "unit"), [(3000, False, ""), (0, True, ""), (0, False, "Nmm")])
def test_outputs_that_no_list_names_are_found_by_label_and_values_or_units(tmp_path, far, power, unit):
    def change(groups: dict[str, Any]) -> None:
        with_labels(groups)
        if unit:
            groups["POINT"]["MOMENT_UNITS"] = unit

    table = labelled_table(far, power)
    motion = read_bytes(tmp_path, built(20, 4, 0, 0, change=change, table=table))
    assert motion.names == ("A:LASI",)
    signals = motion.extras["model_outputs"]["signals"]
    assert {kind: signal.labels for kind, signal in signals.items()} == {
        "ANGLES": ("A:LKneeAngles",),
        "MOMENTS": ("A:RHipMoment",),
        "POWERS": ("A:LAnklePower",),
    }
    assert any(
        "3 points named like A:LKneeAngles are taken for model outputs" in note for note in formats.notes(motion)
    )
    formats.write(tmp_path / "x.c3d", motion)
    values, labels = columns_of(tmp_path / "x.c3d")
    assert labels[1:] == ["A:LKneeAngles", "A:RHipMoment", "A:LAnklePower"]
    assert values[:, 1:].tobytes() == table.reshape(20, 4, 4)[:, 1:].tobytes()
    assert same_tree(formats.read(tmp_path / "x.c3d").extras["model_outputs"], motion.extras["model_outputs"])


def test_labels_alone_are_only_noted(tmp_path):
    motion = read_bytes(tmp_path, built(20, 4, 0, 0, change=with_labels, table=labelled_table(0, False)))
    assert motion.points == 4
    assert any("named like A:LKneeAngles may be model outputs" in note for note in formats.notes(motion))
    other = read_bytes(tmp_path, built(20, 4, 0, 0, table=labelled_table(3000, True)))
    assert other.points == 4
    assert "model_outputs" not in other.extras
