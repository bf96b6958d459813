"""TRC: markers, gaps, units and rate come back; cut and odd files are told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec import BadInput, formats

from .samples import SHARED, markers, needs_shared

HEAD = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "{rate}\t60\t{frames}\t{markers}\t{units}\t60\t1\t2\n"
    "Frame#\tTime\tLASI\t\t\tRASI\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n"
)


def file(rows: str, rate="60", frames=2, markers=2, units="mm") -> str:
    return HEAD.format(rate=rate, frames=frames, markers=markers, units=units) + rows


def read(tmp_path, text: str, **options):
    (tmp_path / "x.trc").write_text(text)
    return formats.read(tmp_path / "x.trc", **options)


def test_round_trip(tmp_path):
    motion = markers()
    formats.write(tmp_path / "x.trc", motion)
    again = formats.read(tmp_path / "x.trc", up="z")
    assert np.array_equal(again.gaps, motion.gaps)
    assert np.nanmax(np.abs(again.positions - motion.positions)) < 1e-9
    assert (again.names, again.rate, again.up) == (motion.names, motion.rate, "z")


@pytest.mark.parametrize("units", ["m", "cm"])
def test_units_and_first_frame(tmp_path, units):
    motion = replace(markers(), source={"format": "trc", "units": units, "first_frame": 41})
    formats.write(tmp_path / "x.trc", motion)
    again = formats.read(tmp_path / "x.trc")
    assert (again.source["units"], again.source["first_frame"]) == (units, 41)
    assert np.nanmax(np.abs(again.positions - motion.positions)) < 1e-7


def test_empty_cells_short_rows_and_line_ends(tmp_path):
    motion = read(tmp_path, file("1\t0\t1\t2\t3\t\t\t\n2\t.016\t4\t5\t6\n").replace("\n", "\r\n"))
    assert motion.gaps.tolist() == [[False, True], [False, True]]
    assert motion.positions[1, 0].tolist() == pytest.approx([0.004, 0.005, 0.006])


def test_columns_without_names_are_points(tmp_path):
    motion = read(tmp_path, file("1\t0" + "\t1\t2\t3" * 3 + "\n2\t.016" + "\t1\t2\t3" * 2 + "\n", markers=5))
    assert motion.names == ("LASI", "RASI", "P3")
    assert motion.gaps[:, 2].tolist() == [False, True]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("BVH", "not a TRC"),
        ("PathFileType\t4\n", "no line of marker names"),
        (file("1\t0\t1\t2\t3\t4\t5\t6\n"), "cut off"),
        (file("1\t0\t1\t2\t3\t4\t5\tx\n2\t0\t1\t2\t3\t4\t5\t6\n"), "'x'"),
        (file("1\t0\t1 1\t2\t3\t4\t5\t6\n2\t0\t1\t2\t3\t4\t5\t6\n"), "more than one number"),
        (file("", frames=0, rate="fast"), "does not say"),
        (file("1\t0\n2\t0\n", units="yards"), "yards"),
        (file("1\t0\t1\t2\t3\t4\t5\t6\n2\t0\t1\t2\t3\t4\t5\t6\n", rate="0"), "rate must be positive"),
    ],
)
def test_damage_is_one_clear_line(tmp_path, text, says):
    with pytest.raises(BadInput, match=says):
        read(tmp_path, text)


def test_names_that_a_trc_cannot_hold(tmp_path):
    with pytest.raises(BadInput, match="tabs"):
        formats.write(tmp_path / "x.trc", replace(markers(), names=("a\tb", "b", "c", "d", "e")))


@needs_shared
def test_field_files():
    gait = formats.read(SHARED / "field-trc" / "Gait.trc")
    assert gait.names[:3] == ("R.Shoulder", "R.Offset", "R.Elbow")
    assert (len(gait), gait.up) == (487, "y")
    assert formats.read(SHARED / "field-trc" / "SprintMotion.trc").up == "z"
    with pytest.raises(BadInput, match="cut off"):
        formats.read(SHARED / "field-trc" / "Truncated.trc")
