"""Arms and legs of a tracked body as chains of links: which links they are, and hypotheses for their poses.

body ──find──► limbs ──reaching, swapped──► rotations of their links ──clamp_to_limits──► allowed rotations

These are the links of a body fitted to points; the bones of a motion's limbs are the tempo codec's matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import AnyInteger, Floats
from . import articulated_icp, joint_limits
from .articulation import Body, Pose, rotation_between, transforms
from .joint_limits import LinkLimits
from .skinning import Skin

MIN_BONE = 0.12
"""Length of a limb's first bone, at least, as a share of the body's size."""
MIN_FIRST_BONE = 0.6
"""Length of a limb's first bone, at least, as a share of its second one's: a collarbone is shorter."""
MIN_LENGTH = 0.25
"""Length of a whole limb, at least, as a share of the body's size."""
MIN_ROWS, MAX_ROWS = 30, 60
"""Template points that a limb must have, and about how many of them score its poses."""


@dataclass(frozen=True, eq=False)
class LimbChain:
    """links: of an arm or leg, from its first long bone to its end. rows: template points that follow them. samples: of
    the template points that search for data, those that follow any of the links, and those beyond the first bone.
    base: the short link that carries the limb alone, such as a collarbone; empty if there is none.
    """

    links: AnyInteger
    rows: AnyInteger
    samples: tuple[AnyInteger, AnyInteger]
    base: AnyInteger

    @property
    def with_base(self) -> AnyInteger:
        """The base, if there is one, and the links."""
        return np.concatenate([self.base, self.links])


def chains(body: Body) -> list[list[int]]:
    """The links of each arm and leg: chains without branches, of MIN_LENGTH or more, from their first long bone on."""
    children = [[c for c, p in enumerate(body.parents) if p == link] for link in range(len(body))]
    size = float(np.ptp(np.concatenate([body.origins, body.tips]), axis=0).max())
    found = list[list[int]]()
    for link in range(1, len(body)):
        chain = [link]
        while len(children[chain[-1]]) == 1:
            chain += children[chain[-1]]
        has_branch = bool(children[chain[-1]])
        is_in_limb = any(link in limb for limb in found)
        is_short = body.lengths[link] < MIN_BONE * size or body.lengths[chain].sum() < MIN_LENGTH * size
        is_collar = len(chain) > 1 and body.lengths[link] < MIN_FIRST_BONE * body.lengths[chain[1]]
        if not (is_in_limb or has_branch or is_short or is_collar):
            found.append(chain)
    return found


