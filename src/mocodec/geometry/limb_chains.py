"""Arms and legs of a body: which links they are, and poses of them.

body ──find──► limbs ──shaken, reaching, exchanged──► rotations of links ──within──► those that joints allow
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import articulated_icp, joint_limits
from .articulation import Body, Floats, Labels, Pose, between, exp, transforms
from .joint_limits import LinkLimits
from .skinning import Skin


@dataclass(frozen=True, eq=False)
class Limb:
    """links of an arm or leg from its long bone on; rows of the template that follow them; and, of those that look for
    data, which follow any of them, and which those beyond the long bone.
    """

    links: Labels
    rows: Labels
    looked_at: tuple[Labels, Labels]


def find(body: Body, skin: Skin, some: Labels) -> list[Limb]:
    """Arms and legs: chains of links without branches, of a quarter of the body's size or more, from their long
    bone. some: rows of the template that look for data.
    """
    children = [[c for c, p in enumerate(body.parents) if p == link] for link in range(len(body))]
    size = float(np.ptp(np.concatenate([body.origins, body.tips]), axis=0).max())
    limbs = list[Limb]()
    for link in range(1, len(body)):
        chain = [link]
        while len(children[chain[-1]]) == 1:
            chain += children[chain[-1]]
        is_path = not children[chain[-1]]
        inside = any(link in limb.links for limb in limbs)
        if inside or not is_path or body.lengths[link] < 0.12 * size or body.lengths[chain].sum() < 0.25 * size:
            continue
        mine = np.flatnonzero(np.isin(skin.links[:, 0], chain))
        if len(mine) >= 30:
            owner = skin.links[some, 0]
            every, beyond = (np.flatnonzero(np.isin(owner, links)) for links in (chain, chain[1:]))
            limbs.append(Limb(np.array(chain), mine[:: max(1, len(mine) // 60)], (every, beyond)))
    return limbs


def exchanged(body: Body, pose: Pose, one: Limb, other: Limb) -> Pose:
    """The pose with two limbs reaching for each other's middle and end."""
    a, b = transforms(body, pose)
    rotations = pose.rotations.copy()
    for mine, theirs in ((one, other), (other, one)):
        upper = mine.links[0]
        bends, ends = (a[link] @ place + b[link] for link, place in reach(body, theirs))
        start = a[upper] @ body.origins[upper] + b[upper]
        rotations[mine.links[:2]] = pointed(body, mine, pose, a, start, bends - start, ends)
    return Pose(rotations, pose.root)


def reach(body: Body, limb: Limb) -> tuple[tuple[int, Floats], tuple[int, Floats]]:
    """Where a limb bends, and where its second bone ends: links, and places in their canonical coordinates."""
    upper, lower = (int(link) for link in limb.links[:2])
    end = body.origins[limb.links[2]] if len(limb.links) > 2 else body.tips[lower]
    return (upper, body.origins[lower]), (lower, end)


def twins(body: Body, limbs: list[Limb]) -> list[tuple[int, int]]:
    """Pairs of limbs that hang on mirrored links."""
    number = {int(limb.links[0]): i for i, limb in enumerate(limbs) if len(limb.links) > 1}
    pairs = articulated_icp.mirrored(body)
    return [(number[one], number[other]) for one, other in pairs if one in number and other in number]


def shaken(limb: Limb, pose: Pose, rng: np.random.Generator, draws: int, first: float, second: float) -> Floats:
    """(draws, links of the limb, 3, 3): its rotations with the first two of them turned at random, by so much."""
    turns = np.zeros((draws, len(limb.links), 3))
    for link, spread in enumerate((first, second)[: len(limb.links)]):
        turns[:, link] = spread * rng.normal(size=(draws, 3))
    return exp(turns) @ pose.rotations[limb.links]


def reaching(body: Body, limb: Limb, pose: Pose, rng: np.random.Generator, targets: Floats) -> Floats:
    """(draws, links of the limb, 3, 3): its rotations where a place on its second bone or a little beyond is at one
    of targets (draws, 3), and it bends to any side.
    """
    a, b = transforms(body, pose)
    (upper, bend), (lower, end) = reach(body, limb)
    start = a[upper] @ body.origins[upper] + b[upper]
    first, second = bend - body.origins[upper], end - body.origins[lower]
    one, two = np.linalg.norm(first), np.linalg.norm(second) * rng.uniform(0.5, 1.3, len(targets))
    to, far = _units(targets - start), np.linalg.norm(targets - start, axis=1)
    far = np.clip(far, np.abs(one - two) + 1e-3, one + two - 1e-3)
    cosine = np.clip((one**2 + far**2 - two**2) / (2 * one * far), -1, 1)[:, None]
    side = _units(np.cross(to, rng.normal(size=to.shape)))
    along = cosine * to + np.sqrt(1 - cosine**2) * side
    rotations = np.tile(pose.rotations[limb.links], (len(to), 1, 1, 1))
    rotations[:, :2] = pointed(body, limb, pose, a, start, along, start + far[:, None] * to)
    return rotations


def pointed(body: Body, limb: Limb, pose: Pose, a: Floats, start: Floats, along: Floats, ends: Floats) -> Floats:
    """(…, 2, 3, 3): rotations of a limb's first two bones where the first, from `start` (3,), points along (…, 3),
    and the second from there to ends (…, 3). a: of the pose, as `transforms` gives it.
    """
    upper, lower = limb.links[:2]
    axes, parent = body.axes, body.parents[upper]
    turned = between(_units(np.broadcast_to(a[upper] @ axes[upper], along.shape)), _units(along)) @ a[upper]
    elbow = start + turned @ (body.origins[lower] - body.origins[upper])
    below = turned @ pose.rotations[lower]
    below = between(_units(below @ axes[lower]), _units(ends - elbow)) @ below
    first = (a[parent].T if parent >= 0 else np.eye(3)) @ turned
    return np.stack([first, np.swapaxes(turned, -1, -2) @ below], axis=-3)


def within(limits: LinkLimits, limb: Limb, rotations: Floats) -> Floats:
    """Rotations (draws, links of the limb, 3, 3), those beyond limits exchanged for the nearest within."""
    own = limits.of(limb.links)
    if len(own.links):
        column = np.searchsorted(limb.links, own.links)
        rotations[:, column] = joint_limits.nearest(own, rotations[:, column])[0]
    return rotations


def _units(vectors: Floats) -> Floats:
    """(…, 3): directions of vectors (…, 3), nothing where they have none."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
