"""The comparison of readers, on files that the test writes."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.readers import command
from benchmarks.readers.comparison import compare
from benchmarks.readers.witnesses import with_mocodec
from mocodec import formats
from mocodec.testing import synthetic


def test_equal_readings(tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    pytest.importorskip("c3d")
    formats.write(tmp_path / "a.c3d", synthetic.markers(60, seed=1))
    formats.write(tmp_path / "a.trc", synthetic.markers(60, seed=1))
    records = command.measure(tmp_path / "a.c3d") + command.measure(tmp_path / "a.trc")
    assert {record["reader"] for record in records} == {"ezc3d", "py-c3d", "splitting"}
    assert [record for record in records if record["difference"]] == []


def test_a_cut_file_is_explained_and_compared_as_far_as_it_goes(tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    pytest.importorskip("c3d")
    path = tmp_path / "a.c3d"
    formats.write(path, synthetic.markers(60, seed=1))
    path.write_bytes(path.read_bytes()[:-9000])
    records = command.measure(path)
    assert {record["quantity"] for record in records if record["difference"]} == {"file"}
    assert all("mocodec is right" in record["why"] for record in records if record["difference"])


def test_every_quantity_that_differs_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.c3d"
    formats.write(path, synthetic.markers(60, seed=1))
    reading = with_mocodec(path)
    moved = reading.positions.copy()
    moved[3, 4] += 1
    moved[5, 6] = float("nan")
    other = reading._replace(labels=["x", *reading.labels[1:]], positions=moved, events=[("a", 1.0)], rates=(1.0, 0.0))
    differing = {quantity for quantity, difference in compare(reading, other).items() if difference}
    assert differing == {"labels", "positions", "gaps", "events", "rates"}
    assert not any(compare(reading, reading).values())


def test_a_difference_without_a_cause_in_the_bytes_is_unexplained(tmp_path: Path) -> None:
    path = tmp_path / "a.c3d"
    formats.write(path, replace(synthetic.markers(60, seed=1), source={}))
    ours = with_mocodec(path)
    told = command.explanation(path, "ezc3d", "rates", ours, ours)
    assert told == command.UNEXPLAINED
    data = bytearray(path.read_bytes())
    at = data.index(b"RATE") - 2
    data[at + 2 : at + 6] = b"RATX"
    path.write_bytes(data)
    assert struct.unpack_from("<f", data, 20)[0] == pytest.approx(ours.rates[0])
    assert "lack POINT:RATE" in command.explanation(path, "ezc3d", "rates", ours, ours)
