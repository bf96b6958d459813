"""Cuts along time: equal lengths, and where PPCA sees the distribution of poses change."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocodec import native
from mocodec.stages import segment


@given(st.integers(0, 500), st.integers(1, 200))
def test_equal_lengths_cover_all_frames(frames: int, length: int) -> None:
    covered = [f for clip in segment.equal_length(frames, length) for f in range(clip.start, clip.stop)]
    assert covered == list(range(frames))


def gaits(*kinds: int, frames: int = 400, dimensions: int = 30) -> np.ndarray:
    """Periodic poses with a little noise; each kind moves in a plane of its own, and one follows the other."""
    random = np.random.default_rng(3)
    planes = random.normal(size=(max(kinds) + 1, 4, dimensions)) / dimensions**0.5
    t = np.arange(frames)[:, None] / 20
    waves = 0.3 * np.concatenate([np.sin(t), np.cos(t), np.sin(2 * t), np.cos(2 * t)], axis=1)
    poses = np.concatenate([waves @ planes[kind] for kind in kinds])
    return poses + 1e-3 * random.normal(size=poses.shape)


def test_a_change_of_motion_is_cut_where_it_happens() -> None:
    found = segment.ppca(gaits(0, 1, 2))
    assert len(found.segments) == 3
    assert [cut.stop for cut in found.segments] == pytest.approx([400, 800, 1200], abs=30)
    assert [curve.cut for curve in found.curves] == [found.segments[0].stop, found.segments[1].stop, None]


def test_one_motion_is_one_segment() -> None:
    assert segment.ppca(gaits(0, 0, 0)).segments == [slice(0, 1200)]


@pytest.mark.parametrize("frames", [1, 349, 350, 361])
def test_segments_cover_all_frames(frames: int) -> None:
    found = segment.ppca(gaits(0, 1)[:frames])
    assert found.segments[0].start == 0
    assert found.segments[-1].stop == frames


@pytest.mark.parametrize("poses", [np.zeros((600, 40)), np.ones((600, 1)), 1e-6 * gaits(0, 1), np.zeros((600, 0))])
def test_poses_without_movement_are_not_cut(poses: np.ndarray) -> None:
    assert segment.ppca(poses).segments == [slice(0, len(poses))]


@pytest.mark.parametrize(
    "poses", [gaits(0, 1, 2, dimensions=60), np.pad(gaits(0, 1, 2, dimensions=60), ((300, 0), (0, 0)))]
)
def test_tracked_directions_give_the_distances_of_the_exact_model(
    poses: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also after frames without movement, where models have no directions; a new plane may need a step to be found."""
    followed = segment.ppca(poses)
    monkeypatch.setattr(segment, "LEADING", 60)
    exact = segment.ppca(poses)
    assert followed.segments == exact.segments
    assert len(exact.segments) > 1
    for a, b in zip(followed.curves, exact.curves, strict=True):
        assert a.distances == pytest.approx(b.distances, rel=0.3)
        assert np.median(np.abs(a.distances / b.distances - 1)) < 0.01


@pytest.mark.skipif(not native.available(), reason="the compiled module is not built")
@pytest.mark.parametrize("dimensions", [3, 30, 61])
@pytest.mark.parametrize("still", [0, 400])
def test_the_compiled_search_cuts_at_the_same_frames(dimensions: int, still: int) -> None:
    poses = np.pad(gaits(0, 1, 2, dimensions=dimensions), ((still, 0), (0, 0)))
    compiled = segment.ppca(poses)
    with native.without():
        by_numpy = segment.ppca(poses)
    assert compiled.segments == by_numpy.segments
    for a, b in zip(compiled.curves, by_numpy.curves, strict=True):
        assert np.array_equal(a.frames, b.frames)
        assert a.distances == pytest.approx(b.distances, rel=1e-6)
        assert a.cut == b.cut
