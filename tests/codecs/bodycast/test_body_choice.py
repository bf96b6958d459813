"""Bodies are used where they save bytes: not for an animal that looks like one, nor for a person in two frames."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.bodycast import Bodycast, body_choice
from mocodec.codecs.bodycast.point_encoder import PointTarget
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences

pytest.importorskip("av")

BOUND_M = 0.004
FRAMES, POINTS = 6, 1500


def limb(start: list[float], stop: list[float], radius: float, points: int, rng: np.random.Generator) -> np.ndarray:
    """Random points around a segment, metres."""
    away = rng.normal(size=(points, 3))
    away *= radius / np.linalg.norm(away, axis=1)[:, None]
    return np.asarray(start) + rng.random((points, 1)) * (np.asarray(stop) - np.asarray(start)) + away


def animal(frame: int) -> np.ndarray:
    """A trunk with a neck, a head, a tail and four legs that swing; other points in every frame."""
    rng, swing = np.random.default_rng(frame), 0.15 * np.sin(0.6 * frame)
    parts = [
        limb([-0.3, 0.52, 0], [0.3, 0.54, 0], 0.12, POINTS * 4 // 10, rng),
        limb([0.3, 0.56, 0], [0.45, 0.74, 0], 0.08, POINTS // 10, rng),
        limb([0.42, 0.74, 0], [0.64, 0.7, 0], 0.06, POINTS // 10, rng),
        limb([-0.3, 0.55, 0], [-0.52, 0.72, swing / 2], 0.025, POINTS // 25, rng),
    ]
    for x, side in ((0.24, 1), (-0.24, -1)):
        for z in (-0.08, 0.08):
            foot = x + side * np.sign(z) * swing
            parts.append(limb([x, 0.5, z], [foot, 0.04, z], 0.035, POINTS * 9 // 100, rng))
    return np.concatenate(parts) + np.array([0.04 * frame, 0, 0])


def test_an_animal_is_coded_without_a_body(monkeypatch):
    clouds = PointClouds([animal(k) for k in range(FRAMES)], 15.0, up="y")
    frames = [(np.asarray(p), None) for p in clouds.positions]
    codec = Bodycast(max_error=BOUND_M)
    bodies = codec._bodies(frames, "y", False)
    assert bodies  # it looks like one
    monkeypatch.setattr(Bodycast, "_bodies", lambda *_: bodies)
    encoded = codec.encode(clouds)
    [alone] = codec._point_chunks([], frames, [slice(0, FRAMES)], False, 0, {"max_error": BOUND_M})
    assert sum(map(len, encoded.shared)) + encoded.payload_bytes <= len(alone)


def test_a_person_is_worth_the_bytes_in_a_long_recording_only():
    clouds = sequences.record(sequences.jumping_jacks(actors.capsules(), FRAMES), 2 * POINTS, seed=1)[:2]
    assert clouds.colours is not None
    frames = [(np.asarray(p), np.asarray(c)) for p, c in zip(clouds.positions, clouds.colours, strict=True)]
    bodies, target, spans = Bodycast(max_error=BOUND_M)._bodies(frames, "y", True), PointTarget(BOUND_M), [slice(0, 2)]
    for body in bodies:
        body.is_present = [True, True]
    assert not body_choice.bodies_pay(bodies, frames, spans, True, target)
    for body in bodies:
        body.is_present = [True] * 300
    assert body_choice.bodies_pay(bodies, frames, spans, True, target)
