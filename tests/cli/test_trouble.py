"""Errors: one clear line on standard error, the documented exit code, no half-written output, no traceback."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import cli, formats
from mocodec.cli import compare, files

from .conftest import LOSSY, Command, Result, restore_sigint


def assert_one_line(result: Result, code: int) -> None:
    assert result.code == code, result.err
    assert result.err.startswith("mocodec: ")
    assert result.err.count("\n") == 1
    assert "Traceback" not in result.err


@pytest.mark.parametrize(
    "arguments",
    [
        ["encode"],
        ["encode", "-"],
        ["decode", "walk.mocz"],
        ["nonsense"],
        ["encode", "walk.trc", "-o", "x.mocz", "--max-error", "2"],
        ["encode", "walk.trc", "-o", "x.mocz", "--max-error", "-2mm"],
        ["encode", "walk.trc", "-o", "x.mocz", "--max-error", "0mm"],
        ["encode", "walk.trc", "-o", "x.mocz", "--max-error", "nanmm"],
        ["encode", "walk.trc", "-o", "x.mocz", "--codec", "h264"],
        ["encode", "walk.trc", "-o", "x.mocz", "--size", "lots"],
        ["encode", "walk.trc", "-o", "x.mocz", "--ratio", "0"],
        ["encode", "walk.trc", "-o", "x.mocz", "--codec", LOSSY, "--set", "no_such=1"],
        ["encode", "walk.trc", "-o", "x.mocz", "--codec", LOSSY, "--set", "no equals sign"],
        ["encode", "walk.trc", "-o", "x.mocz", "--residual", "exact"],
        ["encode", "walk.trc", "-o", "x.trc"],
        ["encode", "walk.trc", "-o", "x.mocz", "--codec", LOSSY, "--set", "blend_frames=a,b"],
        ["decode", "walk.trc", "-o", "x.npz"],
        ["cut", "walk.trc", "--from", "1s", "--to", "0.5s", "-o", "x.trc"],
        ["cut", "walk.trc", "--from", "99s", "-o", "x.trc"],
        ["cut", "walk.trc", "--from", "12", "-o", "x.trc"],
        ["cut", "walk.trc", "--chunks", "-o", "x.trc"],
        ["cut", "walk.trc", "--to", "1s", "-o", "./walk.trc"],
        ["convert", "walk.trc", "walk.trc", "--to-rate", "60"],
        ["encode", "walk.trc", "-o", ""],
        ["encode", "", "-o", "x.mocz"],
        ["decode", "walk.mocz", "-o", "x.mocz"],
    ],
    ids=" ".join,
)
def test_usage_is_2(command: Command, walk_trc: Path, arguments: list[str]) -> None:
    assert_one_line(command(*arguments), cli.USAGE)
    assert os.listdir() == ["walk.trc"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["encode", "missing.c3d", "-o", "x.mocz"],
        ["encode", "text.c3d", "-o", "x.mocz"],
        ["encode", "text.trc", "-o", "x.mocz"],
        ["encode", "text.bvh", "-o", "x.mocz"],
        ["encode", "text.amc", "-o", "x.mocz"],
        ["encode", "text.npz", "-o", "x.mocz"],
        ["encode", "text.xyz", "-o", "x.mocz"],
        ["encode", "empty.c3d", "-o", "x.mocz"],
        ["encode", "walk.trc", "-o", "x.mocz", "--codec", LOSSY, "--set", "normalisation_markers=NO,SUCH,NAMES"],
        ["encode", "walk.trc", "-o", "x.mocz", "--codec", LOSSY, "--set", "normalisation_markers=CLAV,STRN"],
        ["encode", "walk.trc", "-o", "no/such/folder/x.mocz", "--codec", LOSSY],
        ["decode", "missing.mocz", "-o", "x.trc"],
        ["decode", "text.mocz", "-o", "x.trc"],
        ["info", "missing.mocz"],
        ["verify", "walk.trc"],
        ["compare", "walk.trc", "missing.trc"],
    ],
    ids=" ".join,
)
def test_bad_input_is_3(command: Command, walk_trc: Path, arguments: list[str]) -> None:
    for name in ("text.c3d", "text.trc", "text.bvh", "text.amc", "text.npz", "text.xyz", "text.mocz"):
        Path(name).write_text("this is a shopping list: milk, eggs, flour\n" * 40)
    Path("empty.c3d").touch()
    before = sorted(os.listdir())
    assert_one_line(command(*arguments), cli.BAD_INPUT)
    assert sorted(os.listdir()) == before


def test_a_motion_without_frames_is_3(command: Command, walk: mc.Motion, walk_trc: Path) -> None:
    mc.write("no_frames.npz", mc.Motion(np.zeros((0, 3, 3)), 120))
    assert_one_line(command("encode", "no_frames.npz", "-o", "x.mocz", "--codec", LOSSY), cli.BAD_INPUT)
    assert not Path("x.mocz").exists()


@pytest.mark.parametrize("codec", ["tempo", "hou2014", "liu2006", "lossless"])
@pytest.mark.parametrize("points", [0, 3])
def test_a_motion_without_samples_keeps_its_signals(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, codec: str, points: int
) -> None:
    """Force plates that were recorded without markers, or with all markers hidden."""
    monkeypatch.chdir(tmp_path)
    analog = mc.Signal(np.arange(200, dtype=np.int16).reshape(100, 2), 600.0, ("Fx", "Fz"))
    mc.write("plates.c3d", mc.Motion(np.full((20, points, 3), np.nan), 120, extras={"analog": analog}))
    assert command("encode", "plates.c3d", "-o", "x.mocz", "--codec", codec).code == 0
    assert command("verify", "x.mocz", "--against", "plates.c3d").code == 0
    assert command("cut", "x.mocz", "-o", "y.mocz", "--from", "5f").code == 0
    assert command("decode", "y.mocz", "-o", "z.c3d").code == 0
    again = mc.read("z.c3d", mc.Motion)
    assert again.points == points
    assert np.array_equal(again.extras["analog"].values, analog.values[25:])


@pytest.mark.parametrize("verb", ["info", "verify", "decode"])
def test_damage_is_4(command: Command, walk_mocz: Path, verb: str) -> None:
    data = walk_mocz.read_bytes()
    output = ["-o", "x.trc"] if verb == "decode" else []
    for kept in (len(data) - 1, len(data) // 2, 20):
        Path("cut.mocz").write_bytes(data[:kept])
        result = command(verb, "cut.mocz", *output)
        assert_one_line(result, cli.DAMAGED)
        assert result.err.startswith("mocodec: cut.mocz: ")
    if verb != "info":  # which reads header and index only
        flipped = bytearray(data)
        flipped[len(data) // 2] ^= 0x10
        Path("cut.mocz").write_bytes(flipped)
        assert_one_line(command(verb, "cut.mocz", *output), cli.DAMAGED)
    assert not Path("x.trc").exists()


def test_salvage_writes_the_undamaged_frames(command: Command, walk: mc.Motion, walk_trc: Path) -> None:
    assert command("encode", walk_trc, "-o", "walk.mocz", "--codec", "lossless", "--set", "chunk_seconds=0.5").code == 0
    data = bytearray(Path("walk.mocz").read_bytes())
    assert json.loads(command("info", "walk.mocz", "--json").out)["chunks"]["count"] == 4
    data[len(data) // 2] ^= 0x10
    Path("damaged.mocz").write_bytes(data)
    Path("short.mocz").write_bytes(data[: len(data) // 2])
    for name in ("damaged.mocz", "short.mocz"):
        result = command("decode", name, "-o", "left.npz", "--salvage")
        assert result.code == cli.DAMAGED
        left = mc.read("left.npz")
        assert len(left) <= len(walk)
        kept = ~left.gaps
        assert kept[:60].sum() == 60 * 7
        np.testing.assert_allclose(left.positions[kept], walk.positions[: len(left)][kept], atol=1e-6)
    assert "60 frames are gaps" in command("decode", "damaged.mocz", "-o", "left.npz", "--salvage").err
    assert command("decode", "walk.mocz", "-o", "all.npz", "--salvage").code == 0


def test_a_pipe_is_written_to_not_replaced(command: Command, walk_trc: Path) -> None:
    os.mkfifo("pipe")
    reader = subprocess.Popen(["cat", "pipe"], stdout=subprocess.PIPE)
    assert command("encode", walk_trc, "-o", "pipe", "--codec", "lossless").code == 0
    assert mc.decode(reader.communicate(timeout=30)[0]).names == mc.read(walk_trc).names
    assert Path("pipe").is_fifo()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with names are POSIX's")
def test_pipes_with_names_are_read_once_and_passed_over_in_folders(command: Command, walk_mocz: Path) -> None:
    os.mkfifo("pipe")
    with subprocess.Popen(["bash", "-c", f"cat {walk_mocz} > pipe"]):
        assert command("decode", "pipe", "-o", "x.npz").code == 0
    os.remove("x.npz")
    os.mkfifo("later.trc")
    found = command("encode", ".", "-o", "out", "--codec", "lossless", "--json")
    assert [record["file"] for record in json.loads(found.out)["records"]] == ["walk.trc"]


@pytest.mark.skipif(os.name != "posix", reason="lengths of names in POSIX")
def test_an_output_with_too_long_a_name_costs_no_other_file(command: Command, walk_trc: Path) -> None:
    for suffix in (".trc", ".TRC"):
        Path("x" * 250 + suffix).write_bytes(walk_trc.read_bytes())
    result = command("encode", ".", "-o", "out", "--codec", "lossless", "--quiet")
    assert result.code == cli.BAD_INPUT
    assert result.err.count("File name too long") == 2
    assert [path.name for path in Path("out").glob("*.mocz")] == ["walk.mocz"]


def test_an_existing_output_survives_a_failure(command: Command, walk_trc: Path) -> None:
    Path("x.mocz").write_text("unchanged")
    assert command("encode", "missing.c3d", "-o", "x.mocz").code == cli.BAD_INPUT
    assert Path("x.mocz").read_text() == "unchanged"


def test_debug_shows_the_traceback(walk_trc: Path) -> None:
    for arguments in (["--debug", "info", "missing.c3d"], ["info", "--debug", "missing.c3d"]):
        with pytest.raises(mc.BadInput):
            cli.run(arguments)


def test_bugs_are_one_line_too(command: Command, walk_trc: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def bug(*_: object, **__: object) -> None:
        raise ZeroDivisionError("division by\nzero")

    monkeypatch.setattr("mocodec.api.read", bug)
    result = command("info", walk_trc)
    assert_one_line(result, cli.BUG)
    assert "--debug" in result.err


# Real processes and pipes.


def start(*arguments: object, **options: object) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "mocodec", *map(str, arguments)], stderr=subprocess.PIPE, **options)  # type: ignore[call-overload]


def wait_until_idle(process: subprocess.Popen[bytes]) -> None:
    """Returns when the process has used no processor time for a second, for half a minute at most."""
    stat = Path(f"/proc/{process.pid}/stat")
    used, since = "", 0
    for _ in range(60):
        time.sleep(0.5)
        now = stat.read_text().rsplit(")")[-1].split()[11] if stat.exists() else ""
        used, since = (now, 0) if now != used else (used, since + 1)
        if since >= 2:
            return


def test_pipes(walk_trc: Path) -> None:
    def through(data: bytes, *arguments: str) -> bytes:
        done = subprocess.run(
            [sys.executable, "-m", "mocodec", *arguments], input=data, capture_output=True, check=True
        )
        return done.stdout

    blob = through(walk_trc.read_bytes(), "encode", "-", "--format", "trc", "-o", "-", "--codec", LOSSY)
    assert mc.decode(blob).names == mc.read(walk_trc).names
    assert through(blob, "decode", "-", "-o", "-", "--format", "trc").startswith(b"PathFileType")
    assert b"240" in through(blob, "info", "-")


def test_a_broken_pipe_is_quiet(walk_trc: Path) -> None:
    process = start("compare", walk_trc, walk_trc, "--json", stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    _, err = process.communicate(timeout=30)
    assert err == b""
    assert process.returncode in (0, cli.BROKEN_PIPE)


def test_interrupt_is_quiet(walk_trc: Path) -> None:
    process = start("info", "-", stdin=subprocess.PIPE, stdout=subprocess.PIPE, preexec_fn=restore_sigint)
    wait_until_idle(process)  # it waits for standard input
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert err.decode().splitlines() == ["mocodec: interrupted"]
    assert process.returncode == cli.INTERRUPTED


def test_an_option_of_another_codec_names_the_codecs_that_take_it(command: Command, walk_trc: Path) -> None:
    result = command("encode", walk_trc, "-o", "x.mocz", "--residual", "40")
    assert "--residual is for lien2006 and bodycast; this recording is coded by tempo" in result.err
    result = command("encode", walk_trc, "-o", "x.mocz", "--codec", LOSSY, "--chunk-seconds", "1")
    assert "--chunk-seconds is for tempo and lossless" in result.err
    result = command("encode", walk_trc, "-o", "x.mocz", "--codec", "lossless", "--max-error", "1mm")
    assert "--max-error is for liu2006, hou2014, tempo and bodycast; this recording is coded by lossless" in result.err


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("decode", "walk.mocz", "-o", "again.mocz"), 2, "decode does not compress again"),
        (("info", "missing.mocz"), 3, "missing.mocz: no such file"),
        (("view", "missing"), 3, "missing: no such file or folder"),
        (("encode", "walk.trc", "-o", "missing/walk.mocz"), 3, "there is no folder"),
        (("encode", "walk.trc", "-o", "x.mocz", "--size", "10"), 3, "at a size of 10"),
        (("encode", "walk.trc", "-o", "x.mocz", "--set", "components=3"), 2, "tempo has no setting 'components'"),
    ],
)
def test_slips_are_answered_with_the_way_out(
    command: Command, walk_trc: Path, walk_mocz: Path, arguments: tuple[str, ...], code: int, says: str
) -> None:
    result = command(*arguments)
    assert (result.code, says in result.err) == (code, True), result.err


def test_a_note_on_standard_input_is_shown_once(
    command: Command, walk_trc: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(walk_trc.read_bytes())))
    assert command("encode", "-", "-o", "x.mocz", "--format", "trc").err.count("guessed: up") == 1


def test_info_shows_a_note_once(command: Command, walk_trc: Path) -> None:
    result = command("info", walk_trc)
    assert (result.out.count("guessed: up"), result.err) == (1, "")


def test_a_rate_that_no_model_reaches_is_no_internal_error(walk: mc.Motion, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOCODEC_STRICT", "0")
    decoded = mc.decode(mc.encode(replace(walk, rate=1e30), max_error=0.002), mc.Motion)
    notes = " ".join(formats.notes(decoded))
    assert "correct the rate (--rate)" in notes
    assert "internal error" not in notes


def test_extras_that_exceed_a_size_are_named(walk: mc.Motion, tmp_path: Path, command: Command) -> None:
    noise = np.random.default_rng(1).normal(size=(2400, 8))
    analog = mc.Signal(noise, 1200.0, tuple(f"EMG{i}" for i in range(8)))
    mc.write(tmp_path / "loud.c3d", mc.Motion(walk.positions, walk.rate, walk.names, extras={"analog": analog}))
    result = command("encode", tmp_path / "loud.c3d", "-o", tmp_path / "x.mocz", "--size", "5kB")
    assert_one_line(result, cli.BAD_INPUT)
    assert "analog channels" in result.err
    assert "--bare" in result.err
    assert command("encode", tmp_path / "loud.c3d", "-o", tmp_path / "x.mocz", "--size", "5kB", "--bare").code == 0


@pytest.mark.parametrize("name", ["walk.trc", "walk.C3D", "walk.amc"])
def test_decoding_another_format_names_the_command_that_is_meant(
    command: Command, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = command("decode", name, "-o", "x.npz")
    assert_one_line(result, cli.USAGE)
    assert f"`mocodec convert {name} x.npz`" in result.err
    assert f"`mocodec encode {name} -o walk.mocz`" in result.err


def test_compare_takes_the_rate_that_the_mocz_knows(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    recording = mc.PointClouds([np.random.default_rng(i).normal(size=(50, 3)) for i in range(3)], 12.5)
    mc.write("frames", recording)
    Path("other").mkdir()
    for path in Path("frames").iterdir():  # without the comment that says the rate
        lines = path.read_bytes().split(b"\n")
        Path("other", path.name).write_bytes(b"\n".join(line for line in lines if b"rate" not in line))
    assert command("info", "other").code == cli.BAD_INPUT
    monkeypatch.setattr(files, "read", lambda name, **options: (seen.append((name, options)), recording)[1])
    seen: list[tuple[str, dict[str, object]]] = []
    compare.read_both("other", "people.mocz", {"fps": None, "rate": None})
    assert seen == [("people.mocz", {}), ("other", {"fps": 12.5})]
    seen.clear()
    compare.read_both("other", "people.mocz", {"fps": None, "rate": 10.0})
    assert seen == [("people.mocz", {}), ("other", {"rate": 10.0})]


def run_mocodec(arguments: str) -> subprocess.CompletedProcess[bytes]:
    """A command line of a shell, in which `$M` is mocodec."""
    environment = {**os.environ, "M": f"{sys.executable} -m mocodec"}
    return subprocess.run(["bash", "-c", arguments], capture_output=True, env=environment, timeout=60)


@pytest.mark.skipif(os.name != "posix", reason="streams and file names of POSIX")
@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("$M info walk.mocz >&-", 0),
        ("$M info walk.mocz 2>&-", 0),
        ("$M info missing.mocz 2>&-", cli.BAD_INPUT),
        ("$M info - <&-", cli.USAGE),
        ("$M encode walk.trc -o - >&-", cli.USAGE),
        ("$M decode walk.mocz --format trc -o - >&-", cli.USAGE),
        ("$M info walk.mocz > /dev/full", cli.BAD_INPUT),
        ("$M info walk.mocz | head -0; exit ${PIPESTATUS[0]}", None),
        ("$M verify walk.mocz walk.mocz | head -0", None),
    ],
)
def test_closed_and_full_streams_do_not_crash(walk_mocz: Path, line: str, code: int | None) -> None:
    process = run_mocodec(line)
    if code is not None:
        assert process.returncode == code
    assert b"Traceback" not in process.stderr
    assert b"Exception" not in process.stderr
    assert b"bug" not in process.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="file names of any bytes")
def test_undecodable_names_do_not_crash(walk_trc: Path) -> None:
    name = b"\xff\x1b[31m.trc"
    Path(os.fsdecode(name)).write_bytes(walk_trc.read_bytes())
    line = r"$M encode $'\xff\x1b[31m.trc' -o $'\xfe.mocz' --codec lossless && $M info $'\xfe.mocz'"
    process = run_mocodec(line + r" && $M verify $'\xfe.mocz'")
    assert process.returncode == 0, process.stderr
    assert b"\x1b" not in process.stdout + process.stderr
    line = "$M encode . -o out --codec lossless && LC_ALL=C PYTHONIOENCODING=ascii $M info out ."
    many = run_mocodec(line + r"; $M info $'\xfd'")
    assert b"bug" not in many.stderr
    assert b"\x1b" not in many.stdout + many.stderr
    assert many.returncode == cli.BAD_INPUT


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.15, 0.3, 0.6, 1.0])
def test_a_signal_at_any_moment_leaves_no_trace(walk_trc: Path, number: int, after_s: float) -> None:
    start = "import sys, mocodec_command; sys.argv[1:] = ['encode', 'walk.trc', '-o', 'x.mocz']; print(flush=True)"
    process = subprocess.Popen(
        [sys.executable, "-c", f"{start}; mocodec_command.main()"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(0.01 + after_s)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode in (0, 128 + number, -number)  # the last as the interpreter ends
    assert b"Traceback" not in err
    assert [path.name for path in Path().iterdir() if "part" in path.name] == []


def test_a_cut_of_another_format_into_a_mocz_says_its_bound(command: Command, walk_trc: Path) -> None:
    result = command("cut", walk_trc, "--from", "10f", "-o", "part.mocz")
    assert result.code == 0, result.err
    assert "cut and encoded, promised max error 5 mm" in result.err
