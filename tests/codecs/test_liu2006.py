"""Liu & McMillan 2006: the contract of every codec, the roles of points, targets, and the paper's own sequence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocodec import metrics
from mocodec.codecs.liu2006 import Liu2006, codec, global_pca, models, piecewise_pca, rivals, roles, statistics
from mocodec.errors import BadInput, CannotEncode, Corrupt
from mocodec.motion import Motion
from mocodec.testing import CodecTests, synthetic

SEQUENCE_2 = Path(__file__).parents[2] / "../shared/data/cmu/c3d/85_12.c3d"


def two_motions(frames: int = 240) -> Motion:
    """A walk, and from its middle on another's: something to cut."""
    first, second = synthetic.markers(frames, seed=2), synthetic.markers(frames, seed=9)
    half = frames // 2
    jump = first.positions[half] - second.positions[half]
    later = second.positions[half:] + jump[20]
    later[:, ::2, 1] += 0.2 * np.sin(np.arange(len(later)) / 5)[:, None]
    return replace(first, positions=np.concatenate([first.positions[:half], later]))


class TestLiu2006(CodecTests):
    """With a search that cuts short motions, so that chunks need their neighbours."""

    codec = staticmethod(
        lambda **settings: Liu2006(initial_frames=40, ahead_frames=30, rise=20, variance_kept=0.9, **settings)
    )
    can_bound = True

    def figure(self) -> Motion:
        return two_motions()


def test_the_contract_is_tested_on_more_than_one_segment() -> None:
    test = TestLiu2006()
    assert len(test.codec().encode(test.figure()).chunks) >= 2


# ── what is asked for ─────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("mean_error", [0.02, 0.003, 0.0005])
def test_a_mean_error_is_kept_and_nearly_used(mean_error: float) -> None:
    motion = synthetic.markers(300, seed=5)
    encoded = Liu2006(mean_error=mean_error).encode(motion)
    reached = metrics.mean_distance(motion.positions, Liu2006.decode(encoded).positions)
    assert 0.9 * mean_error < reached <= mean_error


def test_a_ratio_is_reached() -> None:
    motion = synthetic.markers(300, seed=5)
    for ratio in (20, 60):
        encoded = Liu2006(ratio=ratio).encode(motion)
        assert ratio <= motion.raw_bytes / encoded.payload_bytes < 1.1 * ratio


def test_a_ratio_beyond_reach_is_refused() -> None:
    with pytest.raises(CannotEncode, match="ratio"):
        Liu2006(ratio=1e6).encode(synthetic.markers(60, seed=5))


@pytest.mark.parametrize(
    "settings",
    [
        {"max_error": 0.0},
        {"mean_error": -1.0},
        {"mean_error": 0.01, "ratio": 20.0},
        {"blend_frames": 1000},
        {"rise": np.nan},
    ],
)
def test_settings_that_make_no_sense_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        Liu2006(**settings)


# ── roles ─────────────────────────────────────────────────────────────────────────────────────────────────────────────


def named(names: list[str]) -> Motion:
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
def test_roles_by_the_usual_labels(names: list[str], normalisation: list[str], feet: list[str]) -> None:
    motion = named(names)
    found = roles.of(motion, (), ())
    assert names_of(motion, found.normalisation) == normalisation
    assert names_of(motion, found.feet) == feet
    assert found.points == len(names)


def test_roles_by_name_and_a_name_that_is_not_there() -> None:
    motion = synthetic.markers(30, seed=1)
    chosen = Liu2006(normalisation_markers=("T10", "lsho", "RSHO"), foot_markers=("LANK",))
    played = codec.read_shared(chosen.encode(motion))[1]
    assert names_of(motion, played.normalisation) == ["T10", "LSHO", "RSHO"]
    assert names_of(motion, played.feet) == ["LANK"]
    for wrong in ({"normalisation_markers": ("C7", "LSHO", "NOSE")}, {"foot_markers": ("NOSE",)}):
        with pytest.raises(CannotEncode, match="NOSE"):
            Liu2006(**wrong).encode(motion)
    with pytest.raises(CannotEncode, match="three"):
        Liu2006(normalisation_markers=("C7", "LSHO")).encode(motion)


def test_unknown_labels_give_three_rigid_points() -> None:
    motion = synthetic.markers(200, seed=1)
    blind = replace(motion, names=tuple(f"P{i}" for i in range(motion.points)))
    a, b, c = roles.of(blind, (), ()).normalisation
    apart = np.linalg.norm(motion.positions[:, [a, b, c]] - motion.positions[:, [b, c, a]], axis=-1)
    assert (apart.std(axis=0) < 0.05).all()
    assert apart.min(axis=0).max() > 0.1


def test_a_normalisation_marker_that_is_mostly_missing_is_not_chosen() -> None:
    motion = synthetic.markers(100, seed=1)
    positions = motion.positions.copy()
    positions[10:, motion.names.index("C7")] = np.nan
    gone = replace(motion, positions=positions)
    assert "C7" not in names_of(gone, roles.of(gone, (), ()).normalisation)
    decoded = Liu2006(max_error=0.005).decode(Liu2006(max_error=0.005).encode(gone))
    assert np.array_equal(decoded.gaps, gone.gaps)


