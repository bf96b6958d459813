"""Forward kinematics: where the joints are, given how each is turned against its parent.

world turn of a joint  =  world turn of its parent · its own turn
place of a joint       =  place of its parent + (world turn of the parent) applied to the joint's offset
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..motion import Floats, Skeleton
from . import rigid


def forward(
    skeleton: Skeleton,
    rotations: Floats,
    root_positions: Floats,
    *,
    own_frame: bool = False,
    translations: Mapping[int, Floats] | None = None,
) -> Floats:
    """Places of all joints (frames, joints, 3), metres: one pass over the joints, all frames at once.

    rotations (frames, joints, 4): from the parent's frame. root_positions (frames, 3): places of the roots' parent, so
    that a root stands at root_position + its offset. own_frame: a joint is the end of a bone that it turns itself
    (ASF/AMC): its offset is in its own frame, not in its parent's. translations: joint to (frames, 3), for joints that
    slide against their parent (BVH with positions): these stand in the place of the joint's offset.
    """
    sliding = translations or {}
    frames, joints = len(rotations), len(skeleton)
    positions = np.empty((frames, joints, 3))
    turns = np.empty((joints, frames, 4))
    for joint, parent in enumerate(skeleton.parents):
        own = rotations[:, joint]
        offset = sliding[joint] if joint in sliding else skeleton.offsets[joint]
        if parent < 0:
            positions[:, joint] = root_positions + offset
            turns[joint] = own
        else:
            turns[joint] = rigid.multiply(turns[parent], own)
            carrier = turns[joint if own_frame else parent]
            positions[:, joint] = positions[:, parent] + rigid.rotate(carrier, offset)
    return positions


def world_rotations(skeleton: Skeleton, rotations: Floats) -> Floats:
    """Turns against the world (frames, joints, 4) of joints that are given as turned against their parents."""
    turns = np.array(rotations)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            turns[:, joint] = rigid.multiply(turns[:, parent], rotations[:, joint])
    return turns
