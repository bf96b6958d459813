"""A mesh that shows a skeleton: an octahedron for each bone, skinned to the joint that turns it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...geometry import rigid
from ...typing import AnyInteger, Floats

WIDTH = 0.1
"""Half the thickness of a bone, as a share of its length."""
END_M = 0.02
"""Half the size of the octahedron at a joint without children."""
MIN_LENGTH_M = 1e-4
TRIANGLES = np.array([(0, 2, 1), (0, 3, 2), (0, 4, 3), (0, 1, 4), (5, 1, 2), (5, 2, 3), (5, 3, 4), (5, 4, 1)])
"""Triangles of an octahedron with the corners start, four around, end; counter-clockwise seen from outside."""


class Mesh(NamedTuple):
    """points (n, 3): metres, at rest. joints (n,): the joint that each follows. triangles (m, 3): indices of points."""

    points: Floats
    joints: AnyInteger
    triangles: AnyInteger


def mesh(rest: Floats, parents: Sequence[int]) -> Mesh:
    """Bones between joints that stand at `rest` (joints, 3); a joint that no bone begins at gets an octahedron."""
    starts, ends, owners = list[Floats](), list[Floats](), list[int]()
    for joint, parent in enumerate(parents):
        if parent >= 0 and np.linalg.norm(rest[joint] - rest[parent]) > MIN_LENGTH_M:
            starts.append(rest[parent])
            ends.append(rest[joint])
            owners.append(parent)
    lone = [joint for joint in range(len(rest)) if joint not in set(owners)]
    up = np.array([0.0, END_M, 0.0])
    start = np.array([*starts, *(rest[joint] - up for joint in lone)])
    end = np.array([*ends, *(rest[joint] + up for joint in lone)])
    axis = end - start
    length = np.linalg.norm(axis, axis=1)
    side = _perpendicular(axis / length[:, None])
    other = np.cross(axis / length[:, None], side)
    thick = np.concatenate([WIDTH * length[: len(owners)], np.full(len(lone), END_M)])[:, None]
    middle = start + np.concatenate([np.full(len(owners), 2 * WIDTH), np.full(len(lone), 0.5)])[:, None] * axis
    corners = [start, *(middle + thick * way for way in (side, other, -side, -other)), end]
    points = np.stack(corners, axis=1)
    triangles = TRIANGLES[None] + 6 * np.arange(len(points))[:, None, None]
    return Mesh(points.reshape(-1, 3), np.repeat([*owners, *lone], 6), triangles.reshape(-1, 3))


def _perpendicular(axes: Floats) -> Floats:
    """Unit vectors (n, 3) perpendicular to unit vectors: x turned as y turns to the axis."""
    half = np.concatenate([1 + axes[:, 1:2], np.cross(np.array([0.0, 1.0, 0.0]), axes)], axis=1)
    half = np.where(half[:, :1] < 1e-6, np.array([0.0, 1.0, 0.0, 0.0]), half)
    return rigid.rotate(half / np.linalg.norm(half, axis=1, keepdims=True), np.array([1.0, 0.0, 0.0]))
