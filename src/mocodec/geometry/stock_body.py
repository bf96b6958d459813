"""A person of average build as capsules between joints: the model that a first pose is fitted with.

The person faces +z, with y up and +x to the left, the arms a little away from the trunk. Joint names are those of CMU's
BVH files. Other people have the same joints in other proportions: factors of PROPORTIONS.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from ..typing import AnyInteger, Floats
from . import articulation
from .articulation import Body
from .capsules import surface_distances


class StockJoint(NamedTuple):
    """A joint's parent ("" for the root), its position in metres, and the body's radius at it, metres; 0 for none."""

    parent: str
    position: tuple[float, float, float]
    radius: float


LEFT_AND_MIDDLE: dict[str, StockJoint] = {
    "Hips": StockJoint("", (0, 0.96, 0), 0.13),
    "LowerBack": StockJoint("Hips", (0, 1.03, 0), 0.125),
    "Spine": StockJoint("LowerBack", (0, 1.16, 0), 0.12),
    "Spine1": StockJoint("Spine", (0, 1.30, 0), 0.125),
    "Neck": StockJoint("Spine1", (0, 1.46, -0.01), 0.07),
    "Neck1": StockJoint("Neck", (0, 1.51, 0), 0.06),
    "Head": StockJoint("Neck1", (0, 1.56, 0.01), 0.085),
    "HeadTip": StockJoint("Head", (0, 1.68, 0.02), 0.095),
    "LeftShoulder": StockJoint("Spine1", (0.03, 1.40, 0), 0.09),
    "LeftArm": StockJoint("LeftShoulder", (0.17, 1.40, -0.01), 0.055),
    "LeftForeArm": StockJoint("LeftArm", (0.36, 1.21, -0.02), 0.042),
    "LeftHand": StockJoint("LeftForeArm", (0.53, 1.04, 0.01), 0.03),
    "LeftHandTip": StockJoint("LeftHand", (0.63, 0.93, 0.04), 0.035),
    "LHipJoint": StockJoint("Hips", (0, 0.96, 0), 0.0),
    "LeftUpLeg": StockJoint("LHipJoint", (0.10, 0.94, 0), 0.10),
    "LeftLeg": StockJoint("LeftUpLeg", (0.12, 0.50, 0.0), 0.06),
    "LeftFoot": StockJoint("LeftLeg", (0.13, 0.09, -0.02), 0.045),
    "LeftToeBase": StockJoint("LeftFoot", (0.14, 0.04, 0.10), 0.038),
    "LeftToeTip": StockJoint("LeftToeBase", (0.15, 0.03, 0.16), 0.03),
}
# capsules across shoulders and hips, not from parent to child: (from, to, radius, the joint that carries the capsule)
CROSS_CAPSULES = (("LeftArm", "RightArm", 0.085, "Spine1"), ("LeftUpLeg", "RightUpLeg", 0.115, "Hips"))


def joints() -> dict[str, StockJoint]:
    """All joints by name: those of LEFT_AND_MIDDLE, and the left ones mirrored to the right."""
    both = dict(LEFT_AND_MIDDLE)
    for name, (parent, (x, y, z), radius) in LEFT_AND_MIDDLE.items():
        if name.startswith(("Left", "LHip")):
            name, parent = (n.replace("Left", "Right").replace("LHip", "RHip") for n in (name, parent))
            both[name] = StockJoint(parent, (-x, y, z), radius)
    return both


def bones() -> list[tuple[str, str, float, float, str]]:
    """The capsules: (from joint, to joint, radius at either end in metres, the joint that carries the capsule)."""
    stock = joints()
    result = list[tuple[str, str, float, float, str]]()
    for name, joint in stock.items():
        if joint.parent and joint.radius and not name.endswith(("Shoulder", "UpLeg")):
            near = stock[joint.parent].radius or 0.09
            result.append((joint.parent, name, near, joint.radius, joint.parent))
    return result + [(a, b, radius, radius, carrier) for a, b, radius, carrier in CROSS_CAPSULES]


PROPORTIONS = {
    "legs": ("Leg", "Foot", "ToeBase", "ToeTip"), "arms": ("ForeArm", "Hand", "HandTip"),
    "trunk": ("LowerBack", "Spine", "Spine1", "Neck"), "head": ("Neck1", "Head", "HeadTip"),
    "breadth": ("Shoulder", "Arm", "UpLeg"), "girth": (),
}  # fmt: skip
"""What people differ in: a factor each, and the joints whose distance from their parents it scales. Girth scales the
radii of all capsules but the head's."""


