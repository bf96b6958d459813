"""How far the links of a body may turn: what a skeleton says of its joints, in the terms of a tracker.

    limits of joints, first pose ──of_links──► limits of links ──nearest──► the rotation nearest to one that is allowed

A link l turns by R_l from the first pose, against its parent. If it moves as joint c does, and its parent as joint d,
then c has turned against d by W_d⁻¹ R_l W_c, W being their rotations against the world in the first pose; and in the
axis frame of c that is Rx(α) Ry(β) Rz(γ), axes exchanged where its order is another. Angles are clamped to ranges.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..motion import Limits, Motion
from . import kinematics, rigid
from .articulation import Body, Floats, Labels

GIVE = 0.1  # radians by which every range is wider than its source says: surfaces say no better how a joint is turned
ROUNDING = 1e-9  # radians beyond a range that do not count
SWEEPS = 4  # over the three angles, to bring a clamped rotation as near as it gets


class LinkLimits(NamedTuple):
    """links (k,) that have limits. The rotation of such a link is allowed where before · R · after (k, 3, 3 each) is
    Rx Ry Rz by angles that are all within `half` (k, 3) of `middle` (k, 3), radians; half is infinite where any is.
    """

    links: Labels
    before: Floats
    after: Floats
    middle: Floats
    half: Floats

    @property
    def table(self) -> Floats:
        """(k, 24): what says which rotations are allowed, a link a row."""
        return np.concatenate([array.reshape(len(array), int(np.prod(array.shape[1:]))) for array in self[1:]], axis=1)

    def of(self, links: Labels) -> LinkLimits:
        """Those of some links."""
        some = np.isin(self.links, links)
        return LinkLimits(*(array[some] for array in self))


NO_LIMITS = LinkLimits(np.zeros(0, np.int64), *np.zeros((2, 0, 3, 3)), *np.zeros((2, 0, 3)))


def of_links(body: Body, motion: Motion) -> LinkLimits:
    """Limits of the links of a body that was made from the first frame of a motion, widened to contain that pose.

    A link has limits where it and its parent each move as one joint does, and nothing turns between the two: where
    several joints that turn were merged into one link, no one of them says how far that may.
    """
    skeleton, rotations = motion.skeleton, motion.rotations
    if skeleton is None or skeleton.limits is None or rotations is None:
        return NO_LIMITS
    limits = skeleton.limits
    fixed = (limits.ranges == 0).all(axis=(1, 2))
    carriers = _carriers(body, skeleton.parents, fixed, motion.source.get("format") == "amc")
    world = rigid.to_matrix(kinematics.world_rotations(skeleton, rotations[:1])[0])
    found = list[tuple[int, Floats, Floats, Floats, Floats]]()
    for link, parent in enumerate(body.parents):
        joint, above = carriers[link], carriers[max(parent, 0)]
        if parent < 0 or joint is None or above is None:
            continue
        between = skeleton.parents[joint]
        while between not in (above, -1) and fixed[between]:
            between = skeleton.parents[between]
        if between != above:
            continue
        frame = _in_order(limits, joint)
        before, after = (world[above] @ frame).T, world[joint] @ frame
        middle, half = _around(_ranges(limits, joint), before @ after)
        if np.isfinite(half).any():
            found.append((link, before, after, middle, half))
    if not found:
        return NO_LIMITS
    links, *arrays = zip(*found, strict=True)
    return LinkLimits(np.array(links, np.int64), *(np.stack(array) for array in arrays))


def _carriers(body: Body, parents: tuple[int, ...], fixed: NDArray[np.bool_], own_frame: bool) -> list[int | None]:
    """For each link the joint of the skeleton that it moves as; None where it moves as none, or as several.

    own_frame: a joint is the end of the bone that it turns, so that a link moves as the bones that begin in its joint.
    """
    link_of, carried = dict(zip(body.joints, range(len(body)), strict=True)), [list[int]() for _ in body.names]
    for joint, parent in enumerate(parents):
        link_of.setdefault(joint, link_of.get(parent, 0))
        carried[link_of[max(parent, 0) if own_frame else joint]].append(joint)
    carriers = list[int | None]([0])
    for joints in carried[1:]:
        moving = [joint for joint in joints if not fixed[joint]] or joints[:1]
        beside = [joint for joint in joints if moving and parents[joint] == parents[moving[0]]]
        carriers.append(moving[0] if len(moving) == 1 and (beside == moving or fixed[moving[0]]) else None)
    return carriers


def _in_order(limits: Limits, joint: int) -> Floats:
    """(3, 3): the joint's axis frame, turned so that its three turns are about x, y and z, or against them."""
    order = ["xyz".index(axis) for axis in limits.orders[joint]]
    exchanged = np.eye(3)[:, order]
    return rigid.to_matrix(limits.axes[joint]) @ exchanged * np.linalg.det(exchanged)


