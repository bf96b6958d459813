"""Joints of rigid bones are coded as directions of bones, with their own proportions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mocodec
from mocodec import metrics
from mocodec.codecs.tempo import Tempo
from mocodec.encoded import Encoded
from mocodec.errors import Corrupt, MocodecError
from mocodec.motion import Motion, Skeleton

from ..motions import header, named_skeleton, renamed_skeleton

ID_END = 5
"""The prior's name ends here in the shared bytes."""


def refuses_or_decodes_damage(encoded: Encoded[Motion], every: int) -> None:
    """Shared bytes cut off or changed behind the prior's name are an error, or decode to a motion of the same shape."""
    shared = encoded.shared[0]
    for at in range(ID_END, len(shared), every):
        for damaged in (shared[:at], shared[:at] + bytes([shared[at] ^ 0x55]) + shared[at + 1 :]):
            try:
                found = Tempo.decode(replace(encoded, shared=(damaged,)))
            except MocodecError:
                continue
            assert found.positions.shape == (encoded.frames, 31, 3)


@pytest.mark.parametrize("with_skeleton", [True, False])
@pytest.mark.parametrize("target", [{"max_error": 0.004}, {"mean_error": 0.002}])
def test_known_joints_are_coded_as_directions_and_meet_their_target(
    with_skeleton: bool, target: dict[str, float]
) -> None:
    motion = named_skeleton(with_skeleton=with_skeleton)
    encoded = Tempo(**target, model="transform").encode_chunks(motion)
    assert header(encoded).model == "directions-prior"
    error = metrics.distances(motion.positions, Tempo.decode(encoded).positions)
    if "max_error" in target:
        assert error.max() <= target["max_error"]
    else:
        assert 0.95 * target["mean_error"] <= error.mean() <= target["mean_error"]


@pytest.mark.parametrize("names", ["known", "unknown"])
def test_the_bound_holds_for_what_a_file_keeps_of_the_skeleton(names: str) -> None:
    motion = named_skeleton(seed=11) if names == "known" else renamed_skeleton(True, 300)
    for bound in (0.0003, 0.004):
        blob = mocodec.encode(motion, max_error=bound)
        assert metrics.distances(motion.positions, mocodec.decode(blob).positions).max() <= bound


def test_directions_take_fewer_bytes_than_points() -> None:
    motion = named_skeleton()
    points = Tempo(model="points-prior").encode_chunks(motion).payload_bytes
    assert Tempo(model="transform").encode_chunks(motion).payload_bytes < 0.9 * points


def test_a_skeleton_beside_the_motion_saves_its_proportions() -> None:
    motions = (named_skeleton(with_skeleton=w) for w in (True, False))
    with_one, without = (len(Tempo(model="transform").encode_chunks(m).shared[0]) for m in motions)
    assert with_one < 10 < without < 120


def test_points_in_another_order_and_another_axis_up() -> None:
    motion = named_skeleton(with_skeleton=False)
    order = np.random.default_rng(8).permutation(motion.points)
    turned = motion.positions[:, order][..., [2, 0, 1]]
    other = Motion(turned, motion.rate, tuple(motion.names[i] for i in order), "z")
    encoded = Tempo(max_error=0.004, model="transform").encode_chunks(other)
    assert header(encoded).model == "directions-prior"
    assert metrics.distances(turned, Tempo.decode(encoded).positions).max() <= 0.004
    assert (
        abs(encoded.payload_bytes / Tempo(max_error=0.004, model="transform").encode_chunks(motion).payload_bytes - 1)
        < 0.03
    )


def test_bones_that_stretch_are_not_coded_as_directions() -> None:
    motion = named_skeleton()
    stretched = motion.positions * (1 + 0.1 * np.sin(np.arange(len(motion)) / 20))[:, None, None]
    assert (
        header(Tempo(model="transform").encode_chunks(replace(motion, positions=stretched))).model != "directions-prior"
    )


def test_a_skeleton_of_other_proportions_is_not_used() -> None:
    motion = named_skeleton()
    assert motion.skeleton is not None
    other = Skeleton(motion.names, motion.skeleton.parents, motion.skeleton.offsets * 1.05)
    encoded = Tempo(max_error=0.004, model="transform").encode_chunks(replace(motion, skeleton=other))
    assert metrics.distances(motion.positions, Tempo.decode(encoded).positions).max() <= 0.004


def test_damaged_proportions_are_refused() -> None:
    encoded = Tempo(model="transform").encode_chunks(named_skeleton(with_skeleton=False))
    refuses_or_decodes_damage(encoded, 1)
    with_one = Tempo(model="transform").encode_chunks(named_skeleton())
    with pytest.raises(Corrupt, match="skeleton"):
        Tempo.decode(replace(with_one, about=replace(with_one.about, skeleton=None)))


@pytest.mark.parametrize("with_skeleton", [True, False])
def test_bones_are_found_among_points_that_no_prior_knows(with_skeleton: bool) -> None:
    motion = renamed_skeleton(with_skeleton)
    encoded = Tempo(max_error=0.004, model="transform").encode_chunks(motion)
    assert header(encoded).model == "directions-stored"
    assert metrics.distances(motion.positions, Tempo.decode(encoded).positions).max() <= 0.004
    part = Tempo.decode(encoded, slice(250, 260))
    assert part.positions == pytest.approx(Tempo.decode(encoded).positions[250:260], abs=1e-9)


def test_points_that_are_not_a_body_are_not_coded_as_directions() -> None:
    rng = np.random.default_rng(2)
    free = Motion(np.cumsum(rng.normal(0, 0.002, (300, 12, 3)), axis=0), 100.0)
    model = header(Tempo(model="transform").encode_chunks(free)).model
    assert model is None or model.startswith("points")


def test_damaged_trees_are_refused() -> None:
    encoded = Tempo(max_error=0.004, model="transform").encode_chunks(renamed_skeleton(False))
    assert header(encoded).model == "directions-stored"
    refuses_or_decodes_damage(encoded, 29)
