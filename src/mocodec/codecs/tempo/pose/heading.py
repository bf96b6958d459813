"""The frame that follows the body: where it is and which way it faces.

    positions (frames, points, 3) ─to_y_up─► ──► place (frames, 3) · heading (frames,) · pose (frames, points, 3)
    pose = positions less their mean, rotated back by the heading

Only the vertical axis and a mean pose are needed, so this works for any set of points: the heading of a frame is the
rotation about the vertical that brings the mean pose nearest to it (Procrustes analysis in the plane, closed form).
Inside tempo y is up; x and z are horizontal.
"""

from __future__ import annotations

import numpy as np

from ....typing import Floats


def to_y_up(positions: Floats, up: str) -> Floats:
    """Positions in right-handed axes with y up."""
    if up == "y":
        return positions
    order = (1, 2, 0) if up == "z" else (2, 0, 1)
    return positions[..., order]


def from_y_up(positions: Floats, up: str) -> Floats:
    """The inverse of `to_y_up`."""
    if up == "y":
        return positions
    order = (2, 0, 1) if up == "z" else (1, 2, 0)
    return positions[..., order]


def heading(centred: Floats, mean_pose: Floats) -> Floats:
    """Rotation about y, radians, unwrapped, that brings the mean pose (points, 3) nearest to each frame."""
    return np.unwrap(_headings(centred[..., 0], centred[..., 2], mean_pose))


def _headings(x: Floats, z: Floats, mean_pose: Floats) -> Floats:
    cosine = x @ mean_pose[:, 0] + z @ mean_pose[:, 2]
    sine = x @ mean_pose[:, 2] - z @ mean_pose[:, 0]
    return np.arctan2(sine, cosine)


def rotate(points: Floats, angle: Floats) -> Floats:
    """Points (frames, points, 3) rotated about y by an angle a frame, (frames,), radians."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    out = np.empty_like(points)
    out[..., 0] = c * points[..., 0] + s * points[..., 2]
    out[..., 1] = points[..., 1]
    out[..., 2] = c * points[..., 2] - s * points[..., 0]
    return out


def align(centred: Floats, mean_pose: Floats) -> Floats:
    """Each frame rotated so that it faces the way the mean pose does."""
    return rotate(centred, -heading(centred, mean_pose))


def mean_pose(centred: Floats, rounds: int = 10) -> Floats:
    """The mean (points, 3) of all frames, each rotated to it (generalised Procrustes analysis)."""
    x, z = np.ascontiguousarray(centred[..., 0]), np.ascontiguousarray(centred[..., 2])
    height = centred[..., 1].mean(axis=0)
    pose = centred[len(centred) // 2]
    for _ in range(rounds):
        angle = _headings(x, z, pose)
        c, s = np.cos(angle) / len(centred), np.sin(angle) / len(centred)
        pose = np.stack([c @ x - s @ z, height, c @ z + s @ x], axis=1)
    return pose
