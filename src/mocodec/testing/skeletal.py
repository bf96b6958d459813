"""Skeletal motions: random trees with smooth random rotations, in both conventions of `Skeleton`."""

from __future__ import annotations

import numpy as np

from ..geometry import kinematics, rigid
from ..motion import Motion, Skeleton
from ..typing import Floats


def random_skeleton(joints: int, seed: int, zeros: float = 0.0) -> Skeleton:
    """A tree of this many joints, named j0, j1, …; a share `zeros` of its offsets is zero."""
    rng = np.random.default_rng(seed)
    parents = (-1, *(int(rng.integers(max(0, j - 4), j)) for j in range(1, joints)))
    offsets = rng.normal(0, 0.3, (joints, 3))
    offsets[1:][rng.random(joints - 1) < zeros] = 0.0
    return Skeleton(tuple(f"j{j}" for j in range(joints)), parents, offsets)


def smooth_rotations(frames: int, joints: int, seed: int) -> Floats:
    """Rotations (frames, joints, 4) that turn slowly."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2, frames)[:, None, None]
    angles = rng.normal(0, 0.5, (joints, 3)) * np.sin(
        t * rng.uniform(1, 4, (joints, 3)) + rng.uniform(0, 6, (joints, 3))
    )
    return rigid.from_euler("zxy", angles)


def random_motion(
    joints: int = 9, frames: int = 24, seed: int = 1, own_frame: bool = False, zeros: float = 0.0
) -> Motion:
    """A skeletal motion at 120 Hz, y up."""
    skeleton = random_skeleton(joints, seed, zeros)
    rotations = smooth_rotations(frames, joints, seed)
    t = np.linspace(0, 2, frames)
    root = np.stack([0.3 * t, 0.05 * np.sin(6 * t), 0.1 * np.cos(t)], axis=1)
    positions = kinematics.forward(skeleton, rotations, root, own_frame=own_frame)
    source = {"format": "amc", "units": "ASF", "unit_m": 0.0254 / 0.45} if own_frame else {}
    return Motion(positions, 120.0, skeleton.names, "y", skeleton, rotations, source)