def find(body: Body, skin: Skin, sample: AnyInteger) -> list[LimbChain]:
    """Arms and legs with enough points of the template. sample: template points that search for data."""
    limbs = list[LimbChain]()
    for chain in chains(body):
        rows = np.flatnonzero(np.isin(skin.links[:, 0], chain))
        if len(rows) >= MIN_ROWS:
            owner = skin.links[sample, 0]
            whole, beyond = (np.flatnonzero(np.isin(owner, links)) for links in (chain, chain[1:]))
            parent = body.parents[chain[0]]
            has_base = parent > 0 and body.parents.count(parent) == 1
            base = np.array([parent] if has_base else [], np.int64)
            limbs.append(LimbChain(np.array(chain), rows[:: max(1, len(rows) // MAX_ROWS)], (whole, beyond), base))
    return limbs


def mirrored_pairs(body: Body, limbs: list[LimbChain]) -> list[tuple[int, int]]:
    """Pairs of limbs, by index, whose first links are left and right of each other."""
    number = {int(limb.links[0]): i for i, limb in enumerate(limbs) if len(limb.links) > 1}
    pairs = articulated_icp.mirrored_links(body)
    return [(number[one], number[other]) for one, other in pairs if one in number and other in number]


def bend_and_end(body: Body, limb: LimbChain) -> tuple[tuple[int, Floats], tuple[int, Floats]]:
    """Where a limb bends and where its second bone ends: the link that carries each, and its canonical place (3,)."""
    upper, lower = (int(link) for link in limb.links[:2])
    end = body.origins[limb.links[2]] if len(limb.links) > 2 else body.tips[lower]
    return (upper, body.origins[lower]), (lower, end)


def swapped(body: Body, pose: Pose, one: LimbChain, other: LimbChain) -> Pose:
    """The pose in which each of two limbs reaches for the other's bend and end."""
    a, b = transforms(body, pose)
    rotations = pose.rotations.copy()
    for mine, theirs in ((one, other), (other, one)):
        upper = mine.links[0]
        bend, end = (a[link] @ place + b[link] for link, place in bend_and_end(body, theirs))
        start = a[upper] @ body.origins[upper] + b[upper]
        rotations[mine.links[:2]] = aimed(body, mine, pose, a, start, bend - start, end)
    return Pose(rotations, pose.root)


def reaching(body: Body, limb: LimbChain, pose: Pose, targets: Floats, shares: Floats, sides: Floats) -> Floats:
    """(count, links of the limb, 3, 3): rotations for which a place on the second bone is at one of targets (count, 3),
    metres. shares (count,): of the second bone's length, at which the place is. sides (count, 3): vectors that
    determine to which side the limb bends.
    """
    a, b = transforms(body, pose)
    (upper, bend), (lower, end) = bend_and_end(body, limb)
    start = a[upper] @ body.origins[upper] + b[upper]
    first, second = bend - body.origins[upper], end - body.origins[lower]
    one, two = np.linalg.norm(first), np.linalg.norm(second) * shares
    to, far = _directions(targets - start), np.linalg.norm(targets - start, axis=1)
    far = np.clip(far, np.abs(one - two) + 1e-3, one + two - 1e-3)
    cosine = np.clip((one**2 + far**2 - two**2) / (2 * one * far), -1, 1)[:, None]  # law of cosines
    side = _directions(np.cross(to, sides))
    along = cosine * to + np.sqrt(1 - cosine**2) * side
    rotations = np.tile(pose.rotations[limb.links], (len(to), 1, 1, 1))
    rotations[:, :2] = aimed(body, limb, pose, a, start, along, start + far[:, None] * to)
    return rotations


def aimed(body: Body, limb: LimbChain, pose: Pose, a: Floats, start: Floats, along: Floats, ends: Floats) -> Floats:
    """(…, 2, 3, 3): rotations of a limb's first two bones for which the first, from `start` (3,), points along (…, 3),
    and the second from there to ends (…, 3). a: of the pose, as `transforms` gives it.
    """
    upper, lower = limb.links[:2]
    axes, parent = body.axes, body.parents[upper]
    now = _directions(np.broadcast_to(a[upper] @ axes[upper], along.shape))
    turned = rotation_between(now, _directions(along)) @ a[upper]
    elbow = start + turned @ (body.origins[lower] - body.origins[upper])
    below = turned @ pose.rotations[lower]
    below = rotation_between(_directions(below @ axes[lower]), _directions(ends - elbow)) @ below
    first = (a[parent].T if parent >= 0 else np.eye(3)) @ turned
    return np.stack([first, np.swapaxes(turned, -1, -2) @ below], axis=-3)


def clamp_to_limits(limits: LinkLimits, limb: LimbChain, rotations: Floats) -> Floats:
    """Rotations (count, links of the limb, 3, 3), changed in place: those beyond their limits become the nearest
    allowed ones.
    """
    own = limits.subset(limb.links)
    if len(own.links):
        column = np.searchsorted(limb.links, own.links)
        rotations[:, column] = joint_limits.nearest_allowed(own, rotations[:, column])[0]
    return rotations


def _directions(vectors: Floats) -> Floats:
    """(…, 3): unit vectors along vectors (…, 3); zero for those of no length."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
