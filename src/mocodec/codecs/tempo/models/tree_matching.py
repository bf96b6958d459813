"""The cheapest correspondence of a tree of joints to the prior's, by dynamic programming from the leaves.

A bone corresponds to one of the prior's, or to two or three in a row, or is an extra bone. The cost compares where
bones point, for a number of headings and sizes of the body, and how long they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....typing import Floats, Integers
from ..pose import bone_directions, heading, tree_fitting
from ..pose.bone_tree import ZERO_LENGTH_M
from .prior import JointSet
from .skeleton_correspondence import NO_JOINT

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
"""A bone corresponds to a run of at most MOST_SKIPPED bones of the prior; runs of extra bones are as short."""


@dataclass(frozen=True, eq=False)
class Match:
    """cost; angle that rotates the pose as the prior's; parents; joint (points,): of the prior, or NO_JOINT."""

    cost: float
    angle: float
    parents: tuple[int, ...]
    joint: Integers


class TreeMatcher:
    """Dynamic programming over trees of the same points, for all headings and sizes ("ways") at once.

    Costs are arrays (sets, prior's joints, ways): for each set of branches of the prior that a subtree uses, as bits,
    and each joint of the prior that the joint above corresponds to. They are kept while the links stay the same: a
    subtree is the same for every root on its other side.
    """

    def __init__(self, aligned: Floats, known: JointSet) -> None:
        """aligned (frames, points, 3): the pose is their mean; lengths of bones are their medians."""
        self.aligned = aligned
        self.theirs = bone_directions.inverse(known.tree, np.zeros((1, known.tree.dimensions)))[0]
        self.pose = aligned.mean(axis=0)
        extent = np.sqrt((self.theirs**2).mean() / max(float((aligned**2).mean()), 1e-12))
        angles = np.arange(HEADINGS) * 2 * np.pi / HEADINGS
        rotated = heading.rotate(np.repeat(self.pose[None], HEADINGS, axis=0), angles)
        self.poses = np.concatenate([rotated] * len(SIZES))
        self.sizes = np.repeat(np.array(SIZES) * extent, HEADINGS)
        self.start, self.branch_of, self.end, self.toll = _descending_paths(known.tree.parents)
        self.bones = self.theirs[self.end] - self.theirs[self.start]
        self.lengths = np.sqrt((self.bones**2).sum(axis=1))
        self.wide = 2 * (NEAR_M + NEAR_SHARE * self.lengths) ** 2
        self.groups = np.flatnonzero(np.diff(self.branch_of * len(self.theirs) + self.start, prepend=-1))
        self.sets = 1 << (int(self.branch_of.max()) + 1)
        self.shape = (self.sets, len(self.theirs), len(self.poses))
        self._links: set[frozenset[int]] = set()
        self._memo: dict[tuple[str, int, int, int], Floats] = {}

    def _begin(self, parents: tuple[int, ...]) -> None:
        """With this tree."""
        order = tree_fitting.topological_order(parents)
        assert order is not None
        self.parents, self.order = parents, order
        self.children: dict[int, list[int]] = {}
        for j in order[1:]:
            self.children.setdefault(parents[j], []).append(int(j))
        offsets = self.pose - self.pose[np.maximum(parents, 0)]
        self.zero_length = {int(j) for j in order[1:] if float((offsets[j] ** 2).sum()) <= ZERO_LENGTH_M**2}
        links = {frozenset((j, p)) for j, p in enumerate(parents) if p >= 0}
        if links != self._links:
            self._links, self._memo = links, {}

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
        key = ("below", joint, self.parents[joint], 0)
        if key not in self._memo:
            children = self.children.get(joint, [])
            self._memo[key] = _disjoint_sums([self._subtree(c, joint, 0) for c in children], self.shape)
        return self._memo[key]

    def match(self, parents: tuple[int, ...]) -> Match:
        """The cheapest correspondence of the tree with these parents."""
        self._begin(parents)
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
