"""Markers of any names are placed on the prior's bones."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from mocodec.codecs.tempo import Tempo, target
from mocodec.codecs.tempo.models import marker_fitting, markers_on_bones, predicted_motion, prior
from mocodec.codecs.tempo.models.markers_on_bones import MarkerPlacement, MarkersOnBones
from mocodec.codecs.tempo.pose import heading
from mocodec.errors import Corrupt
from mocodec.motion import Motion
from mocodec.testing import synthetic

from ..motions import error, header

KNOWN = prior.for_points()
BONES = KNOWN.bones
assert BONES is not None


def placed(motion: Motion, mean_error: float = 0.01) -> MarkersOnBones:
    positions = heading.to_y_up(motion.positions, motion.up)
    found = marker_fitting.fit([positions], KNOWN, motion.names, motion.rate, target.step_for_bound(mean_error))
    assert found is not None
    return found


def test_a_short_clip_of_unknown_markers_is_placed_on_bones() -> None:
    motion = synthetic.markers(frames=240, seed=5)
    encoded = Tempo(mean_error=0.008).encode_chunks(motion)
    assert header(encoded).model == "points-prior"
    without = Tempo(mean_error=0.008, model="points-stored").encode_chunks(motion)
    assert encoded.payload_bytes < 0.9 * without.payload_bytes
    assert 0.95 * 0.008 <= np.nanmean(error(motion, Tempo.decode(encoded))) <= 0.008


def test_left_and_right_feet_are_distinguished_by_how_they_move() -> None:
    motion = synthetic.markers(frames=360, seed=7)
    bones = placed(motion).placement.bone
    of_point = {name: BONES.names[b] for name, b in zip(motion.names, bones, strict=True)}
    left, right = of_point["LTOE"][0], of_point["RTOE"][0]
    assert {left, right} == {"l", "r"}
    assert of_point["LHEE"][0] == of_point["LSHN"][0] == left
    assert of_point["RHEE"][0] == of_point["RSHN"][0] == right


@pytest.mark.parametrize("points", [4, 5, 41])
def test_bases_are_orthonormal_and_placements_come_back_from_their_bytes(points: int) -> None:
    motion = synthetic.markers(frames=120, seed=6)
    motion = motion.select(list(motion.names[:points]))
    found = placed(motion)
    for basis in found.predicted.bases:
        assert basis.shape == (3 * points - 3, 3 * points)
        assert np.abs(basis @ basis.T - np.eye(len(basis))).max() < 1e-9
        assert np.abs(basis.reshape(len(basis), -1, 3).mean(axis=1)).max() < 1e-9
    data = found.placement.pack()
    again = MarkerPlacement.unpack(data, points, BONES)
    for field in fields(MarkerPlacement):
        assert np.array_equal(getattr(again, field.name), getattr(found.placement, field.name))
    ours, theirs = (
        predicted_motion.spreads(p, BONES.median_spread, again.levels)
        for p in (found.predicted, markers_on_bones.predict(again, BONES))
    )
    assert (ours == theirs).all()
    for damaged in (*(data[:size] for size in range(len(data))), data + b"more"):
        with pytest.raises(Corrupt):
            MarkerPlacement.unpack(damaged, points, BONES)


def test_points_that_are_not_a_body_are_not_placed() -> None:
    motion = synthetic.markers(frames=60, seed=6)
    for positions in (motion.positions * 1e5, motion.positions * 1e-3, motion.positions[:, :3], motion.positions[:0]):
        assert marker_fitting.fit([positions], KNOWN, motion.names[: positions.shape[1]], 120.0, 0) is None
