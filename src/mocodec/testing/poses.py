"""Standing and seated poses of an actor by name, one frame each: input for finding a first pose."""

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
SEAT = (FORWARD + 0.12 * OUT, DOWN + 0.05 * OUT)
TRUNK = ("LowerBack", "Spine", "Spine1")
"""Joints that share a turn of the trunk."""
# by name, what `posed` takes: limbs of the left side, of the right side, and the turn of the trunk
POSES: dict[str, tuple[Limbs, Limbs | None, Floats | None]] = {
    "arms hanging": ((DOWN + 0.2 * OUT, DOWN + 0.15 * OUT + 0.2 * FORWARD, *STAND), None, None),
    "A": ((DOWN + OUT, DOWN + OUT, *STAND), None, None),
    "T": ((OUT, OUT, *STAND), None, None),
    "arms raised": ((UP + 0.5 * OUT, UP + 0.1 * OUT, *STAND), None, None),
    "arms forward": ((FORWARD + 0.1 * OUT, FORWARD, *STAND), None, None),
    "one arm up": ((UP + 0.4 * OUT, UP, *STAND), (DOWN - 0.3 * OUT, DOWN - 0.2 * OUT + 0.3 * FORWARD, *STAND), None),
    "hands on hips": ((DOWN + 0.9 * OUT - 0.2 * FORWARD, 0.45 * DOWN - 0.6 * OUT + 0.35 * FORWARD, *STAND), None, None),
    "waving": ((OUT, UP + 0.2 * OUT, *STAND), (DOWN - 0.25 * OUT, DOWN - 0.15 * OUT, *STAND), None),
    "walking": (
        (DOWN + 0.45 * FORWARD + 0.15 * OUT, DOWN + 0.9 * FORWARD, DOWN - 0.35 * FORWARD, DOWN - 0.7 * FORWARD),
        (DOWN - 0.4 * FORWARD - 0.15 * OUT, DOWN - 0.1 * FORWARD, DOWN + 0.5 * FORWARD, DOWN + 0.2 * FORWARD),
        None,
    ),
    "legs apart": ((OUT + 0.3 * UP, OUT + 0.5 * UP, DOWN + 0.5 * OUT, DOWN + 0.5 * OUT), None, None),
    "slight crouch": (
        (
            DOWN + 0.5 * FORWARD + 0.2 * OUT,
            FORWARD + 0.3 * DOWN,
            DOWN + 0.9 * FORWARD + 0.15 * OUT,
            DOWN - 0.6 * FORWARD,
        ),
        None,
        None,
    ),
    "arms folded": ((DOWN + 0.2 * OUT + 0.3 * FORWARD, 0.1 * UP - OUT + 0.6 * FORWARD, *STAND), None, None),
    "seated, hands on thighs": ((DOWN + 0.35 * FORWARD + 0.1 * OUT, FORWARD + 0.45 * DOWN, *SEAT), None, None),
    "seated, arms hanging": ((DOWN + 0.25 * OUT, DOWN + 0.2 * OUT + 0.1 * FORWARD, *SEAT), None, None),
    "seated, one leg stretched": (
        (DOWN + 0.3 * FORWARD + 0.2 * OUT, FORWARD + 0.2 * UP, FORWARD + 0.2 * DOWN, FORWARD + 0.5 * DOWN),
        (DOWN + 0.3 * FORWARD - 0.2 * OUT, FORWARD + 0.5 * DOWN, FORWARD - 0.2 * OUT, DOWN + 0.1 * FORWARD),
        None,
    ),
    "seated, leaning forward": (
        (DOWN + 0.6 * FORWARD + 0.1 * OUT, FORWARD + 0.3 * DOWN, *SEAT),
        None,
        np.array([0.5, 0, 0]),
    ),
    "seated, turned": ((DOWN + 0.3 * FORWARD + 0.2 * OUT, FORWARD + 0.2 * OUT, *SEAT), None, np.array([0, 0.7, 0])),
    "turned": ((DOWN + 0.5 * OUT, FORWARD + 0.4 * DOWN, *STAND), None, np.array([0, 0.8, 0])),
    "turned, looking back": (
        (DOWN + 0.3 * OUT, DOWN + 0.3 * FORWARD, DOWN + 0.3 * FORWARD, DOWN - 0.1 * FORWARD),
        (DOWN - 0.6 * OUT, FORWARD - 0.2 * OUT, DOWN - 0.2 * FORWARD, DOWN - 0.5 * FORWARD),
        np.array([0.1, -0.9, 0]),
    ),
}


def posed(actor: Actor, limbs: Limbs, right: Limbs | None = None, trunk: Floats | None = None) -> Performance:
    """One frame of the actor with its limbs in these directions, hips facing +z.

    limbs: of the left side; right: of the right side, or None for the mirror image of the left. trunk (3,): rotation
    vector of the trunk above the hips, radians, shared by the joints of TRUNK; arms turn with it.
    """
    turns = np.zeros((1, len(actor.names), 3, 3))
    mirror = np.array([-1.0, 1, 1])
    turn = np.zeros(3) if trunk is None else trunk
    whole, part = articulation.exp(turn), articulation.exp(turn / sum(name in TRUNK for name in actor.names))
    wanted = dict[str, Floats]()
    for side, directions in (("Left", limbs), ("Right", right or tuple(mirror * direction for direction in limbs))):
        for (joint, _), direction in zip(LIMB_BONES, directions, strict=True):
            above = whole if "Arm" in joint else np.eye(3)
            wanted[side + joint] = above @ direction / np.linalg.norm(direction)
    ends = dict(LIMB_BONES)
    for joint, (name, parent) in enumerate(zip(actor.names, actor.parents, strict=True)):
        above = turns[0, joint] = turns[0, parent] if parent >= 0 else np.eye(3)
        if name in wanted:
            side = "Left" if name.startswith("Left") else "Right"
            end = actor.names.index(side + ends[name.removeprefix(side)])
            bone = (whole if "Arm" in name else np.eye(3)) @ (actor.joints[end] - actor.joints[joint])
            onto = articulation.rotation_between(bone / np.linalg.norm(bone), wanted[name])
            turns[0, joint] = onto @ (whole if "Arm" in name else np.eye(3))
        elif name in TRUNK:
            turns[0, joint] = above @ part
        elif name in ("LeftFoot", "RightFoot"):
            turns[0, joint] = np.eye(3)
    return Performance(actor, turns, actor.joints[:1].copy(), 15.0)
