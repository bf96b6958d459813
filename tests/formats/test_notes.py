"""Notes of readers appear once in Python, at the command line and in JSON; options override what they report."""

from __future__ import annotations

import json

import numpy as np
import pytest

import mocodec as mc
from mocodec import BadInput, formats
from mocodec.cli import run
from mocodec.formats.conventions import metres_in, start_s
from mocodec.testing import synthetic

from .samples import AMC, ASF, BVH, markers


def sample(folder, suffix: str):
    """A small file of each format."""
    path = folder / f"x{suffix}"
    if suffix == ".bvh":
        path.write_text(BVH)
    elif suffix == ".amc":
        path.write_text(AMC)
        (folder / "x.asf").write_text(ASF)
    else:
        formats.write(path, synthetic.joints(20) if suffix == ".glb" else markers())
    return path


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".bvh", ".amc", ".npz", ".glb"])
def test_every_format_takes_the_same_overrides(tmp_path, suffix):
    path = sample(tmp_path, suffix)
    plain = formats.read(path)
    given = formats.read(path, unit="dm", rate=77.0, up="x", start=3.25)
    assert isinstance(plain, mc.Motion)
    assert isinstance(given, mc.Motion)
    assert (given.rate, given.up) == (77.0, "x")
    assert start_s(given.source, given.rate) == pytest.approx(3.25)
    assert start_s(given[1:].source, given.rate) == pytest.approx(3.25 + 1 / 77)
    assert formats.notes(given) == []
    if suffix != ".glb":  # sampled at the new rate
        scale = 0.1 / plain.source.get("unit_m", 1.0)
        assert np.allclose(given.positions, plain.positions * scale, equal_nan=True)
    for option, value in (("unit", "furlong"), ("up", "w"), ("start", float("nan"))):
        with pytest.raises(BadInput):
            formats.read(path, **{option: value})


