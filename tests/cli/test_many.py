"""Many files in one command: mirrored names, resuming, failures counted, one summary."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import cli
from mocodec.cli import many, summary
from mocodec.cli.journal import NAME

from .conftest import Command, restore_sigint

FAST = ("--codec", "lossless")


@pytest.fixture
def folder(walk: mc.Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two recordings of one name and one in a folder, one file that cannot be read, and one of another kind."""
    monkeypatch.chdir(tmp_path)
    Path("in/sub").mkdir(parents=True)
    mc.write("in/a.trc", walk)
    mc.write("in/a.npz", walk[:50])
    mc.write("in/sub/b.c3d", walk)
    Path("in/sub/broken.trc").write_text("nothing")
    Path("in/readme.txt").write_text("not a recording")
    return tmp_path


def test_failures_are_said_without_a_summary_too(folder: Path, command: Command) -> None:
    result = command("encode", "in", "-o", "out", *FAST, "--quiet")
    assert result.out == ""
    assert [line.partition("] ")[2][:23] for line in result.err.splitlines()] == ["sub/broken.trc: failed:"]


def files_below(path: str) -> list[str]:
    return sorted(p.relative_to(path).as_posix() for p in Path(path).rglob("*") if p.is_file() and p.name != NAME)


def test_a_folder_is_mirrored_and_gone_on_with(folder: Path, command: Command) -> None:
    first = command("encode", "in", "-o", "out", *FAST, "--json")
    assert first.code == cli.BAD_INPUT  # one file failed
    assert files_below("out") == ["a.npz.mocz", "a.trc.mocz", "sub/b.mocz"]
    report = json.loads(first.out)
    by_name = {record["file"]: record for record in report["records"]}
    assert {name: record["status"] for name, record in by_name.items()} == {
        "a.npz": "done", "a.trc": "done", "sub/b.c3d": "done", "sub/broken.trc": "failed",
    }  # fmt: skip
    assert "not a TRC" in by_name["sub/broken.trc"]["reason"]
    totals = report["totals"]
    assert (totals["files"], totals["done"], totals["failed"]) == (4, 3, 1)
    assert totals["bytes"] == sum(Path("out", name).stat().st_size for name in files_below("out"))
    assert totals["ratio"] > 1
    sizes = {name: Path("in", name).stat().st_size for name in ("a.npz", "a.trc", "sub/b.c3d")}
    assert by_name["a.trc"]["file_ratio"] == sizes["a.trc"] / by_name["a.trc"]["bytes"]
    assert totals["file_ratio"] == sum(sizes.values()) / totals["bytes"]
    assert totals["mean_error"] <= totals["max_error"] < 1e-6

    written = {name: Path("out", name).stat().st_mtime_ns for name in files_below("out")}
    second = command("encode", "in", "-o", "out", *FAST, "--json")
    assert json.loads(second.out)["totals"]["skipped"] == 3
    assert written == {name: Path("out", name).stat().st_mtime_ns for name in files_below("out")}

    Path("out/sub/b.mocz").unlink()
    os.utime("in/a.trc")
    statuses = statuses_of(command("encode", "in", "-o", "out", *FAST, "--json").out)
    assert statuses == {"a.npz": "skipped", "a.trc": "done", "sub/b.c3d": "done", "sub/broken.trc": "failed"}
    other = command("encode", "in", "-o", "out", *FAST, "--bare", "--json")
    assert json.loads(other.out)["totals"]["skipped"] == 0


def statuses_of(report: str) -> dict[str, str]:
    return {record["file"]: record["status"] for record in json.loads(report)["records"]}


def test_the_bytes_are_those_of_a_single_encoding(folder: Path, command: Command) -> None:
    command("encode", "in", "-o", "out", "-j", "2", *FAST)
    command("encode", "in/sub/b.c3d", "-o", "one.mocz", *FAST)
    assert Path("out/sub/b.mocz").read_bytes() == Path("one.mocz").read_bytes()


def test_the_table_has_files_totals_and_reasons(folder: Path, command: Command) -> None:
    result = command("encode", "in", "-o", "out", *FAST)
    lines = result.out.splitlines()
    assert lines[0].split()[:2] == ["file", "bytes"]
    assert any(line.startswith("total") for line in lines)
    assert "4 files: 3 done, 1 failed" in result.out
    assert sum("failed: sub/broken.trc" in line for line in lines) == 1
    assert result.err.count("\n") == 4  # one line a file: standard error is no terminal
    assert command("encode", "in", "-o", "out", *FAST, "--again", "-q").err.count("\n") == 1  # what failed


