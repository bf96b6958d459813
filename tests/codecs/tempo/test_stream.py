"""Frames in as they come, chunks out, within the bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec import metrics
from mocodec.codecs.tempo import Decoder, Encoder
from mocodec.encoded import Chunk
from mocodec.testing import synthetic

from .motions import named_points, named_skeleton, renamed_skeleton


@pytest.mark.parametrize("latency", [0.1, 0.5])
def test_a_stream_keeps_its_bound_at_its_latency(latency: float) -> None:
    motion = named_points(frames=200)
    positions = motion.positions.copy()
    positions[50:60, 2] = np.nan
    encoder = Encoder(motion[:0], max_error=0.005, latency_seconds=latency)
    chunks: list[Chunk] = []
    for start in range(0, 200, 7):
        chunks += encoder.push(positions[start : start + 7])
        done = chunks[-1].stop if chunks else 0
        assert min(start + 7, 200) - done < latency * motion.rate + 1
    chunks += encoder.finish()
    decoder = Decoder(encoder.shared, motion[:0])
    decoded = np.concatenate([decoder.push(c) for c in chunks])
    assert np.nanmax(metrics.distances(positions, decoded)) <= 0.005
    assert (np.isnan(decoded) == np.isnan(positions)).all()


def test_a_stream_of_unknown_points_learns_from_an_earlier_recording() -> None:
    earlier, motion = (synthetic.markers(frames=360, seed=s) for s in (1, 2))
    sizes = []
    for like in (None, earlier):
        encoder = Encoder(motion[:0], latency_seconds=1.0, like=like)
        sizes.append(sum(len(c.payload) for c in [*encoder.push(motion.positions), *encoder.finish()]))
    assert sizes[1] < 0.8 * sizes[0]


def test_a_stream_with_a_skeleton_is_coded_as_bone_directions() -> None:
    motion = named_skeleton(240)
    sizes = []
    for about in (motion[:0], replace(motion[:0], skeleton=None)):
        stream = Encoder(about, latency_seconds=0.5)
        chunks = [*stream.push(motion.positions), *stream.finish()]
        decoder = Decoder(stream.shared, about)
        decoded = np.concatenate([decoder.push(c) for c in chunks])
        assert metrics.distances(motion.positions, decoded).max() <= 0.005
        sizes.append(sum(len(c.payload) for c in chunks))
    assert sizes[0] < 0.9 * sizes[1]


def test_a_stream_of_a_renamed_skeleton_needs_nothing_earlier() -> None:
    motion = renamed_skeleton(True, 60)
    stream = Encoder(motion[:0], latency_seconds=0.5)
    chunks = [*stream.push(motion.positions), *stream.finish()]
    decoder = Decoder(stream.shared, motion[:0])
    decoded = np.concatenate([decoder.push(c) for c in chunks])
    assert metrics.distances(motion.positions, decoded).max() <= 0.005