def test_the_command_line_says_guesses_once_and_only_when_all_went_well(tmp_path, capsys):
    path = sample(tmp_path, ".bvh")
    assert run(["encode", str(path), "-o", str(tmp_path / "x.mocz"), "--codec", "lossless"]) == 0
    assert capsys.readouterr().err.count("guessed: up y (--up), unit cm (--unit)") == 1
    assert run(["encode", str(path), "-o", str(tmp_path / "x.mocz"), "--codec", "lossless", "-q"]) == 0
    assert capsys.readouterr().err == ""
    assert run(["encode", str(path), "-o", str(tmp_path / "x.mocz"), "--codec", "none"]) != 0
    assert "guessed" not in capsys.readouterr().err
    assert run(["info", str(path), "--json", "--unit", "m", "--up", "z", "--start", "2.5"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert "notes" not in facts
    assert (facts["up"], facts["source"]["unit_m"], facts["source"]["time_of_frame_1"]) == ("z", 1.0, 2.5)


def test_notes_are_in_json_and_survive_a_mocz(tmp_path, capsys):
    lines = ["PathFileType\t4", "DataRate\tNumFrames\tNumMarkers\tUnits", "100\t3\t1\tmm", "Frame#\tTime\tA", "\t\tX1"]
    lines += [f"{n}\t{n / 50}\t1\t2\t3" for n in (1, 2, 3)]
    (tmp_path / "x.trc").write_text("\n".join(lines))
    assert run(["info", str(tmp_path / "x.trc"), "--json"]) == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert any("DataRate is 100 Hz" in note for note in notes)
    assert formats.notes(mc.decode(mc.encode(formats.read(tmp_path / "x.trc"), codec="lossless"))) == notes


def test_names_of_units():
    assert [metres_in(u) for u in ("Meters", "mete", "MM.", " millimet", "(cm)", "Feet")] == [
        1,
        1,
        1e-3,
        1e-3,
        1e-2,
        0.3048,
    ]
    assert [metres_in(u) for u in ("", "me", "furlong", "meterss")] == [None] * 4


def test_an_option_says_which_formats_have_it(tmp_path, capsys):
    path = str(sample(tmp_path, ".bvh"))
    assert run(["info", path, "--asf", "x.asf"]) == 3
    assert "--asf is for .amc" in capsys.readouterr().err
    assert run(["info", path, "--gaps", "keep"]) == 3
    assert "--gaps is for .c3d" in capsys.readouterr().err
    formats.write(tmp_path / "y.npz", formats.read(path))
    assert run(["compare", str(tmp_path / "y.npz"), path, "--unit", "m", "--asf", "x.asf"]) == 3
    assert "no option 'asf'" in capsys.readouterr().err


def test_options_of_readers_reach_every_command(tmp_path, capsys):
    motion = markers()
    motion.positions[5:9, 2] = 0
    formats.write(tmp_path / "x.c3d", motion)
    path, out = str(tmp_path / "x.c3d"), str(tmp_path / "x.mocz")
    assert run(["encode", path, "-o", out, "--codec", "lossless"]) == 0
    assert "(--gaps keep takes them as positions)" in capsys.readouterr().err
    assert run(["verify", out, "--against", path]) == 0
    assert run(["verify", out, "--against", path, "--gaps", "keep"]) == 1
    assert run(["compare", out, path, "--gaps", "keep"]) == 0
    assert "NOT EQUAL" in capsys.readouterr().out
    assert run(["cut", path, "-o", str(tmp_path / "y.c3d"), "--gaps", "keep", "--to", "10f"]) == 0
    assert run(["info", path, "--gaps", "keep", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["gaps"] == int(motion.gaps.sum())


@pytest.mark.parametrize("command", [["info"], ["cut", "-o", "y.mocz"]])
def test_options_of_readers_are_refused_for_a_mocz(tmp_path, capsys, command):
    mc.write(tmp_path / "x.mocz", markers(), codec="lossless")
    assert run([command[0], str(tmp_path / "x.mocz"), *command[1:], "--unit", "cm"]) == 3
    assert "--unit cannot be used with a .mocz" in capsys.readouterr().err


def test_a_truncated_file_is_salvaged_at_the_command_line(tmp_path, capsys):
    formats.write(tmp_path / "x.c3d", markers(200))
    (tmp_path / "x.c3d").write_bytes((tmp_path / "x.c3d").read_bytes()[:-6000])
    path, out = str(tmp_path / "x.c3d"), str(tmp_path / "x.mocz")
    assert run(["encode", path, "-o", out, "--codec", "lossless"]) == 3
    assert "--salvage" in capsys.readouterr().err
    assert run(["encode", path, "-o", out, "--codec", "lossless", "--salvage"]) == 0
    assert "cut off: 129 of 200 declared frames are read" in capsys.readouterr().err
    assert run(["info", out, "--json"]) == 0
    assert any("129 of 200" in note for note in json.loads(capsys.readouterr().out)["notes"])


def test_notes_of_what_is_left_out_are_made_from_the_source():
    source = {"missing_numbers": 2, "ignored": ["alpha"], "residuals": "left out", "model_outputs": {"angles (deg)": 3}}
    text = "; ".join(formats.notes(mc.Motion(np.zeros((2, 1, 3)), 30.0, source=source)))
    for part in ("2 numbers are missing", "alpha", "--residuals", "3 angles (deg)"):
        assert part in text


@pytest.mark.parametrize("lost", [4, 12, 30])
def test_text_of_skeletons_is_salvaged(tmp_path, lost):
    for suffix, frames in ((".bvh", 3), (".amc", 2)):
        path = sample(tmp_path, suffix)
        whole = formats.read(path)
        text = path.read_text().rstrip("\n")
        path.write_text(text[:-lost])
        part = formats.read(path, salvage=True)
        assert isinstance(part, mc.Motion)
        assert isinstance(whole, mc.Motion)
        assert 0 < len(part) < len(whole) or suffix == ".amc"
        assert np.allclose(part.positions, whole.positions[: len(part)])
        assert any("cut off" in note for note in formats.notes(part))
        path.write_text(text + "\n")
        assert len(formats.read(path, salvage=True)) == len(whole) >= frames
