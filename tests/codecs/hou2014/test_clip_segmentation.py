"""Clips and chunks: any number of frames, chunks that decode alone, adaptive clips, larger steps for fast clips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec import metrics, native
from mocodec.codecs.hou2014 import Hou2014, clip_segmentation, stream
from mocodec.codecs.liu2006 import Liu2006
from mocodec.errors import Corrupt
from mocodec.motion import Motion


@pytest.mark.parametrize("frames", [1, 10, 279, 281, 600])
def test_any_number_of_frames_decodes(walk: Motion, frames: int):
    part = walk[:frames]
    for codec in (Hou2014(), Hou2014(mean_error=0.002)):
        decoded = Hou2014.decode(codec.encode(part))
        assert decoded.positions.shape == part.positions.shape
        assert metrics.mean_distance(part.positions, decoded.positions) < 0.02


def test_chunk_decodes_without_other_chunks(walk: Motion):
    encoded = Hou2014(mean_error=0.001, clip_frames=100, chunk_frames=300).encode(walk)
    assert [chunk.frames for chunk in encoded.chunks] == [300, 300, 300]
    positions = Hou2014.decode(encoded).positions
    damaged = replace(encoded, chunks=tuple(replace(c, payload=b"") if c.start == 300 else c for c in encoded.chunks))
    assert np.array_equal(Hou2014.decode(damaged, slice(650, 880)).positions, positions[650:880])
    with pytest.raises(Corrupt):
        Hou2014.decode(damaged)


def test_adaptive_clips_meet_the_mean_error(walk: Motion):
    motion = walk_then_stand(walk)
    encoded = Hou2014(segmentation="adaptive", mean_error=0.001).encode(motion)
    assert metrics.mean_distance(motion.positions, Hou2014.decode(encoded).positions) <= 0.001


def test_adaptive_clips_in_a_given_number(walk: Motion):
    motion = walk_then_stand(walk)
    decoded = Hou2014.decode(Hou2014(segmentation="adaptive", clips=2).encode(motion))
    assert metrics.mean_distance(motion.positions, decoded.positions) < 0.02


def walk_then_stand(walk: Motion) -> Motion:
    part = walk.select(walk.names[:8])
    still = part.positions[299:300].repeat(300, axis=0)
    return replace(part, positions=np.concatenate([part.positions[:300], still]))


def test_masking_moves_error_to_fast_clips(walk: Motion):
    slow = walk.positions[:450]
    fast = walk.positions[450::3]
    motion = replace(walk, positions=np.concatenate([slow, fast]))
    codec = Hou2014(clip_frames=150, mean_error=0.004)
    ratios = []
    for masking in (0.0, 1.0):
        decoded = Hou2014.decode(replace(codec, masking=masking).encode(motion))
        errors = metrics.distances(motion.positions, decoded.positions).mean(axis=1)
        ratios.append(errors[450:].mean() / errors[:450].mean())
    assert ratios[1] > 1.2 * ratios[0]


@pytest.mark.parametrize("noise", [0.0, 0.3, 3.0])
def test_equal_length_with_the_fewest_bits_is_found(noise: float):
    random = np.random.default_rng(5)
    t = np.arange(1700)[:, None] / 40
    curves = np.concatenate([20 * np.sin(t + 0.1 * t**1.5), 7 * np.cos(3 * t), 1e-3 * t], axis=1)
    curves += noise * random.normal(size=curves.shape)
    lengths = [-(-len(curves) // max(1, round(len(curves) / one))) for one in clip_segmentation.CANDIDATE_LENGTHS]
    bits = {
        one: clip_segmentation.estimate_bits(curves, stream.equal_lengths(len(curves), one), 1.0) for one in lengths
    }
    assert clip_segmentation.best_equal_length(curves, 1.0, 5000) == min(sorted(bits), key=lambda one: bits[one])


@pytest.mark.skipif(not native.available(), reason="the compiled module is not built")
@pytest.mark.parametrize("codec", [Hou2014(mean_error=0.002), Liu2006(mean_error=0.002)])
def test_the_compiled_module_gives_the_same_bytes(walk: Motion, codec: Hou2014 | Liu2006):
    compiled = codec.encode(walk)
    with native.without():
        by_numpy = codec.encode(walk)
    assert [chunk.payload for chunk in compiled.chunks] == [chunk.payload for chunk in by_numpy.chunks]
