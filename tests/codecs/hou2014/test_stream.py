"""Positions of clips by the compiled module and by NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.hou2014 import clip_segmentation, left_transform, quantised_motion, stream
from mocodec.errors import CannotEncode

pytestmark = pytest.mark.skipif(not native.available(), reason="the compiled module is not built")


@pytest.mark.parametrize("points", [1, 3, 11])
@pytest.mark.parametrize("transforms", [1, 2])
@pytest.mark.parametrize("lengths", [[1], [2, 1], [64], [97, 97, 31], [281], [5, 200, 40], [1030]])
def test_both_reconstruct_the_same_positions(points: int, transforms: int, lengths: list[int]) -> None:
    random = np.random.default_rng(0)
    clip_lengths = np.array(lengths)
    for bandwidth in {1, min(2, max(lengths)), -(-max(lengths) // 3), max(lengths)}:
        header = stream.SharedHeader(
            points=points,
            transforms=tuple(left_transform.fit_rows(random.normal(size=(50, 3 * points))) for _ in range(transforms)),
            components=3 * points,
            rung=-200,
            clip_frames=0,
            mean_numbers=random.integers(-100, 100, 3 * points),
            clip_steps=transforms == 2,
        )
        known = int(stream.frequencies_per_clip(clip_lengths, bandwidth).sum())
        clips = stream.QuantisedClips(
            clip_lengths,
            bandwidth,
            random.integers(-20, 20, (known, 3 * points)) * (random.random((known, 3 * points)) < 0.3),
            random.integers(0, transforms, len(lengths)),
            random.integers(-9, 9, len(lengths)),
        )
        compiled, by_numpy = stream.reconstruct(clips, header), stream.reconstruct_by_numpy(clips, header)
        assert np.abs(compiled - by_numpy).max() <= 1e-12 * np.abs(by_numpy).max()


@pytest.mark.parametrize(("frames", "columns"), [(2, 1), (300, 8), (1125, 17)])
@pytest.mark.parametrize("step", [1e-3, 0.1, 10.0])
def test_both_find_the_same_length(frames: int, columns: int, step: float) -> None:
    random = np.random.default_rng(frames)
    curves = np.cumsum(random.normal(size=(frames, columns)), axis=0) / np.arange(1, columns + 1)
    compiled = clip_segmentation.best_equal_length(curves, step, 5000)
    with native.without():
        assert clip_segmentation.best_equal_length(curves, step, 5000) == compiled


def test_curves_that_are_too_large_are_left_to_numpy() -> None:
    kernel = native.kernel("best_length")
    assert kernel is not None
    assert kernel(np.full((9, 2), 1e9), np.array([3, 9]), 24.0, np.zeros(2)) is None


@pytest.mark.parametrize(("clips", "frequencies", "components"), [(1, 1, 1), (3, 40, 13), (2, 5, 0)])
@pytest.mark.parametrize("economy", [0.0, 0.2])
def test_both_quantise_to_the_same_integers(clips: int, frequencies: int, components: int, economy: float) -> None:
    random = np.random.default_rng(components)
    size = 4 / np.arange(1, frequencies + 1)[:, None]
    spectra = random.laplace(size=(clips, frequencies, components)) * size
    steps = random.uniform(0.1, 0.9, clips)
    compiled = quantised_motion._quantised(spectra, steps, economy)
    with native.without():
        by_numpy = quantised_motion._quantised(spectra, steps, economy)
    assert np.array_equal(compiled, by_numpy)
    with pytest.raises(CannotEncode):
        quantised_motion._quantised(np.full((clips, 1, 1), 1.0), np.full(clips, 1e-17), economy)


def test_both_find_the_same_extent() -> None:
    random = np.random.default_rng(4)
    for density in (0.0, 0.01, 0.2, 1.0):
        spectrum = (random.random((30, 17)) < density) * random.integers(1, 5, (30, 17))
        compiled = stream.extent(spectrum)
        with native.without():
            assert stream.extent(spectrum) == compiled
