"""A motion as local transforms of nodes over time: the inverse of reading.

    positions and rotations of joints ─► node by node, parents first: T = parent⁻¹ · position, R = parent⁻¹ · rotation

The translation T of a joint solves parent · T = position, so positions are exact for all rotations and scales of the
nodes above.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...geometry import kinematics, rigid, turning
from ...motion import UP_AXES, Motion
from ...typing import Floats
from . import node_tree
from .node_tree import NodeTree
from .nodes import MIN_DETERMINANT, WORLD, Pose, child_pose, mirrored

SAME_REST_M, SAME_REST = 5e-5, 1e-5
"""Offsets at rest that differ by no more than this, and this share of the longest one, are the same."""


class Local(NamedTuple):
    """A node over time. translation, scale (frames, 3), rotation (frames, 4); None for what stays as it is at rest."""

    translation: Floats | None
    rotation: Floats | None
    scale: Floats | None


def node_tree_of(motion: Motion) -> NodeTree:
    """The tree to write: the one that was read, or the skeleton, or points that only translate."""
    n = motion.points
    joints, names = tuple(range(n)), motion.names
    still = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), np.ones((n, 3))
    if motion.skeleton is None or motion.rotations is None:
        return NodeTree(names, (-1,) * n, joints, motion.positions[0], *still)
    tree = node_tree.unpack(motion)
    if tree is not None and (tree := _turned(tree, motion)) is not None:
        return tree
    return NodeTree(_labels(motion), motion.skeleton.parents, joints, motion.skeleton.offsets, *still)


def _turned(tree: NodeTree, motion: Motion) -> NodeTree | None:
    """The tree, turned as the motion was since it was read; None if the skeleton at rest is another."""
    skeleton = motion.skeleton
    assert skeleton is not None
    turns = [rigid.IDENTITY, *(turning.quarter_turn(up, motion.up) for up in UP_AXES if up != motion.up)]
    is_root = np.array(tree.parents)[:, None] < 0
    place = np.argsort([joint if joint >= 0 else len(tree) for joint in tree.joints], kind="stable")[: len(skeleton)]
    for turn in turns:
        translation = np.where(is_root, rigid.rotate(turn, tree.translation), tree.translation)
        rotation = np.where(is_root, rigid.multiply(turn, tree.rotation), tree.rotation)
        turned = replace(tree, translation=translation, rotation=rotation)
        rest = rest_matrices(turned)[place, :3, 3]
        above = np.array([rest[parent] if parent >= 0 else np.zeros(3) for parent in skeleton.parents])
        if np.abs(rest - above - skeleton.offsets).max() <= SAME_REST_M + SAME_REST * np.abs(skeleton.offsets).max():
            return turned
    return None


def _labels(motion: Motion) -> tuple[str, ...]:
    """The names of the joints in the file that was read."""
    originals = motion.source.get("labels")
    if not isinstance(originals, dict):
        return motion.names
    return tuple(str(originals.get(name, name)) for name in motion.names)


def rest_matrices(tree: NodeTree) -> Floats:
    """World transforms (nodes, 4, 4) of the nodes at rest."""
    poses, result = list[Pose](), np.tile(np.eye(4), (len(tree), 1, 1))
    for node, parent in enumerate(tree.parents):
        pose = _rest_pose(tree, node, poses[parent] if parent >= 0 else WORLD)
        poses.append(pose)
        result[node, :3, :3], result[node, :3, 3] = pose.matrices()[0], pose.position[0]
    return result


def _rest_pose(tree: NodeTree, node: int, parent: Pose) -> Pose:
    return child_pose(parent, tree.translation[node][None], tree.rotation[node][None], np.diag(tree.scale[node])[None])


def local_tracks(motion: Motion, tree: NodeTree) -> list[Local]:
    """Each node over time."""
    turned = None
    if motion.skeleton is not None and motion.rotations is not None:
        turned = kinematics.world_rotations(motion.skeleton, motion.rotations)
    poses, rest, result = list[Pose](), list[Pose](), list[Local]()
    for node, parent in enumerate(tree.parents):
        above, above_rest = (poses[parent], rest[parent]) if parent >= 0 else (WORLD, WORLD)
        rest.append(_rest_pose(tree, node, above_rest))
        local = Local(None, None, tree.scales.get(node))
        if (joint := tree.joints[node]) >= 0:
            rotation = None if turned is None else rigid.multiply(turned[:, joint], rest[node].rotation)
            local = _solved(above, motion.positions[:, joint], rotation, tree.translation[node], local.scale)
        result.append(local)
        poses.append(
            child_pose(
                above,
                tree.translation[node][None] if local.translation is None else local.translation,
                tree.rotation[node][None] if local.rotation is None else local.rotation,
                np.eye(3) * (tree.scale[node][None] if local.scale is None else local.scale)[:, :, None],
            )
        )
    return result


def _solved(above: Pose, position: Floats, rotation: Floats | None, at_rest: Floats, scale: Floats | None) -> Local:
    """The local transform of a joint with this world position (frames, 3) and rotation Q (frames, 4).

    Where a parent is scaled to nothing, the translation at rest is kept.
    """
    away = position - above.position
    if above.linear is None:
        translation = rigid.rotate(rigid.inverse(above.rotation), away)
    else:
        matrices = np.broadcast_to(above.linear, (len(away), 3, 3))
        is_usable = np.abs(np.linalg.det(matrices)) > MIN_DETERMINANT
        solvable = np.where(is_usable[:, None, None], matrices, np.eye(3))
        translation = np.linalg.solve(solvable, away[:, :, None])[:, :, 0]
        translation = np.where(is_usable[:, None], translation, at_rest)
    if rotation is not None:
        rotation = mirrored(above.mirror, rigid.multiply(rigid.inverse(above.rotation), rotation))
        rotation = continuous(np.broadcast_to(rotation, (len(away), 4)))
    return Local(translation, rotation, scale)


def continuous(rotations: Floats) -> Floats:
    """Quaternions (frames, 4) with signs that do not flip from frame to frame: viewers interpolate components."""
    flips = np.where(np.sum(rotations[1:] * rotations[:-1], axis=1) < 0, -1.0, 1.0)
    return rotations * np.concatenate([[1.0], np.cumprod(flips)])[:, None]
