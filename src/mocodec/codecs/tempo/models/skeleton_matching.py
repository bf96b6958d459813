"""Which joint of the prior each joint of a file corresponds to, from positions and topology.

    a tree ─12 headings, 5 sizes─► for each joint and each of the prior's: least cost of the subtree ─► joint of each
    joints, movement ─► hubs, relative bones, proportions ─► Correspondence

Names are not used. `tree_matching` finds the cheapest correspondence of two trees.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .... import parallel
from ....errors import Corrupt
from ....motion import Motion, Skeleton
from ....typing import Floats, Integers
from ..coding import contexts
from ..coding.rows import step_size
from ..pose import bone_directions, heading, tree_fitting
from ..pose.bone_tree import BoneTree
from . import build, skeleton_correspondence
from .marker_fitting import cheapest_levels
from .prior import JointSet, Prior
from .skeleton_correspondence import (
    DIRECTION_DIGITS,
    HUB,
    NO_JOINT,
    RELATIVE,
    USUAL_LEVELS,
    Correspondence,
    MatchedSkeleton,
)
from .tree_matching import Match, TreeMatcher

MOST_ROOTS = 4
"""Number of joints that are tried as root, at most: those nearest to the middle of the body."""
FEWEST_MATCHED = 4
LEVEL_CHUNKS = 8
"""Levels are fitted to about this many of the chunks."""
STRETCH_STEPS = 0.1
"""Tolerance of a bone's length, in quantisation steps."""
SAMPLED_FRAMES = 64
"""Frames of each chunk that are used."""
AMBIGUOUS_RAD = 2.5
"""A bone that tilts farther than this from the prior's rest direction does not correspond: its antipode is near."""


