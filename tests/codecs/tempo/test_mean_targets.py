"""A mean error by other means: noise by the lattice engine, short recordings by other targets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec.codecs.tempo import Tempo, mean_targets
from mocodec.encoded import Encoded
from mocodec.motion import Motion
from mocodec.stages import lattice
from mocodec.testing import synthetic

from .motions import error, header, through

needs_lattice = pytest.mark.skipif(not lattice.is_fast(), reason="needs the compiled module")


def noisy_markers(frames: int = 400, gaps: bool = False) -> Motion:
    """Markers with noise of 0.2 mm; a third of one of them is missing."""
    motion = synthetic.markers(frames=frames, seed=2)
    positions = motion.positions + np.random.default_rng(1).normal(0, 2e-4, motion.positions.shape)
    if gaps:
        positions[: frames // 3, 3] = np.nan
    return Motion(positions, motion.rate, motion.names, motion.up)


@needs_lattice
@pytest.mark.parametrize("gaps", [False, True])
def test_noise_is_smaller_on_the_lattice_and_the_mean_is_met(gaps: bool) -> None:
    motion = noisy_markers(gaps=gaps)
    wanted = 0.0001
    codec = Tempo(mean_error=wanted)
    encoded = codec.encode(motion)
    assert header(encoded).neighbours is not None
    assert encoded.payload_bytes < 0.95 * codec.encode_chunks(motion).payload_bytes
    mean = np.nanmean(error(motion, Tempo.decode(encoded)))
    assert 0.95 * wanted <= mean <= wanted
    assert encoded.settings["mean_error"] == wanted
    assert "max_error" not in encoded.settings


def test_a_coarse_mean_is_not_tried() -> None:
    motion = synthetic.markers(frames=400, seed=2)
    encoded = Tempo(mean_error=0.01).encode_chunks(motion)

    def encode(part: Motion, bound: float) -> Encoded[Motion]:
        raise AssertionError

    assert mean_targets.on_lattice(encoded, motion, 0.01, encode, Tempo.decode) is encoded


@needs_lattice
def test_the_encoding_given_stays_where_the_lattice_is_larger() -> None:
    motion = noisy_markers()
    tiny = Tempo(ratio=60).encode_chunks(motion)
    codec = Tempo(max_error=0.001, model="lattice")

    def encode(part: Motion, bound: float) -> Encoded[Motion]:
        return replace(codec, max_error=bound).encode_chunks(part)

    assert mean_targets.on_lattice(tiny, motion, 1e-6, encode, Tempo.decode) is tiny


@pytest.mark.parametrize("frames", [1, 3, 7])
def test_a_short_recording_is_not_larger_at_twice_the_mean(frames: int) -> None:
    motion = synthetic.markers(frames=600, seed=1)[:frames]
    sizes = []
    for wanted in (0.0025, 0.005, 0.01, 0.02):
        decoded, size = through(motion, mean_error=wanted)
        assert error(motion, decoded).mean() <= wanted
        sizes.append(size)
    assert sizes == sorted(sizes, reverse=True)


def test_a_short_recording_is_not_larger_than_under_a_bound_of_a_smaller_mean() -> None:
    motion = synthetic.markers(frames=600, seed=1)[:3]
    decoded, bounded = through(motion, max_error=0.002)
    assert error(motion, decoded).mean() <= 0.001
    assert through(motion, mean_error=0.001)[1] <= bounded


def test_longer_recordings_are_not_tried_at_other_targets() -> None:
    motion = synthetic.markers(frames=mean_targets.SHORT_FRAMES + 1, seed=1)
    encoded = Tempo(mean_error=0.005).encode_chunks(motion)
    tried = []

    def encode(target: str, wanted: float, kinds: mean_targets.Kinds | None) -> Encoded[Motion]:
        tried.append((target, wanted))
        return encoded

    assert mean_targets.smallest(encoded, motion, 0.005, encode, lambda *_: 0.0) is encoded
    assert tried == [("max_error", 0.005)]
