"""Motion and PointClouds: frames, strides, and positions as arrays."""

from __future__ import annotations

import numpy as np
import pytest

import mocodec as mc
from mocodec.testing import synthetic


def test_one_frame_is_a_motion_of_one_frame() -> None:
    motion = synthetic.joints(frames=20)
    for frame in (0, 7, 19, -1, -20):
        one = motion[frame]
        assert one.positions.shape == (1, 21, 3)
        np.testing.assert_array_equal(one.positions[0], motion.positions[frame])
        assert one.rotations is not None
        assert one.skeleton is motion.skeleton
    assert len(list(motion)) == 20


def test_a_stride_lowers_the_rate_and_thins_out_signals_of_that_rate() -> None:
    extras = {
        "analog": mc.Signal(np.arange(100), 1000.0),
        "residuals": mc.Signal(np.arange(10), 100.0),
        "events": [{"label": "Foot Strike", "time_s": 0.05}],
    }
    motion = mc.Motion(np.arange(30.0).reshape(10, 1, 3), 100, extras=extras, source={"first_frame": 5, "units": "mm"})
    thinned = motion[1::3]
    np.testing.assert_array_equal(thinned.positions, motion.positions[[1, 4, 7]])
    assert thinned.rate == pytest.approx(100 / 3)
    assert dict(thinned.source) == {"units": "mm"}
    np.testing.assert_array_equal(thinned.extras["residuals"].values, [1, 4, 7])
    assert thinned.extras["residuals"].rate == thinned.rate
    np.testing.assert_array_equal(thinned.extras["analog"].values, np.arange(10, 100))
    assert thinned.extras["events"][0]["time_s"] == pytest.approx(0.04)


def test_frames_run_forwards_only() -> None:
    with pytest.raises(mc.BadInput, match="forwards"):
        synthetic.markers(frames=9)[::-1]


def test_positions_as_an_array() -> None:
    motion = synthetic.markers(frames=9)
    assert np.asarray(motion) is motion.positions
    single = np.asarray(motion, dtype=np.float32)
    assert single.dtype == np.float32
    np.testing.assert_array_equal(single, motion.positions.astype(np.float32))
    copied = np.array(motion)
    assert not np.shares_memory(copied, motion.positions)
    assert np.mean(motion) == pytest.approx(motion.positions.mean())


def test_frames_of_point_clouds() -> None:
    clouds = mc.PointClouds([np.full((n, 3), float(n)) for n in range(1, 8)], rate=30)
    assert [len(points) for points in clouds[1:4].positions] == [2, 3, 4]
    assert [len(points) for points in clouds[-1].positions] == [7]
    assert [len(points) for points in clouds[::3].positions] == [1, 4, 7]
    assert clouds[::3].rate == 10
    with pytest.raises(mc.FrameOutOfRange):
        clouds[7]


@pytest.mark.parametrize(
    ("shape", "hint"),
    [
        ((4, 15), r"reshape\(-1, 5, 3\)"),
        ((4, 3, 5), r"transpose\(0, 2, 1\)"),
        ((4, 5, 4), r"\[:, :, :3\]"),
        ((4, 16), r"not \(4, 16\)$"),
    ],
)
def test_arrays_of_other_shapes_are_refused_with_a_hint(shape: tuple[int, ...], hint: str) -> None:
    with pytest.raises(mc.BadInput, match=hint):
        mc.Motion(np.zeros(shape), 30)
