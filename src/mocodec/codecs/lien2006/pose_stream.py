"""Poses as integers: the root's translation and each joint's rotation vector, in steps.

The step of a joint is an angle: the farther the body reaches from the joint, the smaller. So a rotation by one step
moves the farthest link end by REACH_STEP_M, at every joint.
"""

from __future__ import annotations

import numpy as np

from ...geometry import articulation
from ...geometry.articulation import Body, Pose
from ...typing import Floats, Integers

REACH_STEP_M = 0.002  # how far a rotation by one step moves the farthest link end
ROOT_STEP_M = 0.002
MIN_LEVER_M = 0.05
MAX_STEPS = 10**8


def pose_width(links: int) -> int:
    """Integers of a pose."""
    return 3 + 3 * links


def joint_steps(body: Body) -> Floats:
    """(links,): radians of one step of each joint."""
    ends = np.concatenate([body.origins, body.tips])
    distance = np.linalg.norm(ends[None] - body.origins[:, None], axis=2)
    lever = np.where(np.tile(body.ancestors, (1, 2)), distance, 0.0).max(axis=1)
    return REACH_STEP_M / np.maximum(lever, MIN_LEVER_M)


def quantise(body: Body, poses: Pose) -> Integers:
    """(frames, 3 + 3 links): poses in steps; rotations (frames, links, 3, 3), root (frames, 3).

    Each joint corrects the rounding of the joints above it: it rotates its link to the link's world orientation in
    its pose. A rotation has many vectors, a full turn apart; the one nearest to that of the frame before is taken.
    """
    steps = joint_steps(body)
    target, _ = articulation.transforms(body, poses)
    decoded = np.empty_like(target)
    integers = np.empty((*target.shape[:2], 3), np.int64)
    for link, parent in enumerate(body.parents):
        above = decoded[:, parent] if parent >= 0 else np.broadcast_to(np.eye(3), target[:, link].shape)
        vectors = articulation.log(above.swapaxes(-1, -2) @ target[:, link])
        integers[:, link] = _nearest_turns(vectors, steps[link])
        decoded[:, link] = above @ articulation.exp(integers[:, link] * steps[link])
    root = np.round(poses.root / ROOT_STEP_M).astype(np.int64)
    return np.concatenate([root, integers.reshape(len(root), -1)], axis=1)


def _nearest_turns(vectors: Floats, step: float) -> Integers:
    """(frames, 3): rotation vectors (frames, 3) in steps, each with the number of full turns that brings it nearest to
    that of the frame before; the first to zero.
    """
    angles = np.linalg.norm(vectors, axis=1)
    units = vectors / np.maximum(angles, 1e-9)[:, None]
    integers = np.round(vectors / step).astype(np.int64)
    before = np.concatenate([np.zeros((1, 3)), integers[:-1] * step])
    turns = np.round((np.einsum("fi,fi->f", before, units) - angles) / (2 * np.pi))
    turning = np.flatnonzero((turns != 0) & (angles > 1e-9))
    # as long as no frame has a full turn, each one's turns follow from the frame before as it is
    for frame in range(turning[0], len(vectors)) if len(turning) else ():
        if angles[frame] > 1e-9:
            last = integers[frame - 1] * step if frame else np.zeros(3)
            turn = np.round((last @ units[frame] - angles[frame]) / (2 * np.pi))
            integers[frame] = np.round(units[frame] * (angles[frame] + 2 * np.pi * turn) / step)
    return integers


def dequantise(body: Body, integers: Integers) -> Pose:
    """The pose of integers (3 + 3 links,)."""
    values = np.clip(integers, -MAX_STEPS, MAX_STEPS).astype(np.float64)
    vectors = values[3:].reshape(-1, 3) * joint_steps(body)[:, None]
    return Pose(articulation.exp(vectors), values[:3] * ROOT_STEP_M)
