"""Skeletons in, tracked motion out: a first pose from a file, and tracked poses as a Motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ... import formats
from ...encoded import Encoded
from ...errors import BadInput
from ...geometry import articulation
from ...geometry.articulation import Body, Pose
from ...motion import Motion, Skeleton
from ...pointcloud import PointClouds
from ...typing import AnyInteger, Floats


def skeleton_motion(skeleton: Motion | str | Any) -> Motion:
    """The skeleton that a user gives: a Motion, or the path of a file that holds one. Raises BadInput."""
    motion = skeleton if isinstance(skeleton, Motion) else formats.read(str(skeleton))
    if not isinstance(motion, Motion) or motion.skeleton is None or not len(motion):
        raise BadInput(f"{skeleton}: has no skeleton; give a .bvh or .amc whose first frame is the first frame's pose")
    return motion


def tracked_motion(encoded: Encoded[PointClouds], body: Body, poses: Sequence[Pose]) -> Motion:
    """Poses of a body as a motion with skeleton and rotations, which can be written as BVH."""
    tree = _joint_tree(body)
    place, rest = joints_of_links(body)
    offsets = np.array([rest[i] - rest[p] if p >= 0 else np.zeros(3) for i, p in enumerate(tree.parents)])
    names = (*body.names, *(f"{body.names[link]}_end" for link in tree.leaves))
    names = tuple(names[joint] for joint in tree.order)
    positions = np.empty((len(poses), len(tree.order), 3))
    rotations = np.tile([1.0, 0, 0, 0], (len(poses), len(tree.order), 1))
    if poses:
        turns = np.stack([pose.rotations for pose in poses])
        a, b = articulation.transforms(body, Pose(turns, np.stack([pose.root for pose in poses])))
        tips = np.einsum("tlij,lj->tli", a[:, tree.leaves], body.tips[tree.leaves]) + b[:, tree.leaves]
        origins = np.einsum("tlij,lj->tli", a, body.origins) + b
        positions[:] = np.concatenate([origins, tips], axis=1)[:, tree.order]
        rotations[:, place] = articulation.quaternions(turns)
    about = encoded.about
    skeleton = Skeleton(names, tree.parents, offsets)
    return Motion(positions, about.rate, names, up=about.up, skeleton=skeleton, rotations=rotations)


def joints_of_links(body: Body) -> tuple[AnyInteger, Floats]:
    """(links,): the joint of `tracked_motion` at the origin of each link. (joints, 3): joints in the canonical pose."""
    tree = _joint_tree(body)
    place = np.array([tree.order.index(link) for link in range(len(body))])
    return place, np.concatenate([body.origins, body.tips[tree.leaves]])[tree.order]


class _JointTree(NamedTuple):
    """The joints of `tracked_motion`: the links' origins, and the tip of each leaf, so that a leaf's rotation shows.

    leaves: links without children. order: joints depth first, as BVH files need them; joint i is the origin of link i,
    joint links + k the tip of leaf k. parents: by place in `order`, −1 for the root.
    """

    leaves: list[int]
    order: list[int]
    parents: tuple[int, ...]


def _joint_tree(body: Body) -> _JointTree:
    leaves = [link for link in range(len(body)) if link not in body.parents]
    above = [*body.parents, *leaves]
    order = articulation.depth_first_order(above)
    return _JointTree(leaves, order, tuple(order.index(above[joint]) if above[joint] >= 0 else -1 for joint in order))
