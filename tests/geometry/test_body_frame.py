"""The body frame: round trip, the paper's axes, and the choice of markers with and without labels."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.geometry import body_frame
from mocodec.testing import synthetic


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_to_world_inverts_to_body(up: str) -> None:
    positions = np.random.default_rng(1).normal(size=(20, 7, 3))
    frame = body_frame.from_markers(positions[:, :3], up)
    assert body_frame.to_world(body_frame.to_body(positions, frame), frame) == pytest.approx(positions)


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_heading_and_translation_are_removed(up: str) -> None:
    pose = np.random.default_rng(2).normal(size=(6, 3))
    vertical = "xyz".index(up)
    a, b = (vertical + 1) % 3, (vertical + 2) % 3
    poses = []
    for turn in np.linspace(0, 6, 9):
        moved = pose.copy()
        moved[:, a] = np.cos(turn) * pose[:, a] - np.sin(turn) * pose[:, b] + turn
        moved[:, b] = np.sin(turn) * pose[:, a] + np.cos(turn) * pose[:, b] - turn
        poses.append(moved + np.eye(3)[vertical] * turn)
    world = np.array(poses)
    body = body_frame.to_body(world, body_frame.from_markers(world[:, :3], up))
    assert np.ptp(body, axis=0).max() < 1e-12


def test_axes_follow_the_paper() -> None:
    """Section 3.1: C7 is the origin, x from the left shoulder to the right on the ground, z as it was, y = z × x."""
    markers = np.array([[[1.0, 1.0, 1.5], [1.0, 1.2, 1.4], [1.0, 0.8, 1.6]]])
    points = np.array([[[1.0, 0.0, 0.0], [2.0, 1.0, 1.5]]])
    body = body_frame.to_body(points, body_frame.from_markers(markers, "z"))
    assert body[0] == pytest.approx(np.array([[1.0, 0.0, -1.5], [0.0, 1.0, 0.0]]))


def test_vertical_shoulders_use_the_heading_of_the_world() -> None:
    markers = np.array([[[0.0, 0, 0], [1, 1, 0], [1, 1, 2]]])
    assert body_frame.from_markers(markers, "z").heading.tolist() == [[1, 0]]


@pytest.mark.parametrize(
    ("label", "expected"),
    [
        ("LSHO", ("L", "SHO")), ("Male:RSHO", ("R", "SHO")), ("LeftToeBase", ("L", "TOEBASE")),
        ("heel_r", ("R", "HEEL")), ("C7", ("", "C7")),
        ("right_shoulder", ("R", "SHOULDER")), ("subject 1:L.Heel", ("L", "HEEL")),
    ],
)  # fmt: skip
def test_side_and_part_of_labels(label: str, expected: tuple[str, str]) -> None:
    assert body_frame.side_and_part(label) == expected


def test_normalisation_markers_by_label_by_geometry_or_none() -> None:
    motion = synthetic.markers(100, seed=1)
    found = body_frame.normalisation_markers(motion.names, motion.positions, "z")
    assert found is not None
    assert [motion.names[i] for i in found] == ["C7", "LSHO", "RSHO"]
    for points in (3, 5, 41):
        blind = body_frame.normalisation_markers(["?"] * points, motion.positions[:, :points], "z")
        assert blind is not None
        assert len(set(blind)) == 3
    assert body_frame.normalisation_markers(["a", "b"], motion.positions[:, :2], "z") is None


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["LASI", "RASI", "SACR", "LKNE", "RKNE"], ["SACR", "LASI", "RASI"]),
        (["R.ASIS", "L.ASIS", "V.Sacral", "R.Knee", "L.Knee"], ["V.Sacral", "L.ASIS", "R.ASIS"]),
        (["PSISr", "PSISl", "HIPS", "L", "R"], ["HIPS", "PSISl", "PSISr"]),
    ],
)
def test_pelvis_markers_replace_missing_shoulders(names: list[str], expected: list[str]) -> None:
    found = body_frame.normalisation_markers(names, np.random.default_rng(4).normal(size=(30, 5, 3)), "z")
    assert found is not None
    assert [names[i] for i in found] == expected


def test_shoulders_without_a_neck_use_the_most_rigid_point() -> None:
    motion = synthetic.markers(100, seed=1).select(["LKNE", "LSHO", "RWRA", "RSHO", "LHEE", "LFHD"])
    found = body_frame.normalisation_markers(motion.names, motion.positions, "z")
    assert found is not None
    assert [motion.names[i] for i in found] == ["LFHD", "LSHO", "RSHO"]


def test_points_that_are_always_missing_are_chosen_last() -> None:
    positions = np.random.default_rng(4).normal(size=(30, 6, 3))
    positions[:, 2:5] = np.nan
    chosen = body_frame.normalisation_markers(list("abcdef"), positions, "z")
    assert chosen is not None
    assert {0, 1, 5} == set(chosen)
