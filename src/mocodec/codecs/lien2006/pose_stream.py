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


def quantise(body: Body, pose: Pose, previous: Integers) -> Integers:
    """(3 + 3 links,): the pose in steps. previous: the integers of the frame before.

    Each joint corrects the rounding of the joints above it: it rotates its link to the link's world orientation in
    `pose`. A rotation has many vectors, a full turn apart; the one nearest to the previous frame's is taken.
    """
    steps = joint_steps(body)
    target, _ = articulation.transforms(body, pose)
    decoded = np.empty_like(target)
    integers = np.empty((len(body), 3), np.int64)
    for link, parent in enumerate(body.parents):
        above = decoded[parent] if parent >= 0 else np.eye(3)
        vector = articulation.log(above.T @ target[link])
        last = previous[3 + 3 * link : 6 + 3 * link] * steps[link]
        angle = float(np.linalg.norm(vector))
        if angle > 1e-9:
            unit = vector / angle
            vector = unit * (angle + 2 * np.pi * round((float(last @ unit) - angle) / (2 * np.pi)))
        integers[link] = np.round(vector / steps[link])
        decoded[link] = above @ articulation.exp(integers[link] * steps[link])
    return np.concatenate([np.round(pose.root / ROOT_STEP_M).astype(np.int64), integers.ravel()])


def dequantise(body: Body, integers: Integers) -> Pose:
    """The pose of integers (3 + 3 links,)."""
    values = np.clip(integers, -MAX_STEPS, MAX_STEPS).astype(np.float64)
    vectors = values[3:].reshape(-1, 3) * joint_steps(body)[:, None]
    return Pose(articulation.exp(vectors), values[:3] * ROOT_STEP_M)
