"""Rotations of links as swing and twist.

A swing turns a link's axis; a twist, applied first, turns the link about its own axis. A swing moves the far end of
the link, a twist only the surface around the axis. So each can be quantised by what it moves, at any angle.
"""

from __future__ import annotations

import numpy as np

from ...geometry import articulation, cylinder_map
from ...geometry.articulation import Body
from ...typing import Floats


def link_frames(body: Body) -> Floats:
    """(links, 3, 3): orthonormal frames of the links, as rows: two directions across the link, then its axis."""
    return np.stack(cylinder_map.directions(body.origins, body.tips), axis=1)


def to_swing_twist(rotations: Floats, frame: Floats) -> Floats:
    """(frames, 3) radians: rotation vector of the swing about the two directions across the link, then the twist.

    rotations (frames, 3, 3): of one link over time. frame (3, 3): of `link_frames`. Consecutive frames differ by less
    than half a turn: angles are unwrapped.
    """
    w, x, y, z = articulation.quaternions(frame @ rotations @ frame.T).T
    half = np.arctan2(z, w)
    c, s = np.cos(half), np.sin(half)
    across = np.stack([x * c - y * s, x * s + y * c], axis=1)
    sine = np.linalg.norm(across, axis=1)
    angle = 2 * np.arctan2(sine, np.hypot(w, z))
    swing = across * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)[:, None]
    return np.concatenate([_unwrap_vectors(swing), np.unwrap(2 * half)[:, None]], axis=1)


def from_swing_twist(values: Floats, frames: Floats) -> Floats:
    """(…, 3, 3): the rotations of swings and twists (…, 3). frames (…, 3, 3): of `link_frames`."""
    swing, twist = np.zeros_like(values), np.zeros_like(values)
    swing[..., :2], twist[..., 2] = values[..., :2], values[..., 2]
    return transposed(frames) @ articulation.exp(swing) @ articulation.exp(twist) @ frames


def transposed(rotations: Floats) -> Floats:
    """(…, 3, 3): the inverse rotations."""
    return np.swapaxes(rotations, -1, -2)


def _unwrap_vectors(vectors: Floats) -> Floats:
    """Rotation vectors (frames, 2): of the equivalent ones, a full turn apart, the one nearest to the last frame's."""
    result = vectors.copy()
    angle = np.linalg.norm(vectors, axis=1)
    unit = vectors / np.maximum(angle, 1e-9)[:, None]

    def full_turns(frames: slice) -> Floats:
        last = result[frames.start - 1 : frames.stop - 1]
        return np.round((np.sum(last * unit[frames], axis=1) - angle[frames]) / (2 * np.pi))

    wrapped = np.flatnonzero(full_turns(slice(1, len(vectors))))  # vectors before the first of these stay as they are
    for frame in range(1 + wrapped[0] if len(wrapped) else len(vectors), len(vectors)):
        result[frame] += unit[frame] * (2 * np.pi * full_turns(slice(frame, frame + 1)))
    return result
