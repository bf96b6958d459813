"""Recordings in blocks: the same frames as at once, promises kept, nothing unfinished left behind."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import formats, in_pieces
from mocodec.testing import hinged_figures, synthetic
from tests.formats.samples import SHARED, capture, needs_shared, same_tree


@pytest.fixture(autouse=True)
def short_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sample of five seconds, so that short recordings are coded in blocks."""
    monkeypatch.setattr(in_pieces, "SAMPLED_SECONDS", 5.0)


def markers(frames: int = 9000) -> mc.Motion:
    return replace(synthetic.markers(frames=frames, seed=3), extras={})


def blocks(motion: mc.Motion, frames: int = 700) -> Iterator[mc.Motion]:
    for start in range(0, len(motion), frames):
        yield motion[start : start + frames]


@pytest.mark.parametrize("target", [{"max_error": 0.004}, {"mean_error": 0.002}, {"ratio": 60.0}, {"size": 90_000}])
def test_targets_are_kept_in_blocks(tmp_path: Path, target: dict[str, Any]) -> None:
    motion, path = markers(), tmp_path / "long.mocz"
    written = mc.encode_blocks(blocks(motion), path, frames=len(motion), **target)
    with mc.open(path, mc.Motion) as f:
        assert f.encoded.promise == target
        assert len(f.encoded.chunks) > 2
        decoded = f[:]
    compared = mc.compare(motion, decoded)
    assert written.bytes == path.stat().st_size
    assert written.max_error == pytest.approx(compared.max_error)
    assert written.mean_error == pytest.approx(compared.mean_error)
    assert compared.max_error <= target.get("max_error", np.inf)
    assert 0.9 * target.get("mean_error", 0) <= compared.mean_error <= target.get("mean_error", np.inf)
    assert written.bytes <= target.get("size", np.inf)
    assert motion.raw_bytes / written.bytes >= target.get("ratio", 0)
    if "size" in target:
        assert written.bytes > 0.93 * target["size"]


def test_about_as_small_as_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(in_pieces, "SAMPLED_SECONDS", 25.0)
    motion = markers(6000)
    written = mc.encode_blocks(blocks(motion), tmp_path / "long.mocz", max_error=0.004)
    assert written.bytes < 1.03 * len(mc.encode(motion, max_error=0.004, model="transform"))


def test_a_short_recording_is_encoded_as_by_encode(tmp_path: Path) -> None:
    motion = markers(300)
    mc.encode_blocks(blocks(motion, 100), tmp_path / "short.mocz", max_error=0.004)
    assert (tmp_path / "short.mocz").read_bytes() == mc.encode(motion, max_error=0.004)


def require_kept(motion: mc.Motion, path: Path) -> None:
    """Gaps come back, and samples within a bound."""
    mc.encode_blocks(blocks(motion), path, max_error=0.004)
    compared = mc.compare(motion, mc.read(path, mc.Motion))
    assert compared.gaps_equal
    assert compared.max_error <= 0.004


def test_gaps_and_stretches_without_samples(tmp_path: Path) -> None:
    motion = markers(7000)
    positions = motion.positions.copy()
    positions[100:900, 3] = np.nan
    positions[2500:6200] = np.nan
    require_kept(replace(motion, positions=positions), tmp_path / "gaps.mocz")


def test_a_recording_that_begins_without_samples(tmp_path: Path) -> None:
    motion = markers(2500)
    positions = motion.positions.copy()
    positions[:1400] = np.nan
    require_kept(replace(motion, positions=positions), tmp_path / "gaps.mocz")


