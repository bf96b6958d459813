"""The direction from which a recording is drawn flat: across its widest side, from a little above."""

from __future__ import annotations

import numpy as np

from ..typing import Floats

TURN = np.radians(25.0)
"""From where the points spread most, so that left and right limbs are apart."""
MOST_SAMPLES = 50


def level_axes(up: str) -> list[int]:
    """The two horizontal axes; with the vertical one they are right-handed."""
    return {"x": [1, 2], "y": [2, 0], "z": [0, 1]}[up]


def directions(positions: Floats, up: str, tilt: float) -> Floats:
    """Unit vectors (3, 3) to the right, up and away from the viewer, of positions (frames, points, 3); NaN in gaps.

    Right is near the horizontal direction in which the points of a frame spread most. tilt: radians above the horizon.
    """
    level = level_axes(up)
    frames = positions[~np.isnan(positions).all(axis=(1, 2))]
    sample = frames[:: max(1, len(frames) // MOST_SAMPLES)][:, :, level]
    spread = np.nan_to_num(sample - np.nanmean(sample, axis=1, keepdims=True)).reshape(-1, 2) if len(sample) else sample
    _, axes = np.linalg.eigh(spread.reshape(-1, 2).T @ spread.reshape(-1, 2))
    angle = np.arctan2(axes[1, -1], axes[0, -1]) % np.pi + TURN  # of an axis and its opposite, one
    right, away = np.zeros((2, 3))
    right[level] = np.cos(angle), np.sin(angle)
    away[level] = -np.sin(angle), np.cos(angle)
    upwards = np.eye(3)["xyz".index(up)]
    return np.stack([right, np.cos(tilt) * upwards + np.sin(tilt) * away, np.cos(tilt) * away - np.sin(tilt) * upwards])
