"""Joint limits of a tracked body: the limits of a skeleton's joints as limits of the body's links.

    limits of joints, first pose ──of_links──► limits of links ──nearest_allowed──► rotations within the limits

A link l turns by R_l from the first pose, against its parent. If it moves as joint c does, and its parent as joint d,
then c has turned against d by W_d⁻¹ R_l W_c, where W are their world rotations in the first pose. In the axis frame of
c that is Rx(α) Ry(β) Rz(γ), with the axes permuted for another rotation order. Each angle is clamped to its range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from ..motion import Limits, Motion
from ..typing import AnyInteger, Booleans, Floats
from . import kinematics, rigid
from .articulation import Body

TOLERANCE_RAD = 0.1
"""By which every range is widened at either end, radians: tracked surfaces determine rotations no better than that."""
ROUNDING_RAD = 1e-9
"""An angle is within its range if it is beyond it by this or less, radians."""
SWEEPS = 4
"""Number of sweeps of coordinate descent over the three angles of a clamped rotation."""


@dataclass(frozen=True, eq=False)
class LinkLimits:
    """links (k,): those with limits. The rotation R of such a link is allowed if before · R · after (k, 3, 3 each) is
    Rx Ry Rz by angles within `half_width` (k, 3) of `centre` (k, 3), radians. A half width is infinite for a free
    angle.
    """

    links: AnyInteger
    before: Floats
    after: Floats
    centre: Floats
    half_width: Floats

    @cached_property
    def table(self) -> Floats:
        """(k, 24): all but `links` as one row per link, for the compiled kernel."""
        count = len(self.links)
        matrices = [array.reshape(count, 9) for array in (self.before, self.after)]
        return np.concatenate([*matrices, self.centre, self.half_width], axis=1)

    def subset(self, links: AnyInteger) -> LinkLimits:
        """The limits of some links."""
        chosen = np.isin(self.links, links)
        arrays = self.links, self.before, self.after, self.centre, self.half_width
        return LinkLimits(*(array[chosen] for array in arrays))


NO_LIMITS = LinkLimits(np.zeros(0, np.int64), *np.zeros((2, 0, 3, 3)), *np.zeros((2, 0, 3)))


def of_links(body: Body, motion: Motion) -> LinkLimits:
    """Limits of the links of a body that was made from the first frame of a motion, widened to contain that pose.

    A link has limits if it and its parent each move as a single joint does, and no joint turns between the two. A link
    that merges several moving joints has none: no single joint determines how far it may turn.
    """
    skeleton, rotations = motion.skeleton, motion.rotations
    if skeleton is None or skeleton.limits is None or rotations is None:
        return NO_LIMITS
    limits = skeleton.limits
    fixed = (limits.ranges == 0).all(axis=(1, 2))
    carriers = _carriers(body, skeleton.parents, fixed, motion.source.get("format") == "amc")
    world = rigid.to_matrix(kinematics.world_rotations(skeleton, rotations[:1])[0])
    limited = list[LimitedJoint]()
    for link, parent in enumerate(body.parents):
        joint, above = carriers[link], carriers[max(parent, 0)]
        if parent < 0 or joint is None or above is None:
            continue
        between = skeleton.parents[joint]
        while between not in (above, -1) and fixed[between]:
            between = skeleton.parents[between]
        if between != above:
            continue
        frame = _permuted_axes(limits, joint)
        limited.append(LimitedJoint(link, world[above] @ frame, world[joint] @ frame, _ranges(limits, joint)))
    return of_joints(limited)


class LimitedJoint(NamedTuple):
    """A link; the frames (3, 3) of its joint in the first pose, as its parent and as it carries them, equal where all
    angles are 0; ranges (3, 2) of the angles of Rx Ry Rz in these frames, radians.
    """

    link: int
    parent_frame: Floats
    own_frame: Floats
    ranges: Floats


def of_joints(joints: Sequence[LimitedJoint]) -> LinkLimits:
    """The limits of links by their joints, widened to contain the first pose."""
    limited = list[tuple[int, Floats, Floats, Floats, Floats]]()
    for link, parent_frame, own_frame, ranges in joints:
        centre, half_width = _widened(ranges, parent_frame.T @ own_frame)
        if np.isfinite(half_width).any():
            limited.append((link, parent_frame.T, own_frame, centre, half_width))
    if not limited:
        return NO_LIMITS
    links, *arrays = zip(*sorted(limited, key=itemgetter(0)), strict=True)
    return LinkLimits(np.array(links, np.int64), *(np.stack(array) for array in arrays))


def _carriers(body: Body, parents: tuple[int, ...], fixed: Booleans, own_frame: bool) -> list[int | None]:
    """For each link the joint of the skeleton that it moves as; None if it moves as no single joint.

    own_frame: a joint is the end of the bone that it turns (ASF/AMC), so that a link moves as the bones that begin in
    its joint.
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


