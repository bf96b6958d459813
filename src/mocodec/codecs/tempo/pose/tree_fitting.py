"""A bone tree found in poses: which points are linked, which bones rotate together, and where each points at rest.

poses ─trees─► parents ─fit─► hubs · rest directions · which bones are relative ──► BoneTree
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ....motion import Skeleton
from ....typing import Booleans, Floats, Integers
from . import bone_directions, bone_tree, rotations
from .bone_tree import BODY, ZERO_LENGTH_M, BoneTree

FEWEST_FRAMES, FEWEST_POINTS = 16, 4
"""With fewer frames or points, constant distances do not show that the points are the joints of a body."""
MOST_POINTS = 128
"""A tree is searched among at most this many points."""
LOOSE_SHARE = 0.01
"""A bone is rigid, and a tree represents poses, if fewer than this share of the samples exceed the tolerance."""
PROBED_FRAMES, PROBE_TOLERANCE, PROBE_SHARE = 64, 1.5, 5 * LOOSE_SHARE
"""Points that are not linked even in few poses, by wider limits, form no tree."""
RIGID_RAD = 1e-4
"""Bones of one joint whose angle never varies by more than this form a hub."""
SPREAD_SINE = 0.05
"""The bones of a hub make an angle of at least this sine, or its rotation would not be determined."""
RELATIVE_REACH = 1.4
"""A bone is relative if its whole subtree lies within this many lengths of the bone before it."""


def trees(poses: Floats, skeleton: Skeleton | None, tolerance_m: float) -> Iterator[tuple[Sequence[int], bool]]:
    """Parents of each point, to be tried in turn, and whether they are the skeleton's.

    poses (frames, points, 3), metres; tolerance_m: how much the length of a bone may vary.
    """
    if skeleton is not None:
        yield skeleton.parents, True
    if 2 <= poses.shape[1] <= MOST_POINTS and (found := _rigid_tree(poses, tolerance_m)) is not None:
        yield found, False


def _rigid_tree(poses: Floats, tolerance_m: float) -> tuple[int, ...] | None:
    """Parent of each point in the minimum spanning tree of rigid links (Prim), or None if they do not span."""
    if len(poses) > 2 * PROBED_FRAMES:
        probe = poses[:: len(poses) // PROBED_FRAMES]
        if _spanning(*_rigid_links(probe, PROBE_TOLERANCE * tolerance_m, PROBE_SHARE)) is None:
            return None
    return _spanning(*_rigid_links(poses, tolerance_m, LOOSE_SHARE))


def _rigid_links(poses: Floats, tolerance_m: float, loose_share: float) -> tuple[Floats, Booleans]:
    """Median distances (points, points), metres, and which of them vary by more than the tolerance in few samples."""
    points = poses.shape[1]
    a, b = np.triu_indices(points, 1)
    x, y, z = (np.ascontiguousarray(poses[..., axis].T) for axis in range(3))
    apart = np.sqrt((x[a] - x[b]) ** 2 + (y[a] - y[b]) ** 2 + (z[a] - z[b]) ** 2)
    median = np.median(apart, axis=1)
    loose = (np.abs(apart - median[:, None]) > tolerance_m).mean(axis=1)
    usual, rigid = np.zeros((points, points)), np.eye(points, dtype=bool)
    usual[a, b] = usual[b, a] = median
    rigid[a, b] = rigid[b, a] = loose < loose_share
    return usual, rigid


def _spanning(usual: Floats, rigid: Booleans) -> tuple[int, ...] | None:
    """The minimum spanning tree over rigid links of these lengths (points, points)."""
    cost = np.where(rigid, usual, np.inf)
    root = int(usual.sum(axis=0).argmin())
    parents = np.full(len(cost), -1)
    nearest, link = cost[root].copy(), np.full(len(cost), root)
    outside = np.ones(len(cost), bool)
    outside[root] = False
    while outside.any():
        at = int(np.where(outside, nearest, np.inf).argmin())
        if not outside[at] or not np.isfinite(nearest[at]):
            return None
        parents[at], outside[at] = link[at], False
        closer = cost[at] < nearest
        nearest[closer], link[closer] = cost[at][closer], at
    return tuple(int(p) for p in parents)


def represents(tree: BoneTree, poses: Floats, tolerance_m: float) -> bool:
    """Whether poses (frames, points, 3), in the tree's order, come back from their bone directions within the
    tolerance, in nearly all samples."""
    centred = np.ascontiguousarray(poses.T)  # NumPy's loops run along the frames
    centred -= centred.mean(axis=1, keepdims=True)
    decoded = bone_directions.inverse(tree, bone_directions.forward(tree, centred.T)).T
    off = np.sqrt(((decoded - centred) ** 2).sum(axis=0))
    return bool((off > tolerance_m).mean() < LOOSE_SHARE)


def topological_order(parents: Sequence[int]) -> Integers | None:
    """Points in an order in which each comes after its parent, or None if the parents are not one tree."""
    children: dict[int, list[int]] = {}
    for point, parent in enumerate(parents):
        children.setdefault(parent, []).append(point)
    order = list(children.get(-1, []))
    if len(order) != 1:
        return None
    for at in order:
        order += children.get(at, [])
    return np.array(order) if len(order) == len(parents) else None


def reordered_parents(parents: Sequence[int], order: Integers) -> tuple[int, ...]:
    """The parents of points that are put in this order."""
    place = np.append(np.argsort(order), -1)  # the root's parent, −1, stays
    return tuple(int(place[parents[c]]) for c in order)


def fit(poses: Sequence[Floats], parents: Sequence[int], builds: Sequence[Floats] | None = None) -> BoneTree:
    """The bone tree of runs of poses (frames, points, 3), in the frame of the body, with these parents.

    builds: offsets (points, 3) of the skeleton of each run, if they are known.
    """
    offsets = [bone_directions.offsets_from_parents(p, parents) for p in poses]
    vectors = _mean_directions(offsets)
    hub = _hubs(offsets, parents, vectors, builds)
    relative = _relative(parents, vectors)
    tree = BoneTree(tuple(parents), _with_rigid_hubs(vectors, offsets, parents, hub), hub, np.zeros(len(parents), bool))
    return with_relative(tree, poses, np.flatnonzero(relative))


def _relative(parents: Sequence[int], vectors: Floats) -> Booleans:
    """Hands, feet and forearms; and all that hangs on a relative bone."""
    lengths = np.sqrt((vectors**2).sum(axis=1))
    reach = np.zeros(len(parents))
    for j in range(len(parents) - 1, -1, -1):
        if parents[j] >= 0:
            reach[parents[j]] = max(reach[parents[j]], reach[j] + lengths[j])
    out, before = np.zeros(len(parents), bool), np.zeros(len(parents))
    for j, p in enumerate(parents):
        if p < 0:
            continue
        before[j] = lengths[p] if lengths[p] > ZERO_LENGTH_M else before[p]
        out[j] = before[j] > 0 and (out[p] or reach[j] + lengths[j] < RELATIVE_REACH * before[j])
    return out & (lengths > ZERO_LENGTH_M)


def _mean_directions(runs: Sequence[Floats]) -> Floats:
    """Mean directions (points, 3) of offsets (3, points, frames) in several runs, of the mean length."""
    frames = sum(r.shape[2] for r in runs)
    length = np.asarray(sum(np.sqrt((r**2).sum(axis=0)).sum(axis=1) for r in runs)) / frames
    direction = np.asarray(sum(r.sum(axis=2) for r in runs)).T
    size = np.sqrt((direction**2).sum(axis=1, keepdims=True))
    safe = np.where(size > 1e-9 * frames, direction / np.maximum(size, 1e-30), [0.0, 1.0, 0.0])
    return safe * length[:, None]


def _hubs(runs: Sequence[Floats], parents: Sequence[int], vectors: Floats, builds: Sequence[Floats] | None) -> Booleans:
    """Mask of the bones that form a hub: same joint, constant angles, not all collinear.

    builds: offsets (points, 3) of each run's skeleton, whose angles they must have; else the median angle of all runs.
    """
    lengths = np.sqrt((vectors**2).sum(axis=1))
    out = np.zeros(len(parents), bool)
    for joint in range(len(parents)):
        bones = [j for j, p in enumerate(parents) if p == joint and lengths[j] > ZERO_LENGTH_M]
        best: list[int] = []
        for first in bones:
            together, spread = [first], 0.0
            for other in (b for b in bones if b != first):
                angles = [rotations.angle_between(r[:, first], r[:, other]) for r in runs]
                usual = [float(np.median(a)) for a in angles]
                if builds is None:
                    usual = [float(np.median(usual))] * len(runs)
                else:
                    usual = [float(rotations.angle_between(b[first], b[other])) for b in builds]
                off = max(float(np.abs(a - m).max()) for a, m in zip(angles, usual, strict=True))
                if off < RIGID_RAD:
                    together.append(other)
                    spread = max(spread, abs(float(np.sin(usual[0]))))
            if len(together) > max(1, len(best)) and spread > SPREAD_SINE:
                best = together
        out[best] = True
    return out


def _with_rigid_hubs(vectors: Floats, offsets: Sequence[Floats], parents: Sequence[int], hub: Booleans) -> Floats:
    """Rest vectors whose hubs have their measured shape, rotated nearest to their mean directions."""
    out = vectors.copy()
    for joint in sorted({p for p, in_hub in zip(parents, hub, strict=True) if in_hub}):
        children = [j for j, p in enumerate(parents) if hub[j] and p == joint]
        shape = offsets[0][:, children, offsets[0].shape[2] // 2].T
        out[children] = rotations.rotated_onto(shape, vectors[children])
    return out


def with_relative(tree: BoneTree, poses: Sequence[Floats], bones: Integers) -> BoneTree:
    """The tree with these bones, and the hubs that they belong to, made relative, and their mean directions so.

    A direction is in the frame of the bone before it, so that bones are worked on level by level.
    """
    hubs = tree.schedule.hub_bones
    sets = {tuple(hubs[tree.parents[j]]) if tree.hub[j] else (j,) for j in bones.tolist()}
    relative = tree.relative.copy()
    relative[[j for together in sets for j in together]] = True
    level_of = bone_tree.levels(replace(tree, relative=relative))
    for level in sorted({level_of[together[0]] for together in sets}):
        tree = _with_relative_level(tree, poses, [each for each in sets if level_of[each[0]] == level])
    return tree


def _with_relative_level(tree: BoneTree, poses: Sequence[Floats], sets: Sequence[tuple[int, ...]]) -> BoneTree:
    """`with_relative`, for bones, or all bones of hubs, whose references are known."""
    relative, vectors = tree.relative.copy(), tree.vectors.copy()
    relative[[j for together in sets for j in together]] = True
    changed = replace(tree, relative=relative)
    runs = [_Offsets.of(changed, p) for p in poses]
    for together in sets:
        mean = _mean_directions([run.in_reference(changed, together) for run in runs])
        own = list(together)
        vectors[own] = rotations.rotated_onto(vectors[own], mean) if tree.hub[own[0]] else mean
    return replace(changed, vectors=vectors)


class _Offsets(NamedTuple):
    """from_parents (3, points, frames), in the frame of the body; frames (3, 3, slots, frames) of all references."""

    from_parents: Floats
    frames: Floats

    @classmethod
    def of(cls, tree: BoneTree, pose: Floats) -> _Offsets:
        """The offsets in poses (frames, points, 3)."""
        coordinates = tree.schedule.split(np.empty((tree.dimensions, len(pose))))
        frames = bone_directions.frames_and_coordinates(tree, pose, *coordinates)
        return cls(bone_directions.offsets_from_parents(pose, tree.parents), frames)

    def in_reference(self, tree: BoneTree, bones: Sequence[int]) -> Floats:
        """Offsets (3, bones, frames) of bones that have one reference, in its frame."""
        offsets, schedule = self.from_parents[:, list(bones)], tree.schedule
        reference = schedule.reference[bones[0]]
        if reference == BODY:
            return offsets
        own = rotations.into(self.frames[:, :, [schedule.slot[reference]]], offsets)
        return rotations.into(schedule.axes[reference][..., None, None], own)
