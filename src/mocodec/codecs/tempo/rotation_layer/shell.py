"""Shell points: three points at a set distance off each joint, along the axes of its frame, so that rotations count.

    local rotations, positions ─► world rotations ─► joints and shell points ─► errors

In AMC's convention a joint's frame is that of the bone that ends in it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .... import native
from ....geometry import rigid
from ....motion import Skeleton
from ....typing import Booleans, Floats


class Errors(NamedTuple):
    """joints (frames, joints): distances, metres; shell (frames, joints): largest of the three points; total: sum of
    the distances of joints and shell points."""

    joints: Floats
    shell: Floats
    total: float

    def beyond(self, bound: float | Floats) -> Booleans:
        """(frames, joints): whether a joint or one of its shell points is beyond the bound, or that of the joint."""
        return (self.joints > bound) | (self.shell > bound)

    @property
    def largest(self) -> float:
        return max(float(self.joints.max(initial=0.0)), float(self.shell.max(initial=0.0)))

    @property
    def mean(self) -> float:
        return self.total / max(4 * self.joints.size, 1)


def world_rotations(skeleton: Skeleton, local: Floats) -> Floats:
    """Rotations of joints against the world (frames, joints, 4), from those against their parents."""
    if (kernel := native.kernel("world_rotations")) is not None:
        return kernel(np.ascontiguousarray(local), np.array(skeleton.parents, np.int64))
    world = np.array(local)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            world[:, joint] = rigid.multiply(world[:, parent], local[:, joint])
    return world


def forward(skeleton: Skeleton, local: Floats, own_frame: bool) -> Floats:
    """Joint positions (frames, joints, 3) by forward kinematics, roots at their offsets."""
    world = world_rotations(skeleton, local)
    positions = np.empty((*local.shape[:2], 3))
    for joint, parent in enumerate(skeleton.parents):
        if parent < 0:
            positions[:, joint] = skeleton.offsets[joint]
        else:
            carrier = world[:, joint if own_frame else parent]
            positions[:, joint] = positions[:, parent] + rigid.rotate(carrier, skeleton.offsets[joint])
    return positions


def points(skeleton: Skeleton, local: Floats, positions: Floats, reach_m: float) -> Floats:
    """Joints and shell points (frames, joints, 4, 3), metres."""
    axes = np.moveaxis(rigid.to_matrix(world_rotations(skeleton, local)), -1, -2)
    return np.concatenate([positions[:, :, None], positions[:, :, None] + reach_m * axes], axis=2)


def errors(positions: Floats, world: Floats, positions_2: Floats, world_2: Floats, reach_m: float) -> Errors:
    """Distances between joints and shell points of two motions: positions (frames, joints, 3), world rotations
    (frames, joints, 4)."""
    if (kernel := native.kernel("shell_errors")) is not None:
        arrays = (np.ascontiguousarray(a) for a in (positions, world, positions_2, world_2))
        return Errors(*kernel(*arrays, reach_m))
    off = positions_2 - positions
    axes = np.moveaxis(rigid.to_matrix(world_2) - rigid.to_matrix(world), -1, -2)
    apart = off[:, :, None] + reach_m * axes
    joints = np.sqrt((off * off).sum(axis=-1))
    around = np.sqrt((apart * apart).sum(axis=-1))
    return Errors(joints, around.max(axis=-1), float(joints.sum() + around.sum()))


def angles(q: Floats, q_2: Floats) -> Floats:
    """Angles (…), radians, between rotations (…, 4), exact also for small ones."""
    near = np.where((q * q_2).sum(axis=-1, keepdims=True) < 0, -q_2, q_2)
    half = np.sqrt(((q - near) ** 2).sum(axis=-1)) / 2
    return 4 * np.arcsin(np.minimum(half, 1.0))
