"""A person of ordinary build, y up, facing +z, arms held a little away: what a body is fitted from.

Each joint has a parent, a place in metres and the radius of the body where it ends; left is +x. Names are those of
CMU's BVH files. Other people are the same joints with other proportions: factors of BUILD.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import articulation
from .articulation import Body, Floats

Ints = NDArray[Any]


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


BUILD = {
    "legs": ("Leg", "Foot", "ToeBase", "ToeTip"), "arms": ("ForeArm", "Hand", "HandTip"),
    "trunk": ("LowerBack", "Spine", "Spine1", "Neck"), "head": ("Neck1", "Head", "HeadTip"),
    "breadth": ("Shoulder", "Arm", "UpLeg"), "girth": (),
}  # fmt: skip
"""The proportions that people differ by: the joints whose distance from their parents each scales; girth scales the
radii, but for the head's."""


@dataclass(frozen=True, eq=False)
class Flesh:
    """Capsules (c,) of the stock body, each carried by a link and reaching between two joints; and places (m,) on them.

    link (c,), ends (c, 2): joints. radii (c, 2). scales (joints,), (c,): which proportion scales a joint's distance
    from its parent, and a capsule's radii. part (m,), shares (m,), out (m, 3): the capsule of each place, how far
    along, and the way out of it in the stock body's pose. Places inside another capsule are left out.
    """

    body: Body
    parents: tuple[int, ...]
    stock: Floats
    link: Ints
    ends: Ints
    stock_radii: Floats
    joint_scales: Ints
    radius_scales: Ints
    part: Ints
    shares: Floats
    out: Floats

    def places(self, build: Floats) -> Floats:
        """(…, joints, 3): the joints of people of these builds (…, BUILD), hips at the stock body's height times the
        legs' factor."""
        places = np.empty((*build.shape[:-1], *self.stock.shape))
        for joint, parent in enumerate(self.parents):
            factor = build[..., self.joint_scales[joint], None]
            above = places[..., parent, :] if parent >= 0 else 0.0
            places[..., joint, :] = above + factor * (self.stock[joint] - (self.stock[parent] if parent >= 0 else 0.0))
        return places

    def radii(self, build: Floats) -> Floats:
        """(…, c, 2)."""
        return self.stock_radii * build[..., self.radius_scales, None]

    def surface(self, a: Floats, ends: Floats, radii: Floats) -> tuple[Floats, Floats]:
        """(…, m, 3) each: the places, and the ways out there, of capsules whose links are turned by a (…, links, 3, 3)
        and whose ends are at (…, c, 2, 3)."""
        out = np.einsum("...mij,mj->...mi", a[..., self.link[self.part], :, :], self.out)
        p, q, r = ends[..., self.part, 0, :], ends[..., self.part, 1, :], radii[..., self.part, :]
        share = self.shares[:, None]
        return p + share * (q - p) + (r[..., :1] + share * (r[..., 1:] - r[..., :1])) * out, out


@cache
def flesh(places_each: int = 16) -> Flesh:
    """The stock body's links and capsules."""
    from .capsules import gaps

    stock = joints()
    names = tuple(stock)
    parents = tuple(names.index(joint.parent) if joint.parent else -1 for joint in stock.values())
    places = np.array([joint.place for joint in stock.values()], float)
    body = articulation.from_skeleton(names, parents, places)
    link_of = np.zeros(len(names), np.int64)
    for joint in range(len(names)):
        link_of[joint] = body.joints.index(joint) if joint in body.joints else link_of[max(parents[joint], 0)]
    parts = bones()
    ends = np.array([[names.index(start), names.index(stop)] for start, stop, *_ in parts])
    radii = np.array([[near, far] for _, _, near, far, _ in parts])
    link = np.array([link_of[names.index(carrier)] for *_, carrier in parts])
    build = list(BUILD)
    bare = [name.removeprefix("Left").removeprefix("Right") for name in names]
    scales = [next((i for i, of in enumerate(BUILD.values()) if name in of), 0) for name in bare]
    of_radii = [build.index("head" if stop == "HeadTip" else "girth") for _, stop, *_ in parts]
    rng = np.random.default_rng(2)
    part = np.repeat(np.arange(len(parts)), places_each)
    shares, out = rng.random(len(part)), rng.normal(size=(len(part), 3))
    axis = (places[ends[:, 1]] - places[ends[:, 0]])[part]
    out -= np.sum(out * axis, axis=1, keepdims=True) * axis / np.sum(axis**2, axis=1, keepdims=True)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    radius = radii[part, 0] + shares * (radii[part, 1] - radii[part, 0])
    points = places[ends[part, 0]] + shares[:, None] * axis + radius[:, None] * out
    outside = gaps(points, places[ends][None], radii[None], signed=True)[0] > -0.01
    return Flesh(
        body, parents, places, link, ends, radii, np.array(scales), np.array(of_radii), part[outside], shares[outside],
        out[outside],
    )  # fmt: skip
