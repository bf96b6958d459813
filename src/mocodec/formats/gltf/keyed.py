"""Sparse keys of a motion: how far each track moves the joints, and how far they are from where they were."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...motion import Motion
from ...typing import Floats
from . import keys
from .local_tracks import Local
from .node_tree import NodeTree
from .nodes import WORLD, Pose, child_pose

SHELL_M = 0.03
"""Distance off a joint of the points that show its rotation."""


def curves(
    motion: Motion,
    tree: NodeTree,
    locals_: Sequence[Local],
    moving: Sequence[tuple[int, str, Floats]],
    tolerance_m: float,
) -> list[keys.Curve]:
    """A curve for each moving property, so that joints and shell points stay within the tolerance.

    moving: node, path and values over time. Raises CannotEncode.
    """
    reach = _reaches(motion, tree)
    properties = [
        keys.Property(values, path == "rotation", 1.0 if path == "translation" else reach[node])
        for node, path, values in moving
    ]
    exact = _shell(tree, locals_, len(motion))

    def errors(sampled: list[Floats]) -> Floats:
        replaced = [local._asdict() for local in locals_]
        for (node, path, _), values in zip(moving, sampled, strict=True):
            replaced[node][path] = values
        made = _shell(tree, [Local(**local) for local in replaced], len(motion))
        off = np.sqrt(np.sum((made - exact) ** 2, axis=-1)).max(axis=1)
        return _below(tree, off)[[node for node, _, _ in moving]]

    return keys.fit(properties, errors, tolerance_m)


def _below(tree: NodeTree, errors: Floats) -> Floats:
    """For each node the largest error (nodes, frames) of it and the joints below; errors (joints, frames)."""
    result = np.zeros((len(tree), errors.shape[1]))
    for node in reversed(range(len(tree))):
        if tree.joints[node] >= 0:
            result[node] = np.maximum(result[node], errors[tree.joints[node]])
        if (parent := tree.parents[node]) >= 0:
            result[parent] = np.maximum(result[parent], result[node])
    return result


def _shell(tree: NodeTree, locals_: Sequence[Local], frames: int) -> Floats:
    """Joints and the points SHELL_M off them in three directions (joints, 4, frames, 3)."""
    poses = list[Pose]()
    points = np.empty((max(tree.joints) + 1, 4, frames, 3))
    for node, (parent, local) in enumerate(zip(tree.parents, locals_, strict=True)):
        stretch = np.diag(tree.scale[node])[None] if local.scale is None else np.eye(3) * local.scale[:, :, None]
        pose = child_pose(
            poses[parent] if parent >= 0 else WORLD,
            tree.translation[node][None] if local.translation is None else local.translation,
            tree.rotation[node][None] if local.rotation is None else local.rotation,
            stretch,
        )
        poses.append(pose)
        if tree.joints[node] >= 0:
            axes = pose.matrices()
            axes = axes / np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-12)
            points[tree.joints[node]] = pose.position
            points[tree.joints[node], 1:] += SHELL_M * axes.transpose(2, 0, 1)
    return points


def _reaches(motion: Motion, tree: NodeTree) -> Floats:
    """The length (nodes,) of the longest chain of bones that each node turns, metres."""
    middle = motion.positions[len(motion) // 2]
    at = np.zeros((len(tree), 3))
    for node, (joint, parent) in enumerate(zip(tree.joints, tree.parents, strict=True)):
        at[node] = middle[joint] if joint >= 0 else at[parent] if parent >= 0 else 0.0
    reach = np.full(len(tree), SHELL_M)
    for node in reversed(range(len(tree))):
        if (parent := tree.parents[node]) >= 0:
            reach[parent] = max(reach[parent], reach[node] + np.linalg.norm(at[node] - at[parent]))
    return reach
