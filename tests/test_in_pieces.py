"""Recordings in blocks: the same frames as at once, promises kept, nothing unfinished left behind."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import formats, in_pieces
from mocodec.testing import hinged_figures, synthetic


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


def test_gaps_and_stretches_without_samples(tmp_path: Path) -> None:
    motion = markers(7000)
    positions = motion.positions.copy()
    positions[100:900, 3] = np.nan
    positions[2500:6200] = np.nan
    motion = replace(motion, positions=positions)
    mc.encode_blocks(blocks(motion), tmp_path / "gaps.mocz", max_error=0.004)
    compared = mc.compare(motion, mc.read(tmp_path / "gaps.mocz", mc.Motion))
    assert compared.gaps_equal
    assert compared.max_error <= 0.004


def test_a_recording_that_begins_without_samples(tmp_path: Path) -> None:
    motion = markers(2500)
    positions = motion.positions.copy()
    positions[:1400] = np.nan
    motion = replace(motion, positions=positions)
    mc.encode_blocks(blocks(motion), tmp_path / "gaps.mocz", max_error=0.004)
    compared = mc.compare(motion, mc.read(tmp_path / "gaps.mocz", mc.Motion))
    assert compared.gaps_equal
    assert compared.max_error <= 0.004


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


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".trc", ".bvh", ".amc"])
def test_files_in_pieces_give_the_frames_of_the_file(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mocodec.formats.text_lines.BLOCK_LINES", 333)
    monkeypatch.setattr("mocodec.formats.text_lines.blocks.__defaults__", (333,))
    monkeypatch.setattr("mocodec.formats.amc_blocks.BLOCK_FRAMES", 333)
    skeletal = suffix in (".bvh", ".amc")
    motion = hinged_figures.figure(1000, own_frame=suffix == ".amc") if skeletal else markers(1000)
    if suffix == ".trc":
        positions = motion.positions.copy()
        positions[300:340, 2] = np.nan
        motion = replace(motion, positions=positions)
    path = tmp_path / f"recording{suffix}"
    options = {"rate": motion.rate} if suffix == ".npy" else {}
    mc.write(path, motion)
    whole, parts = mc.read(path, mc.Motion, **options), mc.read_blocks(path, **options)
    found = list(parts)
    assert len(found) > 1 or suffix in (".npy", ".npz")
    assert (parts.about.names, parts.about.rate, parts.about.up) == (whole.names, whole.rate, whole.up)
    assert parts.frames in (None, 1000)
    np.testing.assert_array_equal(np.concatenate([m.positions for m in found]), whole.positions)
    if whole.rotations is not None:
        turned = [m.rotations for m in found if m.rotations is not None]
        np.testing.assert_array_equal(np.concatenate(turned), whole.rotations)
    written = mc.encode_blocks(parts, tmp_path / "out.mocz", max_error=0.005)
    assert mc.compare(whole, mc.read(tmp_path / "out.mocz", mc.Motion)).max_error <= 0.005
    assert written.frames == 1000


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".trc", ".bvh", ".amc"])
def test_truncated_files_raise_in_pieces(tmp_path: Path, suffix: str) -> None:
    motion = hinged_figures.figure(400, own_frame=suffix == ".amc")
    path = tmp_path / f"recording{suffix}"
    mc.write(path, motion)
    data = path.read_bytes()
    options = {"rate": motion.rate} if suffix == ".npy" else {}
    for share in (0.05, 0.5, 0.9, 0.999):
        path.write_bytes(data[: int(share * len(data))])
        if suffix == ".trc" and share == 0.999:
            continue  # within the last row: empty cells at its end are gaps
        with pytest.raises(mc.BadInput):
            list(mc.read_blocks(path, **options))


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
    with pytest.raises(mc.BadInput, match="block 1 has other points"):
        mc.encode_blocks([motion, replace(motion, rate=60.0)], path)
    with pytest.raises(mc.BadInput, match="no frames"):
        mc.encode_blocks([], path)
    with pytest.raises(mc.BadInput, match="read as a whole only"):
        mc.read_blocks(tmp_path / "x.c3d")
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
