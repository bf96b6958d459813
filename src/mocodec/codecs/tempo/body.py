"""The frame that follows the body: where it is, and which way it faces.

    positions (frames, points, 3), up first ──► place (frames, 3), heading (frames,), pose (frames, points, 3)
    pose = the points less their mean, turned back by the heading

Only the vertical axis and a mean pose are needed, so it works for any set of points: the heading of a frame is the
turn about the vertical that brings the mean pose nearest to it (the closed form of Procrustes analysis in a plane).
Axes here: y up, x and z level.
"""

from __future__ import annotations

import numpy as np

from ...motion import Floats


def level(positions: Floats, up: str) -> Floats:
    """Positions in axes with y up, right-handed."""
    if up == "y":
        return positions
    order = (1, 2, 0) if up == "z" else (2, 0, 1)
    return positions[..., order]


def unlevel(positions: Floats, up: str) -> Floats:
    """The inverse of `level`."""
    if up == "y":
        return positions
    order = (2, 0, 1) if up == "z" else (1, 2, 0)
    return positions[..., order]


def heading(centred: Floats, mean_pose: Floats) -> Floats:
    """The turn about y, radians, unwrapped, that brings the mean pose (points, 3) nearest to each frame."""
    x, z = centred[..., 0], centred[..., 2]
    cosine = x @ mean_pose[:, 0] + z @ mean_pose[:, 2]
    sine = x @ mean_pose[:, 2] - z @ mean_pose[:, 0]
    return np.unwrap(np.arctan2(sine, cosine))


def turn(points: Floats, angle: Floats) -> Floats:
    """Points (frames, points, 3) turned about y by an angle a frame, (frames,)."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    out = np.empty_like(points)
    out[..., 0] = c * points[..., 0] + s * points[..., 2]
    out[..., 1] = points[..., 1]
    out[..., 2] = c * points[..., 2] - s * points[..., 0]
    return out


def mean_pose(centred: Floats, rounds: int = 10) -> Floats:
    """The pose (points, 3) that is the mean of all frames, each turned to it (generalised Procrustes analysis)."""
    pose = centred[len(centred) // 2]
    for _ in range(rounds):
        pose = turn(centred, -heading(centred, pose)).mean(axis=0)
    return pose
