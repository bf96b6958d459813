"""An articulated body: links in a tree, posed by a rotation at each joint and a translation of the root.

    Body (canonical pose) + Pose ──transforms──► a rigid transform per link ──skinning──► points of the posed body

All coordinates are metres in the world. The canonical pose is the pose that the body was defined in: every rotation
there is the identity, and a canonical point x of link l is at A_l x + b_l in another pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import BadInput
from ..typing import AnyInteger, Booleans, Floats


@dataclass(frozen=True, eq=False)
class Body:
    """Links of a body in its canonical pose.

    Each link turns about its origin (the joint with its parent) and has the shape of a cylinder from `origins` to
    `tips` (both (links, 3)) with radius `radii` (links,), metres. Parents come before their children; link 0 is the
    root, the torso. joints: for each link, the index of its joint in the skeleton that the body was made from.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    origins: Floats
    tips: Floats
    radii: Floats
    joints: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.names)

    @property
    def lengths(self) -> Floats:
        """(links,): metres from origin to tip, at least a centimetre."""
        return np.maximum(np.linalg.norm(self.tips - self.origins, axis=1), 0.01)

    @property
    def axes(self) -> Floats:
        """(links, 3) unit vectors from origin to tip."""
        return (self.tips - self.origins) / self.lengths[:, None]

    @property
    def ancestors(self) -> Booleans:
        """(links, links): [a, l] is true if a is l or an ancestor of l: a rotation of a moves l."""
        moves = np.eye(len(self), dtype=bool)
        for link, parent in enumerate(self.parents):
            if parent >= 0:
                moves[:, link] |= moves[:, parent]
        return moves

    def scaled(self, factor: float) -> Body:
        """The body scaled about the world's origin."""
        return replace(self, origins=self.origins * factor, tips=self.tips * factor, radii=self.radii * factor)


@dataclass(frozen=True, eq=False)
class Pose:
    """rotations (links, 3, 3) from the parent's frame, identity in the canonical pose; root (3,): its translation."""

    rotations: Floats
    root: Floats

    @staticmethod
    def canonical(links: int) -> Pose:
        return Pose(np.tile(np.eye(3), (links, 1, 1)), np.zeros(3))


def transforms(body: Body, pose: Pose) -> tuple[Floats, Floats]:
    """A (…, links, 3, 3) and b (…, links, 3), metres: a canonical point x of link l is at A_l x + b_l. Leading axes are
    free: a pose may hold those of many frames.
    """
    rotations, root = pose.rotations, pose.root
    a, b = np.empty_like(rotations), np.empty(rotations.shape[:-1])
    for link, parent in enumerate(body.parents):
        origin, turn = body.origins[link], rotations[..., link, :, :]
        if parent < 0:
            a[..., link, :, :] = turn
            b[..., link, :] = origin - turn @ origin + root
        else:
            above = a[..., parent, :, :]
            a[..., link, :, :] = above @ turn
            b[..., link, :] = np.einsum("...ij,...j->...i", above, origin - turn @ origin) + b[..., parent, :]
    return a, b


def joint_positions(body: Body, a: Floats, b: Floats) -> Floats:
    """(links, 3): the links' origins under transforms a (links, 3, 3), b (links, 3)."""
    return np.einsum("lij,lj->li", a, body.origins) + b


def pose_from_world(body: Body, a: Floats, root_origin: Floats) -> Pose:
    """The pose whose links have world rotations a (links, 3, 3), with the root's joint at root_origin (3,)."""
    rotations = np.stack([a[i] if p < 0 else a[p].T @ a[i] for i, p in enumerate(body.parents)])
    return Pose(rotations, root_origin - body.origins[0])


def depth_first_order(parents: Sequence[int]) -> list[int]:
    """The links in an order in which each is followed by its whole subtree, as in BVH files."""
    order, waiting = list[int](), [i for i, p in enumerate(parents) if p < 0][::-1]
    while waiting:
        order.append(waiting.pop())
        waiting += [i for i, p in enumerate(parents) if p == order[-1]][::-1]
    return order


