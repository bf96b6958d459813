"""Skeletal motions for tests: trees with limbs, hinges, hubs, end sites, zero offsets and placed joints."""

from __future__ import annotations

import numpy as np

from ..geometry import kinematics, rigid
from ..motion import Limits, Motion, Skeleton
from ..typing import Floats

PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 9, 8, 11, 12)
NAMES = ("hips", "l_hip", "l_knee", "l_foot", "r_hip", "r_knee", "r_foot", "spine", "chest", "l_arm", "l_hand",
         "r_arm", "r_elbow", "r_hand")  # fmt: skip
OFFSETS = np.array([
    [0, 0.9, 0], [0.1, -0.08, 0.02], [0, -0.42, 0], [0.02, -0.4, 0], [-0.1, -0.08, 0.02], [0, -0.42, 0], [0, -0.4, 0],
    [0, 0.12, 0], [0, 0.2, 0.02], [0.2, 0.15, 0], [0.28, 0, 0], [-0.2, 0.15, 0], [-0.28, 0, 0], [-0.25, 0, 0],
])  # fmt: skip
HINGES = {2: "x", 5: "x", 12: "y"}
"""Joints that rotate about one axis."""
LEAVES = (3, 6, 10, 13)


def curves(frames: int, count: int, seed: int, amplitude: float = 0.5) -> Floats:
    """Smooth curves (frames, count)."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2, frames)[:, None]
    return amplitude * rng.normal(0, 1, count) * np.sin(t * rng.uniform(1, 5, count) + rng.uniform(0, 6, count))


def figure(frames: int = 96, seed: int = 1, own_frame: bool = False) -> Motion:
    """A figure of 14 joints at 60 Hz with hinges at knees and an elbow; leaves rotate in their own frame only."""
    joints = len(NAMES)
    angles = curves(frames, 3 * joints, seed).reshape(frames, joints, 3)
    for joint, axis in HINGES.items():
        angles[:, joint, ["zxy".index(other) for other in "xyz" if other != axis]] = 0.0
        angles[:, joint, "zxy".index(axis)] += 1.0
    if not own_frame:
        angles[:, LEAVES] = 0.0
    rotations = rigid.from_euler("zxy", angles)
    limits = None
    if own_frame:
        ranges = np.tile([-np.inf, np.inf], (joints, 3, 1))
        for joint, axis in HINGES.items():
            ranges[joint, ["zxy".index(other) for other in "xyz" if other != axis]] = 0.0
        axes = np.tile([1.0, 0, 0, 0], (joints, 1))
        limits = Limits(("zxy",) * joints, axes, ranges)
    skeleton = Skeleton(NAMES, PARENTS, OFFSETS, limits)
    root = np.stack([np.linspace(0, 1, frames), curves(frames, 1, seed, 0.05)[:, 0], np.zeros(frames)], axis=1)
    positions = kinematics.forward(skeleton, rotations, root, own_frame=own_frame)
    source = {"format": "amc" if own_frame else "bvh", "units": "m", "unit_m": 1.0}
    return Motion(positions, 60.0, NAMES, "y", skeleton, rotations, source)


def with_translations(frames: int = 96) -> Motion:
    """The figure with a shoulder that slides and a leg that stretches."""
    motion = figure(frames, seed=3)
    assert motion.skeleton is not None
    assert motion.rotations is not None
    moving = {
        9: motion.skeleton.offsets[9] + curves(frames, 3, 7, 0.03),
        6: motion.skeleton.offsets[6] * (1.2 + curves(frames, 1, 8, 0.1)),
    }
    root = motion.positions[:, 0] - motion.skeleton.offsets[0]
    positions = kinematics.forward(motion.skeleton, motion.rotations, root, translations=moving)
    return Motion(positions, 60.0, NAMES, "y", motion.skeleton, motion.rotations, motion.source)


def tree(parents: tuple[int, ...], offsets: Floats, angles: Floats, own_frame: bool = False) -> Motion:
    """A motion of any tree, angles (frames, joints, 3) about z, x, y."""
    rotations = rigid.from_euler("zxy", angles)
    skeleton = Skeleton(tuple(f"j{j}" for j in range(len(parents))), parents, offsets)
    root = 0.1 * np.cumsum(np.ones((len(angles), 3)), axis=0) / len(angles)
    positions = kinematics.forward(skeleton, rotations, root, own_frame=own_frame)
    source = {"format": "amc", "units": "m", "unit_m": 1.0} if own_frame else {}
    return Motion(positions, 60.0, skeleton.names, "y", skeleton, rotations, source)
