"""Frozen samples: found from the numbers, kept out of the transform, and exact again after decoding."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mocodec as mc
from mocodec import metrics
from mocodec.entropy import varint
from mocodec.errors import Corrupt
from mocodec.motion import Motion
from mocodec.stages import frozen, gaps
from mocodec.testing import corruption, edge_cases, synthetic

WALK = synthetic.markers(frames=400, seed=5)
CLAMP = (3.2767, -3.2768, 3.2767)


def holes(seed: int = 3, share: float = 0.2) -> np.ndarray:
    """(frames, points): where markers of the walk are lost, in runs of 1 to some hundred frames."""
    random = np.random.default_rng(seed)
    lost = np.zeros(WALK.positions.shape[:2], bool)
    while lost.mean() < share:
        start, point = random.integers(1, len(WALK)), random.integers(WALK.points)
        lost[start : start + int(random.lognormal(3, 1)) + 1, point] = True
    return lost


def parked(lost: np.ndarray, where: str) -> Motion:
    positions = WALK.positions.copy()
    for frame in range(len(positions)):
        at = {"gap": np.nan, "origin": 0.0, "clamp": np.array(CLAMP), "last": positions[frame - 1, lost[frame]]}
        positions[frame, lost[frame]] = at[where]
    return replace(WALK, positions=positions)


def test_motion_without_frozen_samples_is_packed_as_before():
    positions = edge_cases.motion("gaps").positions
    apart = frozen.split(positions)
    assert not apart.frozen.any()
    assert apart.pack() == gaps.pack(np.isnan(positions[..., 0]))
    assert np.array_equal(apart.moving, positions, equal_nan=True)


@pytest.mark.parametrize("name", [n for n in edge_cases.MOTIONS if n != "parked"])
def test_nothing_is_frozen_in(name: str):
    assert not frozen.split(edge_cases.motion(name).positions).frozen.any()


@pytest.mark.parametrize("where", ["origin", "clamp", "last"])
def test_lost_markers_are_found(where: str):
    lost = holes()
    apart = frozen.split(parked(lost, where).positions)
    assert (apart.frozen & lost).sum() >= (0.97 if where != "last" else 0.8) * lost.sum()
    assert not (apart.frozen & ~lost).any()


@pytest.mark.parametrize(("where", "run_bytes"), [("origin", 0), ("clamp", 0), ("last", 12)])
@pytest.mark.parametrize(
    ("codec", "target"),
    [
        ("tempo", {"max_error": 0.001}),
        ("tempo", {"mean_error": 0.001}),
        ("hou2014", {"max_error": 0.001}),
        ("liu2006", {"max_error": 0.01}),
        ("lossless", {}),
    ],
)
def test_parked_markers_cost_no_more_than_gaps(codec: str, target: dict[str, float], where: str, run_bytes: int):
    lost = holes()
    runs = np.diff(lost.astype(int), axis=0, prepend=0).clip(0).sum()
    as_gaps = mc.encode(parked(lost, "gap"), codec=codec, **target)
    motion = parked(lost, where)
    blob = mc.encode(motion, codec=codec, **target)
    assert len(blob) <= 1.02 * len(as_gaps) + 100 + run_bytes * runs
    decoded = mc.decode(blob, Motion)
    errors = metrics.distances(motion.positions, decoded.positions)
    assert np.array_equal(decoded.gaps, motion.gaps)
    assert errors.max() <= target.get("max_error", np.inf)
    assert errors.mean() <= target.get("mean_error", np.inf)
    if where != "last":
        assert errors[lost].max() <= 1e-12


def test_a_slow_camera_in_a_fast_file_freezes_nothing():
    assert not frozen.split(WALK.positions[np.arange(400) // 8 * 8]).frozen.any()


def test_feet_that_stand_on_a_coarse_grid_are_motion():
    positions = np.rint(WALK.positions * 500) / 500
    positions[100:200, 35] = positions[100, 35]
    positions[200:, 35] = positions[200:, 35] - positions[200, 35] + positions[100, 35] + 0.002
    assert not frozen.split(positions).frozen.any()


def test_a_joint_that_never_moves_is_motion_and_a_marker_that_never_moves_is_not():
    positions = WALK.positions.copy()
    positions[:, 4] = 0.0
    assert frozen.split(positions).constant[:, 4].all()
    assert not frozen.split(positions, bones=True).frozen.any()


def test_a_constant_is_exact_and_a_position_rounded_within_the_tolerance():
    motion = edge_cases.motion("parked")
    for holds in (False, True):
        apart = frozen.split(motion.positions, tolerance=1e-3, holds=holds)
        filled, _ = gaps.fill(apart.moving)
        for part in (slice(None), slice(80, 120)):
            there = frozen.restore(filled[part], apart[part].pack())
            error = metrics.distances(motion.positions[part], there)
            assert error[apart.constant[part]].max() == 0
            assert error.max() <= 1e-3


@settings(deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(2, 60), st.integers(1, 8), st.sampled_from([0.0, 0.1, 0.5, 0.9]))
def test_any_positions_come_back_exactly(seed: int, frames: int, points: int, share: float):
    random = np.random.default_rng(seed)
    positions = random.normal(size=(frames, points, 3)) * 10.0 ** random.integers(-6, 7)
    for frame in range(1, frames):
        again = random.random(points) < share
        positions[frame, again] = positions[frame - 1, again]
    positions[random.random((frames, points)) < share / 3] = 0.0
    positions[random.random((frames, points)) < share / 3] = np.nan
    apart = frozen.split(positions, tolerance=0.0, bones=bool(seed % 2), holds=bool(seed % 3))
    filled, mask = gaps.fill(apart.moving)
    assert np.array_equal(mask, apart.apart)
    for part in (slice(None), slice(frames // 3, None), slice(frames // 2, frames // 2 + 1)):
        assert np.array_equal(frozen.restore(filled[part], apart[part].pack()), positions[part], equal_nan=True)
        assert np.array_equal(frozen.apart(apart[part].pack(), filled[part].shape[:2]), apart[part].apart)


def test_damaged_runs_are_corrupt_or_positions():
    motion = edge_cases.motion("parked")
    data = frozen.split(motion.positions).pack()
    for broken in [*corruption.prefixes(data), *(b for _, b in corruption.flips(data)), *corruption.damaged(data, 500)]:
        with contextlib.suppress(Corrupt):
            assert frozen.restore(motion.positions, broken).shape == motion.positions.shape
    for head in ([0, 0, 0, 0], [0, 0, 1 << 60, 0], [0, 1 << 60, 1, 0], [0, 0, 1, 1 << 60], [0, 0, 1, 0]):
        with contextlib.suppress(Corrupt):
            frozen.restore(motion.positions, varint.write(head))


def test_a_motion_that_repeats_is_not_frozen() -> None:
    """Loops come back to the same exact positions, at speed and from the same places: nothing is parked there."""
    rng = np.random.default_rng(4)
    once = rng.normal(size=(90, 5, 3)).cumsum(axis=0) * rng.uniform(0.001, 0.05, (90, 1, 1))
    once[40:42, 1] = once[40, 1]  # a frame that repeats another, so that the search begins
    for loop in (np.tile(once, (8, 1, 1)), np.tile(np.concatenate([once, once[::-1]]), (6, 1, 1))):
        assert not frozen.split(loop).frozen.any()
