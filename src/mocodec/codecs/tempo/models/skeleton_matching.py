"""Which joint of the prior each joint of a file corresponds to, from positions and topology.

    a tree ─12 headings, 5 sizes─► for each joint and each of the prior's: least cost of the subtree ─► joint of each
    joints, movement ─► hubs, relative bones, proportions ─► Correspondence

Names are not used. The cost of matching a subtree is found by dynamic programming from the leaves: a bone corresponds
to one of the prior's, or to two or three in a row, or is an extra bone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ....errors import Corrupt
from ....motion import Motion, Skeleton
from ....typing import Floats, Integers
from ..coding import contexts
from ..coding.rows import step_size
from ..pose import bone_directions, heading, tree_fitting
from ..pose.bone_tree import ZERO_LENGTH_M, BoneTree
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

HEADINGS = 12
SIZES = (0.72, 0.85, 1.0, 1.18, 1.4)
"""Sizes of the prior's body that are tried, relative to what the extent of the points suggests."""
NEAR_M, NEAR_SHARE = 0.03, 0.3
"""Usual distance between the ends of corresponding bones: a constant, and a share of the length."""
LENGTH_LOG = 0.2
"""Usual difference of their lengths, as a natural logarithm; lengths do not depend on the pose."""
EXTRA_COST, SKIP_COST = 3.0, 1.0
"""Cost of a bone without correspondence, and of a bone of the prior that is passed over."""
MOST_SKIPPED = 3
"""A bone corresponds to at most this many of the prior's in a row, and at most so many extra bones stand in a row."""
MOST_ROOTS = 4
"""At most so many joints, those nearest to the middle of the body, are tried as root."""
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
    """The skeleton of chunks (frames, points, 3), y up, matched to the prior's; None if they have none that fits.

    like: any motion with their names, rate and skeleton. step: log₂ of about the step, 1/32 octave.
    """
    known = prior.joints
    if not tree_fitting.FEWEST_POINTS <= like.points <= tree_fitting.MOST_POINTS:
        return None
    if sum(map(len, chunks)) < tree_fitting.FEWEST_FRAMES:
        return None
    some = (r[:: max(1, len(r) // SAMPLED_FRAMES)] for r in chunks)
    centred = [r - r.mean(axis=1, keepdims=True) for r in some]
    pose = heading.mean_pose(np.concatenate(centred))
    aligned = [heading.align(c, pose) for c in centred]
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
        if _is_rigid(matched, np.concatenate(rotated), 2 * tolerance):
            sample = chunks[:: -(-len(chunks) // LEVEL_CHUNKS)]
            start = matched.model(like.names, like.rate)
            levels = cheapest_levels(sample, start, matched.pose_spreads, USUAL_LEVELS, step)
            return replace(matched, stored=replace(stored, levels=levels))
    return None


def _is_rigid(matched: MatchedSkeleton, poses: Floats, tolerance_m: float) -> bool:
    """Whether poses (frames, points, 3) come back from their directions within the tolerance, nearly everywhere."""
    centred = poses[:, matched.columns] - poses.mean(axis=1, keepdims=True)
    decoded = bone_directions.inverse(matched.tree, bone_directions.forward(matched.tree, centred))
    off = np.sqrt(((decoded - centred) ** 2).sum(axis=2))
    return bool((off > tolerance_m).mean() < tree_fitting.LOOSE_SHARE)


@dataclass(frozen=True, eq=False)
class Match:
    """cost; angle that rotates the pose as the prior's; parents; joint (points,): of the prior, or NO_JOINT."""

    cost: float
    angle: float
    parents: tuple[int, ...]
    joint: Integers


def _best_match(
    aligned: Floats, parents: tuple[int, ...], pose: Floats, known: JointSet, tolerance_m: float, of_skeleton: bool
) -> Match:
    roots = [parents] if of_skeleton else _rooted(parents, pose)
    best = min((_TreeMatcher(aligned, tree, known).match() for tree in roots), key=lambda m: m.cost)
    if not of_skeleton and (tree := _relinked(aligned, best, known.tree, tolerance_m)) != best.parents:
        best = min(best, _TreeMatcher(aligned, tree, known).match(), key=lambda m: m.cost)
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


class _TreeMatcher:
    """Dynamic programming over a tree, for all headings and sizes ("ways") at once.

    Costs are arrays (sets, prior's joints, ways): for each set of branches of the prior that a subtree uses, as bits,
    and each joint of the prior that the joint above corresponds to.
    """

    def __init__(self, aligned: Floats, parents: tuple[int, ...], known: JointSet) -> None:
        """aligned (frames, points, 3): the pose is their mean; lengths of bones are their medians."""
        order = tree_fitting.topological_order(parents)
        assert order is not None
        self.aligned, self.parents, self.order = aligned, parents, order
        self.theirs = bone_directions.inverse(known.tree, np.zeros((1, known.tree.dimensions)))[0]
        self.pose = aligned.mean(axis=0)
        extent = np.sqrt((self.theirs**2).mean() / max(float((aligned**2).mean()), 1e-12))
        angles = np.arange(HEADINGS) * 2 * np.pi / HEADINGS
        rotated = heading.rotate(np.repeat(self.pose[None], HEADINGS, axis=0), angles)
        self.poses = np.concatenate([rotated] * len(SIZES))
        self.sizes = np.repeat(np.array(SIZES) * extent, HEADINGS)
        self.children: dict[int, list[int]] = {}
        for j in order[1:]:
            self.children.setdefault(parents[j], []).append(int(j))
        offsets = self.pose - self.pose[np.maximum(parents, 0)]
        self.zero_length = {int(j) for j in order[1:] if float((offsets[j] ** 2).sum()) <= ZERO_LENGTH_M**2}
        self.start, self.branch_of, self.end, self.toll = _descending_paths(known.tree.parents)
        self.bones = self.theirs[self.end] - self.theirs[self.start]
        self.lengths = np.sqrt((self.bones**2).sum(axis=1))
        self.wide = 2 * (NEAR_M + NEAR_SHARE * self.lengths) ** 2
        self.groups = np.flatnonzero(np.diff(self.branch_of * len(self.theirs) + self.start, prepend=-1))
        self.sets = 1 << (int(self.branch_of.max()) + 1)
        self.shape = (self.sets, len(self.theirs), len(self.poses))
        self._memo: dict[tuple[str, int, int, int], Floats] = {}

    def _path_costs(self, joint: int, above: int) -> Floats:
        """Cost of matching this subtree's first bone to each descending path of the prior: (paths, ways)."""
        key = ("paths", joint, above, 0)
        if key not in self._memo:
            offset = self.poses[:, joint] - self.poses[:, above]
            apart = np.sqrt(((self.aligned[:, joint] - self.aligned[:, above]) ** 2).sum(axis=1))
            long = self.sizes * np.median(apart)
            offset = offset / np.maximum(np.sqrt((offset**2).sum(axis=1)), 1e-9)[:, None] * long[:, None]
            cost = ((offset - self.bones[:, None]) ** 2).sum(axis=2) / self.wide[:, None]
            ratio = np.log((long + NEAR_M) / (self.lengths[:, None] + NEAR_M))
            cost += (ratio / LENGTH_LOG) ** 2 / 2
            self._memo[key] = cost + self.toll[:, None] + self._below(joint).min(axis=0)[self.end]
        return self._memo[key]

    def _branch_costs(self, joint: int, above: int) -> Floats:
        """The least of these by branch, (branches, prior's joints that `above` corresponds to, ways)."""
        key = ("branches", joint, above, 0)
        if key not in self._memo:
            out = np.full((int(self.branch_of.max()) + 1, *self.shape[1:]), np.inf)
            at = self.branch_of[self.groups], self.start[self.groups]
            out[at] = np.minimum.reduceat(self._path_costs(joint, above), self.groups, axis=0)
            self._memo[key] = out
        return self._memo[key]

    def _extra_costs(self, joint: int, above: int, extras: int) -> Floats:
        """Cost of the subtree if its first bone is an extra bone, after `extras` others in a row."""
        key = ("extra", joint, above, extras)
        if key not in self._memo:
            children = self.children.get(joint, [])
            if joint in self.zero_length:
                out = _disjoint_sums([self._subtree(c, above, extras) for c in children], self.shape)
            elif extras < MOST_SKIPPED:
                out = EXTRA_COST + _disjoint_sums([self._subtree(c, above, extras + 1) for c in children], self.shape)
            else:
                out = np.full(self.shape, np.inf)
                out[0] = EXTRA_COST * len(_descendants(joint, self.parents))
            self._memo[key] = out
        return self._memo[key]

    def _subtree(self, joint: int, above: int, extras: int) -> Floats:
        """Least cost of the subtree."""
        key = ("subtree", joint, above, extras)
        if key not in self._memo:
            out = self._extra_costs(joint, above, extras).copy()
            if joint not in self.zero_length:
                for b, cost in enumerate(self._branch_costs(joint, above)):
                    out[1 << b] = np.minimum(out[1 << b], cost)
            self._memo[key] = out
        return self._memo[key]

    def _below(self, joint: int) -> Floats:
        """Least cost of all subtrees below a joint, if it corresponds to each of the prior's."""
        key = ("below", joint, 0, 0)
        if key not in self._memo:
            children = self.children.get(joint, [])
            self._memo[key] = _disjoint_sums([self._subtree(c, joint, 0) for c in children], self.shape)
        return self._memo[key]

    def match(self) -> Match:
        for joint in self.order[::-1]:  # from the leaves, so that long chains do not recurse deeply
            self._below(int(joint))
        root = int(self.order[0])
        cost = self._below(root).min(axis=0)
        first, way = (int(i) for i in np.unravel_index(cost.argmin(), cost.shape))
        joint = np.full(len(self.parents), NO_JOINT)
        joint[root] = first
        todo = self._share(root, root, first, 0, int(self._below(root)[:, first, way].argmin()), way)
        while todo:
            todo += self._follow(*todo.pop(), way, joint)
        sure = joint >= 0
        here, there = (each - each.mean(axis=0) for each in (self.pose[sure], self.theirs[joint[sure]]))
        return Match(float(cost[first, way]), -float(heading.heading(here[None], there)[0]), self.parents, joint)

    def _follow(
        self, joint: int, above: int, at_above: int, extras: int, branches: int, way: int, out: Integers
    ) -> list[tuple[int, int, int, int, int]]:
        """Enters the correspondence of a subtree's first joint in `out`, and returns its subtrees.

        at_above: the prior's joint that `above` corresponds to; branches: the set that the subtree uses.
        """
        only = branches.bit_length() - 1
        alone = branches and branches == 1 << only and joint not in self.zero_length
        if (
            alone
            and self._branch_costs(joint, above)[only, at_above, way]
            <= self._extra_costs(joint, above, extras)[branches, at_above, way]
        ):
            paths = np.flatnonzero((self.branch_of == only) & (self.start == at_above))
            at = int(self.end[paths[self._path_costs(joint, above)[paths, way].argmin()]])
            out[joint] = at
            return self._share(joint, joint, at, 0, int(self._below(joint)[:, at, way].argmin()), way)
        if joint in self.zero_length or extras < MOST_SKIPPED:
            return self._share(joint, above, at_above, extras + (joint not in self.zero_length), branches, way)
        return []

    def _share(
        self, joint: int, above: int, at_above: int, extras: int, branches: int, way: int
    ) -> list[tuple[int, int, int, int, int]]:
        """The set of branches distributed among the children of a joint, as arguments of `_follow`."""
        below = self.children.get(joint, [])
        costs = [self._subtree(c, above, extras)[:, at_above, way] for c in below]
        out = []
        for i in range(len(below) - 1, -1, -1):
            others = _disjoint_sums([c[:, None, None] for c in costs[:i]], (self.sets, 1, 1))[:, 0, 0]
            own = min(_subsets(branches), key=lambda s: others[branches ^ s] + costs[i][s])
            out.append((below[i], above, at_above, extras, own))
            branches ^= own
        return out


def _disjoint_sums(costs: Sequence[Floats], shape: tuple[int, int, int]) -> Floats:
    """Least sum of subtrees' costs (sets, …), by the union of the sets that they use, no branch used twice."""
    out = np.full(shape, np.inf)
    out[0] = 0.0
    for cost in costs:
        before, out = out, np.full(shape, np.inf)
        for union in range(shape[0]):
            for own in _subsets(union):
                np.minimum(out[union], before[union ^ own] + cost[own], out=out[union])
    return out


def _subsets(bits: int) -> list[int]:
    return [s for s in range(bits + 1) if s & bits == s]


def _descending_paths(parents: Sequence[int]) -> tuple[Integers, Integers, Integers, Floats]:
    """Paths of at most `MOST_SKIPPED` bones down a tree: start, number of the branch at the start, end, and toll for
    the bones that are passed over. Ordered by branch and start."""
    children = [[j for j, p in enumerate(parents) if p == v] for v in range(len(parents))]
    paths: list[tuple[int, int, int, float]] = []
    for j in range(len(parents)):
        at = j
        for skipped in range(MOST_SKIPPED):
            if parents[at] < 0:
                break
            paths.append((children[parents[at]].index(at), parents[at], j, SKIP_COST * skipped))
            at = parents[at]
    branch, start, end, toll = (np.array(column) for column in zip(*sorted(paths), strict=True))
    return start, branch, end, toll


def _descendants(joint: int, parents: Sequence[int]) -> list[int]:
    """The joint and all below it."""
    out = [joint]
    for at in out:
        out += [j for j, p in enumerate(parents) if p == at]
    return out


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
        ambiguous = [
            columns[b] for b, far in zip(rest.schedule.bones, farthest, strict=True) if far > AMBIGUOUS_RAD**2
        ]
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
    for j in np.flatnonzero(~sure & relative & ~rest.zero_length):
        rest = tree_fitting.with_relative(rest, found.poses, int(j))
    return stored(rest.vectors)
