"""Sessions: facts about recordings, and frames inside a page."""

from __future__ import annotations

import base64
import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec.geometry import links
from mocodec.viewer import facts, packed, session
from mocodec.viewer.marks import marks
from mocodec.viewer.recording import Shown, of_file
from mocodec.viewer.session import Limit


def unpacked(media: dict[str, Any], points: int, decoded: np.ndarray | None = None) -> np.ndarray:
    """What the page makes of a packed media."""
    data = zlib.decompress(base64.b64decode(media["base64"]))
    low, high = np.frombuffer(data, np.uint8).reshape(2, -1).astype(np.uint16)
    numbers = (low | high << 8).reshape(-1, points, 3)
    if media["relative"]:
        assert decoded is not None
        values = decoded + media["step"] * (numbers.astype(float) - packed.MIDDLE)
    else:
        numbers = np.cumsum(numbers, axis=0, dtype=np.uint16)
        values = np.asarray(media["origin"]) + media["step"] * numbers
    return np.where((numbers == packed.GAP).all(axis=-1, keepdims=True), np.nan, values)


def described(original: mc.Motion, blob: bytes) -> dict[str, Any]:
    with mc.open(blob, mc.Motion) as f:
        return facts.facts(*session.matched(of_file("walk.mocz", f), Shown("walk", original)))


def test_facts_are_those_of_compare(original: mc.Motion, blob: bytes) -> None:
    found = described(original, blob)
    measured = mc.compare(original, mc.decode(blob, mc.Motion), len(blob))
    errors = found["errors"]
    assert errors["mean"] == pytest.approx(measured.mean_error)
    assert errors["p99"] == pytest.approx(measured.p99_error)
    assert errors["max"] == pytest.approx(measured.max_error)
    assert measured.max_at is not None
    assert [errors["maxAt"][0], original.names[errors["maxAt"][1]]] == list(measured.max_at)
    assert found["ratio"] == pytest.approx(measured.ratio)
    assert found["bytes"] == len(blob)
    assert found["promise"] == {"max_error": 0.002}
    assert errors["pointMax"] == pytest.approx([measured.per_point[n]["max_error"] for n in original.names], rel=1e-3)
    assert sum(size for _, size in found["chunks"]) < len(blob)
    json.dumps(found, allow_nan=False)


def test_facts_tell_events_signals_and_gaps(original: mc.Motion, blob: bytes) -> None:
    found = described(original, blob)
    assert [event["label"] for event in found["events"]] == ["heel strike", "toe off"]
    (force,) = found["signals"]
    assert (force["label"], force["unit"]) == ("Fz1", "N")
    assert max(force["high"]) == pytest.approx(700, rel=1e-3)
    assert found["gaps"][130] == pytest.approx(1 / 6, rel=1e-2)
    assert found["gaps"][300] == 0


def test_points_are_matched_by_name(original: mc.Motion) -> None:
    turned = original.select(tuple(reversed(original.names)))
    shown, before = session.matched(Shown("a", turned), Shown("b", original))
    assert before is not None
    np.testing.assert_array_equal(shown.positions(0, 600), before.positions(0, 600))
    assert facts.motion_errors(shown, before)["max"] == 0


def test_recordings_of_other_shapes_are_refused(original: mc.Motion, clouds: mc.PointClouds) -> None:
    with pytest.raises(mc.BadInput, match=r"600 frames, .* 10"):
        session.matched(Shown("a", original), Shown("b", original[:10]))
    with pytest.raises(mc.BadInput, match="6 points"):
        session.matched(Shown("a", original), Shown("b", original.select(["LA"])))
    with pytest.raises(mc.BadInput, match="point clouds"):
        session.matched(Shown("a", original), Shown("b", clouds))


def test_frames_inside_a_page(original: mc.Motion, blob: bytes) -> None:
    decoded = mc.decode(blob, mc.Motion)
    pair = session.matched(Shown("decoded", decoded), Shown("original", original))
    made = session.of_page([pair], "title")["recordings"][0]
    shown = unpacked(made["decoded"], 6)
    np.testing.assert_allclose(shown, decoded.positions, atol=1e-4)
    before = unpacked(made["original"], 6, shown)
    errors = np.linalg.norm(before - shown, axis=2)
    np.testing.assert_allclose(errors, np.linalg.norm(original.positions - decoded.positions, axis=2), atol=1e-5)


def test_an_original_with_other_gaps_is_stored_as_it_is(original: mc.Motion) -> None:
    filled = mc.Motion(np.nan_to_num(original.positions), 60, original.names)
    made = session.of_page([session.matched(Shown("a", filled), Shown("b", original))], "t")["recordings"][0]
    assert not made["original"]["relative"]
    np.testing.assert_allclose(unpacked(made["original"], 6), original.positions, atol=1e-4)


def test_long_recordings_are_thinned_out(original: mc.Motion, blob: bytes) -> None:
    pair = session.matched(Shown("a", mc.decode(blob, mc.Motion)), Shown("b", original))
    whole = session.of_page([pair], "t")["recordings"][0]
    made = session.of_page([pair], "t", Limit(2500))["recordings"][0]
    assert made["frames"] == 200
    assert made["rate"] == 20
    assert unpacked(made["decoded"], 6).shape == (200, 6, 3)
    assert made["errors"]["max"] == whole["errors"]["max"]
    assert max(made["errors"]["binMax"]) == max(whole["errors"]["binMax"])
    assert len(made["errors"]["binMax"]) == 200
    assert made["errors"]["maxAt"][0] == whole["errors"]["maxAt"][0] // 3
    assert "one of 3 frames" in made["notes"][-1]


