"""Which joint of the prior's each joint of a file is, from where the joints are and how they hang together.

    a tree ─turned 16 ways, in 5 sizes─► for each joint and each of the prior's: what the branch costs at best ─► where
    where, movement ─► hubs, what is carried, lengths ─► matched.Stored

Names say nothing here. A branch is laid on a branch: a bone takes the place of one of the prior's, or of two or three
in a row, or is a piece more than the prior has.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

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

TURNS = 16
SIZES = (0.72, 0.85, 1.0, 1.18, 1.4)
"""Of the body, against what the spread of its points says."""
NEAR_M, NEAR = 0.03, 0.3
"""A bone ends about so far from where the prior's does, and so much of its length."""
EXTRA, SKIPPED = 2.0, 0.5
"""What a bone costs that none of the prior's stands for, and one of the prior's that is passed over."""
PASSED = 3
"""A bone stands for at most so many of the prior's in a row, and at most so many in a row are pieces more."""


def candidate(runs: Sequence[Floats], like: Motion, step: int, prior: Prior) -> tuple[bytes, Model] | None:
    """What is stored of the model for runs of positions (frames, points, 3), and that; none where they are no limbs'
    or no body's. like: any motion with their names, rate and skeleton."""
    known = prior.sets[0]
    assert known.limbs is not None
    if like.points < skeletal.FEWEST_POINTS or sum(map(len, runs)) < skeletal.FEWEST_FRAMES:
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
        best = _parted(pose, min((_laid(pose, tree, known) for tree in rooted), key=lambda p: p.cost), known)
        if fine is not None and (tree := _relinked(every, best, known, tolerance)) != best.parents:
            best = min(best, _parted(pose, _laid(pose, tree, known), known), key=lambda p: p.cost)
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
            start = matched.model(prior, like.names, like.rate)
            levels = attach.cheapest(runs, start, lambda at, m=matched: m.spreads(known, at), USUAL_LEVELS, step)
            matched = replace(matched, stored=replace(found, levels=levels))
            return matched.stored.pack(known.limbs), matched.model(prior, like.names, like.rate)
    return None


@dataclass(frozen=True, eq=False)
class Place:
    """One way to see the tree: what it costs, the turn of the pose, the prior's joint of each (−1 for none), and what the
    branch that begins with each gains by not being pieces more; and the best turns and sizes."""

    cost: float
    turn: float
    parents: tuple[int, ...]
    where: Integers
    gains: Floats
    ways: Integers


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


def _parted(pose: Floats, place: Place, known: PointSet) -> Place:
    """The same, with no two joints on one of the prior's."""
    barred = np.zeros((len(place.parents), len(known.names)), bool)
    for _ in range(ROUNDS):
        if not (twice := _twice(place, len(known.names))).any():
            return place
        barred |= twice
        place = _laid(pose, place.parents, known, barred, place.ways)
    twice = _twice(place, len(known.names))
    return replace(place, where=np.where(twice.any(axis=1), -1, place.where))


ROUNDS = 8
"""So often joints that are one and the same are parted."""


