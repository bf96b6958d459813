"""Standing poses of an actor by name, one frame each: input for finding a first pose."""

from __future__ import annotations

import numpy as np

from ..geometry import articulation
from ..typing import Floats
from .actors import Actor
from .sequences import Performance

JOINTS = (
    "Hips", "Neck", "LeftArm", "LeftForeArm", "LeftHand", "RightArm", "RightForeArm", "RightHand", "LeftUpLeg",
    "LeftLeg", "LeftFoot", "RightUpLeg", "RightLeg", "RightFoot",
)  # fmt: skip
LIMB_BONES = (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("UpLeg", "Leg"), ("Leg", "Foot"))
"""Start and end joints of the limbs' bones, without the side."""
DOWN, OUT, FORWARD, UP = np.array([0, -1.0, 0]), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), np.array([0, 1.0, 0])
Limbs = tuple[Floats, Floats, Floats, Floats]
"""Directions of upper arm, forearm, thigh and shin."""
STAND = (DOWN + 0.08 * OUT, DOWN + 0.06 * OUT)
POSES: dict[str, tuple[Limbs, Limbs | None]] = {
    "arms hanging": ((DOWN + 0.2 * OUT, DOWN + 0.15 * OUT + 0.2 * FORWARD, *STAND), None),
    "A": ((DOWN + OUT, DOWN + OUT, *STAND), None),
    "T": ((OUT, OUT, *STAND), None),
    "arms raised": ((UP + 0.5 * OUT, UP + 0.1 * OUT, *STAND), None),
    "arms forward": ((FORWARD + 0.1 * OUT, FORWARD, *STAND), None),
    "one arm up": ((UP + 0.4 * OUT, UP, *STAND), (DOWN - 0.3 * OUT, DOWN - 0.2 * OUT + 0.3 * FORWARD, *STAND)),
    "hands on hips": ((DOWN + 0.9 * OUT - 0.2 * FORWARD, 0.45 * DOWN - 0.6 * OUT + 0.35 * FORWARD, *STAND), None),
    "waving": ((OUT, UP + 0.2 * OUT, *STAND), (DOWN - 0.25 * OUT, DOWN - 0.15 * OUT, *STAND)),
    "walking": (
        (DOWN + 0.45 * FORWARD + 0.15 * OUT, DOWN + 0.9 * FORWARD, DOWN - 0.35 * FORWARD, DOWN - 0.7 * FORWARD),
        (DOWN - 0.4 * FORWARD - 0.15 * OUT, DOWN - 0.1 * FORWARD, DOWN + 0.5 * FORWARD, DOWN + 0.2 * FORWARD),
    ),
    "legs apart": ((OUT + 0.3 * UP, OUT + 0.5 * UP, DOWN + 0.5 * OUT, DOWN + 0.5 * OUT), None),
    "slight crouch": (
        (
            DOWN + 0.5 * FORWARD + 0.2 * OUT,
            FORWARD + 0.3 * DOWN,
            DOWN + 0.9 * FORWARD + 0.15 * OUT,
            DOWN - 0.6 * FORWARD,
        ),
        None,
    ),
    "arms folded": ((DOWN + 0.2 * OUT + 0.3 * FORWARD, 0.1 * UP - OUT + 0.6 * FORWARD, *STAND), None),
}


def posed(actor: Actor, limbs: Limbs, right: Limbs | None = None) -> Performance:
    """One frame of the actor with its limbs in these directions, facing +z; the trunk stays in the bind pose.

    limbs: of the left side; right: of the right side, or None for the mirror image of the left.
    """
    turns = np.zeros((1, len(actor.names), 3, 3))
    mirror = np.array([-1.0, 1, 1])
    wanted = dict[str, Floats]()
    for side, directions in (("Left", limbs), ("Right", right or tuple(mirror * direction for direction in limbs))):
        for (joint, _), direction in zip(LIMB_BONES, directions, strict=True):
            wanted[side + joint] = direction / np.linalg.norm(direction)
    ends = dict(LIMB_BONES)
    for joint, (name, parent) in enumerate(zip(actor.names, actor.parents, strict=True)):
        turns[0, joint] = turns[0, parent] if parent >= 0 else np.eye(3)
        if name in wanted:
            side = "Left" if name.startswith("Left") else "Right"
            end = actor.names.index(side + ends[name.removeprefix(side)])
            bone = actor.joints[end] - actor.joints[joint]
            turns[0, joint] = articulation.rotation_between(bone / np.linalg.norm(bone), wanted[name])
        elif name in ("LeftFoot", "RightFoot"):
            turns[0, joint] = np.eye(3)
    return Performance(actor, turns, actor.joints[:1].copy(), 15.0)