@dataclass(frozen=True, eq=False)
class CapsuleModel:
    """c capsules of the stock body, each carried by a link, and m samples of their surface.

    body: its links; parents (joints,); stock (joints, 3): positions of the joints, metres. Of capsules: link (c,), ends
    (c, 2), two joints, and stock_radii (c, 2), metres. joint_scales (joints,), radius_scales (c,): which proportion
    scales a joint's distance from its parent, and a capsule's radii. Of surface samples: capsule (m,), shares (m,)
    along the capsule's axis, and outward (m, 3), the unit normal in the stock body's pose. Samples inside another
    capsule are left out.
    """

    body: Body
    parents: tuple[int, ...]
    stock: Floats
    link: AnyInteger
    ends: AnyInteger
    stock_radii: Floats
    joint_scales: AnyInteger
    radius_scales: AnyInteger
    capsule: AnyInteger
    shares: Floats
    outward: Floats

    def joint_positions(self, build: Floats) -> Floats:
        """(…, joints, 3), metres: of people of builds (…, PROPORTIONS) in the stock body's pose."""
        positions = np.empty((*build.shape[:-1], *self.stock.shape))
        for joint, parent in enumerate(self.parents):
            factor = build[..., self.joint_scales[joint], None]
            above = positions[..., parent, :] if parent >= 0 else 0.0
            offset = self.stock[joint] - (self.stock[parent] if parent >= 0 else 0.0)
            positions[..., joint, :] = above + factor * offset
        return positions

    def radii(self, build: Floats) -> Floats:
        """(…, c, 2), metres: radii of the capsules of people of builds (…, PROPORTIONS)."""
        return self.stock_radii * build[..., self.radius_scales, None]

    def surface_samples(self, a: Floats, ends: Floats, radii: Floats) -> tuple[Floats, Floats]:
        """(…, m, 3) each: the surface samples, metres, and their unit normals, for world rotations a (…, links, 3, 3),
        capsule ends (…, c, 2, 3) and radii (…, c, 2).
        """
        normals = np.einsum("...mij,mj->...mi", a[..., self.link[self.capsule], :, :], self.outward)
        p, q, r = ends[..., self.capsule, 0, :], ends[..., self.capsule, 1, :], radii[..., self.capsule, :]
        share = self.shares[:, None]
        return p + share * (q - p) + (r[..., :1] + share * (r[..., 1:] - r[..., :1])) * normals, normals


@cache
def capsule_model(samples_per_capsule: int = 16) -> CapsuleModel:
    """The stock body's links, capsules and surface samples."""
    stock = joints()
    names = tuple(stock)
    parents = tuple(names.index(joint.parent) if joint.parent else -1 for joint in stock.values())
    positions = np.array([joint.position for joint in stock.values()], float)
    body = articulation.from_skeleton(names, parents, positions)
    link_of = np.zeros(len(names), np.int64)
    for joint in range(len(names)):
        link_of[joint] = body.joints.index(joint) if joint in body.joints else link_of[max(parents[joint], 0)]
    capsules = bones()
    ends = np.array([[names.index(start), names.index(stop)] for start, stop, *_ in capsules])
    radii = np.array([[near, far] for _, _, near, far, _ in capsules])
    link = np.array([link_of[names.index(carrier)] for *_, carrier in capsules])
    proportions = list(PROPORTIONS)
    without_side = [name.removeprefix("Left").removeprefix("Right") for name in names]
    joint_scales = [next((i for i, of in enumerate(PROPORTIONS.values()) if name in of), 0) for name in without_side]
    radius_scales = [proportions.index("head" if stop == "HeadTip" else "girth") for _, stop, *_ in capsules]
    capsule, shares, outward = _sample_surface(positions[ends], radii, samples_per_capsule)
    return CapsuleModel(
        body, parents, positions, link, ends, radii, np.array(joint_scales), np.array(radius_scales), capsule, shares,
        outward,
    )  # fmt: skip


def _sample_surface(ends: Floats, radii: Floats, samples: int) -> tuple[AnyInteger, Floats, Floats]:
    """Capsule (m,), share along its axis (m,) and outward unit vector (m, 3) of random samples of the capsules'
    surfaces, without those that are more than a centimetre inside another capsule. ends (c, 2, 3), radii (c, 2):
    metres.
    """
    rng = np.random.default_rng(2)
    capsule = np.repeat(np.arange(len(ends)), samples)
    shares, outward = rng.random(len(capsule)), rng.normal(size=(len(capsule), 3))
    axis = (ends[:, 1] - ends[:, 0])[capsule]
    outward -= np.sum(outward * axis, axis=1, keepdims=True) * axis / np.sum(axis**2, axis=1, keepdims=True)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    radius = radii[capsule, 0] + shares * (radii[capsule, 1] - radii[capsule, 0])
    points = ends[capsule, 0] + shares[:, None] * axis + radius[:, None] * outward
    is_outside = surface_distances(points, ends[None], radii[None], signed=True)[0] > -0.01
    return capsule[is_outside], shares[is_outside], outward[is_outside]
