"""Each command on valid input: its output and its exit code."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import container, metrics, native

from .conftest import LOSSY, Command


def test_encode_and_decode(command: Command, walk_trc: Path, walk_mocz: Path) -> None:
    assert command("decode", walk_mocz, "-o", "back.trc").code == 0
    a, b = mc.read(walk_trc), mc.read("back.trc")
    assert b.names == a.names
    assert b.rate == a.rate
    assert (b.gaps == a.gaps).all()
    assert metrics.compare(a, b).max_error <= 0.0021


def test_encode_without_an_output_writes_beside_the_source_and_replaces_nothing(
    command: Command, walk_trc: Path
) -> None:
    Path("in").mkdir()
    source = walk_trc.rename(Path("in") / "walk.1.trc")
    assert command("encode", source, "--codec", "lossless").code == 0
    stored = Path("in/walk.1.mocz").read_bytes()
    again = command("encode", source, "--codec", LOSSY)
    assert again.code == 2
    assert "walk.1.mocz exists: name the output" in again.err
    assert Path("in/walk.1.mocz").read_bytes() == stored
    assert "name the output" in command("encode", "in/walk.1.mocz", "--codec", "lossless").err


def test_an_output_in_no_folder_is_refused_before_the_work(command: Command, walk_trc: Path, walk_mocz: Path) -> None:
    for arguments in (("encode", walk_trc, "-o", "no/x.mocz"), ("decode", walk_mocz, "-o", "no/x.trc")):
        result = command(*arguments)
        assert result.code == 3
        assert "there is no folder" in result.err


def test_encode_prints_a_summary_on_standard_error(command: Command, walk_trc: Path) -> None:
    result = command("encode", walk_trc, "-o", "x.mocz", "--codec", LOSSY, "--max-error", "0.2cm")
    assert result.out == ""
    assert "bytes" in result.err
    assert ": 1 against float32" in result.err
    assert "mm" in result.err
    assert command("encode", walk_trc, "-o", "x.mocz", "--codec", LOSSY, "-q").err == ""


def test_the_summary_names_the_parts_of_a_file_with_signals(
    command: Command, walk: mc.Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    force = mc.Signal(np.arange(2400, dtype=np.int16)[:, None] % 97, rate=1200.0, labels=("Fz1",))
    mc.write("walk.c3d", mc.Motion(walk.positions, walk.rate, walk.names, extras={"analog": force}))
    text = command("encode", "walk.c3d", "-o", "x.mocz", "--codec", LOSSY, "--max-error", "0.2cm").err
    source, stored = (Path(name).stat().st_size for name in ("walk.c3d", "x.mocz"))
    found = re.search(r"([\d,]+) bytes of ([\d,]+) .*motion ([\d,]+) .*signals ([\d,]+), rest ([\d,]+)", text)
    assert found is not None, text
    total, of, *parts = (int(number.replace(",", "")) for number in found.groups())
    assert (total, of, sum(parts)) == (stored, source, stored)
    facts = json.loads(command("info", "x.mocz", "--json").out)
    assert facts["motion_bytes"] == parts[0]
    assert f"{facts['motion_ratio']:.1f} : 1 against float32" in text
    command("encode", "walk.c3d", "-o", "y.mocz", "--codec", LOSSY, "--bare")
    assert "motion_ratio" not in json.loads(command("info", "y.mocz", "--json").out)


@pytest.mark.parametrize("target", ["--ratio=30", "--size=900"])
def test_size_and_ratio_are_kept_by_the_whole_file(
    command: Command, walk: mc.Motion, walk_trc: Path, target: str
) -> None:
    mc.write("walk.npz", mc.Motion(np.nan_to_num(walk.positions), walk.rate, walk.names))
    result = command("encode", "walk.npz", "-o", "x.mocz", "--codec", "tempo", target)
    assert result.code == 0, result.err
    assert Path("x.mocz").stat().st_size <= (walk.raw_bytes / 30 if "ratio" in target else 900)
    assert command("verify", "x.mocz", "--against", "walk.npz").code == 0


def test_a_size_that_is_too_small_is_refused(command: Command, walk_trc: Path) -> None:
    assert command("encode", walk_trc, "-o", "y.mocz", "--codec", "tempo", "--size", "30B").code == 3


def test_encoding_twice_gives_the_same_file(command: Command, walk_trc: Path) -> None:
    for name in ("a.mocz", "b.mocz"):
        command("encode", walk_trc, "-o", name, "--codec", LOSSY)
    assert Path("a.mocz").read_bytes() == Path("b.mocz").read_bytes()


def test_info(command: Command, walk_mocz: Path, walk_trc: Path) -> None:
    facts = json.loads(command("info", walk_mocz, "--json").out)
    assert facts["frames"] == 240
    assert facts["rate"] == 120
    assert LOSSY in command("info", walk_mocz).out
    source = json.loads(command("info", walk_trc, "--json").out)
    assert source["names"] == facts["names"]
    assert source["gaps"] == 30


def test_verify_an_undamaged_file(command: Command, walk_mocz: Path) -> None:
    result = command("verify", walk_mocz)
    assert result.code == 0
    assert "undamaged" in result.out
    assert "2 mm" in result.out


def test_verify_against_its_source(command: Command, walk_mocz: Path, walk_trc: Path) -> None:
    result = command("verify", walk_mocz, "--against", walk_trc, "--json")
    report = json.loads(result.out)
    assert result.code == 0
    assert report["promise_kept"]
    assert report["promise"] == {"max_error": 0.002}
    assert 0 < report["max_error"] <= 0.002
    assert "the promise is kept" in command("verify", walk_mocz, "--against", walk_trc).out


@pytest.mark.parametrize("change", ["moved", "shorter", "gap filled", "renamed"])
def test_verify_against_another_recording_is_1(command: Command, walk_mocz: Path, walk: mc.Motion, change: str) -> None:
    positions, names = walk.positions.copy(), walk.names
    if change == "moved":
        positions[50, 2, 0] += 0.01
    elif change == "shorter":
        positions = positions[:-1]
    elif change == "gap filled":
        positions[110, 3] = positions[99, 3]
    else:
        names = ("X", *names[1:])
    mc.write("other.npz", mc.Motion(positions, walk.rate, names))
    result = command("verify", walk_mocz, "--against", "other.npz")
    assert result.code == 1
    assert "broken:" in result.out
    assert json.loads(command("verify", walk_mocz, "--against", "other.npz", "--json").out)["promise_kept"] is False


def test_info_and_verify_show_the_same_promise(command: Command, walk_mocz: Path) -> None:
    shown, verified = (json.loads(command(verb, walk_mocz, "--json").out) for verb in ("info", "verify"))
    assert shown["promise"] == verified["promise"] == {"max_error": 0.002}
    assert "max error  2 mm" in command("info", walk_mocz).out


def test_verify_checks_a_ratio(command: Command, walk_trc: Path) -> None:
    assert command("encode", walk_trc, "-o", "a.mocz", "--codec", LOSSY, "--ratio", "20").code == 0
    assert command("verify", "a.mocz", "--against", walk_trc).code == 0
    with mc.open("a.mocz") as opened:
        promising = replace(opened.encoded, settings={"ratio": 1000.0})
        Path("b.mocz").write_bytes(container.pack(promising))
    result = command("verify", "b.mocz", "--against", walk_trc)
    assert result.code == 1
    assert "broken: the ratio is" in result.out


def test_what_a_format_cannot_store_is_listed(command: Command, walk: mc.Motion, walk_trc: Path) -> None:
    analog = mc.Signal(np.arange(480, dtype=np.int16).reshape(240, 2), 120.0, ("Fx", "Fy"))
    extras = {"analog": analog, "events": [{"label": "Foot Strike", "time_s": 0.5}]}
    mc.write("full.c3d", replace(walk, extras=extras))
    assert command("encode", "full.c3d", "-o", "full.mocz", "--codec", "lossless").code == 0
    assert "note: .trc cannot store analog channels, events" in command("decode", "full.mocz", "-o", "x.trc").err
    assert "note: .trc cannot store analog channels, events" in command("cut", "full.c3d", "-o", "x.trc").err
    assert "note:" not in command("decode", "full.mocz", "-o", "x.c3d").err
    assert command("cut", "full.c3d", "-o", "x.trc", "-q").err == ""


def test_bare_leaves_out_extras(command: Command, walk: mc.Motion, walk_trc: Path) -> None:
    analog = mc.Signal(np.random.default_rng(1).integers(0, 4096, (960, 8)).astype(np.int16), 480.0)
    mc.write("full.c3d", replace(walk, extras={"analog": analog}))
    assert command("encode", "full.c3d", "-o", "full.mocz").code == 0
    assert command("encode", "full.c3d", "-o", "bare.mocz", "--bare").code == 0
    assert Path("bare.mocz").stat().st_size < 0.2 * Path("full.mocz").stat().st_size
    with mc.open("bare.mocz") as opened:
        assert "analog" not in opened[:].extras
    checked = command("verify", "bare.mocz", "--against", "full.c3d")
    assert checked.code == 0
    assert "not in the file, which was encoded without them: analog" in checked.out
    assert json.loads(command("verify", "bare.mocz", "--against", "full.c3d", "--json").out)["left_out"][0] == "analog"
    bare = mc.read("bare.mocz", mc.Motion)
    mc.write("other.mocz", replace(bare, extras={"analog": replace(analog, values=analog.values + 1)}))
    assert "extras differ: analog" in command("verify", "other.mocz", "--against", "full.c3d").out
    silent = {name: value for name, value in bare.source.items() if name != "extras"}
    mc.write("silent.mocz", replace(bare, source=silent))
    assert "extras differ: analog" in command("verify", "silent.mocz", "--against", "full.c3d").out


def test_residuals_are_left_out_with_a_note_or_kept_on_request(
    command: Command, walk: mc.Motion, walk_trc: Path
) -> None:
    words = np.random.default_rng(1).integers(1, 2**15, (240, 7)).astype(np.int16)
    mc.write("noisy.c3d", replace(walk, extras={"residuals": mc.Signal(words, 120.0)}))
    left = command("encode", "noisy.c3d", "-o", "a.mocz", "--codec", "lossless")
    assert "residuals and camera masks of samples are left out" in left.err
    kept = command("encode", "noisy.c3d", "-o", "b.mocz", "--codec", "lossless", "--residuals")
    assert "note:" not in kept.err
    assert np.array_equal(mc.decode("b.mocz").extras["residuals"].values[walk.gaps == 0], words[walk.gaps == 0])


def test_compare(command: Command, walk_mocz: Path, walk_trc: Path) -> None:
    result = command("compare", walk_trc, walk_mocz, "--json")
    facts = json.loads(result.out)
    assert facts["max_error"] <= 0.002
    assert set(facts["per_point"]) == set(mc.read(walk_trc).names)
    assert facts["ratio"] > 1
    text = command("compare", walk_trc, walk_mocz).out
    for word in ("mean error", "p99 error", "max error", "distortion", "ratio", "HEAD", "gaps        equal"):
        assert word in text


def test_a_file_without_a_rate_is_compared_at_that_of_the_mocz(
    command: Command, walk: mc.Motion, tmp_path: Path
) -> None:
    np.save(tmp_path / "walk.npy", np.nan_to_num(walk.positions))
    stored = tmp_path / "walk.mocz"
    assert command("encode", tmp_path / "walk.npy", "-o", stored, "--rate", "50", "--max-error", "5mm").code == 0
    assert command("compare", tmp_path / "walk.npy", stored).code == 0
    assert command("verify", stored, "--against", tmp_path / "walk.npy").code == 0
    assert command("verify", stored, "--against", tmp_path / "walk.npy", "--rate", "60").code == 1


def test_compare_draws(command: Command, walk_mocz: Path, walk_trc: Path) -> None:
    pytest.importorskip("matplotlib", reason="drawing needs the [plot] extra")
    assert command("compare", walk_trc, walk_mocz, "--plot", "error.png").code == 0
    assert command("compare", walk_trc, walk_mocz, "--plot", "a.png", "--poses", "poses.png").code == 0
    for name in ("error.png", "poses.png"):
        assert Path(name).read_bytes().startswith(b"\x89PNG")
    result = command("compare", walk_trc, walk_mocz, "--plot", "error.docx")
    assert (result.code, result.out) == (2, "")
    assert not Path("error.docx").exists()


def test_compare_recordings_of_different_length(command: Command, walk_trc: Path, walk: mc.Motion) -> None:
    mc.write("short.trc", walk[:10])
    result = command("compare", walk_trc, "short.trc")
    assert result.code == 3
    assert "cannot compare" in result.err


def test_decode_takes_the_format_that_the_suffix_says(command: Command, walk_mocz: Path) -> None:
    assert command("decode", walk_mocz, "-o", "back.trc", "--format", "TRC").code == 0
    assert Path("back.trc").read_bytes().startswith(b"PathFileType")


def test_cut_to_a_format(command: Command, walk_mocz: Path, walk_trc: Path) -> None:
    assert command("cut", walk_mocz, "--from", "0.5s", "--to", "1.25s", "-o", "part.npz").code == 0
    part, whole = mc.read("part.npz"), mc.read(walk_mocz)
    np.testing.assert_allclose(part.positions, whole.positions[60:150], atol=1e-12)
    assert command("cut", walk_trc, "--from", "10f", "--to", "20f", "-o", "part.trc").code == 0
    assert len(mc.read("part.trc")) == 10


@pytest.mark.parametrize(
    ("begin", "end", "says"),
    [("9s", "10s", "--from is frame 1080, the recording has 240 frames (2 s)"), ("1s", "0.5s", "range is empty")],
)
def test_cut_of_nothing(command: Command, walk_trc: Path, begin: str, end: str, says: str) -> None:
    result = command("cut", walk_trc, "--from", begin, "--to", end, "-o", "part.trc")
    assert (result.code, says in result.err) == (2, True), result.err


def test_cut_to_a_mocz_keeps_a_promise_that_is_true(
    command: Command, walk_mocz: Path, walk_trc: Path, walk: mc.Motion
) -> None:
    result = command("cut", walk_mocz, "--from", "0.5s", "--to", "1.25s", "-o", "part.mocz")
    assert result.code == 0, result.err
    mc.write("part.npz", walk[60:150])
    verified = command("verify", "part.mocz", "--against", "part.npz", "--json")
    assert verified.code == 0, verified.out + verified.err
    assert json.loads(verified.out)["promise"]["max_error"] == pytest.approx(0.003)


def test_cut_of_a_motion_that_was_coded_losslessly_after_a_failure(
    command: Command, walk_trc: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mocodec.codecs.tempo import codec as tempo

    def broken(*_: object) -> None:
        raise IndexError("injected")

    with monkeypatch.context() as patch:
        patch.setenv("MOCODEC_STRICT", "0")
        for name in ("_encode_any", "encode_chunks"):
            patch.setattr(tempo.Tempo, name, broken)
        assert command("encode", walk_trc, "-o", "walk.mocz", "--max-error", "2mm").code == 0
    result = command("cut", "walk.mocz", "--from", "0.5s", "--to", "1.25s", "-o", "part.mocz")
    assert result.code == 0, result.err
    with mc.open("part.mocz") as part, mc.open("walk.mocz") as whole:
        assert part.encoded.codec == "lossless"
        assert part.encoded.promise == {"max_error": 0.002}
        np.testing.assert_array_equal(part[:].positions, whole[60:150].positions)
    assert command("verify", "part.mocz").code == 0


def test_cut_with_chunks_encodes_nothing_again(command: Command, walk_mocz: Path) -> None:
    result = command("cut", walk_mocz, "--from", "0.5s", "--chunks", "-o", "part.mocz")
    assert result.code == 0
    assert "nothing encoded again" in result.err
    whole, part = mc.read(walk_mocz), mc.read("part.mocz")
    np.testing.assert_allclose(part.positions, whole.positions[-len(part) :], atol=1e-9)


def test_help_names_every_command_and_exit_code(command: Command) -> None:
    result = command("--help")
    assert result.code == 0
    for word in ("encode", "decode", "info", "verify", "compare", "cut", "demo", "Exit codes"):
        assert word in result.out
    assert command().out == result.out
    for name in ("encode", "decode", "info", "verify", "compare", "cut", "demo"):
        assert command(name, "--help").code == 0


def test_version(command: Command) -> None:
    shown = command("--version").out
    assert f"mocodec {mc.__version__}" in shown
    assert ("compiled module in use" in shown) == native.available()
