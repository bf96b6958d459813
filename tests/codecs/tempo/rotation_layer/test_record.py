"""The stored form of rules: departures from reference rules, constant angles in decimal degrees, shell distances."""

from __future__ import annotations

import zlib
from dataclasses import replace

import numpy as np
import pytest

from mocodec.codecs.tempo.models import prior
from mocodec.codecs.tempo.rotation_layer import choose, record, reference
from mocodec.codecs.tempo.rotation_layer import rules as r
from mocodec.codecs.tempo.rotation_layer.chunk_layer import _causes  # pyright: ignore[reportPrivateUsage]
from mocodec.codecs.tempo.rotation_layer.payload import Layer
from mocodec.codecs.tempo.rotation_layer.rules import Rules
from mocodec.codecs.tempo.rotation_layer.side import SideModel
from mocodec.errors import Corrupt
from mocodec.motion import Motion
from mocodec.testing import hinged_figures


def rules_of(motion: Motion) -> Rules:
    assert motion.skeleton is not None
    assert motion.rotations is not None
    own_frame = motion.source.get("format") == "amc"
    return choose.choose(record.rounded(motion.skeleton), own_frame, motion.positions, motion.rotations)


def chain(joints: int) -> Motion:
    angles = hinged_figures.curves(12, 3 * joints, 3, 0.3).reshape(12, joints, 3)
    offsets = np.random.default_rng(joints).normal(0, 0.1, (joints, 3))
    return hinged_figures.tree(tuple(range(-1, joints - 1)), offsets, angles, own_frame=True)


def require_same(found: Rules, expected: Rules) -> None:
    for a, b in zip(found.joints, expected.joints, strict=True):
        assert (a.rule, a.placed, a.branch) == (b.rule, b.placed, b.branch)
        assert a.rule != r.HUB or a.pair == b.pair
        assert np.array_equal(a.usual, b.usual)


@pytest.mark.parametrize("number", [0, 1])
def test_departures_from_a_reference_come_back(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    rules = rules_of(chain(31))
    monkeypatch.setattr(reference, "numbers", lambda joints: [number])
    packed = record.pack(rules, 0.03, b"rest")
    found, reach_m, statistics = record.unpack(packed, rules.skeleton)
    require_same(found, rules)
    assert (reach_m, statistics) == (0.03, b"rest")


def test_a_reference_of_another_skeleton_is_corrupt(monkeypatch: pytest.MonkeyPatch) -> None:
    rules = rules_of(chain(31))
    with monkeypatch.context() as only:
        only.setattr(reference, "numbers", lambda joints: [1])
        packed = record.pack(rules, 0.03, b"")
    with pytest.raises(Corrupt):
        record.unpack(packed, rules_of(chain(30)).skeleton)


@pytest.mark.parametrize("reach_m", [0.03, 0.0001, 1.5, 1 / 3, 1e-7, 1e6])
def test_distances_of_shell_points_come_back(reach_m: float) -> None:
    rules = rules_of(hinged_figures.figure(12))
    assert record.unpack(record.pack(rules, reach_m, b""), rules.skeleton)[1] == reach_m


def test_constant_angles_of_limited_joints_take_few_bytes() -> None:
    motion = hinged_figures.figure(12, own_frame=True)
    assert motion.skeleton is not None
    assert motion.skeleton.limits is not None
    assert motion.rotations is not None
    rotations = motion.rotations.copy()
    rotations[:, 2] = np.cos(np.radians(7.125) / 2), np.sin(np.radians(7.125) / 2), 0, 0
    rules = rules_of(replace(motion, rotations=rotations))
    assert rules.joints[2].rule == r.FIXED
    packed = record.pack(rules, 0.03, b"")
    skeleton = rules.skeleton
    free = replace(rules, skeleton=replace(skeleton, limits=None))
    assert len(packed) <= len(record.pack(free, 0.03, b"")) - 20
    require_same(record.unpack(packed, skeleton)[0], rules)
    np.testing.assert_allclose(rules.joints[2].usual, rotations[0, 2], rtol=0, atol=1e-8)


def test_corrections_reach_up_the_chain() -> None:
    rules = rules_of(chain(8))
    model = SideModel.of(None, prior.for_points(), rules, np.zeros((0, 0)), 60.0)
    of = Layer(rules, 0.03, model)
    broken = np.zeros((2, 8), bool)
    broken[1, 7] = True
    causes = [_causes(of, broken, levels)[:, :8] for levels in (2, 4, 8)]
    assert not any(wrong[0].any() for wrong in causes)
    counts = [int(wrong[1].sum()) for wrong in causes]
    assert counts[0] < counts[1] < counts[2] == 8


def test_reference_rules_are_frozen() -> None:
    """Released entries never change."""
    assert zlib.crc32(repr((reference.CMU_JOINTS, reference.CMU_USUAL)).encode()) == REFERENCE_CRC


REFERENCE_CRC = 0xEAA9A276
