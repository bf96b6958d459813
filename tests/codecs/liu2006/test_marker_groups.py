"""Division of points into normalisation markers, feet and others: by label, by given name, by geometry."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocodec.codecs.liu2006 import Liu2006, decoding, marker_groups
from mocodec.errors import CannotEncode, Corrupt
from mocodec.motion import Motion
from mocodec.testing import synthetic


def motion_with_names(names: list[str]) -> Motion:
    return Motion(np.random.default_rng(1).normal(size=(5, len(names), 3)), 100, tuple(names))


def names_of(motion: Motion, columns: np.ndarray) -> list[str]:
    return [motion.names[c] for c in columns]


@pytest.mark.parametrize(
    ("names", "normalisation", "feet"),
    [
        (["LSHO", "RSHO", "C7", "LHEE", "RTOE", "LKNE"], ["C7", "LSHO", "RSHO"], ["LHEE", "RTOE"]),
        (["Male:RSHO", "Male:LSHO", "Male:C7", "Male:LMT5"], ["Male:C7", "Male:LSHO", "Male:RSHO"], ["Male:LMT5"]),
        (["cv7", "L_ACR", "R_ACR", "L.Heel", "R_Knee"], ["cv7", "L_ACR", "R_ACR"], ["L.Heel"]),
        (["Hips", "Neck", "LeftArm", "RightArm", "LeftToeBase"], ["Neck", "LeftArm", "RightArm"], ["LeftToeBase"]),
        (["root", "lowerneck", "lhumerus", "rhumerus", "ltoes"], ["lowerneck", "lhumerus", "rhumerus"], ["ltoes"]),
        (["pelvis", "neck", "left_shoulder", "right_shoulder", "left_foot"],
         ["neck", "left_shoulder", "right_shoulder"], ["left_foot"]),
    ],
)  # fmt: skip
def test_common_labels_are_recognised(names: list[str], normalisation: list[str], feet: list[str]) -> None:
    motion = motion_with_names(names)
    markers = marker_groups.assign(motion, (), ())
    assert names_of(motion, markers.normalisation) == normalisation
    assert names_of(motion, markers.feet) == feet
    assert markers.points == len(names)


def test_given_names_are_used() -> None:
    motion = synthetic.markers(30, seed=1)
    settings = Liu2006(normalisation_markers=("T10", "lsho", "RSHO"), foot_markers=("LANK",))
    markers = decoding.read_shared(settings.encode(motion))[1]
    assert names_of(motion, markers.normalisation) == ["T10", "LSHO", "RSHO"]
    assert names_of(motion, markers.feet) == ["LANK"]


@pytest.mark.parametrize("settings", [{"normalisation_markers": ("C7", "LSHO", "NOSE")}, {"foot_markers": ("NOSE",)}])
def test_unknown_given_name_raises_cannot_encode(settings: dict[str, Any]) -> None:
    with pytest.raises(CannotEncode, match="NOSE"):
        Liu2006(**settings).encode(synthetic.markers(30, seed=1))


def test_two_normalisation_markers_raise_cannot_encode() -> None:
    with pytest.raises(CannotEncode, match="three"):
        Liu2006(normalisation_markers=("C7", "LSHO")).encode(synthetic.markers(30, seed=1))


def test_unknown_labels_give_three_rigid_points() -> None:
    motion = synthetic.markers(200, seed=1)
    unlabelled = replace(motion, names=tuple(f"P{i}" for i in range(motion.points)))
    a, b, c = marker_groups.assign(unlabelled, (), ()).normalisation
    distances = np.linalg.norm(motion.positions[:, [a, b, c]] - motion.positions[:, [b, c, a]], axis=-1)
    assert (distances.std(axis=0) < 0.05).all()
    assert distances.min(axis=0).max() > 0.1


def test_marker_with_mostly_gaps_is_not_a_normalisation_marker() -> None:
    motion = synthetic.markers(100, seed=1)
    positions = motion.positions.copy()
    positions[10:, motion.names.index("C7")] = np.nan
    motion = replace(motion, positions=positions)
    assert "C7" not in names_of(motion, marker_groups.assign(motion, (), ()).normalisation)
    decoded = Liu2006(max_error=0.005).decode(Liu2006(max_error=0.005).encode(motion))
    assert np.array_equal(decoded.gaps, motion.gaps)


def test_contradictory_groups_raise_corrupt() -> None:
    for data in (b"\3\0\1\1\0", b"\3\0\1\7\0", b"\2\0\1\0", b"\3\0\1", b"\3\0\1\2\1\2"):
        with pytest.raises(Corrupt):
            marker_groups.unpack(data, 5)