def _permuted_axes(limits: Limits, joint: int) -> Floats:
    """(3, 3): the joint's axis frame with its axes permuted, so that its rotations are about x, y and z in that order;
    for an odd rotation order the axes are negated.
    """
    order = ["xyz".index(axis) for axis in limits.orders[joint]]
    permutation = np.eye(3)[:, order]
    return rigid.to_matrix(limits.axes[joint]) @ permutation * np.linalg.det(permutation)


def _ranges(limits: Limits, joint: int) -> Floats:
    """(3, 2): ranges in the frame of `_permuted_axes`: negated for an odd rotation order."""
    ranges = limits.ranges[joint]
    return ranges if limits.orders[joint] in ("xyz", "yzx", "zxy") else -ranges[:, ::-1]


def _widened(ranges: Floats, first: Floats) -> tuple[Floats, Floats]:
    """Centre and half width (3,) of ranges (3, 2), widened to contain the rotation `first` (3, 3), and by the
    tolerance.

    A range of a whole turn or more, or without an end, is free: whole turns cannot be told from none.
    """
    free = ranges[:, 1] - ranges[:, 0] >= 2 * np.pi
    known = np.where(free[:, None], 0.0, ranges)
    centre, half_width = known.mean(axis=1), np.where(free, np.inf, np.ptp(known, axis=1) / 2)
    offsets = _wrapped(_euler(first) - centre)
    offset = min(offsets, key=lambda triple: float(np.maximum(np.abs(triple) - half_width, 0).sum()))
    below, above = np.minimum(offset + half_width, 0), np.maximum(offset - half_width, 0)
    return centre + (below + above) / 2, half_width + (above - below) / 2 + TOLERANCE_RAD


def nearest_allowed(limits: LinkLimits, rotations: Floats) -> tuple[Floats, Booleans]:
    """The allowed rotation nearest to each of rotations (…, k, 3, 3) of the limited links, and a mask (…, k) of those
    that were beyond their limits.

    Both triples of Euler angles of a rotation are clamped, each is improved by coordinate descent (each angle in turn
    is set to the best value within its range, given the other two), and the nearer result is taken. Clamping alone is
    not enough near gimbal lock, where one outer angle can compensate for the other.
    """
    turn = limits.before @ rotations @ limits.after
    offset = _wrapped(_euler(turn) - limits.centre)
    clamped = np.clip(offset, -limits.half_width, limits.half_width)
    one, other = (np.abs(triple) > limits.half_width + ROUNDING_RAD for triple in offset)
    outside = np.asarray(one.any(axis=-1)) & np.asarray(other.any(axis=-1))
    if not outside.any():
        return rotations, outside
    result, row = rotations.copy(), np.nonzero(outside)[-1]
    arrays = limits.before, limits.after, limits.centre, limits.half_width
    before, after, centre, half_width = (array[row] for array in arrays)
    target, angles = turn[outside], centre + clamped[:, outside]
    for _ in range(SWEEPS):
        for axis in range(3):
            alone = np.swapaxes(target, -1, -2)
            for other in range(axis):
                alone = alone @ _about(other, angles[..., other])
            for other in range(2, axis, -1):
                alone = _about(other, angles[..., other]) @ alone
            i, j = (axis + 1) % 3, (axis + 2) % 3
            best = np.arctan2(alone[..., i, j] - alone[..., j, i], alone[..., i, i] + alone[..., j, j])
            best = np.clip(_wrapped(best - centre[:, axis]), -half_width[:, axis], half_width[:, axis])
            angles[..., axis] = centre[:, axis] + best
    products = _about(0, angles[..., 0]) @ _about(1, angles[..., 1]) @ _about(2, angles[..., 2])
    similarity = np.einsum("cnij,nij->cn", products, target)  # greatest for the rotation nearest to the target
    nearest = products[similarity.argmax(axis=0), np.arange(len(row))]
    result[outside] = np.swapaxes(before, -1, -2) @ nearest @ np.swapaxes(after, -1, -2)
    return result, outside


def _euler(turn: Floats) -> Floats:
    """(2, …, 3): the two triples of angles for which Rx Ry Rz is a rotation (…, 3, 3), radians."""
    sine, cosine = turn[..., 0, 2], np.hypot(turn[..., 0, 0], turn[..., 0, 1])
    angles = np.stack([
        np.arctan2(-turn[..., 1, 2], turn[..., 2, 2]),
        np.arctan2(sine, cosine),
        np.arctan2(-turn[..., 0, 1], turn[..., 0, 0]),
    ], axis=-1)  # fmt: skip
    return np.stack([angles, np.pi + angles * [1.0, -1.0, 1.0]])


def _about(axis: int, angle: Floats) -> Floats:
    """(…, 3, 3): rotations about a coordinate axis (0, 1 or 2) by angles (…), radians."""
    return rigid.to_matrix(rigid.about_axis("xyz"[axis], angle))


def _wrapped(angles: Floats) -> Floats:
    """The same angles between −π and π."""
    return angles - 2 * np.pi * np.rint(angles / (2 * np.pi))
