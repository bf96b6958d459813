"""Which joint of the prior's each joint of a file is, from where the joints are and how they hang together.

    a tree ─turned 12 ways, in 5 sizes─► for each joint and each of the prior's: what the branch costs at best ─► where
    where, movement ─► hubs, what is carried, lengths ─► matched.Stored

Names say nothing here. A branch is laid on a branch: a bone takes the place of one of the prior's, or of two or three
in a row, or is a piece more than the prior has.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ...errors import Corrupt
from ...motion import Floats, Motion, Skeleton
from . import attach, body, contexts, skeletal
from .limbs import SHORTEST_M, Limbs, carry, fit
from .matched import ROUGH, USUAL_LEVELS, Matched, Stored, at_rest, usual_tree
from .model import Model, step_size
from .prior import PointSet, Prior

Integers = NDArray[np.int64]

TURNS = 12
SIZES = (0.72, 0.85, 1.0, 1.18, 1.4)
"""Of the body, against what the spread of its points says."""
NEAR_M, NEAR = 0.03, 0.3
"""A bone ends about so far from where the prior's does, and so much of its length."""
AS_LONG = 0.2
"""Its length differs by about this, as a logarithm: that does not depend on the pose."""
EXTRA, SKIPPED = 3.0, 1.0
"""What a bone costs that none of the prior's stands for, and one of the prior's that is passed over."""
LEVELLED = 8
"""Levels are fitted to about so many of the chunks."""
PASSED = 3
"""A bone stands for at most so many of the prior's in a row, and at most so many in a row are pieces more."""