def test_roles_that_contradict_themselves_are_corrupt() -> None:
    for data in (b"\3\0\1\1\0", b"\3\0\1\7\0", b"\2\0\1\0", b"\3\0\1", b"\3\0\1\2\1\2"):
        with pytest.raises(Corrupt):
            roles.unpack(data, 5)


# ── the method ────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_the_fewest_components_within_the_tolerance() -> None:
    variances = np.array([16.0, 9.0, 4.0, 1.0])
    assert models.components_needed(variances, 10.0, 1) == 0
    assert models.components_needed(variances, 2.5, 1) == 2
    assert models.components_needed(variances, 2.5 / 2**0.5, 2) == 2
    assert models.components_needed(variances, 1e-9, 1) == 4


def test_the_blend_closes_the_gap_at_the_cuts() -> None:
    motion = two_motions()
    jumps: list[float] = []
    for h in (0, 10, 20):
        chosen = Liu2006(initial_frames=40, ahead_frames=30, rise=20, variance_kept=0.9, blend_frames=h)
        encoded = chosen.encode(motion)
        error = chosen.decode(encoded).positions - motion.positions
        cuts = [chunk.start for chunk in encoded.chunks[1:]]
        jumps.append(max(float(np.linalg.norm(error[cut] - error[cut - 1])) for cut in cuts))
    assert jumps[0] > 2 * max(jumps[1:])


def test_weights_of_the_blend_are_the_frames_of_each_segment() -> None:
    """Two models of constant poses: around the cut the blend walks from one to the other in steps of 1 / (h + 1)."""
    h, cut = 4, 50
    chosen = Liu2006(initial_frames=40, ahead_frames=30, blend_frames=h, fineness=1e-6)
    positions = np.zeros((100, 5, 3))
    positions[:, :3] = np.eye(3)
    positions[cut:, 3:] = 1.0
    played = roles.Roles(np.arange(3), np.zeros(0, np.int64), np.arange(3, 5))
    segments = [
        replace(s, groups=tuple(constant(s, value) for _ in s.groups))
        for s, value in zip(
            chosen.fit(positions, played, [slice(0, cut), slice(cut, 100)], "z", 1.0), (0.0, 1.0), strict=True
        )
    ]
    poses = [codec.blended(segments, i, 0, s.start, s.stop, h)[:, 0] for i, s in enumerate(segments)]
    assert np.concatenate(poses)[cut - 4 : cut + 4] == pytest.approx([0, 0, 0.2, 0.4, 0.6, 0.8, 1, 1])


def constant(segment: models.Segment, value: float) -> models.PoseModel:
    model = segment.groups[0]
    return replace(model, mean=np.full_like(model.mean, value), basis=model.basis * 0)


def test_statistics_count_what_is_stored() -> None:
    motion = synthetic.markers(300, seed=5)
    encoded = Liu2006().encode(motion)
    counted = statistics(encoded)
    assert counted.segments == len(encoded.chunks)
    assert sum(counted.bytes_by_part.values()) == encoded.payload_bytes
    assert counted.scalar_ratio == motion.positions.size / counted.scalars
    (feet, others), frames = counted.components[0], 9 * counted.normalisation_control_points
    assert frames + 18 * (1 + feet) + 96 * (1 + others) < counted.scalars


def test_rivals_keep_their_tolerance() -> None:
    motion = synthetic.markers(300, seed=5)
    played = roles.of(motion, (), ())
    for tolerance in (0.02, 0.005):
        whole = global_pca(motion, played, tolerance)
        pieces = piecewise_pca(motion, played, [slice(0, 150), slice(150, 300)], tolerance)
        assert len(whole.components) == 1
        assert len(pieces.components) == 2
        assert max(pieces.components) <= whole.components[0]
        assert 0 < pieces.d_world < pieces.d_normalised


@pytest.mark.skipif(
    not SEQUENCE_2.exists(), reason="the paper's sequence 2 is not here (../shared/data/cmu/c3d/85_12.c3d)"
)
def test_the_papers_second_sequence() -> None:
    """Tables 2 and 3: 9 segments, 10.9 components, ratio 18.4 at d = 7.1 %; rivals 3.7 and 5.0."""
    import mocodec

    motion = mocodec.read(SEQUENCE_2)
    encoded = Liu2006().encode(motion)
    decoded = Liu2006.decode(encoded)
    played = codec.read_shared(encoded)[1]
    counted = statistics(encoded)
    assert abs(counted.segments - 9) <= 1
    assert abs(counted.average_components - 10.9) <= 1
    assert counted.scalar_ratio >= 18.4
    assert rivals.d_normalised(motion, decoded.positions, played) <= 7.1
    assert motion.raw_bytes / encoded.payload_bytes >= 40
    cuts = [slice(chunk.start, chunk.stop) for chunk in encoded.chunks]
    assert global_pca(motion, played).scalar_ratio == pytest.approx(3.7, abs=0.1)
    assert piecewise_pca(motion, played, cuts).scalar_ratio == pytest.approx(5.0, abs=0.15)