def test_rotations_are_kept_under_a_bound(tmp_path: Path) -> None:
    motion = replace(synthetic.joints(frames=2600, seed=2), extras={})
    assert motion.rotations is not None
    written = mc.encode_blocks(blocks(motion), tmp_path / "walk.mocz", max_error=0.005)
    decoded = mc.read(tmp_path / "walk.mocz", mc.Motion)
    compared = mc.compare(motion, decoded)
    assert compared.skeletal is not None
    assert compared.max_error <= 0.005
    assert written.max_error == pytest.approx(compared.max_error)
    with pytest.raises(mc.BadInput, match="rotations are kept under max_error"):
        mc.encode_blocks(blocks(motion), tmp_path / "no.mocz", mean_error=0.005)
    gappy = motion.positions.copy()
    gappy[2000, 4] = np.nan
    with pytest.raises(mc.BadInput, match="without gaps"):
        mc.encode_blocks(blocks(replace(motion, positions=gappy)), tmp_path / "no.mocz", max_error=0.005)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["walk.mocz"]


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".trc", ".bvh", ".amc", ".c3d", ".csv"])
def test_files_in_pieces_give_the_frames_of_the_file(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mocodec.formats.text_lines.BLOCK_LINES", 333)
    monkeypatch.setattr("mocodec.formats.text_lines.blocks.__defaults__", (333,))
    monkeypatch.setattr("mocodec.formats.amc_blocks.BLOCK_FRAMES", 333)
    monkeypatch.setattr("mocodec.formats.blocks.BLOCK_SAMPLES", 333 * 41)
    skeletal = suffix in (".bvh", ".amc")
    motion = hinged_figures.figure(1000, own_frame=suffix == ".amc") if skeletal else markers(1000)
    if suffix in (".trc", ".c3d", ".csv"):
        positions = motion.positions.copy()
        positions[300:340, 2] = np.nan
        motion = replace(motion, positions=positions)
    path = tmp_path / f"recording{suffix}"
    options = {"rate": motion.rate} if suffix == ".npy" else {}
    mc.write(path, motion)
    whole, parts = mc.read(path, mc.Motion, **options), mc.read_blocks(path, **options)
    found = list(parts)
    assert len(found) > 1
    assert (parts.about.names, parts.about.rate, parts.about.up) == (whole.names, whole.rate, whole.up)
    assert parts.frames in (None, 1000)
    np.testing.assert_array_equal(np.concatenate([m.positions for m in found]), whole.positions)
    if whole.rotations is not None:
        turned = [m.rotations for m in found if m.rotations is not None]
        np.testing.assert_array_equal(np.concatenate(turned), whole.rotations)
    written = mc.encode_blocks(parts, tmp_path / "out.mocz", max_error=0.005)
    assert mc.compare(whole, mc.read(tmp_path / "out.mocz", mc.Motion)).max_error <= 0.005
    assert written.frames == 1000


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".trc", ".bvh", ".amc", ".c3d", ".csv"])
def test_truncated_files_raise_in_pieces(tmp_path: Path, suffix: str) -> None:
    motion = hinged_figures.figure(400, own_frame=suffix == ".amc")
    path = tmp_path / f"recording{suffix}"
    mc.write(path, motion)
    data = path.read_bytes()
    options = {"rate": motion.rate} if suffix == ".npy" else {}
    for share in (0.05, 0.5, 0.9, 0.999):
        path.write_bytes(data[: int(share * len(data))])
        if suffix in (".trc", ".csv") and share == 0.999:
            continue  # within the last row: empty cells at its end are gaps
        with pytest.raises(mc.BadInput):
            list(mc.read_blocks(path, **options))


