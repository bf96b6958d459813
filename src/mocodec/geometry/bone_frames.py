"""Two ways to say what a joint's rotation moves, and exact conversion between them.

    own frame (ASF/AMC)   a joint is the END of a bone and its rotation moves itself: offset in its own frame
    usual (BVH, glTF, …)  a joint is where rotations happen, and its rotation moves its children: offset in its parent's

`to_starts`  own frame ─► usual: a joint at the start of each bone, with the bone's rotation, and an End Site at each
             leaf's end. Bones that begin in one point become joints at one place, offset zero.
`to_ends`    usual ─► own frame: a bone for each joint. Where children begin at different places, a bone of length
             zero carries the rotation and bones without rotation lead to the children, as hips do in CMU's skeletons.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import BadInput
from ..motion import Limits, Motion, Skeleton
from ..typing import Booleans, Floats
from . import kinematics, rigid

SAME_PLACE_M = 1e-9
"""Offsets that differ less than this are the same."""
STILL = 1e-9
"""Largest quaternion component of a rotation that is none."""
RIGID_M = 1e-4
"""A joint that moves farther than this against its parent has no fixed offset."""


def is_own_frame(motion: Motion) -> bool:
    """Whether the joints of a motion are ends of bones that rotate themselves (see `Skeleton`)."""
    return motion.skeleton is not None and motion.source.get("format") == "amc"


def to_starts(motion: Motion) -> Motion:
    """The usual form of a motion in own frames, with rotations; other motions are returned as they are.

    Its points are the starts of the bones, named as the bones, and the ends of the last ones, "<bone>_end". Positions
    that the original has agree within 1e-9 m. `source` keeps only what does not depend on the form.
    """
    skeleton, rotations = motion.skeleton, motion.rotations
    if skeleton is None or rotations is None or not is_own_frame(motion):
        return motion
    parents, bones = skeleton.parents, len(skeleton)
    has_child = set(parents)
    names: list[str] = []
    new_parents: list[int] = []
    offsets: list[Floats] = []
    of_bone: list[tuple[int, bool]] = []  # the bone of each joint, and whether it is the bone's end
    place: dict[int, int] = {}

    def visit(bone: int, parent: int) -> int:
        above = parents[bone]
        is_first = above < 0 or parents[above] < 0
        offsets.append(skeleton.offsets[bone] if above < 0 else np.zeros(3) if is_first else skeleton.offsets[above])
        names.append(skeleton.names[bone])
        new_parents.append(parent)
        of_bone.append((bone, False))
        return len(names) - 1

    children: list[list[int]] = [[] for _ in range(bones)]
    for bone, parent in enumerate(parents):
        if parent >= 0:
            children[parent].append(bone)
    stack = [bone for bone in range(bones - 1, -1, -1) if parents[bone] < 0]
    while stack:  # depth first
        bone = stack.pop()
        place[bone] = visit(bone, place[parents[bone]] if parents[bone] >= 0 else -1)
        if bone not in has_child and parents[bone] >= 0:
            names.append(f"{skeleton.names[bone]}_end")
            new_parents.append(place[bone])
            offsets.append(skeleton.offsets[bone])
            of_bone.append((bone, True))
        stack += children[bone][::-1]
    from_bone = [bone for bone, _ in of_bone]
    is_end = np.array([end for _, end in of_bone], bool)
    new_rotations = rotations[:, from_bone].copy()
    new_rotations[:, is_end] = rigid.IDENTITY
    starts = [bone if end or parents[bone] < 0 else parents[bone] for bone, end in of_bone]
    unique = _unique(names)
    return replace(
        motion,
        positions=motion.positions[:, starts],
        names=unique,
        skeleton=Skeleton(unique, tuple(new_parents), np.array(offsets), _limits(skeleton.limits, from_bone, is_end)),
        rotations=new_rotations,
        source=_plain_source(motion),
    )


def to_ends(motion: Motion) -> Motion:
    """A motion in own frames, root first; motions in own frames are returned as they are.

    Raises BadInput without skeleton and rotations, for more than one root, gaps, and joints that move against their
    parent: bones have one length.
    """
    skeleton, rotations = motion.skeleton, motion.rotations
    if is_own_frame(motion) and rotations is not None:
        return motion
    if skeleton is None or rotations is None:
        raise BadInput("this motion has no skeleton and rotations")
    roots = [joint for joint, parent in enumerate(skeleton.parents) if parent < 0]
    if len(roots) != 1:
        raise BadInput(f"an ASF has one root, this skeleton has {len(roots)}: {', '.join(_named(skeleton, roots))}")
    offsets = _fixed_offsets(motion, skeleton, rotations)
    bones = _Bones(skeleton.names[0], offsets[0])
    turns: Booleans = np.abs(rotations[..., 1:]).max(axis=(0, 2), initial=0.0) > STILL
    _grow(bones, skeleton, offsets, turns)
    from_joint = [joint for joint, _ in bones.of_joint]
    stiff = np.array([not carries for _, carries in bones.of_joint])
    new_rotations = rotations[:, from_joint].copy()
    new_rotations[:, stiff] = rigid.IDENTITY
    names = _unique(bones.names)
    limits = _limits(skeleton.limits, from_joint, stiff)
    own = Skeleton(names, tuple(bones.parents), np.array(bones.offsets), limits)
    root = motion.positions[:, 0] - own.offsets[0]
    return replace(
        motion,
        positions=kinematics.forward(own, new_rotations, root, own_frame=True),
        names=names,
        skeleton=own,
        rotations=new_rotations,
        source={**_plain_source(motion), "format": "amc", "channels": _channels(stiff)},
    )


class _Bones:
    """Bones in own frames while they are collected; the first is the root."""

    def __init__(self, root: str, offset: Floats) -> None:
        self.names, self.parents, self.offsets = [root], [-1], [offset]
        self.of_joint: list[tuple[int, bool]] = [(0, True)]  # joint, and whether the bone carries its rotation

    def add(self, name: str, parent: int, offset: Floats, joint: int, carries: bool) -> int:
        """Append a bone; returns its number."""
        self.names.append(name)
        self.parents.append(parent)
        self.offsets.append(offset)
        self.of_joint.append((joint, carries))
        return len(self.names) - 1


def _grow(bones: _Bones, skeleton: Skeleton, offsets: Floats, turns: Booleans) -> None:
    """Add the bones of all joints. `turns` (joints,): whether a joint ever rotates."""
    children: list[list[int]] = [[] for _ in skeleton.parents]
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            children[parent].append(joint)
    waiting = [(0, 0)]  # joints whose bone exists, and that bone
    while waiting:
        joint, bone = waiting.pop(0)
        carried = 0 if joint == 0 else bone
        below = children[joint]
        same = all(np.abs(offsets[c] - offsets[below[0]]).max() < SAME_PLACE_M for c in below)
        is_whole = joint != 0 and bool(below) and same
        if is_whole:
            bones.offsets[bone] = offsets[below[0]]
        for child in below:
            is_end = not children[child] and not turns[child]
            start = carried
            if not is_whole and np.abs(offsets[child]).max() >= SAME_PLACE_M:
                name = skeleton.names[child] if is_end else f"{skeleton.names[joint]}_{skeleton.names[child]}"
                start = bones.add(name, carried, offsets[child], child, False)
            elif is_end and (joint == 0 or len(below) > 1):
                bones.add(skeleton.names[child], carried, np.zeros(3), child, False)
            if not is_end:
                waiting.append((child, bones.add(skeleton.names[child], start, np.zeros(3), child, True)))


def _fixed_offsets(motion: Motion, skeleton: Skeleton, rotations: Floats) -> Floats:
    """The offsets of the skeleton. Raises BadInput for a joint that does not keep its own."""
    if motion.gaps.any():
        raise BadInput("bones cannot have gaps")
    root = motion.positions[:, 0] - skeleton.offsets[0]
    placed = kinematics.forward(skeleton, rotations, root)
    off = np.linalg.norm(placed - motion.positions, axis=2).max(axis=0, initial=0.0)
    moving = np.flatnonzero(off > RIGID_M * max(1.0, float(np.abs(skeleton.offsets).max(initial=0.0))))
    if len(moving):
        raise BadInput(
            f"joint {skeleton.names[moving[0]]} moves against its parent (up to {off[moving[0]] * 1000:.3g} mm), "
            "and bones of an ASF have one length"
        )
    return skeleton.offsets


def _limits(limits: Limits | None, joints: list[int], stiff: Booleans) -> Limits | None:
    """The limits of these joints; none of the stiff ones rotates."""
    if limits is None:
        return None
    ranges = limits.ranges[joints].copy()
    ranges[stiff] = 0.0
    return Limits(tuple(limits.orders[j] for j in joints), limits.axes[joints], ranges)


def _plain_source(motion: Motion) -> dict[str, object]:
    """The entries of `source` that hold for any form of the skeleton."""
    kept = ("first_frame", "time_of_frame_1", "notes", "rate_given")
    return {name: motion.source[name] for name in kept if name in motion.source}


def _channels(stiff: Booleans) -> list[str]:
    """Degrees of freedom as `source["channels"]` of an AMC lists them: of the root, then of each bone."""
    return ["XYZxyz", *("" if is_stiff else "xyz" for is_stiff in stiff[1:].tolist())]


def _named(skeleton: Skeleton, joints: list[int]) -> list[str]:
    return [skeleton.names[joint] for joint in joints]


def _unique(names: list[str]) -> tuple[str, ...]:
    """The names, with a number where one repeats another."""
    taken, result = set(names), list[str]()
    seen: set[str] = set()
    for name in names:
        number, chosen = 1, name
        while chosen in seen or (number > 1 and chosen in taken):
            number += 1
            chosen = f"{name}{number}"
        seen.add(chosen)
        result.append(chosen)
    return tuple(result)