def _laid(
    pose: Floats,
    parents: tuple[int, ...],
    known: PointSet,
    barred: NDArray[np.bool_] | None = None,
    ways: NDArray[np.int64] | None = None,
) -> Place:
    """The best way to lay the prior's tree on this one, as the mean pose (points, 3) has it.

    barred (points, prior's joints): what they are not. ways: turns and sizes that are tried, all unless given.
    """
    assert known.limbs is not None
    order = skeletal.ordered(parents)
    assert order is not None
    theirs = known.limbs.inverse(np.zeros((1, known.limbs.dimensions)))[0]
    angles = np.arange(TURNS) * 2 * np.pi / TURNS
    spread = np.sqrt((theirs**2).mean() / max(float((pose**2).mean()), 1e-12))
    poses = np.concatenate([body.turn(np.repeat(pose[None], TURNS, axis=0), angles) * spread * s for s in SIZES])
    if ways is None:
        ways = np.arange(len(poses))
    poses = poses[ways]
    children: dict[int, list[int]] = {}
    for j in order[1:]:
        children.setdefault(parents[j], []).append(int(j))
    bones = theirs - theirs[:, None]  # from, to
    length = np.sqrt((bones**2).sum(axis=2))
    passed = _passed(known.limbs.parents)
    wide = 2 * (NEAR_M + NEAR * length) ** 2
    toll = np.where(passed > 0, SKIPPED * (passed - 1.0), np.inf)
    memo: dict[tuple[int, int, int], tuple[Floats, Integers]] = {}
    ends = {j: _sum_of_branch(j, children) for j in range(len(parents))}

    none = np.zeros((len(theirs), len(poses)))
    still = {int(j) for j in order[1:] if float(((pose[j] - pose[parents[j]]) ** 2).sum()) <= SHORTEST_M**2}

    def below(joint: int) -> Floats:
        """What the branches at a joint cost where it is each of the prior's: (prior's joints, ways)."""
        return sum((branch(c, joint, 0)[0] for c in children.get(joint, [])), none)

    def branch(joint: int, above: int, more: int) -> tuple[Floats, Integers]:
        """What the branch that begins with this joint costs, where `above` is each of the prior's; and which of them
        the joint is then."""
        if (joint, above, more) in memo:
            return memo[joint, above, more]
        if joint in still:
            costs = [branch(c, above, more)[0] for c in children.get(joint, [])]
            memo[joint, above, more] = sum(costs, none), np.full(none.shape, -1)
            return memo[joint, above, more]
        offset = poses[:, joint] - poses[:, above]
        apart = ((offset[:, None, None] - bones) ** 2).sum(axis=3) / wide + toll
        if barred is not None:
            apart[..., barred[joint]] = np.inf
        laid = apart.transpose(1, 2, 0) + below(joint)[None]
        cost, at = laid.min(axis=1), laid.argmin(axis=1)
        if more == PASSED:
            left = np.full(cost.shape, EXTRA * ends[joint])
        else:
            left = sum((branch(c, above, more + 1)[0] for c in children.get(joint, [])), np.full(cost.shape, EXTRA))
        memo[joint, above, more] = np.minimum(cost, left), np.where(left < cost, -1, at)
        return memo[joint, above, more]

    root = int(order[0])
    cost = below(root)
    first, way = np.unravel_index(cost.argmin(), cost.shape)
    where = np.full(len(parents), -1)

    def follow(joint: int, above: int, over: int, more: int) -> None:
        at = int(branch(joint, above, more)[1][over, way])
        where[joint] = at
        if at >= 0:
            above, over, more = joint, at, 0
        elif joint not in still:
            more += 1
        for c in children.get(joint, []) if more <= PASSED else []:
            follow(c, above, over, more)

    where[root] = first
    for c in children.get(root, []):
        follow(c, root, int(first), 0)
    gains = np.zeros(len(parents))
    for (j, above, _), (of_branch, _) in memo.items():
        if where[j] >= 0 and where[above] >= 0:
            gains[j] = EXTRA * ends[j] - of_branch[where[above], way]
    sure = where >= 0
    here, there = (each - each.mean(axis=0) for each in (pose[sure], theirs[where[sure]]))
    turn = -float(body.heading(here[None], there)[0])
    best = ways[cost.min(axis=0).argsort()[:BEST_WAYS]]
    return Place(float(cost[first, way]), turn, parents, where, gains, best)


def _twice(place: Place, joints: int) -> NDArray[np.bool_]:
    """What joints should not be, (points, prior's joints): of those that are one and the same, only that whose branch
    gains most by it should be."""
    out = np.zeros((len(place.where), joints), bool)
    for v in range(joints):
        same = np.flatnonzero(place.where == v)
        if len(same) > 1:
            out[same, v] = same != same[place.gains[same].argmax()]
    return out


FEWEST_MATCHED, BEST_WAYS = 4, 8


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


def _sum_of_branch(joint: int, children: dict[int, list[int]]) -> int:
    return 1 + sum(_sum_of_branch(c, children) for c in children.get(joint, []))


def _passed(parents: Sequence[int]) -> Integers:
    """How many bones lie between two joints, the second below the first: (from, to); 0 where more than `PASSED`."""
    out = np.zeros((len(parents), len(parents)), np.int64)
    for j in range(len(parents)):
        at = parents[j]
        for count in range(1, PASSED + 1):
            if at < 0:
                break
            out[at, j] = count
            at = parents[at]
    return out


def _stored(
    poses: Sequence[Floats], place: Place, fine: int | None, known: PointSet, skeleton: Skeleton | None
) -> Stored:
    """What is stored of limbs so placed, for runs of poses (frames, points, 3) turned as the prior's. Raises Corrupt."""
    assert known.limbs is not None
    like, parents, where = known.limbs, place.parents, place.where.copy()
    columns = skeletal.ordered(parents)
    assert columns is not None
    back = np.argsort(columns)
    for j in columns[:0:-1]:  # a piece more, before a joint that the prior knows, is one of the same bone
        if where[parents[j]] < 0 <= where[j]:
            where[parents[j]] = where[j]
    builds = [skeleton.offsets[columns]] * len(poses) if skeleton is not None and fine is None else None
    ordered = [p[:, columns] for p in poses]
    found = fit(ordered, skeletal.in_order(parents, columns), builds)
    where[(found.still[back]) | (np.array(like.parents)[where] < 0)] = -1
    digits = ROUGH if fine is None else round(-fine / contexts.OCTAVE + 0.5)
    for _ in range(2):
        stored = _with_directions(ordered, found, where, digits, () if fine is None else parents, like, skeleton)
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
