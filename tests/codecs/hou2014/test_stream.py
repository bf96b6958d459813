"""Positions of clips by the compiled module and by NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.hou2014 import clip_segmentation, left_transform, stream

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


@pytest.mark.parametrize(("frames", "columns"), [(1, 1), (7, 3), (300, 8), (1125, 17)])
def test_both_count_the_same_bits(frames: int, columns: int) -> None:
    kernel = native.kernel("bits_of_length")
    assert kernel is not None
    curves = np.cumsum(np.random.default_rng(1).normal(size=(frames, columns)), axis=0)
    for length in {1, min(frames, 2), min(frames, 97), min(frames, 140), frames}:
        lengths = stream.equal_lengths(frames, length)
        bits = clip_segmentation.bits_of_spectra(clip_segmentation.spectra_of_clips(curves, lengths), 1.0)
        assert kernel(curves, length) == pytest.approx(bits, rel=1e-11)
    assert kernel(curves * 1e9, 1) is None
