"""A person of ordinary build, y up, facing +z, arms held a little away: the joints that a body is fitted from.

Each joint has a parent, a place in metres and the radius of the body where it ends; left is +x. Names are those of
CMU's BVH files.
"""

from __future__ import annotations

from typing import NamedTuple


class Joint(NamedTuple):
    parent: str
    place: tuple[float, float, float]
    radius: float


LEFT_AND_MIDDLE: dict[str, Joint] = {
    "Hips": Joint("", (0, 0.96, 0), 0.13),
    "LowerBack": Joint("Hips", (0, 1.03, 0), 0.125),
    "Spine": Joint("LowerBack", (0, 1.16, 0), 0.12),
    "Spine1": Joint("Spine", (0, 1.30, 0), 0.125),
    "Neck": Joint("Spine1", (0, 1.46, -0.01), 0.07),
    "Neck1": Joint("Neck", (0, 1.51, 0), 0.06),
    "Head": Joint("Neck1", (0, 1.56, 0.01), 0.085),
    "HeadTip": Joint("Head", (0, 1.68, 0.02), 0.095),
    "LeftShoulder": Joint("Spine1", (0.03, 1.40, 0), 0.09),
    "LeftArm": Joint("LeftShoulder", (0.17, 1.40, -0.01), 0.055),
    "LeftForeArm": Joint("LeftArm", (0.36, 1.21, -0.02), 0.042),
    "LeftHand": Joint("LeftForeArm", (0.53, 1.04, 0.01), 0.03),
    "LeftHandTip": Joint("LeftHand", (0.63, 0.93, 0.04), 0.035),
    "LHipJoint": Joint("Hips", (0, 0.96, 0), 0.0),
    "LeftUpLeg": Joint("LHipJoint", (0.10, 0.94, 0), 0.10),
    "LeftLeg": Joint("LeftUpLeg", (0.12, 0.50, 0.0), 0.06),
    "LeftFoot": Joint("LeftLeg", (0.13, 0.09, -0.02), 0.045),
    "LeftToeBase": Joint("LeftFoot", (0.14, 0.04, 0.10), 0.038),
    "LeftToeTip": Joint("LeftToeBase", (0.15, 0.03, 0.16), 0.03),
}
# besides from parent to child, the breadth of shoulders and hips: (from, to, radius, the joint that carries it)
BREADTHS = (("LeftArm", "RightArm", 0.085, "Spine1"), ("LeftUpLeg", "RightUpLeg", 0.115, "Hips"))


def joints() -> dict[str, Joint]:
    """Both sides: the right one has x negated and Right for Left in its names."""
    both = dict(LEFT_AND_MIDDLE)
    for name, (parent, (x, y, z), radius) in LEFT_AND_MIDDLE.items():
        if name.startswith(("Left", "LHip")):
            name, parent = (n.replace("Left", "Right").replace("LHip", "RHip") for n in (name, parent))
            both[name] = Joint(parent, (-x, y, z), radius)
    return both


def bones() -> list[tuple[str, str, float, float, str]]:
    """(from, to, radius at either end, the joint that carries it) of every part of the body that has flesh on it."""
    stock = joints()
    result = list[tuple[str, str, float, float, str]]()
    for name, joint in stock.items():
        if joint.parent and joint.radius and not name.endswith(("Shoulder", "UpLeg")):
            near = stock[joint.parent].radius or 0.09
            result.append((joint.parent, name, near, joint.radius, joint.parent))
    return result + [(a, b, radius, radius, carrier) for a, b, radius, carrier in BREADTHS]