def test_verify_info_and_decode_take_the_folder_again(folder: Path, command: Command) -> None:
    Path("in/sub/broken.trc").unlink()
    command("encode", "in", "-o", "out", *FAST)
    verified = command("verify", "out", "--against", "in", "--json")
    assert verified.code == 0, verified.out
    assert all(record["kept"] for record in json.loads(verified.out)["records"])
    shown = command("info", "out", "in/a.trc", "--json")
    assert shown.code == 0
    assert "note: a.trc: guessed: up z (--up)" in command("info", "in").out
    assert [r["file"] for r in json.loads(shown.out)["records"]] == [
        "in/a.trc", "out/a.npz.mocz", "out/a.trc.mocz", "out/sub/b.mocz",
    ]  # fmt: skip
    decoded = command("decode", "out", "-o", "back")
    assert decoded.code == 0, decoded.out
    assert files_below("back") == ["a.npz", "a.trc", "sub/b.c3d"]
    command("decode", "out", "-o", "as_npz", "--format", "npz")
    assert files_below("as_npz") == ["a.npz", "a.trc.npz", "sub/b.npz"]
    again = command("decode", "out", "-o", "back", "--json")
    assert json.loads(again.out)["totals"]["skipped"] == 3


def test_a_format_that_is_unknown_becomes_npz(folder: Path, command: Command, walk: mc.Motion) -> None:
    for name, format_ in (("a", "synthetic"), ("b", "../../x"), ("c", "trc")):
        motion = mc.Motion(walk.positions, walk.rate, walk.names, source={"format": format_, "unit_m": 0.001})
        mc.write(f"{name}.mocz", motion, codec="lossless")
    assert command("decode", "a.mocz", "b.mocz", "c.mocz", "-o", "back").code == 0
    assert files_below("back") == ["a.npz", "b.npz", "c.trc"]


def test_damage_and_a_broken_promise_fail_one_file(folder: Path, command: Command, walk: mc.Motion) -> None:
    Path("in/sub/broken.trc").unlink()
    command("encode", "in", "-o", "out", *FAST)
    data = bytearray(Path("out/a.trc.mocz").read_bytes())
    data[len(data) // 2] ^= 1
    Path("out/a.trc.mocz").write_bytes(data)
    result = command("verify", "out", "--json")
    assert result.code == cli.DAMAGED
    assert statuses_of(result.out) == {"a.npz.mocz": "done", "a.trc.mocz": "failed", "sub/b.mocz": "done"}
    mc.write("in/sub/b.c3d", mc.Motion(walk.positions[:9], walk.rate, walk.names))
    result = command("verify", "out/sub", "--against", "in/sub")
    assert result.code == cli.PROMISE_BROKEN
    assert "the source has 9 frames" in result.out
    extra = command("verify", "out/a.npz.mocz", "out/sub/b.mocz", "--against", "in/sub")
    assert "has no recording of this name" in extra.out


def test_originals_are_found_by_stem(folder: Path, command: Command) -> None:
    Path("in/sub/broken.trc").unlink()
    command("encode", "in", "-o", "out", *FAST)
    Path("in/a.trc").unlink()  # a.npz alone is mirrored to a.mocz; the file is a.npz.mocz
    result = command("verify", "out", "--against", "in", "--json")
    assert statuses_of(result.out) == {"a.npz.mocz": "done", "a.trc.mocz": "failed", "sub/b.mocz": "done"}
    assert "in has no recording of this name (a.trc, with any suffix), or several" in result.out


def test_decoding_never_replaces_what_it_did_not_write(folder: Path, command: Command) -> None:
    Path("in/sub/broken.trc").unlink()
    command("encode", "in", "-o", "out", *FAST)
    before = {name: Path("in", name).read_bytes() for name in files_below("in")}
    result = command("decode", "out", "-o", "in")
    assert result.code == cli.BAD_INPUT
    assert result.out.count("was not written by this command") == 3
    assert before == {name: Path("in", name).read_bytes() for name in files_below("in")}
    assert command("decode", "out", "-o", "in", "--again").code == 0


def test_a_folder_of_ply_is_one_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command, walk: mc.Motion
) -> None:
    monkeypatch.chdir(tmp_path)
    frames = [np.zeros((3, 3)), np.ones((3, 3))]
    mc.write("in/people/one", mc.PointClouds(frames, 30.0))
    mc.write("in/walk.trc", walk)
    assert [s.name for s in many.find(["in"], {".ply", ".trc"})] == ["people/one", "walk.trc"]
    assert not many.is_many(["in/people/one"], "one.mocz")
    assert not many.is_many(["in/people/one"])
    assert many.is_many(["in"], "out")
    assert many.is_many(["in/walk.trc"], "out/")
    result = command("info", "in/people/one/frame_000000.ply", "in/people/one/frame_000001.ply")
    assert result.code == cli.USAGE
    assert "name the folder in/people/one" in result.err