def candidate(runs: Sequence[Floats], like: Motion, step: int, prior: Prior) -> tuple[bytes, Model] | None:
    """What is stored of the model for runs of positions (frames, points, 3), and that; none where they are no limbs'
    or no body's. like: any motion with their names, rate and skeleton."""
    known = prior.sets[0]
    assert known.limbs is not None
    if not skeletal.FEWEST_POINTS <= like.points <= skeletal.MOST_POINTS:
        return None
    if sum(map(len, runs)) < skeletal.FEWEST_FRAMES:
        return None
    centred = [r - r.mean(axis=1, keepdims=True) for r in (r[:: max(1, len(r) // skeletal.SAMPLED)] for r in runs)]
    pose = body.mean_pose(np.concatenate(centred))
    headed = [body.turn(c, -body.heading(c, pose)) for c in centred]
    tolerance = float(skeletal.STRETCH * step_size(step))
    every = np.concatenate(headed)
    for parents, fine in skeletal.trees(every, like.skeleton, tolerance, step):
        if skeletal.ordered(parents) is None:
            continue
        rooted = [tuple(parents)] if fine is None else _rooted(parents, pose)
        best = min((_laid(every, tree, known) for tree in rooted), key=lambda p: p.cost)
        if fine is not None and (tree := _relinked(every, best, known, tolerance)) != best.parents:
            best = min(best, _laid(every, tree, known), key=lambda p: p.cost)
        if (best.where >= 0).sum() < FEWEST_MATCHED:
            continue
        turned = [body.turn(h, np.full(len(h), best.turn)) for h in headed]
        try:
            found = _stored(turned, best, fine, known, like.skeleton)
            matched = Matched.of(found, prior, like.skeleton)
        except Corrupt:
            continue
        poses = np.concatenate(turned)[:, matched.columns]
        poses = poses - poses.mean(axis=1, keepdims=True)
        off = np.sqrt(((matched.limbs.inverse(matched.limbs.forward(poses)) - poses) ** 2).sum(axis=2))
        if (off > 2 * tolerance).mean() < 0.01:
            some = runs[:: -(-len(runs) // LEVELLED)]
            start = matched.model(prior, like.names, like.rate)
            levels = attach.cheapest(some, start, lambda at, m=matched: m.spreads(known, at), USUAL_LEVELS, step)
            matched = replace(matched, stored=replace(found, levels=levels))
            return matched.stored.pack(known.limbs), matched.model(prior, like.names, like.rate)
    return None


@dataclass(frozen=True, eq=False)
class Place:
    """One way to see the tree: what it costs, the turn of the pose, and the prior's joint of each, −1 for none."""

    cost: float
    turn: float
    parents: tuple[int, ...]
    where: Integers


def _rooted(parents: Sequence[int], pose: Floats) -> Iterator[tuple[int, ...]]:
    """The tree from some of the joints that three bones or more meet in, or from its own root."""
    beside: dict[int, list[int]] = {j: [] for j in range(len(parents))}
    for j, p in enumerate(parents):
        if p >= 0:
            beside[j].append(p)
            beside[p].append(j)
    middle = (pose**2).sum(axis=1)
    meeting = sorted((j for j, near in beside.items() if len(near) > 2), key=middle.__getitem__)[:ROOTS]
    for root in meeting or [list(parents).index(-1)]:
        out = [-1] * len(parents)
        todo = [root]
        for at in todo:
            for other in beside[at]:
                if other != out[at]:
                    out[other] = at
                    todo.append(other)
        yield tuple(out)


ROOTS = 4
"""Of these, as many are tried, those in the middle of the body."""


def _laid(headed: Floats, parents: tuple[int, ...], known: PointSet) -> Place:
    """The best way to lay the prior's tree on this one, as poses (frames, points, 3) have it: where bones point is that
    of their mean, how long they are is not."""
    assert known.limbs is not None
    order = skeletal.ordered(parents)
    assert order is not None
    theirs = known.limbs.inverse(np.zeros((1, known.limbs.dimensions)))[0]
    angles = np.arange(TURNS) * 2 * np.pi / TURNS
    pose = headed.mean(axis=0)
    spread = np.sqrt((theirs**2).mean() / max(float((headed**2).mean()), 1e-12))
    poses = np.concatenate([body.turn(np.repeat(pose[None], TURNS, axis=0), angles)] * len(SIZES))
    sizes = np.repeat(np.array(SIZES) * spread, TURNS)
    children: dict[int, list[int]] = {}
    for j in order[1:]:
        children.setdefault(parents[j], []).append(int(j))
    still = {int(j) for j in order[1:] if float(((pose[j] - pose[parents[j]]) ** 2).sum()) <= SHORTEST_M**2}
    start, number, end, toll = _ways_down(known.limbs.parents)
    bones = theirs[end] - theirs[start]
    length = np.sqrt((bones**2).sum(axis=1))
    wide = 2 * (NEAR_M + NEAR * length) ** 2
    groups = np.flatnonzero(np.diff(number * len(theirs) + start, prepend=-1))
    branches = int(number.max()) + 1
    sets = 1 << branches
    shape = (sets, len(theirs), len(poses))

    @cache
    def matched(joint: int, above: int) -> Floats:
        """What the branch that begins with this joint costs where the bone from `above` is each of the ways down the
        prior's tree: (ways down, ways)."""
        offset = poses[:, joint] - poses[:, above]
        long = sizes * np.median(np.sqrt(((headed[:, joint] - headed[:, above]) ** 2).sum(axis=1)))
        offset = offset / np.maximum(np.sqrt((offset**2).sum(axis=1)), 1e-9)[:, None] * long[:, None]
        apart = ((offset - bones[:, None]) ** 2).sum(axis=2) / wide[:, None]
        apart += (np.log((long + NEAR_M) / (length[:, None] + NEAR_M)) / AS_LONG) ** 2 / 2
        return apart + toll[:, None] + below(joint).min(axis=0)[end]

    @cache
    def cheapest(joint: int, above: int) -> Floats:
        """The same by the branch that is gone down, (branches, prior's joints that `above` is, ways)."""
        out = np.full((branches, *shape[1:]), np.inf)
        out[number[groups], start[groups]] = np.minimum.reduceat(matched(joint, above), groups, axis=0)
        return out

    @cache
    def left_out(joint: int, above: int, more: int) -> Floats:
        """What the branch costs if its first bone is a piece more, by the set of the prior's branches that it takes."""
        if joint in still:
            return _together([branch(c, above, more) for c in children.get(joint, [])], shape)
        if more < PASSED:
            return EXTRA + _together([branch(c, above, more + 1) for c in children.get(joint, [])], shape)
        out = np.full(shape, np.inf)
        out[0] = EXTRA * len(_below(joint, parents))
        return out

    @cache
    def branch(joint: int, above: int, more: int) -> Floats:
        """What the branch costs at best, by the set of the prior's branches that it takes."""
        out = left_out(joint, above, more).copy()
        if joint not in still:
            for b, cost in enumerate(cheapest(joint, above)):
                out[1 << b] = np.minimum(out[1 << b], cost)
        return out

    @cache
    def below(joint: int) -> Floats:
        """What the branches at a joint cost where it is each of the prior's, by the set of branches that they take."""
        return _together([branch(c, joint, 0) for c in children.get(joint, [])], shape)

    for joint in order[::-1]:  # or a long chain would nest as deeply
        below(int(joint))
    root = int(order[0])
    cost = below(root).min(axis=0)
    first, way = (int(i) for i in np.unravel_index(cost.argmin(), cost.shape))
    where = np.full(len(parents), -1)

    def follow(joint: int, above: int, over: int, more: int, taken: int) -> None:
        """Say where the branch lies, given where `above` does, and which branches there are its own."""
        only = taken.bit_length() - 1
        alone = taken and taken == 1 << only and joint not in still
        if alone and cheapest(joint, above)[only, over, way] <= left_out(joint, above, more)[taken, over, way]:
            ways_down = np.flatnonzero((number == only) & (start == over))
            at = int(end[ways_down[matched(joint, above)[ways_down, way].argmin()]])
            where[joint] = at
            share(joint, joint, at, 0, int(below(joint)[:, at, way].argmin()))
        elif joint in still or more < PASSED:
            share(joint, above, over, more + (joint not in still), taken)

    def share(joint: int, above: int, over: int, more: int, taken: int) -> None:
        """Share the branches out among the children of a joint."""
        below_it = children.get(joint, [])
        costs = [branch(c, above, more)[:, over, way] for c in below_it]
        for i in range(len(below_it) - 1, -1, -1):
            others = _together([c[:, None, None] for c in costs[:i]], (sets, 1, 1))[:, 0, 0]
            own = min(_within(taken), key=lambda s: others[taken ^ s] + costs[i][s])
            follow(below_it[i], above, over, more, own)
            taken ^= own

    where[root] = first
    share(root, root, first, 0, int(below(root)[:, first, way].argmin()))
    sure = where >= 0
    here, there = (each - each.mean(axis=0) for each in (pose[sure], theirs[where[sure]]))
    return Place(float(cost[first, way]), -float(body.heading(here[None], there)[0]), parents, where)


def _together(costs: Sequence[Floats], shape: tuple[int, int, int]) -> Floats:
    """What branches cost together, each by the set that it takes (sets, …), none taken twice."""
    out = np.full(shape, np.inf)
    out[0] = 0.0
    for cost in costs:
        before, out = out, np.full(shape, np.inf)
        for taken in range(shape[0]):
            for own in _within(taken):
                np.minimum(out[taken], before[taken ^ own] + cost[own], out=out[taken])
    return out


def _within(taken: int) -> list[int]:
    """The sets that are within a set."""
    return [s for s in range(taken + 1) if s & taken == s]


def _ways_down(parents: Sequence[int]) -> tuple[Integers, Integers, Integers, Floats]:
    """From each joint to those below it, at most `PASSED` bones away: where from, the number of the branch, where to,
    and what it costs to pass over bones. Ordered by branch and start."""
    children = [[j for j, p in enumerate(parents) if p == v] for v in range(len(parents))]
    found: list[tuple[int, int, int, float]] = []
    for j in range(len(parents)):
        at = j
        for passed in range(PASSED):
            if parents[at] < 0:
                break
            found.append((children[parents[at]].index(at), parents[at], j, SKIPPED * passed))
            at = parents[at]
    number, start, end, toll = (np.array(column) for column in zip(*sorted(found), strict=True))
    return start, number, end, toll


def _below(joint: int, parents: Sequence[int]) -> list[int]:
    """The joint and all that hang on it."""
    out = [joint]
    for at in out:
        out += [j for j, p in enumerate(parents) if p == at]
    return out


FEWEST_MATCHED = 4


def _relinked(poses: Floats, place: Place, known: PointSet, tolerance: float) -> tuple[int, ...]:
    """The tree with joints linked as the prior's are, where those links keep their lengths too."""
    assert known.limbs is not None
    parents = list(place.parents)
    for j, usual in enumerate(usual_tree(place.where, known.limbs)):
        if place.where[j] < 0 or usual < 0 or parents[j] < 0:
            continue
        apart = np.sqrt(((poses[:, j] - poses[:, usual]) ** 2).sum(axis=1))
        if (np.abs(apart - np.median(apart)) > tolerance).mean() < 0.01:
            before, parents[j] = parents[j], int(usual)
            if skeletal.ordered(parents) is None:
                parents[j] = before
    return tuple(parents)


def _stored(
    poses: Sequence[Floats], place: Place, fine: int | None, known: PointSet, skeleton: Skeleton | None
) -> Stored:
    """What is stored of limbs so placed, for runs of poses (frames, points, 3) turned as the prior's. Raises
    Corrupt."""
    assert known.limbs is not None
    like, parents, where = known.limbs, place.parents, place.where.copy()
    columns = skeletal.ordered(parents)
    assert columns is not None
    back = np.argsort(columns)
    for j in columns[:0:-1]:  # a piece more, before a joint that the prior knows, is one of the same bone
        if where[parents[j]] < 0 <= where[j] and parents[parents[j]] >= 0:
            where[parents[j]] = where[j]
    builds = [skeleton.offsets[columns]] * len(poses) if skeleton is not None and fine is None else None
    ordered = [p[:, columns] for p in poses]
    found = fit(ordered, skeletal.in_order(parents, columns), builds)
    where[(found.still[back]) | (np.array(like.parents)[where] < 0)] = -1
    digits = ROUGH if fine is None else round(-fine / contexts.OCTAVE + 0.5)
    tree = () if fine is None else parents
    while True:
        stored = _with_directions(ordered, found, where, digits, tree, like, skeleton)
        rest, _ = at_rest(stored, like, skeleton)
        plan = rest.plan
        turns, _ = plan.split(np.concatenate([rest.forward(o) for o in ordered]).T)
        furthest = (turns**2).sum(axis=0).max(axis=1)
        odd = [columns[b] for b, far in zip(plan.bones, furthest, strict=True) if far > ODD**2]
        if (where[odd] < 0).all():
            break
        where[odd] = -1
    if fine is None:
        return stored
    every = np.concatenate(ordered)
    offsets = every - every[:, [max(p, 0) for p in rest.parents]]
    measured = rest.built(offsets[len(offsets) // 2])
    sure = where[columns] >= 0
    longer = np.median(np.sqrt((offsets**2).sum(axis=2)), axis=0) - rest.lengths
    shapes = measured.vectors - np.where(sure[:, None], rest.vectors, 0.0)
    numbers = np.where((sure & ~rest.hub)[:, None], longer[:, None], shapes)
    return replace(stored, bones=np.rint(np.ldexp(numbers[back], digits)).astype(np.int64))


ODD = 2.5
"""A bone that turns by more than this, radians, from where the prior's points is another: the far side is ambiguous."""


def _with_directions(
    poses: Sequence[Floats],
    found: Limbs,
    where: Integers,
    digits: int,
    parents: tuple[int, ...],
    like: Limbs,
    skeleton: Skeleton | None,
) -> Stored:
    """Marks, and the directions of bones that the prior does not know; poses (frames, points, 3) and limbs in order."""
    order = skeletal.ordered(parents or (skeleton.parents if skeleton is not None else ()))
    assert order is not None
    at = where[order]
    sure = at >= 0
    hub, carried = found.hub & ~found.still, np.where(sure, like.carried[at], found.carried)
    for joint in {p for p, h in zip(found.parents, hub, strict=True) if h}:
        of = [j for j, p in enumerate(found.parents) if p == joint and hub[j]]
        theirs = [j for j in of if sure[j] and like.hub[at[j]]]
        carried[of] = carried[theirs[0]] if theirs else False
        hub[of] = bool(theirs) or not sure[of].any()
    back = np.argsort(order)

    def stored(vectors: Floats) -> Stored:
        bones = np.rint(np.ldexp(np.where(sure[:, None], 0.0, vectors), digits)).astype(np.int64)
        marks = (hub + 2 * carried).astype(np.int64)
        return Stored(digits, parents, where.copy(), marks[back], bones[back], np.array(USUAL_LEVELS))

    limbs, _ = at_rest(stored(found.vectors), like, skeleton)
    for j in np.flatnonzero(~sure & carried & ~limbs.still):
        limbs = carry(limbs, poses, int(j))
    return stored(limbs.vectors)
