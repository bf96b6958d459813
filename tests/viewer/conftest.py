"""A motion, what a codec made of it, and point clouds."""

from __future__ import annotations

import numpy as np
import pytest

import mocodec as mc


@pytest.fixture(scope="session")
def original() -> mc.Motion:
    """Ten seconds of two rigid limbs of three markers each, one of them missing for a while; a force and two events."""
    t = np.arange(600) / 60
    base = np.array([[0, 0, 0.1], [0.1, 0, 0.2], [0, 0.1, 0.3], [0, 0, 1.0], [0.1, 0, 1.1], [0, 0.1, 1.2]])
    sway = np.stack([0.3 * np.sin(t), 0.1 * t, 0.05 * np.cos(2 * t)], axis=1)
    positions = np.repeat(sway[:, None], 6, axis=1) + base
    positions[:, 3:] += 0.2 * np.stack([np.cos(3 * t), np.sin(2 * t), 0 * t], axis=1)[:, None]
    positions[100:160, 2] = np.nan
    force = mc.Signal(np.maximum(0, 700 * np.sin(np.arange(6000) / 200)), 600, ("Fz1",), ("N",))
    extras = {"analog": force, "events": [{"label": "heel strike", "time_s": 2.5}, {"label": "toe off", "time_s": 4.0}]}
    return mc.Motion(positions, 60, ("LA", "LB", "LC", "RA", "RB", "RC"), extras=extras)


@pytest.fixture(scope="session")
def blob(original: mc.Motion) -> bytes:
    """The motion within 2 mm."""
    return mc.encode(original, "liu2006", max_error=0.002)


@pytest.fixture
def clouds() -> mc.PointClouds:
    """Three frames of coloured points, the second with none."""
    random = np.random.default_rng(5)
    positions = [random.normal(size=(n, 3)) for n in (50, 0, 70)]
    colours = [random.integers(0, 256, (n, 3)).astype(np.uint8) for n in (50, 0, 70)]
    return mc.PointClouds(positions, 15, colours)
