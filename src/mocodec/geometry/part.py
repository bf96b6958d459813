"""Some joints of a skeleton, with their rotations, where they are still a skeleton."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..motion import Limits, Skeleton
from ..typing import Floats
from . import kinematics


def part(skeleton: Skeleton, rotations: Floats | None, columns: Sequence[int]) -> tuple[Skeleton, Floats | None] | None:
    """Skeleton and rotations (frames, len(columns), 4) of these joints; None if they are no skeleton of their own.

    They are one if each joint comes after its parent, or none of the joints above it is among them: leaves or limbs
    may be left out, and a limb may stand alone, but no joint in between may be missing. The first joint of a limb that
    stands alone becomes a root, which rotates against the world.
    """
    place = {joint: i for i, joint in enumerate(columns)}
    parents: list[int] = []
    new_roots: list[int] = []
    for i, joint in enumerate(columns):
        above = skeleton.parents[joint]
        if above in place:
            parents.append(place[above])
        else:
            new_roots += [i] if above >= 0 else []
            while above >= 0 and above not in place:
                above = skeleton.parents[above]
            parents.append(-1)
        if above >= 0 and (above not in place or parents[-1] < 0 or place[above] >= i):
            return None
    chosen = list(columns)
    limits = skeleton.limits
    if limits is not None:
        ranges = limits.ranges[chosen].copy()
        ranges[new_roots] = -np.inf, np.inf
        limits = Limits(tuple(limits.orders[j] for j in chosen), limits.axes[chosen], ranges)
    names = tuple(skeleton.names[j] for j in chosen)
    if rotations is not None:
        world = kinematics.world_rotations(skeleton, rotations) if new_roots else rotations
        rotations = rotations[:, chosen]
        rotations[:, new_roots] = world[:, [chosen[i] for i in new_roots]]
    return Skeleton(names, tuple(parents), skeleton.offsets[chosen], limits), rotations
