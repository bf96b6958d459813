"""docs/payloads/tempo-lattice.md holds all that a decoder of tempo's lattice engine needs."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocodec.codecs.tempo import Tempo
from mocodec.encoded import Encoded
from mocodec.motion import Motion

from . import tempo
from .test_tempo import FEW_MARKERS, PAGE, check

LATTICE = Tempo(max_error=0.0005, model="lattice")


def is_lattice(encoded: Encoded[Any]) -> list[bool]:
    """Of each chunk. For motions without repeats."""
    return [bool(chunk.payload[0] & 2) for chunk in encoded.chunks]


def noisy_markers(frames: int, points: int = 6) -> Motion:
    motion = FEW_MARKERS.select(list(FEW_MARKERS.names[:points]))
    noise = np.random.default_rng(frames).normal(0, 0.0004, (frames, points, 3))
    return replace(motion, positions=motion.positions[:frames] + noise)


def with_many_holes(motion: Motion) -> Motion:
    """60 frames with gaps at both ends, in the middle and of a whole frame, with spikes, and with a leap."""
    positions = motion.positions.copy()
    points = motion.points
    positions[30:] += (0.4, 0.3, -0.2)
    positions[10, -1] += 0.7
    positions[33, 0] -= (0.3, -0.2, 0.5)
    for p in range(points):
        positions[5 + 7 * p : 9 + 8 * p, p] = np.nan
    positions[:3, points // 2] = np.nan
    positions[0, 0] = np.nan
    positions[-6:, -1] = np.nan
    positions[17] = np.nan
    return replace(motion, positions=positions)


@pytest.mark.parametrize("frames", [1, 2, 3, 9, 60])
@pytest.mark.parametrize("points", [1, 2, 6])
def test_chunks_shorter_and_longer_than_the_stride(points: int, frames: int) -> None:
    encoded = LATTICE.encode_chunks(noisy_markers(frames, points))
    assert check(encoded).neighbours is not None
    assert all(is_lattice(encoded))


@pytest.mark.parametrize("weights", [{}, {"C7": 5.0, "LKNE": 2.0}])
@pytest.mark.parametrize("points", [1, 2, 6])
def test_gaps_spikes_leaps_weights_and_every_axis(points: int, weights: dict[str, float]) -> None:
    motion = with_many_holes(noisy_markers(60, points))
    weights = {name: weight for name, weight in weights.items() if name in motion.names}
    for up in ("x", "y", "z"):
        encoded = replace(LATTICE, weights=weights).encode_chunks(replace(motion, up=up))
        assert bool(check(encoded).weights) == bool(weights)
        assert all(is_lattice(encoded))


@pytest.mark.parametrize("points", [slice(0, 1), slice(2, 3), slice(None)])
def test_gaps_in_the_first_frames(points: slice) -> None:
    motion = noisy_markers(40)
    positions = motion.positions.copy()
    positions[:5, points] = np.nan
    encoded = LATTICE.encode_chunks(replace(motion, positions=positions))
    check(encoded)
    assert all(is_lattice(encoded))


def test_frozen_runs_count_as_gaps() -> None:
    motion = noisy_markers(60)
    positions = motion.positions.copy()
    positions[10:25, 2] = 0
    positions[40:, 0] = positions[40, 0]
    positions[30:36, 3] = np.nan
    encoded = LATTICE.encode_chunks(replace(motion, positions=positions))
    check(encoded)
    assert all(is_lattice(encoded))
    assert (LATTICE.decode(encoded).positions[10:25, 2] == 0).all()


def test_large_residuals() -> None:
    rng = np.random.default_rng(8)
    positions = rng.normal(size=(30, 6, 3)) * 10.0 ** rng.uniform(-3, 4, (30, 1, 1))
    encoded = LATTICE.encode_chunks(replace(FEW_MARKERS, positions=positions))
    check(encoded)
    assert all(is_lattice(encoded))


def test_repeats() -> None:
    motion = noisy_markers(60, 3)
    repeated = replace(motion, positions=motion.positions[np.repeat(np.arange(60), 3)])
    encoded = replace(LATTICE, chunk_seconds=0.5).encode(repeated)
    found = check(encoded)
    assert found.millihertz is not None
    assert found.neighbours is not None
    assert len(encoded.chunks) > 1


def test_chunks_of_both_engines_in_one_stream() -> None:
    motion = noisy_markers(40)
    transform = Tempo(max_error=0.005, model="points-prior").encode_chunks(motion)
    lattice = LATTICE.encode_chunks(motion)
    head = replace(check(transform), neighbours=check(lattice).neighbours)
    later = [replace(c, start=c.start + 40) for c in lattice.chunks]
    both = replace(transform, shared=(head.pack(),), chunks=(*transform.chunks, *later))
    assert check(both) == head
    assert is_lattice(both) == [False, True]


def test_the_example_of_the_page() -> None:
    example = (PAGE.parent / "tempo-lattice.md").read_text(encoding="utf-8").split("## An example")[1]
    shared, chunk, poses = re.findall(r"(?:^    .+\n)+", example, re.MULTILINE)
    like = tempo.Recording(("A", "B"), 30.0, "y")
    found = tempo.decode(bytes.fromhex(shared), [(10, bytes.fromhex(chunk))], like)
    frames = np.array(poses.split(), float).reshape(2, 2, 3)
    np.testing.assert_allclose(found[[0, -1]], frames, rtol=0, atol=1e-9)
    assert np.argwhere(np.isnan(found[..., 0])).tolist() == [[3, 1]]
