"""Frames that repeat the one before cost next to nothing, and come back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocodec import metrics
from mocodec.codecs.tempo import Tempo, repeats
from mocodec.errors import Corrupt
from mocodec.motion import Motion
from mocodec.testing import synthetic

from .motions import header


def twice(frames: int = 360, order: tuple[int, ...] = (0, 0)) -> Motion:
    """Runs of frames: `order` says which of its own frames each frame of a run shows."""
    motion = synthetic.markers(frames=frames, seed=4)
    which = np.arange(frames) // len(order) * len(order) + np.array(order)[np.arange(frames) % len(order)]
    return replace(motion, positions=motion.positions[np.minimum(which, frames - 1)])


@pytest.mark.parametrize(("order", "share"), [((0, 0), 0.85), ((0, 0, 0, 3), 0.85), ((0, 0, 2, 3), 0.95)])
def test_repeated_frames_cost_next_to_nothing(order: tuple[int, ...], share: float) -> None:
    motion = twice(order=order)
    encoded = Tempo(max_error=0.001).encode(motion)
    assert header(encoded).millihertz is not None
    assert encoded.payload_bytes < share * Tempo(max_error=0.001).encode_without_repeats(motion).payload_bytes
    decoded = Tempo.decode(encoded)
    assert decoded.rate == motion.rate
    assert metrics.distances(motion.positions, decoded.positions).max() <= 0.001
    assert (decoded.positions[1] == decoded.positions[0]).all()
    part = Tempo.decode(encoded, slice(101, 250)).positions
    assert part == pytest.approx(decoded.positions[101:250], abs=1e-9)
    assert len(Tempo.decode(encoded, slice(7, 7))) == 0


@pytest.mark.parametrize("settings", [{"mean_error": 0.002}, {"ratio": 60.0}, {"size": 4000}, {}])
def test_repeated_frames_under_every_target(settings: dict[str, Any]) -> None:
    motion = twice(order=(0, 0))
    positions = motion.positions.copy()
    positions[40:90, 3] = np.nan
    motion = replace(motion, positions=positions)
    encoded = Tempo(**settings).encode(motion)
    assert header(encoded).millihertz is not None
    error = metrics.distances(positions, Tempo.decode(encoded).positions)
    assert (np.isnan(error) == motion.gaps).all()
    if "mean_error" in settings:
        assert 0.95 * 0.002 <= np.nanmean(error) <= 0.002
    elif settings:
        assert encoded.payload_bytes <= (Tempo(**settings).size or motion.raw_bytes / 60)
    else:
        assert np.nanmax(error) <= 0.005
    assert set(settings) <= set(encoded.settings)


def test_a_motion_with_few_repeats_is_coded_frame_by_frame() -> None:
    motion = synthetic.markers(frames=100, seed=4)
    assert repeats.distinct_frames(motion, 4.0) is None
    motion.positions[10:20] = motion.positions[10]
    assert repeats.distinct_frames(motion, 4.0) is None
    assert repeats.distinct_frames(motion[:2], 4.0) is None


def test_a_long_still_keeps_its_chunks_short() -> None:
    motion = synthetic.markers(frames=1500, seed=4)
    still = replace(motion, positions=np.repeat(motion.positions[:1], 1500, axis=0))
    encoded = Tempo().encode(still)
    assert header(encoded).millihertz is not None
    assert encoded.payload_bytes < 600
    assert metrics.distances(still.positions, Tempo.decode(encoded).positions).max() <= 0.005


def test_damaged_run_lengths_are_noticed() -> None:
    encoded = Tempo().encode(twice())
    chunk = encoded.chunks[0]
    for payload in (b"", b"\x00\x00\x01", b"\xff\x7f\x00\x01", chunk.payload[:2] + b"\x03" + chunk.payload[3:]):
        damaged = replace(encoded, chunks=[replace(chunk, payload=payload), *encoded.chunks[1:]])
        with pytest.raises(Corrupt):
            Tempo.decode(damaged)
    with pytest.raises(Corrupt):
        Tempo.decode(replace(encoded, shared=(encoded.shared[0][:1] + b"\x00" + encoded.shared[0][3:],)))
