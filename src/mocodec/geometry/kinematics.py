"""Forward kinematics: joint positions from joint rotations.

world rotation of a joint  =  world rotation of its parent · its own rotation
position of a joint        =  position of its parent + its offset, rotated by the world rotation of the parent
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .. import native
from ..motion import Skeleton
from ..typing import Floats
from . import rigid


def forward(
    skeleton: Skeleton,
    rotations: Floats,
    root_positions: Floats,
    *,
    own_frame: bool = False,
    translations: Mapping[int, Floats] | None = None,
) -> Floats:
    """Positions of all joints (frames, joints, 3), metres.

    rotations (frames, joints, 4): quaternions against the parent. root_positions (frames, 3): added to the offset of
    each root. own_frame: a joint is the end of the bone that it rotates (ASF/AMC), so its offset is in its own frame
    and not in its parent's. translations: by joint, (frames, 3) in place of the offset, for joints that move against
    their parent (BVH with position channels).
    """
    moving = translations or {}
    if not moving and (kernel := native.kernel("forward_kinematics")) is not None:
        arrays = (rotations, root_positions, np.array(skeleton.parents, np.int64), skeleton.offsets)
        return kernel(*map(np.ascontiguousarray, arrays), own_frame)
    frames, joints = len(rotations), len(skeleton)
    positions = np.empty((frames, joints, 3))
    world = np.empty((joints, frames, 4))  # rotations
    for joint, parent in enumerate(skeleton.parents):
        own = rotations[:, joint]
        offset = moving[joint] if joint in moving else skeleton.offsets[joint]
        if parent < 0:
            positions[:, joint] = root_positions + offset
            world[joint] = own
        else:
            world[joint] = rigid.multiply(world[parent], own)
            carrier = world[joint if own_frame else parent]
            positions[:, joint] = positions[:, parent] + rigid.rotate(carrier, offset)
    return positions


def world_rotations(skeleton: Skeleton, rotations: Floats) -> Floats:
    """Rotations of joints against the world (frames, joints, 4), from those against their parents (frames, joints,
    4).
    """
    world = np.array(rotations)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            world[:, joint] = rigid.multiply(world[:, parent], rotations[:, joint])
    return world
