"""Random motions for property tests with hypothesis: small, with all features of real recordings and some others."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from ..motion import Motion


@st.composite
def motions(draw: st.DrawFn, max_frames: int = 90, max_points: int = 8, max_scale: float = 1e4) -> Motion:
    """Smooth motion, noise or still poses, with gaps, jumps and repeated samples, at huge and tiny coordinates.

    One frame or one point occur too; at least one sample is present. max_scale: the largest extent, metres.
    """
    frames = draw(st.one_of(st.integers(1, 4), st.integers(1, max_frames)), label="frames")
    points = draw(st.one_of(st.just(1), st.integers(1, max_points)), label="points")
    random = np.random.default_rng(draw(st.integers(0, 2**16), label="seed"))
    scale = draw(st.sampled_from([s for s in (1e-6, 1e-3, 1.0, 1.0, 1.0, 50.0, 1e4, 1e6) if s <= max_scale]))
    kind = draw(st.sampled_from(["smooth", "smooth", "still", "noise", "line"]))
    seconds = np.arange(frames)[:, None, None] / 120
    waves = random.normal(size=(3, points, 3)) / np.array([1, 3, 9])[:, None, None]
    positions = sum(
        w * np.sin(seconds * r + 6 * random.random((points, 3))) for w, r in zip(waves, (2, 6, 20), strict=True)
    )
    positions = np.asarray(positions) + random.normal(size=(points, 3))
    if kind == "still":
        positions = np.repeat(positions[:1], frames, axis=0)
    elif kind == "noise":
        positions = random.normal(size=positions.shape)
    elif kind == "line":
        positions = positions[:1] + seconds * random.normal(size=(points, 3))
    for _ in range(draw(st.integers(0, 2), label="jumps")):
        positions[random.integers(frames)] += random.normal(size=(points, 3) if random.random() < 0.5 else 3)
    repeats = draw(st.sampled_from([1, 1, 2, 5]), label="repeats of each sample")
    positions = scale * positions[np.arange(frames) // repeats * repeats]
    if draw(st.booleans(), label="far from the origin"):
        positions = positions + 1000 * scale
    missing_share = draw(st.sampled_from([0.0, 0.0, 0.02, 0.3, 0.9]), label="missing share")
    missing = random.random((frames, points)) < missing_share
    for _ in range(draw(st.integers(0, 2), label="gaps")):
        start, point = random.integers(frames), random.integers(points)
        missing[start : start + random.integers(1, frames + 1), point] = True
    if draw(st.booleans(), label="point missing"):
        missing[:, random.integers(points)] = True
    missing.flat[random.integers(missing.size)] = False
    positions[missing] = np.nan
    return Motion(positions, draw(st.sampled_from([120.0, 30.0, 59.94])), up=draw(st.sampled_from(["x", "y", "z"])))
