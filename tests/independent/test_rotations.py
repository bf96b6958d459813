"""docs/payloads/tempo-rotations.md holds all that a decoder of rotations needs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec.codecs.tempo import Tempo
from mocodec.codecs.tempo.rotation_layer import chunk_layer, payload, record, reference
from mocodec.encoded import Encoded
from mocodec.geometry import kinematics
from mocodec.motion import Motion
from mocodec.testing import hinged_figures

from . import tempo_rotations
from .tempo_statistics import Recording

GOLDEN = sorted((Path(__file__).parents[1] / "golden").glob("rotations-*.mocz"))
GOLDEN = [path for path in GOLDEN if path.stem != "rotations-lossless"]


def check(encoded: Encoded[Any]) -> set[int]:
    """Both decoders agree. Returns the kinds of the chunks' parts."""
    like = encoded.about
    assert like.skeleton is not None
    limits = like.skeleton.limits
    kept = None if limits is None else (limits.orders, limits.axes, limits.ranges)
    parents = list(like.skeleton.parents)
    offsets = record.rounded(like.skeleton).offsets
    chunks = [(c.frames, c.payload) for c in encoded.chunks]
    named = Recording(like.names, like.rate, like.up, parents, like.skeleton.offsets)
    tree = tempo_rotations.Tree(parents, offsets, kept)
    rotations, positions = tempo_rotations.decode(list(encoded.shared), chunks, named, tree)
    decoded = Tempo.decode(encoded)
    assert decoded.rotations is not None
    np.testing.assert_allclose(positions, decoded.positions, rtol=0, atol=1e-8)
    same = np.abs((rotations * decoded.rotations).sum(axis=2))
    np.testing.assert_allclose(same, 1, rtol=0, atol=1e-12)
    parts = [payload.split(c.payload)[0] for c in encoded.chunks]
    return {part[0] for part in parts if part}


@pytest.mark.parametrize("path", GOLDEN, ids=lambda path: path.stem)
def test_golden_files(path: Path) -> None:
    with mc.open(path) as f:
        check(f.encoded)


@pytest.mark.parametrize(
    ("motion", "options"),
    [
        (hinged_figures.figure(40), {"mean_error": 0.005}),
        (hinged_figures.figure(40, own_frame=True), {"mean_error": 0.002}),
        (hinged_figures.figure(60, own_frame=True), {"max_error": 0.01, "chunk_seconds": 0.5}),
        (hinged_figures.with_translations(40), {"max_error": 0.01}),
    ],
)
def test_every_convention(motion: Motion, options: dict[str, Any]) -> None:
    check(Tempo(**options).encode(motion))


def test_direct_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunk_layer, "TIGHTER", ())
    for own_frame in (False, True):
        assert 1 in check(Tempo(max_error=1e-4).encode(hinged_figures.figure(24, own_frame=own_frame)))


def test_trees_with_every_rule() -> None:
    parents = (-1, 0, 1, 2, 2, 0, 5, -1)
    offsets = np.random.default_rng(6).normal(0, 0.2, (8, 3))
    for locked in range(3):
        angles = hinged_figures.curves(20, 24, 5, 0.6).reshape(20, 8, 3)
        angles[:, 1::2, locked] = 0.4
        angles[:, 4, 1:] = 0.0
        for own_frame in (False, True):
            check(Tempo(mean_error=0.004).encode(hinged_figures.tree(parents, offsets, angles, own_frame)))


def test_departures_from_reference_rules(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "numbers", lambda joints: [1])
    offsets = np.random.default_rng(31).normal(0, 0.1, (31, 3))
    angles = hinged_figures.curves(6, 93, 3, 0.3).reshape(6, 31, 3)
    check(Tempo(mean_error=0.01).encode(hinged_figures.tree(tuple(range(-1, 30)), offsets, angles, True)))


def test_constant_angles_that_limits_say() -> None:
    motion = hinged_figures.figure(12, own_frame=True)
    assert motion.rotations is not None
    assert motion.skeleton is not None
    rotations = motion.rotations.copy()
    rotations[:, 2] = np.cos(np.radians(7.125) / 2), np.sin(np.radians(7.125) / 2), 0, 0
    root = motion.positions[:, 0] - motion.skeleton.offsets[0]
    positions = kinematics.forward(motion.skeleton, rotations, root, own_frame=True)
    check(Tempo(mean_error=0.01).encode(replace(motion, rotations=rotations, positions=positions)))