def _ranges(limits: Limits, joint: int) -> Floats:
    """(3, 2): ranges in the frame that `_in_order` gives: an odd order turns against its axes."""
    ranges = limits.ranges[joint]
    return ranges if limits.orders[joint] in ("xyz", "yzx", "zxy") else -ranges[:, ::-1]


def _around(ranges: Floats, first: Floats) -> tuple[Floats, Floats]:
    """Middle and half width (3,) of ranges (3, 2), widened to contain a rotation (3, 3) and by what joints give."""
    free = ranges[:, 1] - ranges[:, 0] >= 2 * np.pi  # without an end on one side too: whole turns do not show
    known = np.where(free[:, None], 0.0, ranges)
    middle, half = known.mean(axis=1), np.where(free, np.inf, np.ptp(known, axis=1) / 2)
    away = min(_wrapped(_euler(first) - middle), key=lambda one: float(np.maximum(np.abs(one) - half, 0).sum()))
    below, above = np.minimum(away + half, 0), np.maximum(away - half, 0)
    return middle + (below + above) / 2, half + (above - below) / 2 + GIVE


def nearest(limits: LinkLimits, rotations: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """The allowed rotation nearest to each of rotations (…, k, 3, 3) of the limited links, and which (…, k) were not
    allowed.

    Both triples of angles of a rotation are clamped, and the nearer result is taken. Where the outer two angles turn
    about almost the same axis, one may be clamped in vain that the other could make up for; so each angle in turn is
    then put where it brings the rotation nearest, given the others.
    """
    turn = limits.before @ rotations @ limits.after
    away = _wrapped(_euler(turn) - limits.middle)
    clamped = np.clip(away, -limits.half, limits.half)
    one, other = (np.abs(triple) > limits.half + ROUNDING for triple in away)
    outside = np.asarray(one.any(axis=-1)) & np.asarray(other.any(axis=-1))
    if not outside.any():
        return rotations, outside
    result, row = rotations.copy(), np.nonzero(outside)[-1]
    before, after, middle, half = (array[row] for array in limits[1:])
    wanted, angles = turn[outside], middle + clamped[:, outside]
    for _ in range(SWEEPS):
        for axis in range(3):
            alone = np.swapaxes(wanted, -1, -2)
            for other in range(axis):
                alone = alone @ _about(other, angles[..., other])
            for other in range(2, axis, -1):
                alone = _about(other, angles[..., other]) @ alone
            i, j = (axis + 1) % 3, (axis + 2) % 3
            best = np.arctan2(alone[..., i, j] - alone[..., j, i], alone[..., i, i] + alone[..., j, j])
            best = np.clip(_wrapped(best - middle[:, axis]), -half[:, axis], half[:, axis])
            angles[..., axis] = middle[:, axis] + best
    made = _about(0, angles[..., 0]) @ _about(1, angles[..., 1]) @ _about(2, angles[..., 2])
    likeness = np.einsum("cnij,nij->cn", made, wanted)
    made = made[likeness.argmax(axis=0), np.arange(len(row))]
    result[outside] = np.swapaxes(before, -1, -2) @ made @ np.swapaxes(after, -1, -2)
    return result, outside


def _euler(turn: Floats) -> Floats:
    """(2, …, 3): both triples of angles whose Rx Ry Rz is a rotation (…, 3, 3)."""
    sine, cosine = turn[..., 0, 2], np.hypot(turn[..., 0, 0], turn[..., 0, 1])
    angles = np.stack([
        np.arctan2(-turn[..., 1, 2], turn[..., 2, 2]),
        np.arctan2(sine, cosine),
        np.arctan2(-turn[..., 0, 1], turn[..., 0, 0]),
    ], axis=-1)  # fmt: skip
    return np.stack([angles, np.pi + angles * [1.0, -1.0, 1.0]])


def _about(axis: int, angle: Floats) -> Floats:
    """(…, 3, 3): rotations about one of the axes by angles (…)."""
    return rigid.to_matrix(rigid.about_axis("xyz"[axis], angle))


def _wrapped(angles: Floats) -> Floats:
    """The same turns, from −π to π."""
    return angles - 2 * np.pi * np.rint(angles / (2 * np.pi))
