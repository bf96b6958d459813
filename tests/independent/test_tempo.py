"""docs/payloads/tempo.md and tempo-models.md hold all that a decoder of tempo needs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocodec.codecs.tempo import Tempo, header
from mocodec.encoded import Encoded
from mocodec.motion import Motion
from mocodec.testing import synthetic

from . import motions, tempo


def check(encoded: Encoded[Motion]) -> header.Header:
    """Both decoders agree. Returns the header."""
    like = encoded.about
    bones = (None, None) if like.skeleton is None else (list(like.skeleton.parents), like.skeleton.offsets)
    chunks = [(c.frames, c.payload) for c in encoded.chunks]
    found = tempo.decode(encoded.shared[0], chunks, tempo.Recording(like.names, like.rate, like.up, *bones))
    np.testing.assert_allclose(found, Tempo.decode(encoded).positions, rtol=0, atol=1e-9)
    return header.Header.unpack(encoded.shared, like.points)


def with_holes(motion: Motion) -> Motion:
    """With gaps, a spike, and a leap."""
    positions = motion.positions.copy()
    positions[len(positions) // 2 :] += (0.4, 0.3, -0.2)
    positions[10, 3] += 0.7
    positions[20:29, 5] = np.nan
    positions[:4, 0] = np.nan
    return replace(motion, positions=positions)


MARKERS = synthetic.markers(frames=120, seed=3)
FEW_MARKERS = MARKERS.select(["C7", "LSHO", "RSHO", "LKNE", "LTOE", "RTOE"])
NAMED = motions.named_joints(150)


@pytest.mark.parametrize(
    ("motion", "options"),
    [
        (motions.named_points(100), {"model": "points-prior"}),
        (replace(MARKERS, rate=60.0), {"model": "points-prior"}),
        (MARKERS, {"model": "points-prior", "mean_error": 0.001}),
        (FEW_MARKERS, {"model": "points-stored", "max_error": 0.001}),
        (with_holes(FEW_MARKERS), {"model": "points-stored", "mean_error": 0.002}),
        (NAMED, {"model": "points-prior", "max_error": 0.02}),
        (NAMED, {"model": "points-stored", "max_error": 0.001}),
        (NAMED, {"model": "directions-prior", "max_error": 0.001}),
        (replace(NAMED, skeleton=None), {"model": "directions-prior", "max_error": 0.003}),
        (motions.renamed_joints(160, with_skeleton=True), {"model": "directions-prior"}),
        (motions.renamed_joints(160, with_skeleton=False, shuffled=True), {"model": "directions-prior"}),
        (motions.renamed_joints(90, True, ("lhipjoint", "rfingers", "upperneck"), size=0.03), {"model": "directions-prior"}),
        (motions.renamed_joints(90, False, ("lhipjoint", "rtoes"), size=0.03), {"model": "directions-prior"}),
        (motions.renamed_joints(90, with_skeleton=True), {"model": "directions-stored", "max_error": 0.001}),
        (motions.renamed_joints(200, False, shuffled=True), {"model": "directions-stored", "max_error": 0.003}),
        (FEW_MARKERS, {"model": "direct", "max_error": 0.002}),
        (MARKERS, {"model": "direct", "max_error": 0.0001}),
        (FEW_MARKERS, {"model": "hou2014"}),
    ],
)
def test_every_model(motion: Motion, options: dict[str, Any]) -> None:
    found = check(Tempo(**options).encode(motion))
    assert (found.model or ("hou2014" if found.fallback is not None else "direct")) == options["model"]


@pytest.mark.parametrize("model", ["points-prior", "points-stored", "direct"])
def test_weights(model: str) -> None:
    weights = {name: 5.0 for name in MARKERS.names[:6]}
    assert check(Tempo(model=model, max_error=0.008, weights=weights).encode(MARKERS)).weights


@pytest.mark.parametrize("model", ["points-stored", "direct", "hou2014"])
def test_repeats(model: str) -> None:
    irregular = np.repeat(np.arange(60), np.random.default_rng(1).integers(1, 5, 60))
    for frames in (np.repeat(np.arange(60), 3), irregular):
        motion = replace(FEW_MARKERS, positions=FEW_MARKERS.positions[frames])
        assert check(Tempo(model=model, chunk_seconds=0.5).encode(motion)).millihertz is not None


@pytest.mark.parametrize("up", ["x", "y", "z"])
@pytest.mark.parametrize("target", [{"max_error": 0.0005}, {"max_error": 0.03}, {"mean_error": 0.003}, {"ratio": 20.0}])
def test_gaps_spikes_leaps_and_every_axis(up: str, target: dict[str, float]) -> None:
    check(Tempo(chunk_seconds=0.7, **target).encode_chunks(replace(with_holes(FEW_MARKERS), up=up)))


@pytest.mark.parametrize("rate", [7.3, 24.0, 240.0, 1000.0])
def test_frame_rates(rate: float) -> None:
    check(Tempo(model="points-stored", chunk_seconds=0.5).encode(replace(FEW_MARKERS, rate=rate)))


@pytest.mark.parametrize("frames", [1, 2, 3, 4, 17, 33])
def test_short_recordings(frames: int) -> None:
    for model in ("direct", "points-prior"):
        check(Tempo(model=model).encode(motions.named_points(frames)))
