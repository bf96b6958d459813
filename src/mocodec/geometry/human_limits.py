"""Joint limits of people, for a body whose skeleton has none: of knees and elbows.

    body ──limb_chains──► arms, legs ──which way is front──► frames of their hinges ──RANGES──► limits of links

Only places of joints are known, no axes. A knee or an elbow bends about the axis that it is bent about in the first
pose, or if it is straight, about the one that bends a knee backwards and an elbow forwards. Its angles are zero where
the limb is straight: Rx bends, Ry moves sideways, Rz twists. Hips and shoulders turn so far that limits of theirs have
not helped.
"""

from __future__ import annotations

import numpy as np

from ..typing import Floats
from . import joint_limits, limb_chains
from .articulation import Body
from .joint_limits import LimitedJoint, LinkLimits

RANGES = {"knee": ((-10, 155), (-15, 15), (-40, 40)), "elbow": ((-10, 155), (-70, 70), (-120, 120))}
"""Degrees by which people bend a joint, move it sideways and twist it. An elbow's axis turns with an upper arm, whose
twist its points hardly show: hence the wide range."""
LEG_WORDS = "leg", "thigh", "femur", "tibia", "shin", "knee", "calf", "ankle", "foot", "toe"
ARM_WORDS = "arm", "humerus", "shldr", "shoulder", "elbow", "radius", "ulna", "wrist", "hand"
SIDES = ("left", "right"), ("l", "r")
"""Words and first letters by which names tell left from right."""
BENT_RAD = 0.35
"""Angle from which the first pose shows about which axis a knee or an elbow bends, radians."""
MIN_SINE = 0.5
"""Sine of the angle between two directions from which both together determine a third one."""
KNEE_TURNED_OUT = -0.3
"""Cosine between the axes of a knee and of the hips, below which the knee would bend forwards."""


def of_body(body: Body) -> LinkLimits:
    """Limits of the links of a body with two arms and two legs, or two legs alone, widened to contain its first pose.

    Limbs are legs or arms by the names of their links, or else by their place: legs hang on the root. There are no
    limits where it is not known which side of the body is its front.
    """
    limbs = [chain for chain in limb_chains.chains(body) if len(chain) > 1]
    legs = [chain for chain in limbs if _is_leg(body, chain)]
    trunk = _trunk_frame(body, legs, [chain for chain in limbs if chain not in legs])
    if trunk is None:
        return joint_limits.NO_LIMITS
    joints = [_hinge(body, chain, trunk, chain in legs) for chain in limbs]
    return joint_limits.of_joints([joint for joint in joints if joint is not None])


def _is_leg(body: Body, chain: list[int]) -> bool:
    """Whether a chain of links is a leg, by the names of its links or else by its place."""
    names = " ".join(body.names[link].lower() for link in chain)
    named_leg, named_arm = (any(word in names for word in words) for words in (LEG_WORDS, ARM_WORDS))
    return named_leg if named_leg != named_arm else body.parents[chain[0]] == 0


def _trunk_frame(body: Body, legs: list[list[int]], arms: list[list[int]]) -> Floats | None:
    """(3, 3): columns are the directions to the left, up and to the front; None if they are unknown.

    Left is known by names, or else by the direction to which the feet point, or to which the knees bend.
    """
    if len(legs) != 2:
        return None
    hips = [leg[0] for leg in legs]
    trunk = [link for link, parent in enumerate(body.parents) if parent == 0 and link not in hips]
    above = [arm[0] for arm in arms] or trunk
    if not above:
        return None
    across = body.origins[hips[0]] - body.origins[hips[1]]
    up = body.origins[above].mean(axis=0) - body.origins[hips].mean(axis=0)
    front = np.cross(across, up)
    if np.linalg.norm(front) < MIN_SINE * np.linalg.norm(across) * np.linalg.norm(up) or not front.any():
        return None
    up, front = up / np.linalg.norm(up), front / np.linalg.norm(front)
    left = np.cross(up, front)
    sign = _named_side(body.names[hips[0]], body.names[hips[1]])
    if sign == 0:
        sign = float(np.sign(sum(body.axes[leg[2]] @ front for leg in legs if len(leg) > 2)))
    if sign == 0:
        sign = float(np.sign(sum(np.cross(body.axes[leg[0]], body.axes[leg[1]]) @ left for leg in legs)))
    return None if sign == 0 else np.stack([sign * left, up, sign * front], axis=1)


def _named_side(one: str, other: str) -> float:
    """1 if the first of two names is the left one, −1 if it is the right one, 0 if they do not tell."""
    one, other = one.lower(), other.lower()
    for left, right in SIDES:
        if left in one and one.replace(left, right, 1) == other:
            return 1.0
        if right in one and one.replace(right, left, 1) == other:
            return -1.0
    return 0.0


def _hinge(body: Body, chain: list[int], trunk: Floats, is_leg: bool) -> LimitedJoint | None:
    """The knee or elbow of a limb, None if its axis is unknown. trunk (3, 3): see `_trunk_frame`."""
    upper, lower = chain[:2]
    left, _, front = trunk.T
    first, second = body.axes[[upper, lower]]
    axis = np.cross(first, second)
    if np.arctan2(np.linalg.norm(axis), first @ second) > BENT_RAD and axis.any():
        if is_leg and axis @ left < KNEE_TURNED_OUT * np.linalg.norm(axis):
            return None
    else:
        axis = left if is_leg else np.cross(first, front)
        if np.linalg.norm(np.cross(axis, first)) < MIN_SINE:
            return None
    ranges = np.radians(np.array(RANGES["knee" if is_leg else "elbow"], float))
    return LimitedJoint(lower, _frame(axis, first), _frame(axis, second), ranges)


def _frame(x: Floats, z: Floats) -> Floats:
    """(3, 3): columns are the unit vector along x (3,) perpendicular to z, z × x, and the unit vector z (3,)."""
    across = x - (x @ z) * z
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(z, across), z], axis=1)