def test_point_clouds_inside_a_page(clouds: mc.PointClouds) -> None:
    made = session.of_page([(Shown("c", clouds), Shown("c", clouds))], "t")["recordings"][0]
    assert made["kind"] == "clouds"
    assert made["decoded"]["counts"] == [50, 0, 70]
    data = np.frombuffer(zlib.decompress(base64.b64decode(made["decoded"]["base64"])), np.uint8).reshape(3, 120, 3)
    numbers = data[0] + 256.0 * data[1]
    points = np.asarray(made["decoded"]["origin"]) + made["decoded"]["step"] * numbers
    np.testing.assert_allclose(points, np.concatenate(clouds.positions), atol=1e-3)
    assert clouds.colours is not None
    np.testing.assert_array_equal(data[2], np.concatenate(clouds.colours))
    assert made["errors"]["max"] == 0


@pytest.mark.parametrize(
    "motion",
    [
        mc.Motion(np.zeros((0, 3, 3)), 60),
        mc.Motion(np.zeros((5, 0, 3)), 60),
        mc.Motion(np.full((4, 2, 3), np.nan), 60),
        mc.Motion(np.zeros((1, 1, 3)), 60),
    ],
    ids=["no frames", "no points", "gaps only", "one point"],
)
def test_edge_cases(motion: mc.Motion) -> None:
    made = session.of_page([session.matched(Shown("a", motion), Shown("b", motion))], "t")
    json.dumps(made, allow_nan=False)
    assert made["recordings"][0]["frames"] == len(motion)


def test_damaged_frames_are_gaps(original: mc.Motion, tmp_path: Path) -> None:
    data = bytearray(mc.encode(original, "lossless", chunk_seconds=100 / 60))
    with mc.open(bytes(data), mc.Motion) as f:
        start = f.encoded.chunks[2].start
        payload = bytes(f.encoded.chunks[2].payload)
    at = bytes(data).index(payload) + len(payload) // 2
    data[at] ^= 255
    path = tmp_path / "damaged.mocz"
    path.write_bytes(data)
    with mc.open(path, mc.Motion, salvage=True) as f:
        shown = of_file("damaged", f)
        ((first, stop),) = shown.damage
        assert first == start
        positions = shown.positions(0, 600)
        assert np.isnan(positions[first:stop]).all()
        np.testing.assert_allclose(positions[:first], original.positions[:first], atol=1e-6)
        np.testing.assert_allclose(positions[stop:], original.positions[stop:], atol=1e-6)


def test_damaged_and_truncated_files_make_pages(original: mc.Motion, tmp_path: Path) -> None:
    data = bytearray(mc.encode(original, "lossless", chunk_seconds=100 / 60))
    with mc.open(bytes(data), mc.Motion) as f:
        chunks = list(f.encoded.chunks)
        payload = bytes(chunks[2].payload)
    at = bytes(data).index(payload)
    (tmp_path / "cut.mocz").write_bytes(data[:at])
    data[at + len(payload) // 2] ^= 255
    (tmp_path / "damaged.mocz").write_bytes(data)
    for name, frames, says in (
        ("damaged.mocz", 600, "damaged and left out"),
        ("cut.mocz", chunks[2].start, "cut short"),
    ):
        with mc.open(tmp_path / name, mc.Motion, salvage=True) as f:
            pair = session.matched(of_file(name, f), Shown("original", original))
            made = session.of_page([pair], name)["recordings"][0]
            assert made["frames"] == frames
            assert any(says in note for note in made["notes"])
            assert made["errors"]["max"] < 1e-6
            assert (-1.0 in made["errors"]["binMax"]) == (name == "damaged.mocz")
            json.dumps(made, allow_nan=False)


def test_links_of_markers_join_limbs(original: mc.Motion) -> None:
    found = links.links(original)
    assert (0, 1) in found
    assert (3, 4) in found
    assert all((a < 3) == (b < 3) for a, b in found)


def test_links_of_a_skeleton_are_its_bones() -> None:
    skeleton = mc.Skeleton(("a", "b", "c"), (-1, 0, 1), np.ones((3, 3)))
    assert links.links(mc.Motion(np.zeros((1, 3, 3)), 30, skeleton.names, skeleton=skeleton)) == [(0, 1), (1, 2)]


def test_clips_segments_and_key_frames_are_marked(original: mc.Motion, blob: bytes) -> None:
    with mc.open(blob, mc.Motion) as f:
        segments, keys = marks(of_file("walk.mocz", f))
        starts = [chunk.start for chunk in f.encoded.chunks]
    assert (segments["label"], keys["label"]) == ("segment", "key frame")
    assert segments["frames"] == starts
    assert set(starts) <= set(keys["frames"])
    assert keys["frames"] == sorted(set(keys["frames"]))
    assert keys["frames"][0] >= 0
    assert keys["frames"][-1] == 599
    clips = mc.encode(original, mc.Hou2014(clip_frames=70, components=6))
    with mc.open(clips, mc.Motion) as f:
        (found,) = marks(of_file("walk.mocz", f))
        assert found["label"] == "clip"
        assert np.diff([*found["frames"], 600]).max() <= 70
        assert {chunk.start for chunk in f.encoded.chunks} <= set(found["frames"])
    with mc.open(mc.encode(original, max_error=0.01), mc.Motion) as f:
        assert marks(of_file("walk.mocz", f)) == []
    assert marks(Shown("walk", original)) == []
