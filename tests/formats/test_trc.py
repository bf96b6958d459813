"""TRC: markers, gaps, units, clock and rate survive a round trip; damaged and unusual files."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, formats
from mocodec.formats.conventions import start_s

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


def test_columns_that_never_hold_a_point_are_left_out_and_noted(tmp_path):
    rows = "".join(f"{i}\t{i / 60}" + "\t1\t2\t3" * 2 + "\t7\t8\n" for i in range(3))
    motion = read(tmp_path, file(rows, frames=3))
    assert motion.names == ("LASI", "RASI")
    assert any("2 columns after those of the markers" in note for note in formats.notes(motion))


@pytest.mark.parametrize("row", ["1\t2\t3\t4\t5\t6\t7", "1\t2\t2\t3\t4\t5\t6"])
def test_a_row_with_a_cell_too_many_is_refused(tmp_path, row):
    rows = "1\t0\t1\t2\t3\t4\t5\t6\n" + f"2\t.016\t{row}\n"
    with pytest.raises(BadInput, match="row 2 of its numbers has 9 cells, its 2 markers have 8"):
        read(tmp_path, file(rows))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("BVH", "not a TRC"),
        ("PathFileType\t4\n", "no line of marker names"),
        ("PathFileType\t4\nFrame#\tTime\tLASI\n1\t0\t1\t2\t3\n", "its header is incomplete"),
        (file("1\t0\t1\t2\t3\t4\t5\t6\n"), "cut off"),
        (file("1\t0\t1\t2\t3\t4\t5\tx\n2\t0\t1\t2\t3\t4\t5\t6\n"), "'x'"),
        (file("1\t0\t1 1\t2\t3\t4\t5\t6\n2\t0\t1\t2\t3\t4\t5\t6\n"), "more than one number"),
        (file("", frames=0, rate="fast"), "does not give"),
        (file("1\t0\n2\t0\n", units="yards"), "yards"),
        (file("1\t0\t1\t2\t3\t4\t5\t6\n2\t0\t1\t2\t3\t4\t5\t6\n", rate="0"), "rate must be positive"),
    ],
)
def test_damage_raises_one_line(tmp_path, text, says):
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


def rows(numbers, times, separator="\t") -> str:
    return "".join(
        separator.join([str(n), f"{t:.5f}", *(f"{n + k:.3f}" for k in range(6))]) + "\n"
        for n, t in zip(numbers, times, strict=True)
    )


def test_start_time_and_frame_numbers_survive_reading_cutting_and_writing(tmp_path):
    text = file(rows(range(41, 61), [2.5 + i / 100 for i in range(20)]), rate="100", frames=20)
    motion = read(tmp_path, text)
    assert (motion.source["first_frame"], start_s(motion.source, motion.rate)) == (41, pytest.approx(2.5))
    formats.write(tmp_path / "y.trc", motion[5:12])
    again = formats.read(tmp_path / "y.trc")
    assert (again.source["first_frame"], start_s(again.source, 100.0)) == (46, pytest.approx(2.55))
    assert (tmp_path / "y.trc").read_text().split("\n")[6].startswith("46\t2.550000\t")
    coded = mc.decode(mc.encode(motion, codec="lossless"))
    assert start_s(coded.source, coded.rate) == pytest.approx(2.5)
    assert start_s(read(tmp_path, text, start=1.25).source, 100.0) == pytest.approx(1.25)


def test_a_usual_clock_needs_nothing_in_the_source(tmp_path):
    """Times that are frame numbers / rate, to the digits that the file has."""
    motion = read(tmp_path, file(rows(range(31, 51), [round(i / 60, 3) for i in range(30, 50)]), frames=20))
    assert "time_of_frame_1" not in motion.source
    assert "notes" not in motion.source


def test_frames_that_the_numbering_skips_are_gaps(tmp_path):
    numbers = [*range(1, 11), *range(15, 25)]
    text = file(rows(numbers, [(n - 1) / 100 for n in numbers]), rate="100", frames=20)
    motion = read(tmp_path, text)
    assert len(motion) == 24
    assert motion.gaps[10:14].all()
    assert motion.gaps.sum() == 8
    assert any("4 frames are missing" in note for note in formats.notes(motion))
    by_time = read(tmp_path, file(rows(range(1, 21), [(n - 1) / 100 for n in numbers]), rate="100", frames=20))
    assert np.array_equal(by_time.gaps, motion.gaps)
    decimated = read(tmp_path, file(rows(range(1, 41, 2), [i / 50 for i in range(20)]), rate="50", frames=20))
    assert len(decimated) == 20
    with pytest.raises(BadInput, match="frame numbers from 1 to 1000000"):
        read(tmp_path, file(rows([1, 2, 10**6], [0, 0.01, 9999.99]), rate="100", frames=3))


def test_a_time_column_against_the_rate_is_used_and_noted(tmp_path):
    text = file(rows(range(1, 21), [i / 50 for i in range(20)]), rate="100", frames=20)
    motion = read(tmp_path, text)
    assert motion.rate == 50.0
    assert any("DataRate is 100 Hz, the time column runs at 50 Hz" in note for note in formats.notes(motion))
    assert read(tmp_path, text, rate=100.0).rate == 100.0
    video = file(rows(range(1, 1001), [i * 1001 / 120000 for i in range(1000)]), rate="120", frames=1000)
    assert read(tmp_path, video).rate == 120000 / 1001


def test_spaces_for_tabs(tmp_path):
    tabbed = file(rows(range(1, 21), [i / 60 for i in range(20)]), frames=20)
    spaced = re.sub(r"\t+", " ", tabbed)
    expected, motion = read(tmp_path, tabbed), read(tmp_path, spaced)
    assert motion.names == expected.names
    assert np.array_equal(motion.positions, expected.positions)
    with pytest.raises(BadInput, match="gaps cannot be located"):
        read(tmp_path, spaced.rsplit(" ", 1)[0] + "\n")


@pytest.mark.parametrize(("units", "unit_m"), [("meters", 1.0), ("Millimetres", 1e-3), ("mete", 1), ("inches", 0.0254)])
def test_spelled_out_units(tmp_path, units, unit_m):
    text = file(rows([1, 2], [0, 1 / 60]), units=units)
    motion = read(tmp_path, text)
    assert motion.positions[0, 0, 1] == pytest.approx(2 * unit_m)
    formats.write(tmp_path / "y.trc", motion)
    assert formats.read(tmp_path / "y.trc").source["units"] == units
    assert read(tmp_path, text, unit="cm").positions[0, 0, 1] == pytest.approx(0.02)
    assert read(tmp_path, text, unit=0.5).positions[0, 0, 1] == pytest.approx(1.0)


def test_declared_counts_are_checked_against_the_file(tmp_path):
    with pytest.raises(BadInput, match="declares 1000000000 markers"):
        read(tmp_path, file(rows([1, 2], [0, 1 / 60]), markers=10**9))
    more = read(tmp_path, file(rows(range(1, 4), [0, 1 / 60, 2 / 60]), frames=2))
    assert len(more) == 3
    assert any("declares 2 frames, the file has 3" in note for note in formats.notes(more))


def test_zeros_are_gaps_and_come_back(tmp_path):
    motion = markers(30)
    positions = motion.positions.copy()
    positions[10:14, 3] = 0
    formats.write(tmp_path / "x.trc", replace(motion, positions=positions))
    text = (tmp_path / "x.trc").read_text().split("\n", 1)[1]
    again = formats.read(tmp_path / "x.trc")
    assert np.array_equal(again.gaps[10:14, 3], [True] * 4)
    assert any("--gaps keep" in note for note in formats.notes(again))
    formats.write(tmp_path / "y.trc", again)
    assert (tmp_path / "y.trc").read_text().split("\n", 1)[1] == text
    assert np.array_equal(formats.read(tmp_path / "x.trc", gaps="keep").gaps, np.isnan(positions[..., 0]))


@pytest.mark.parametrize("zero", ["0", "-0.000", "0.0e+00", '"0.0"'])
def test_zeros_of_any_spelling_are_gaps_in_pieces(tmp_path, zero):
    formats.write(tmp_path / "x.trc", markers(30))
    lines = (tmp_path / "x.trc").read_text().split("\n")
    cells = lines[-3].split("\t")
    cells[5:8] = [zero] * 3
    (tmp_path / "x.trc").write_text("\n".join([*lines[:-3], "\t".join(cells), *lines[-2:]]))
    whole, parts = formats.read(tmp_path / "x.trc"), formats.read_blocks(tmp_path / "x.trc")
    assert whole.gaps[-2, 1]
    np.testing.assert_array_equal(np.concatenate([m.positions for m in parts]), whole.positions)
    assert parts.about.source == whole.source


def test_salvage_reads_the_complete_rows(tmp_path):
    formats.write(tmp_path / "x.trc", markers(30))
    text = (tmp_path / "x.trc").read_text()
    whole = formats.read(tmp_path / "x.trc")
    lines = text.split("\n")
    for cut in ("\n".join(lines[:20]) + "\n", "\n".join(lines[:21])[:-5]):
        (tmp_path / "x.trc").write_text(cut)
        with pytest.raises(BadInput, match="cut off"):
            formats.read(tmp_path / "x.trc")
        part = formats.read(tmp_path / "x.trc", salvage=True)
        assert np.array_equal(part.positions, whole.positions[: len(part)], equal_nan=True)
        assert len(part) == 20 - lines.index("") - 1
        assert any(f"{len(part)} of 30 declared frames" in note for note in formats.notes(part))
    (tmp_path / "x.trc").write_text(text)
    assert len(formats.read(tmp_path / "x.trc", salvage=True)) == 30


def test_a_last_row_that_ends_early_is_cut_off(tmp_path):
    """All declared rows are there, the last one in part; a row of gaps that ends with a line break is whole."""
    rows = "1\t0.0\t1\t2\t3\t4\t5\t6\n2\t0.0166667\t1\t2\t3"
    with pytest.raises(BadInput, match="last row ends early"):
        read(tmp_path, file(rows))
    assert len(read(tmp_path, file(rows), salvage=True)) == 1
    assert read(tmp_path, file(rows + "\n")).gaps.tolist() == [[False, False], [False, True]]