def match(chunks: Sequence[Floats], like: Motion, step: int, prior: Prior) -> MatchedSkeleton | None:
    """The skeleton of chunks (frames, points, 3), y up, matched to the prior's; None if no tree fits.

    like: any motion with their names, rate and skeleton. step: log₂ of about the step, 1/32 octave.
    """
    known = prior.joints
    if not tree_fitting.FEWEST_POINTS <= like.points <= tree_fitting.MOST_POINTS:
        return None
    if sum(map(len, chunks)) < tree_fitting.FEWEST_FRAMES:
        return None
    some = [r[:: max(1, len(r) // SAMPLED_FRAMES)] for r in chunks]
    centred = heading.centred(some)
    pose = heading.mean_pose(centred)
    stops = np.cumsum([len(r) for r in some])
    aligned = list(parallel.over(lambda c: heading.align(c, pose), np.split(centred, stops[:-1])))
    tolerance = float(STRETCH_STEPS * step_size(step))
    every = np.concatenate(aligned)
    for parents, of_skeleton in tree_fitting.trees(every, like.skeleton, tolerance):
        if tree_fitting.topological_order(parents) is None:
            continue
        best = _best_match(every, tuple(parents), pose, known, tolerance, of_skeleton)
        if (best.joint >= 0).sum() < FEWEST_MATCHED:
            continue
        rotated = [heading.rotate(a, np.full(len(a), best.angle)) for a in aligned]
        fine = None if of_skeleton else step - build.FINER
        try:
            stored = _correspondence(rotated, best, fine, known.tree, like.skeleton)
            matched = MatchedSkeleton.of(stored, prior, like.skeleton)
        except Corrupt:
            continue
        in_order = np.concatenate(rotated)[:, matched.columns]
        if tree_fitting.represents(matched.tree, in_order, 2 * tolerance):
            sample = chunks[:: -(-len(chunks) // LEVEL_CHUNKS)]
            start = matched.model(like.names, like.rate)
            levels = cheapest_levels(sample, start, matched.pose_spreads, USUAL_LEVELS, step)
            return replace(matched, stored=replace(stored, levels=levels))
    return None


def _best_match(
    aligned: Floats, parents: tuple[int, ...], pose: Floats, known: JointSet, tolerance_m: float, of_skeleton: bool
) -> Match:
    roots = [parents] if of_skeleton else _rooted(parents, pose)
    matcher = TreeMatcher(aligned, known)
    best = min((matcher.match(tree) for tree in roots), key=lambda m: m.cost)
    if not of_skeleton and (tree := _relinked(aligned, best, known.tree, tolerance_m)) != best.parents:
        best = min(best, matcher.match(tree), key=lambda m: m.cost)
    return best


def _rooted(parents: Sequence[int], pose: Floats) -> Iterator[tuple[int, ...]]:
    """The tree with some of the joints of three bones or more as root, or with its own root."""
    beside: dict[int, list[int]] = {j: [] for j in range(len(parents))}
    for j, p in enumerate(parents):
        if p >= 0:
            beside[j].append(p)
            beside[p].append(j)
    distance = (pose**2).sum(axis=1)
    branching = sorted((j for j, near in beside.items() if len(near) > 2), key=distance.__getitem__)[:MOST_ROOTS]
    for root in branching or [list(parents).index(-1)]:
        out = [-1] * len(parents)
        todo = [root]
        for at in todo:
            for other in beside[at]:
                if other != out[at]:
                    out[other] = at
                    todo.append(other)
        yield tuple(out)


def _relinked(poses: Floats, match_: Match, like: BoneTree, tolerance_m: float) -> tuple[int, ...]:
    """The tree with joints linked as the prior's are, where those links are rigid too."""
    parents = list(match_.parents)
    for j, expected in enumerate(skeleton_correspondence.expected_parents(match_.joint, like)):
        if match_.joint[j] < 0 or expected < 0 or parents[j] < 0:
            continue
        apart = np.sqrt(((poses[:, j] - poses[:, expected]) ** 2).sum(axis=1))
        if (np.abs(apart - np.median(apart)) > tolerance_m).mean() < tree_fitting.LOOSE_SHARE:
            before, parents[j] = parents[j], int(expected)
            if tree_fitting.topological_order(parents) is None:
                parents[j] = before
    return tuple(parents)


@dataclass(frozen=True, eq=False)
class _Found:
    """A matched tree in order: poses (frames, points, 3) of each chunk, the tree, and what of it is stored."""

    poses: Sequence[Floats]
    tree: BoneTree
    digits: int
    parents: tuple[int, ...]
    like: BoneTree
    skeleton: Skeleton | None

    @cached_property
    def order(self) -> Integers:
        parents = self.parents or (self.skeleton.parents if self.skeleton is not None else ())
        order = tree_fitting.topological_order(parents)
        assert order is not None
        return order


def _correspondence(
    poses: Sequence[Floats], match_: Match, fine: int | None, like: BoneTree, skeleton: Skeleton | None
) -> Correspondence:
    """The stored form of a match, for poses (frames, points, 3) rotated as the prior's. Raises Corrupt.

    fine: log₂ of the step of proportions, 1/32 octave; None where they are the skeleton's.
    """
    parents, joint = match_.parents, match_.joint.copy()
    columns = tree_fitting.topological_order(parents)
    assert columns is not None
    back = np.argsort(columns)
    for j in columns[:0:-1]:  # an extra joint just above a matched one is on the same bone
        if joint[parents[j]] < 0 <= joint[j] and parents[parents[j]] >= 0:
            joint[parents[j]] = joint[j]
    builds = [skeleton.offsets[columns]] * len(poses) if skeleton is not None and fine is None else None
    in_order = [p[:, columns] for p in poses]
    tree = tree_fitting.fit(in_order, tree_fitting.reordered_parents(parents, columns), builds)
    joint[(tree.zero_length[back]) | (np.array(like.parents)[joint] < 0)] = NO_JOINT
    digits = DIRECTION_DIGITS if fine is None else round(-fine / contexts.OCTAVE + 0.5)
    found = _Found(in_order, tree, digits, () if fine is None else parents, like, skeleton)
    while True:
        stored = _with_directions(found, joint)
        rest, _ = skeleton_correspondence.rest_tree(stored, like, skeleton)
        tilts, _ = rest.schedule.split(np.concatenate([bone_directions.forward(rest, p) for p in in_order]).T)
        farthest = (tilts**2).sum(axis=0).max(axis=1)
        ambiguous = [columns[b] for b, far in zip(rest.schedule.bones, farthest, strict=True) if far > AMBIGUOUS_RAD**2]
        if (joint[ambiguous] < 0).all():
            break
        joint[ambiguous] = NO_JOINT
    if fine is None:
        return stored
    lengths, offsets = build.median_lengths(np.concatenate(in_order), rest.parents)
    measured = rest.with_offsets(offsets)
    sure = joint[columns] >= 0
    shapes = measured.vectors - np.where(sure[:, None], rest.vectors, 0.0)
    numbers = np.where((sure & ~rest.hub)[:, None], (lengths - rest.lengths)[:, None], shapes)
    return replace(stored, vectors=np.rint(np.ldexp(numbers[back], digits)).astype(np.int64))


def _with_directions(found: _Found, joint: Integers) -> Correspondence:
    """Marks, and the directions of bones without correspondence."""
    tree, like = found.tree, found.like
    at = joint[found.order]
    sure = at >= 0
    hub, relative = tree.hub & ~tree.zero_length, np.where(sure, like.relative[at], tree.relative)
    for parent in {p for p, in_hub in zip(tree.parents, hub, strict=True) if in_hub}:
        bones = [j for j, p in enumerate(tree.parents) if p == parent and hub[j]]
        theirs = [j for j in bones if sure[j] and like.hub[at[j]]]
        relative[bones] = relative[theirs[0]] if theirs else False
        hub[bones] = bool(theirs) or not sure[bones].any()
    back = np.argsort(found.order)

    def stored(vectors: Floats) -> Correspondence:
        rest = np.rint(np.ldexp(np.where(sure[:, None], 0.0, vectors), found.digits)).astype(np.int64)
        marks = (HUB * hub + RELATIVE * relative).astype(np.int64)
        return Correspondence(
            found.digits, found.parents, joint.copy(), marks[back], rest[back], np.array(USUAL_LEVELS)
        )

    rest, _ = skeleton_correspondence.rest_tree(stored(tree.vectors), like, found.skeleton)
    loose = np.flatnonzero(~sure & relative & ~rest.zero_length)
    return stored(tree_fitting.with_relative(rest, found.poses, loose).vectors)