def exp(vectors: Floats) -> Floats:
    """Rotation matrices (…, 3, 3) of rotation vectors (…, 3), radians."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    k = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*vectors.shape[:-1], 3, 3)
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    s = np.where(small, 1.0, np.sin(safe) / safe)
    c = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    return np.eye(3) + s * k + c * (k @ k)


def log(matrices: Floats) -> Floats:
    """Rotation vectors (…, 3), of at most π radians, of rotation matrices (…, 3, 3)."""
    m = matrices
    trace = np.einsum("...ii->...", m)
    # the unit quaternion through its largest component: exact near π too
    squares = np.stack([1 + trace, *(1 - trace + 2 * m[..., i, i] for i in range(3))], -1)
    w = np.stack(
        [squares[..., 0], m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]], -1
    )
    x = np.stack([w[..., 1], squares[..., 1], m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0]], -1)
    y = np.stack([w[..., 2], x[..., 2], squares[..., 2], m[..., 1, 2] + m[..., 2, 1]], -1)
    z = np.stack([w[..., 3], x[..., 3], y[..., 3], squares[..., 3]], -1)
    best = np.argmax(squares, axis=-1)[..., None, None]
    q = np.take_along_axis(np.stack([w, x, y, z], -2), best, axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., :1])
    return q[..., 1:] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)


def rotation_between(directions: Floats, onto: Floats) -> Floats:
    """(…, 3, 3): the smallest rotations that turn unit vectors `directions` (…, 3) onto unit vectors `onto` (…, 3)."""
    axis = np.cross(directions, onto)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    cosine = np.sum(directions * onto, axis=-1, keepdims=True)
    normal = np.cross(directions, np.where(np.abs(directions[..., :1]) < 0.9, [1.0, 0, 0], [0, 1.0, 0]))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)  # the axis for opposite directions
    unit = np.where(sine > 1e-9, axis / np.maximum(sine, 1e-9), normal)
    return exp(unit * np.arctan2(sine, cosine))


def from_skeleton(
    names: Sequence[str], parents: Sequence[int], positions: Floats, *, one_trunk: bool = False, shortest: float = 0.085
) -> Body:
    """The links of a skeleton in a pose; bones too small to be tracked in points are merged with their parents.

    names, parents: of its joints, parents before children. positions (joints, 3): metres. A joint becomes a link if a
    chain of at least `shortest` of the body's size hangs on it: fingers and toes do not. one_trunk: hips, spine and
    collars are one cylinder as far as the arms, as in Lien and Bajcsy 2006, section 3.1, and so are neck and head, and
    hand and fingers; otherwise every bone of the spine is a link. Radii are estimated from the lengths. Raises BadInput
    for fewer than two joints, or joints all within 5 cm.
    """
    positions = np.asarray(positions, np.float64)
    count = len(names)
    size = float(np.ptp(positions, axis=0).max()) if count and np.isfinite(positions).all() else 0.0
    if count < 2 or size <= 0.05:
        raise BadInput(
            f"a skeleton of {count} joints within {size:.2f} m is not a body: two joints or more are needed, in metres"
        )
    bones = np.array([0.0 if p < 0 else np.linalg.norm(positions[j] - positions[p]) for j, p in enumerate(parents)])
    if one_trunk:
        size = min(size, 4 * float(bones.max()))  # raised arms make the pose taller, not the bones
    leaf = np.array([joint not in set(parents) for joint in range(count)])
    below = np.where(
        leaf, np.clip(bones, 0.03 * size, 0.07 * size), 0.0
    )  # length of the longest chain below each joint
    long_bone = np.zeros(count, bool)
    for joint in range(count - 1, 0, -1):
        if (parent := parents[joint]) >= 0:
            below[parent] = max(below[parent], below[joint] + bones[joint])
            long_bone[parent] |= bones[joint] > 0.13 * size
    chains = np.zeros(count, int)  # number of arms and legs below each joint, counted at their last long bone
    for joint in range(count - 1, -1, -1):
        chains[joint] += bool(long_bone[joint] and chains[joint] == 0)
        if parents[joint] >= 0:
            chains[parents[joint]] += chains[joint]
    kept, link_of = [0], np.zeros(count, int)
    in_limb = np.zeros(count, bool)
    for joint in range(1, count):
        parent = max(parents[joint], 0)
        in_limb[joint] = chains[joint] < 2 and (long_bone[joint] or in_limb[parent])
        in_trunk = parent == 0 or chains[parent] >= 2
        is_link = below[joint] >= shortest * size and not (leaf[joint] and bones[joint] < 0.04 * size)
        nested = chains[joint] == 1 and not in_limb[joint]
        if nested and np.linalg.norm(positions[joint] - positions[kept[link_of[parent]]]) < 0.01 * size:
            is_link = False  # a second joint in one place, as at the hips in CMU's BVH files
        if one_trunk:
            is_link &= (in_limb[joint] and bones[joint] > 0.04 * size) or (chains[joint] == 0 and in_trunk)
        if is_link:
            kept.append(joint)
        link_of[joint] = len(kept) - 1 if is_link else link_of[parent]
    trunk = [joint for joint in range(count) if one_trunk and link_of[joint] == 0 and chains[joint] >= 2]
    return _links(names, parents, positions, kept, link_of, size, trunk)


def _links(
    names: Sequence[str],
    parents: Sequence[int],
    positions: Floats,
    kept: list[int],
    link_of: AnyInteger,
    size: float,
    trunk: Sequence[int],
) -> Body:
    """A link per kept joint, whose axis runs to the joint that carries most below it; the root's to one of `trunk`."""
    above = [-1 if i == 0 else int(link_of[max(parents[joint], 0)]) for i, joint in enumerate(kept)]
    carried = np.ones(len(names), int)
    for joint in range(len(names) - 1, 0, -1):
        carried[max(parents[joint], 0)] += carried[joint]
    origins = positions[kept]
    tips = origins.copy()
    for link, joint in enumerate(kept):
        hanging = [j for j, p in enumerate(parents) if p >= 0 and j != joint and link in (link_of[j], link_of[p])]
        hanging = [j for j in hanging if link or j in trunk] or hanging
        reach = np.array([np.linalg.norm(positions[j] - origins[link]) for j in hanging])
        if hanging and reach.max() > 0.02 * size:
            score = carried[hanging] * (reach > 0.03 * size) + reach if link == 0 and not trunk else reach
            tips[link] = positions[hanging[int(np.argmax(score))]]
        else:
            back = origins[link] - origins[max(above[link], 0)]
            length = float(np.linalg.norm(back))
            tips[link] = origins[link] + (back / length if length > 0 else np.array([0, 1.0, 0])) * 0.08 * size
    radii = np.clip(0.22 * np.linalg.norm(tips - origins, axis=1), 0.025 * size, 0.08 * size)
    radii[0] = 0.085 * size
    return Body(tuple(names[j] for j in kept), tuple(above), origins, tips, radii, tuple(kept))


def quaternions(matrices: Floats) -> Floats:
    """Unit quaternions (…, 4), w first and w ≥ 0, of rotation matrices (…, 3, 3)."""
    vectors = log(matrices)
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), vectors * 0.5 * np.sinc(angle / (2 * np.pi))], axis=-1)
