"""A mean error is met, and a size is kept."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.tempo import Tempo
from mocodec.errors import CannotEncode
from mocodec.motion import Motion
from mocodec.testing import synthetic

from .motions import error, header, through


@pytest.mark.parametrize("mean", [0.0003, 0.001, 0.01])
def test_a_mean_error_is_a_promise(mean: float) -> None:
    motion = synthetic.markers(frames=600, seed=3)
    decoded, _ = through(motion, mean_error=mean)
    assert 0.95 * mean <= np.nanmean(error(motion, decoded)) <= mean


@pytest.mark.parametrize(("frames", "seed", "mean"), [(60, 3, 0.005), (72, 2, 0.01), (96, 3, 0.005)])
def test_a_mean_error_is_met_where_it_does_not_always_rise_with_the_step(frames: int, seed: int, mean: float) -> None:
    motion = synthetic.markers(frames=frames, seed=seed)
    encoded = Tempo(mean_error=mean).encode_chunks(motion)
    assert header(encoded).model is not None
    assert 0.95 * mean <= error(motion, Tempo.decode(encoded)).mean() <= mean


def test_a_mean_error_finer_than_the_bases_are_exact() -> None:
    motion = synthetic.markers(frames=60, seed=3)
    decoded, _ = through(motion, mean_error=1e-10)
    assert np.nanmean(error(motion, decoded)) <= 1e-10


def test_size_and_ratio_are_kept() -> None:
    motion = synthetic.markers(frames=600, seed=3)
    assert 0.9 * 9000 < through(motion, size=9000)[1] <= 9000
    assert through(motion, ratio=60)[1] <= motion.raw_bytes / 60
    with pytest.raises(CannotEncode):
        through(motion, size=5)


def test_a_size_that_leaves_room_for_everything_or_for_hardly_a_basis() -> None:
    still = Motion(np.repeat(synthetic.markers(frames=1, seed=3).positions, 90, axis=0), 120.0)
    assert through(still, size=20_000)[1] <= 20_000
    line = Motion(np.cumsum(np.ones((90, 5, 3)), axis=0), 120.0)
    assert through(line, ratio=2.0)[1] <= line.raw_bytes / 2
    noise = Motion(np.random.default_rng(0).normal(size=(90, 41, 3)), 120.0)
    assert through(noise, ratio=20.0)[1] <= noise.raw_bytes / 20
