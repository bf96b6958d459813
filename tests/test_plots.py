"""Pictures: drawn for any motion, with the same bytes each time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocodec import BadInput, Motion, Skeleton

pytest.importorskip("matplotlib", reason="drawing needs the [plot] extra")

from mocodec import plots


def motion(frames: int = 50, gaps: bool = False, skeleton: bool = False) -> Motion:
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(frames, 5, 3)).cumsum(axis=0) * 0.01
    if gaps:
        positions[: frames // 2, 1] = np.nan
        positions[frames // 3] = np.nan
        positions[:, 4] = np.nan
    tree = Skeleton(tuple("abcde"), (-1, 0, 1, 2, 2), np.zeros((5, 3))) if skeleton else None
    return Motion(positions, 100, tuple("abcde"), skeleton=tree)


@pytest.mark.parametrize("frames", [1, 2, 50])
@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("draw", [plots.errors, plots.recording])
def test_draws(tmp_path: Path, frames: int, gaps: bool, draw: object) -> None:
    if frames < 3 and gaps:
        gaps = False
    original = motion(frames, gaps, skeleton=not gaps)
    decoded = Motion(original.positions + 0.001, 100, original.names)
    for name in ("a.png", "b.png"):
        plots.save(draw(original, decoded, "title"), tmp_path / name)  # type: ignore[operator]
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_other_suffixes(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"\.png"):
        plots.save(plots.errors(motion(), motion()), tmp_path / "a.doc")


def test_poses_of_frames_without_points_and_far_above_the_ground() -> None:
    far = motion()
    positions = far.positions + np.array([0.0, 50.0, 0.0])
    positions[:30] = np.nan
    picture = plots.poses(Motion(positions, 100, far.names, "y"))
    (axes,) = picture.axes
    left, right = axes.get_xlim()
    low, high = axes.get_ylim()
    for text in axes.texts:
        x, y = text.xy  # type: ignore[attr-defined]
        assert left <= x <= right
        assert low <= y <= high
    assert len(axes.texts) == 7
