"""liu2006: the contract of every codec, targets, settings, the blend at transitions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocodec import metrics, native
from mocodec.codecs.liu2006 import Liu2006, decoding, marker_groups, segment_model
from mocodec.errors import BadInput, CannotEncode
from mocodec.motion import Motion
from mocodec.testing import CodecTests, synthetic

SHORT_SEGMENTS: dict[str, Any] = {"initial_frames": 40, "ahead_frames": 30, "rise": 20, "variance_kept": 0.9}


def two_motions(frames: int = 240) -> Motion:
    """A walk whose second half is another walk with added swing, so the segmentation finds a cut."""
    first, second = synthetic.markers(frames, seed=2), synthetic.markers(frames, seed=9)
    half = frames // 2
    offset = first.positions[half] - second.positions[half]
    later = second.positions[half:] + offset[20]
    later[:, ::2, 1] += 0.2 * np.sin(np.arange(len(later)) / 5)[:, None]
    return replace(first, positions=np.concatenate([first.positions[:half], later]))


class TestLiu2006(CodecTests):
    """With settings that cut short motions, so that chunks need their neighbours."""

    codec = staticmethod(lambda **settings: Liu2006(**SHORT_SEGMENTS, **settings))
    can_bound = True

    def figure(self) -> Motion:
        return two_motions()


def test_contract_motion_has_at_least_two_segments() -> None:
    test = TestLiu2006()
    assert len(test.codec().encode(test.figure()).chunks) >= 2


# ── targets and settings ─────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("mean_error", [0.02, 0.003, 0.0005])
def test_mean_error_is_at_most_and_near_the_target(mean_error: float) -> None:
    motion = synthetic.markers(300, seed=5)
    encoded = Liu2006(mean_error=mean_error).encode(motion)
    measured = metrics.mean_distance(motion.positions, Liu2006.decode(encoded).positions)
    assert 0.9 * mean_error < measured <= mean_error


def test_ratio_is_at_least_and_near_the_target() -> None:
    motion = synthetic.markers(300, seed=5)
    for ratio in (20, 60):
        encoded = Liu2006(ratio=ratio).encode(motion)
        assert ratio <= motion.raw_bytes / encoded.payload_bytes < 1.1 * ratio


def test_unreachable_ratio_raises_cannot_encode() -> None:
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
def test_invalid_settings_raise_bad_input(settings: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        Liu2006(**settings)


# ── blend ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_blend_halves_the_jump_of_the_error_at_cuts() -> None:
    motion = two_motions()
    largest_jumps: list[float] = []
    for blend_frames in (0, 10, 20):
        settings = Liu2006(**SHORT_SEGMENTS, blend_frames=blend_frames)
        encoded = settings.encode(motion)
        error = settings.decode(encoded).positions - motion.positions
        cuts = [chunk.start for chunk in encoded.chunks[1:]]
        largest_jumps.append(max(float(np.linalg.norm(error[cut] - error[cut - 1])) for cut in cuts))
    assert largest_jumps[0] > 2 * max(largest_jumps[1:])


def test_blend_weights_are_the_shares_of_frames_in_the_window() -> None:
    """Two models of constant poses, 0 and 1: around the cut the blend rises in steps of 1 / (h + 1)."""
    h, cut = 4, 50
    settings = Liu2006(initial_frames=40, ahead_frames=30, blend_frames=h, fineness=1e-6)
    positions = np.zeros((100, 5, 3))
    positions[:, :3] = np.eye(3)
    positions[cut:, 3:] = 1.0
    markers = marker_groups.MarkerGroups(np.arange(3), np.zeros(0, np.int64), np.arange(3, 5))
    fitted = settings.fit_segments(positions, markers, [slice(0, cut), slice(cut, 100)], "z", 1.0)
    models = [with_constant_pose(model, pose) for model, pose in zip(fitted, (0.0, 1.0), strict=True)]
    poses = [decoding.blended_poses(models, i, 0, model.start, model.stop, h)[:, 0] for i, model in enumerate(models)]
    assert np.concatenate(poses)[cut - 4 : cut + 4] == pytest.approx([0, 0, 0.2, 0.4, 0.6, 0.8, 1, 1])


def with_constant_pose(segment: segment_model.SegmentModel, coordinate: float) -> segment_model.SegmentModel:
    (group,) = segment.groups
    constant = replace(group, mean=np.full_like(group.mean, coordinate), basis=group.basis * 0)
    return replace(segment, groups=(constant,))


@pytest.mark.skipif(not native.available(), reason="the compiled module is not built")
@pytest.mark.parametrize("mean_error", [None, 0.0001])
def test_the_compiled_module_decodes_the_same_positions(mean_error: float | None) -> None:
    """With few key frames and with many, whose poses are computed in different orders."""
    encoded = Liu2006(**SHORT_SEGMENTS, mean_error=mean_error).encode(two_motions())
    assert len(encoded.chunks) > 1
    start = encoded.chunks[1].start
    for frames in (None, slice(start - 5, start + 9), slice(start, start + 1)):
        compiled = Liu2006.decode(encoded, frames).positions
        with native.without():
            by_numpy = Liu2006.decode(encoded, frames).positions
        np.testing.assert_allclose(compiled, by_numpy, rtol=0, atol=1e-12)