@pytest.mark.parametrize(
    ("names", "outputs"),
    [
        (["a.c3d", "b/a.c3d"], ["a.mocz", "b/a.mocz"]),
        (["a.c3d", "a.bvh"], ["a.c3d.mocz", "a.bvh.mocz"]),
        (["a.c3d", "A.bvh"], ["a.c3d.mocz", "A.bvh.mocz"]),
        (["a.c3d", "a.bvh", "a.c3d.trc"], ["a.c3d.mocz", "a.bvh.mocz", "a.c3d.trc.mocz"]),
        (["walk.v2.c3d", "walk.c3d"], ["walk.v2.mocz", "walk.mocz"]),
    ],
)
def test_outputs_never_collide(names: Sequence[str], outputs: Sequence[str]) -> None:
    sources = [many.Source(name, name) for name in names]
    found = many.output_names(sources, dict.fromkeys(names, ".mocz"))
    assert [found[name] for name in names] == list(outputs)


@pytest.mark.parametrize(
    "arguments",
    [
        ["encode", "in", "-o", "x.mocz"],
        ["encode", "in", "-o", "-"],
        ["encode", "in", "in/a.trc", "-o", "in/a.trc"],
        ["encode", "-", "in/a.trc", "-o", "out"],
        ["encode", "in", "-o", "out", "--set", "no_such=1"],
        ["encode", "in", "-o", "out", "--codec", "lossless", "--max-error", "1mm"],
        ["decode", "in", "-o", "out"],
        ["decode", "in", "-o", "out", "--format", "docx"],
        ["decode", "x.mocz", "-o", "x.npz", "--format", "trc"],
        ["verify", "in"],
        ["verify", "x.mocz", "y.mocz", "--against", "in/a.trc"],
    ],
    ids=" ".join,
)
def test_usage_errors_come_before_any_work(folder: Path, command: Command, arguments: list[str]) -> None:
    before = files_below(".")
    result = command(*arguments)
    assert result.code == cli.USAGE
    assert result.err.count("\n") == 1
    assert files_below(".") == before


def test_a_folder_without_recordings_is_named_as_such(tmp_path: Path, command: Command) -> None:
    result = command("encode", tmp_path, "-o", tmp_path / "x.mocz")
    assert (result.code, "there is no file that `mocodec encode` reads" in result.err) == (cli.USAGE, True)
    (tmp_path / "scan.xyz").write_bytes(b"")
    result = command("info", tmp_path)
    assert (result.code, f"{tmp_path}: there is no file" in result.err, ".ply and .pcd are read" in result.err) == (
        cli.USAGE,
        True,
        True,
    )


def test_a_killed_run_is_gone_on_with(folder: Path, walk: mc.Motion) -> None:
    """A line of the journal that was cut off, and an output that was begun, are no obstacle."""
    Path("out").mkdir()
    Path("out", NAME).write_bytes(b'{"output": "a.trc.mocz", "begun": true}\n{"output": "a.np')
    process = subprocess.run([*MOCODEC, "encode", "in", "-o", "out", *FAST, "--json"], capture_output=True, text=True)
    assert json.loads(process.stdout)["totals"]["done"] == 3
    lines = Path("out", NAME).read_text().splitlines()
    assert sum(line.startswith('{"output"') and line.endswith("}") for line in lines) >= 4


MOCODEC = [sys.executable, "-m", "mocodec"]


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stopped_run_leaves_whole_files_only(folder: Path, number: int) -> None:
    steps = np.random.default_rng(1).normal(size=(20_000, 20, 3)).cumsum(axis=0) * 1e-3
    for name in ("long1", "long2"):
        mc.write(f"in/{name}.npz", mc.Motion(steps, 120))
    process = subprocess.Popen(
        [*MOCODEC, "encode", "in", "-o", "out", "-j", "2"], stderr=subprocess.PIPE, stdout=subprocess.PIPE,
        start_new_session=True, preexec_fn=restore_sigint,
    )  # fmt: skip
    while not Path("out", NAME).exists() and process.poll() is None:
        time.sleep(0.02)
    os.kill(process.pid, number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert b"Traceback" not in err + out
    assert err.decode().splitlines()[-1] == "mocodec: interrupted"
    for name in files_below("out"):
        assert name.endswith(".mocz")
        mc.decode(f"out/{name}")


def test_a_summary_weighs_the_mean_by_samples() -> None:
    records = [
        {"file": "a", "status": "done", "mean_error": 0.001, "max_error": 0.002, "samples": 100, "bytes": 10},
        {"file": "b", "status": "skipped", "mean_error": 0.003, "max_error": 0.009, "samples": 300, "bytes": 30},
        {"file": "c", "status": "failed", "reason": "unreadable", "code": 3},
    ]
    report = summary.report("encode", records, 1.0)
    assert report["totals"]["mean_error"] == pytest.approx(0.0025)
    assert report["totals"]["max_error_in"] == "b"
    assert report["totals"]["bytes"] == 40
    text = "\n".join(summary.lines("encode", report))
    assert "2.50 mm" in text
    assert "failed: c: unreadable" in text