@pytest.mark.parametrize("residuals", [None, True, False])
def test_a_c3d_in_pieces_has_all_that_it_has_at_once(
    tmp_path: Path, residuals: bool | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mocodec.formats.blocks.BLOCK_SAMPLES", 7 * 41)
    path, out = tmp_path / "lab.c3d", tmp_path / "out.mocz"
    mc.write(path, capture())
    whole, parts = mc.read(path, mc.Motion, residuals=residuals), mc.read_blocks(path, residuals=residuals)
    assert same_tree(dict(parts.about.extras), dict(whole.extras))
    assert parts.about.source == whole.source
    written = mc.encode_blocks(parts, out, max_error=0.005)
    with mc.open(out) as file:
        assert file.info["bytes_by_part"]["signals"] == written.signal_bytes > 0
    assert same_tree(dict(mc.read(out, mc.Motion).extras), dict(whole.extras))


CSV = {
    "labels": "time,A.x,A.y,A.z,Fz,B.x,B.y,B.z\n",
    "decimal commas": "sep=;\ntime;A.x;A.y;A.z;Fz;B.x;B.y;B.z\n",
    "comments and units": "# unit: mm\n# up: y\ntime,A.x,A.y,A.z,Fz,B.x,B.y,B.z\ns,mm,mm,mm,N,mm,mm,mm\n",
}


@pytest.mark.parametrize("kind", CSV)
def test_a_csv_in_pieces_has_all_that_it_has_at_once(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mocodec.formats.text_lines.BLOCK_LINES", 33)
    monkeypatch.setattr("mocodec.formats.blocks.BLOCK_SAMPLES", 50 * 2)
    rng = np.random.default_rng(1)
    lines = []
    for frame in range(500):
        if 200 <= frame < 210:
            continue  # frames that the times skip
        cells = [frame / 100, *rng.normal(5, 1, 7).round(3).tolist()]
        if 300 <= frame < 320:
            cells[1:4] = [0.0, 0.0, 0.0]
        texts = [f"{cell:g}" for cell in cells]
        if frame == 450:
            texts[5:8] = ["", "", ""]
        lines.append((";" if "commas" in kind else ",").join(texts))
    body = "\n".join(lines) + "\n"
    path = tmp_path / "table.csv"
    path.write_text(CSV[kind] + (body.replace(".", ",") if "commas" in kind else body))
    whole, parts = mc.read(path, mc.Motion, up="y"), mc.read_blocks(path, up="y")
    assert same_tree(dict(parts.about.extras), dict(whole.extras))
    assert parts.about.source == whole.source
    assert (parts.about.names, parts.about.rate, parts.frames) == (whole.names, whole.rate, len(whole))
    np.testing.assert_array_equal(np.concatenate([m.positions for m in parts]), whole.positions)


def test_a_csv_of_one_row_is_read_in_pieces(tmp_path: Path) -> None:
    path = tmp_path / "one.csv"
    path.write_text("A.x,A.y,A.z\n1,2,3\n")
    (block,) = mc.read_blocks(path, rate=100)
    np.testing.assert_array_equal(block.positions, [[[1, 2, 3]]])


@needs_shared
@pytest.mark.parametrize("path", sorted(SHARED.glob("**/*.c3d")), ids=lambda path: path.name)
def test_real_c3d_files_in_pieces_have_all_that_they_have_at_once(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mocodec.formats.blocks.BLOCK_SAMPLES", 50 * 41)
    try:
        parts = mc.read_blocks(path)
    except mc.BadInput as error:
        pytest.skip(str(error))
    whole = mc.read(path, mc.Motion)
    assert same_tree(dict(parts.about.extras), dict(whole.extras))
    assert parts.about.source == whole.source
    np.testing.assert_array_equal(np.concatenate([m.positions for m in parts]), whole.positions)


@pytest.mark.parametrize("has_gaps", [False, True])
@pytest.mark.parametrize("suffix", [".trc", ".c3d", ".csv"])
def test_zeros_are_the_same_gaps_in_blocks(
    tmp_path: Path, suffix: str, has_gaps: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In blocks of nothing else too, and unless the marker passes through the origin at the border of two blocks."""
    monkeypatch.setattr("mocodec.formats.blocks.BLOCK_SAMPLES", 100 * 41)
    monkeypatch.setattr("mocodec.formats.text_lines.blocks.__defaults__", (100,))
    positions = markers(600).positions.copy()
    positions[150:450] = 0.0
    positions[:200, 3] = np.linspace(-0.1, 0.1, 200)[:, None]
    positions[95:105, 3] = 0.0
    if has_gaps:
        positions[500:510, 5] = np.nan
    path = tmp_path / f"empty{suffix}"
    mc.write(path, replace(markers(600), positions=positions))
    whole, parts = mc.read(path, mc.Motion), mc.read_blocks(path)
    found = np.concatenate([m.positions for m in parts])
    np.testing.assert_array_equal(found, whole.positions)
    assert np.isnan(found[250:450]).all()
    assert not np.isnan(found[95:105, 3]).any()
    assert (dict(parts.about.source), parts.about.up) == (dict(whole.source), whole.up)
    assert same_tree(dict(parts.about.extras), dict(whole.extras))


def test_what_cannot_be_done_in_blocks(tmp_path: Path) -> None:
    motion, path = markers(1500), tmp_path / "out.mocz"
    for settings, message in (
        ({"ratio": 50.0}, "number of frames"),
        ({"codec": "hou2014"}, "tempo encodes in blocks"),
        ({"weights": {"LANK": 2.0}}, "whole recording"),
        ({"psnr": 40}, "no target 'psnr'"),
    ):
        with pytest.raises(mc.BadInput, match=message):
            mc.encode_blocks(blocks(motion), path, **settings)  # pyright: ignore[reportArgumentType]
    with pytest.raises(mc.CannotEncode):
        mc.encode_blocks(blocks(motion), path, frames=1500, size=300)
    with pytest.raises(mc.BadInput, match=r"block 1 has .*60 Hz.* the first .*120 Hz"):
        mc.encode_blocks([motion, replace(motion, rate=60.0)], path)
    with pytest.raises(mc.BadInput, match="no frames"):
        mc.encode_blocks([], path)
    with pytest.raises(mc.BadInput, match="read as a whole only"):
        mc.read_blocks(tmp_path / "x.glb")
    assert list(tmp_path.iterdir()) == []


def test_a_source_that_fails_leaves_no_file(tmp_path: Path) -> None:
    def failing() -> Iterator[mc.Motion]:
        yield from blocks(markers(2000))
        raise OSError("the camera is gone")

    with pytest.raises(mc.BadInput, match="camera is gone"):
        mc.encode_blocks(failing(), tmp_path / "out.mocz")
    assert list(tmp_path.iterdir()) == []


def test_progress_rises_to_one(tmp_path: Path) -> None:
    heard: list[float] = []
    motion = markers(5000)
    mc.encode_blocks(blocks(motion), tmp_path / "x.mocz", frames=len(motion), progress=heard.append)
    assert heard == sorted(heard)
    assert heard[0] == 0
    assert heard[-1] == 1
    assert len(heard) > 3


def test_only_listed_formats_are_read_in_pieces() -> None:
    assert formats.can_read_blocks("x.NPY")
    assert not formats.can_read_blocks("x.glb")


@pytest.mark.parametrize("frames", [0, -5, 10.5, np.nan, "many"])
def test_a_number_of_frames_that_is_none(tmp_path: Path, frames: Any) -> None:
    with pytest.raises(mc.BadInput, match="frames is the number"):
        mc.encode_blocks(blocks(markers(1500)), tmp_path / "x.mocz", frames=frames, size=10_000)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("at", [0, 1])
@pytest.mark.parametrize("block", [None, "text", np.zeros((9, 41, 3)), mc.PointClouds([np.zeros((4, 3))], 60.0)])
def test_blocks_that_are_no_motions(tmp_path: Path, block: Any, at: int) -> None:
    path = tmp_path / "x.mocz"
    path.write_bytes(b"before")
    source: list[Any] = [*blocks(markers(1500))]
    with pytest.raises(mc.BadInput, match=f"block {at} is a .*, not a motion"):
        mc.encode_blocks([*source[:at], block, *source[at:]], path, max_error=0.005)
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("target", [{"max_error": 0.005}, {"mean_error": 0.002}])
def test_motions_without_points(tmp_path: Path, target: dict[str, Any]) -> None:
    nothing = mc.Motion(np.zeros((1500, 0, 3)), 100.0)
    assert mc.encode_blocks(blocks(nothing), tmp_path / "x.mocz", **target).frames == 1500
    assert mc.read(tmp_path / "x.mocz", mc.Motion).positions.shape == (1500, 0, 3)


def test_a_generator_may_fill_one_array_again(tmp_path: Path) -> None:
    motion = markers(2000).select(["C7", "LSHO", "LKNE"])

    def camera() -> Iterator[mc.Motion]:
        taken = np.empty((500, 3, 3))
        for block in blocks(motion, 500):
            taken[:] = block.positions
            yield replace(block, positions=taken)

    mc.encode_blocks(camera(), tmp_path / "x.mocz", max_error=0.005)
    assert mc.compare(motion, mc.read(tmp_path / "x.mocz", mc.Motion)).max_error <= 0.005


@pytest.mark.parametrize("size", [300_000, 1_000_000, 1_000_000_000])
def test_a_size_beyond_what_the_steps_can_use(tmp_path: Path, size: int) -> None:
    motion = markers(1500).select(["C7", "LSHO", "RSHO", "LKNE", "LHEE"])
    written = mc.encode_blocks(blocks(motion), tmp_path / "x.mocz", frames=1500, size=size)
    assert written.bytes <= size
    assert written.max_error < 1e-8


def test_a_bound_too_small_for_the_model(tmp_path: Path) -> None:
    motion = markers(1500).select(["C7", "LSHO", "RSHO", "LKNE", "LHEE"])
    assert mc.encode_blocks(blocks(motion), tmp_path / "x.mocz", max_error=1e-12).max_error <= 1e-12


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_takes_the_file(tmp_path: Path) -> None:
    pipe, motion = tmp_path / "pipe", markers(1500)
    os.mkfifo(pipe)
    received: list[bytes] = []
    reader = threading.Thread(target=lambda: received.append(pipe.read_bytes()))
    reader.start()
    written = mc.encode_blocks(blocks(motion), pipe, max_error=0.005)
    reader.join()
    assert written.bytes == len(received[0])
    assert len(mc.decode(received[0])) == 1500


def test_an_interrupt_leaves_the_file_of_before(tmp_path: Path) -> None:
    path = tmp_path / "x.mocz"
    path.write_bytes(b"before")

    def interrupted() -> Iterator[mc.Motion]:
        yield from blocks(markers(2000))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mc.encode_blocks(interrupted(), path)
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]
