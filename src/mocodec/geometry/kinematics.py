"""Forward kinematics: where the joints are, given how each is turned against its parent.

    world turn of a joint  =  world turn of its parent · its own turn
    place of a joint       =  place of its parent + (world turn of the parent) applied to the joint's offset
"""

from __future__ import annotations

import numpy as np

from ..motion import Floats, Skeleton
from . import rigid


def forward(skeleton: Skeleton, rotations: Floats, root_positions: Floats, *, own_frame: bool = False) -> Floats:
    """Places of all joints (frames, joints, 3), metres: one pass over the joints, all frames at once.

    rotations (frames, joints, 4): from the parent's frame. root_positions (frames, 3): places of the roots' parent, so
    that a root stands at root_position + its offset. own_frame: a joint is the end of a bone that it turns itself
    (ASF/AMC): its offset is in its own frame, not in its parent's.
    """
    frames, joints = len(rotations), len(skeleton)
    positions = np.empty((frames, joints, 3))
    turns = np.empty((joints, frames, 4))
    for joint, parent in enumerate(skeleton.parents):
        own = rotations[:, joint]
        if parent < 0:
            positions[:, joint] = root_positions + skeleton.offsets[joint]
            turns[joint] = own
        else:
            turns[joint] = rigid.multiply(turns[parent], own)
            carrier = turns[joint if own_frame else parent]
            positions[:, joint] = positions[:, parent] + rigid.rotate(carrier, skeleton.offsets[joint])
    return positions
