"""Limbs that the prior knows under other names: its model of them, for a few bytes each.

    file's tree, mean pose ─turned and scaled, branch by branch─► the prior's joint that each point is   where
    where ─► turns of the file's bones as those of the prior's   W ─► the prior's components as turns of the file's
    components · Wᵀ · reach ─orthonormal, strongest first─► bases     Σ over components ─► spreads of their rows

Skeletons differ in names, in fingers and toes, in how many pieces a back has; hips and knees they all have. A bone
counts from the direction that the prior's usually has, in the frame that the prior counts it in, and so moves as the
prior says. What no bone of the prior's stands for gets a level, as on bones (`mapped`).

The coder depends on the spreads, so what leads to them is arithmetic on single numbers in a written order, from whole
numbers and the prior's: the file's own build has no part in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...motion import Floats, Skeleton
from . import mapped, skeletal
from .limbs import Limbs
from .mapped import LEVELS, Movements
from .model import POSE, Model
from .prior import PointSet, Prior

Integers = NDArray[np.int64]

FINEST = 40
"""Bones are stored in steps of at least 2^−(this) m."""
ROUGH = 7
"""Directions alone are stored in steps of 2^−(this) m."""
USUAL_LEVELS = (0, 0, -24, 0, -150, 0)
"""Levels, as in `mapped`, and how much larger it is what no bone of the prior's has a part in; stored less these."""


@dataclass(frozen=True, eq=False)
class Stored:
    """What is stored, in the order of the points.

    digits: bones are in 2^(−digits) m. parents: −1 for the root; empty where they and the build are the skeleton's.
    where (points,): the prior's point, −1 for none. marks (points,): 1 of a hub, 2 carried. bones (points, 3): the
    vector, less the prior's if it knows the bone; if that is of no hub, only its length, less the prior's. levels (6,).
    """

    digits: int
    parents: tuple[int, ...]
    where: Integers
    marks: Integers
    bones: Integers
    levels: Integers

    @property
    def told(self) -> NDArray[np.bool_]:
        """Which numbers of the bones are stored, (points, 3)."""
        known = self.where >= 0
        if not self.parents:
            return np.repeat(~known[:, None], 3, axis=1)
        length = known & (self.marks % 2 == 0)
        return ~length[:, None] | (np.arange(3) == 0)

    def pack(self, like: Limbs) -> bytes:
        tree, marks = usual_tree(self.where, like), usual_marks(self.where, like)
        parents = np.array(self.parents or tree, np.int64)
        names = coder.pack(np.stack([np.diff(self.where, prepend=-1) - 1, self.marks - marks, parents - tree], axis=1))
        head = [varint.signed(int(n)) for n in (self.digits, *(self.levels - np.array(USUAL_LEVELS)))]
        head += [bool(self.parents), len(names)]
        return varint.write(head) + names + coder.pack(self.bones[self.told][:, None])

    @classmethod
    def unpack(cls, data: bytes, points: int, like: Limbs) -> Stored:
        """Raises Corrupt."""
        (*folded, has_tree, size), at = varint.read(data, 1 + len(USUAL_LEVELS) + 2)
        digits, *levels = (varint.unsigned(n) for n in folded)
        if has_tree > 1 or abs(digits) > FINEST or max(map(abs, levels)) > 2000 or at + size > len(data):
            raise Corrupt("tempo: matched limbs that are out of range")
        names = coder.unpack(data[at : at + size], (points, 3))
        where = np.cumsum(names[:, 0] + 1) - 1
        if where.min() < -1 or where.max() >= len(like.parents):
            raise Corrupt("tempo: a limb that is not there")
        marks = names[:, 1] + usual_marks(where, like)
        if (marks != marks.clip(0, 3)).any() or (names[:, 2].any() and not has_tree):
            raise Corrupt("tempo: matched limbs that are out of range")
        parents = tuple(int(p) for p in names[:, 2] + usual_tree(where, like)) if has_tree else ()
        levels = np.array(levels, np.int64) + np.array(USUAL_LEVELS)
        out = cls(digits, parents, where, marks, np.zeros((points, 3), np.int64), levels)
        out.bones[out.told] = coder.unpack(data[at + size :], (int(out.told.sum()), 1))[:, 0]
        if not np.abs(out.bones).max() < 1 << 40:
            raise Corrupt("tempo: matched limbs that are out of range")
        return out

    def tree(self, skeleton: Skeleton | None) -> tuple[tuple[int, ...], Integers]:
        """Parents, and the points so that each comes after its own. Raises Corrupt."""
        parents = self.parents
        if not parents:
            if skeleton is None:
                raise Corrupt("tempo: the motion lacks the skeleton that it was coded with")
            parents = skeleton.parents
        columns = skeletal.ordered(parents)
        if columns is None or len(parents) != len(self.where):
            raise Corrupt("tempo: bones that make no tree")
        return parents, columns


def usual_marks(where: Integers, like: Limbs) -> Integers:
    """The marks that the prior's bones have."""
    return np.where(where >= 0, like.hub[where] + 2 * like.carried[where], 0)


def usual_tree(where: Integers, like: Limbs) -> Integers:
    """The parents, were the points linked as the prior's are; those that it does not know follow each other."""
    at = {int(v): j for j, v in enumerate(where) if v >= 0}
    out = np.arange(len(where)) - 1
    for j in np.flatnonzero(where >= 0):
        above = like.parents[where[j]]
        while above >= 0 and above not in at:
            above = like.parents[above]
        out[j] = at.get(above, -1)
    return out


def paths(where: Integers, parents: Sequence[int], like: Limbs) -> list[tuple[int, ...]]:
    """The prior's bones that each bone stands for, the last first: all from the joint that its start is, or the joint
    before its start; pieces of a bone stand for the same. Parents stand before their children."""
    out: list[tuple[int, ...]] = []
    for j, at in enumerate(where):
        above = parents[j]
        while above >= 0 and where[above] < 0:
            above = parents[above]
        path = [int(at)] if at >= 0 and like.parents[at] >= 0 else []
        if path and above >= 0 and where[above] == at:
            path = list(out[above]) or path
        elif path and above >= 0:
            line = path.copy()
            while like.parents[line[-1]] >= 0 and like.parents[line[-1]] != where[above]:
                line.append(like.parents[line[-1]])
            path = line if like.parents[line[-1]] == where[above] else path
        out.append(tuple(path))
    return out


def at_rest(stored: Stored, like: Limbs, skeleton: Skeleton | None) -> tuple[Limbs, Integers]:
    """The file's limbs on the prior's build, and the points in their order: of whole numbers and the prior's only.
    Raises Corrupt."""
    parents, columns = stored.tree(skeleton)
    ordered, marks = skeletal.in_order(parents, columns), stored.marks[columns]
    vectors = np.ldexp(stored.bones[columns].astype(float), -stored.digits)
    for j, path in enumerate(paths(stored.where[columns], ordered, like)):
        if stored.where[columns[j]] >= 0:
            vectors[j] = sum((like.vectors[b] for b in path), np.zeros(3))
    limbs = Limbs(ordered, vectors, marks % 2 == 1, marks > 1)
    if not limbs.dimensions or any(len(children) < 2 for children in limbs.plan.children.values()):
        raise Corrupt("tempo: limbs without bones, or a hub of one")
    return limbs, columns


def built(stored: Stored, rest: Limbs, columns: Integers, skeleton: Skeleton | None) -> Limbs:
    """The limbs on the file's build. Raises Corrupt."""
    if not stored.parents:
        assert skeleton is not None
        out = rest.built(skeletal.offsets_of(skeleton, columns))
    else:
        numbers = np.ldexp(stored.bones[columns].astype(float), -stored.digits)
        length = (stored.where[columns] >= 0) & ~rest.hub
        longer = np.maximum(rest.lengths + numbers[:, 0], 0.0) / np.maximum(rest.lengths, 1e-30)
        full = np.where((stored.where[columns] >= 0)[:, None], rest.vectors + numbers, numbers)
        vectors = np.where(length[:, None], rest.vectors * longer[:, None], full)
        out = replace(rest, vectors=vectors)
    if not np.array_equal(out.still[1:], rest.still[1:]) or not out.lengths.max() < skeletal.LONGEST_M:
        raise Corrupt("tempo: bones that are there on one build only")
    return out


def movements(stored: Stored, rest: Limbs, columns: Integers, like: PointSet) -> tuple[Movements, Floats]:
    """What the prior's limbs explain of the file's, and the reach of the coordinates of these."""
    assert like.limbs is not None
    assert like.reach is not None
    reach = _cholesky(_metric(rest))
    onto = _onto(rest, paths(stored.where[columns], rest.parents, like.limbs), like.limbs)
    free = rest.dimensions
    strength = mapped.power(np.concatenate([like.means[POSE:, None], like.spreads[POSE:, 1:]], axis=1))
    bases, explained = [], []
    for band, modes in enumerate(like.bases):
        moved = mapped.times(mapped.times(_unweighed(modes, like.reach), onto), reach)
        nodes = mapped.nodes_of(band)
        loud = np.sqrt(strength[:, max(nodes.start, 1) : nodes.stop].max(axis=1))
        basis = _with_the_rest(mapped.directions(moved * loud[:, None], free), moved)
        variance = np.zeros((free, strength.shape[1]))
        variance[: len(basis)] = mapped.times(mapped.times(basis, moved.T.copy()) ** 2, strength)
        bases.append(mapped.completed(basis, free, np.zeros((0, free))))
        explained.append(variance)
    return Movements(tuple(bases), tuple(explained)), reach


def usual_spreads(like: PointSet) -> Integers:
    """How large the prior's components are in the middle, at each frequency."""
    return np.median(np.concatenate([like.means[POSE:, None], like.spreads[POSE:, 1:]], axis=1), axis=0).astype(int)


@dataclass(frozen=True, eq=False)
class Matched:
    """Limbs on the file's build, and all that the model needs beside the levels."""

    stored: Stored
    limbs: Limbs
    columns: Integers
    found: Movements
    reach: Floats

    @classmethod
    def of(cls, stored: Stored, prior: Prior, skeleton: Skeleton | None) -> Matched:
        """Raises Corrupt."""
        like = prior.sets[0]
        assert like.limbs is not None
        rest, columns = at_rest(stored, like.limbs, skeleton)
        limbs = built(stored, rest, columns, skeleton)
        return cls(stored, limbs, columns, *movements(stored, rest, columns, like))

    def spreads(self, like: PointSet, levels: Integers) -> Integers:
        """Of the components, (rows, frequencies), at these levels."""
        out = mapped.spreads_of(self.found, usual_spreads(like), levels[:LEVELS])
        for band, explained in enumerate(self.found.explained):
            out[~explained.any(axis=1), mapped.nodes_of(band)] += levels[LEVELS] * mapped.LEVEL_UNIT
        return out

    def model(self, prior: Prior, names: tuple[str, ...], rate: float) -> Model:
        like = prior.sets[0]
        spreads = self.spreads(like, self.stored.levels)
        pose = self.limbs.inverse(np.zeros((1, self.limbs.dimensions)))[0][np.argsort(self.columns)]
        moved, means = mapped.of_whole_body(like, len(names))
        points = PointSet(
            names,
            pose,
            self.found.bases,
            np.concatenate([moved, spreads]),
            np.concatenate([means, spreads[:, 0]]),
            self.limbs,
            self.reach,
            self.columns,
        )
        return Model(points, prior, rate)


def unpack(data: bytes, names: tuple[str, ...], rate: float, skeleton: Skeleton | None, prior: Prior) -> Model:
    """The model again. Raises Corrupt."""
    if not prior.sets or prior.sets[0].limbs is None:
        raise Corrupt("tempo: limbs, of a prior that knows none")
    stored = Stored.unpack(data, len(names), prior.sets[0].limbs)
    return Matched.of(stored, prior, skeleton).model(prior, names, rate)


# The arithmetic in a written order.


def _with_the_rest(basis: Floats, moved: Floats) -> Floats:
    """Orthonormal rows, with those after them that rows `moved` need beside them, however faint."""
    rest = moved / np.sqrt(np.maximum(mapped.sum_of(moved.T**2), 1e-30))[:, None]
    for _ in range(2):
        rest = rest - mapped.times(mapped.times(rest, basis.T.copy()), basis)
    return np.concatenate([basis, mapped.orthonormal(rest, len(basis[0]) - len(basis), FAINT)])


FAINT = 1e-14
"""Of a row of length one, squared: so little left is nothing."""


def _turns(limbs: Limbs) -> Iterator[tuple[Floats, list[int]]]:
    """Of each coordinate the axis that it turns about at rest, and the points whose bones it turns."""
    plan = limbs.plan
    carried: dict[int, list[int]] = {}
    for b in (j for j in range(len(limbs.parents)) if limbs.parents[j] >= 0 and not limbs.still[j]):
        by = -2 - limbs.parents[b] if limbs.hub[b] else b
        while True:
            carried.setdefault(by, []).append(b)
            if by == -1:
                break
            first = plan.children[-2 - by][0] if by < -1 else by
            by = plan.carrier[first]
    for b in plan.bones:
        first, second = tilts(limbs.vectors[b])
        yield second, carried[b]
        yield -first, carried[b]
    for h in plan.hubs:
        for axis in np.eye(3):
            yield axis, carried[-2 - h]


def tilts(vector: Floats) -> tuple[Floats, Floats]:
    """The first two axes of a bone, as `limbs` has them."""
    d = _unit(vector)
    helper = np.eye(3)[np.abs(d).argmin()]
    along = (helper[0] * d[0] + helper[1] * d[1]) + helper[2] * d[2]
    first = _unit(helper - d * along)
    return first, _cross(d, first)


def _cross(a: Floats, b: Floats) -> Floats:
    return np.stack([a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=-1)


def _metric(limbs: Limbs) -> Floats:
    """`Limbs.metric` at rest."""
    moved = np.zeros((limbs.dimensions, len(limbs.parents), 3))
    for row, (axis, bones) in zip(moved, _turns(limbs), strict=True):
        row[bones] = _cross(np.broadcast_to(axis, (len(bones), 3)), limbs.vectors[bones])
        for j, p in enumerate(limbs.parents):
            if p >= 0:
                row[j] += row[p]
    mean = mapped.sum_of(moved.swapaxes(0, 1)) / len(limbs.parents)
    flat = (moved - mean[:, None]).reshape(len(moved), -1)
    metric = mapped.times(flat, flat.T.copy())
    return metric + skeletal.LEAST * metric.max() * np.eye(len(metric))


def _cholesky(metric: Floats) -> Floats:
    """Lower triangular, times its transpose the metric."""
    left, out = metric.copy(), np.zeros_like(metric)
    for i in range(len(left)):
        out[i:, i] = left[i:, i] / np.sqrt(left[i, i])
        left[i:, i:] -= out[i:, i, None] * out[i:, i]
    return out


def _unweighed(modes: Floats, reach: Floats) -> Floats:
    """modes · reach⁻¹, reach lower triangular."""
    out = modes.copy()
    for i in range(len(reach) - 1, -1, -1):
        out[:, i] /= reach[i, i]
        out[:, :i] -= out[:, i, None] * reach[i, :i]
    return out


def _onto(rest: Limbs, paths: Sequence[tuple[int, ...]], like: Limbs) -> Floats:
    """Coordinates of the prior's limbs to those of the file's, (theirs, these), as small turns about the rest."""
    turned = np.zeros((len(like.parents), like.dimensions, 3))  # how the prior's bones turn with its coordinates
    for number, (axis, bones) in enumerate(_turns(like)):
        turned[bones, number] += axis
    plan = rest.plan
    number = {b: 2 * i for i, b in enumerate(plan.bones)}
    number |= {-2 - h: 2 * len(plan.bones) + 3 * i for i, h in enumerate(plan.hubs)}
    frames: dict[int, Floats] = {-1: np.zeros((like.dimensions, 3))}
    out = np.zeros((like.dimensions, rest.dimensions))
    for j, parent in enumerate(rest.parents):
        if parent < 0 or rest.still[j]:
            continue
        carried = frames[plan.carrier[j]]
        at = number[-2 - parent if rest.hub[j] else j]
        if rest.hub[j]:
            theirs = [b for c in plan.children[parent] for b in paths[c][-1:] if like.hub[b]]
            if -2 - parent not in frames:
                own = turned[theirs[0]] - carried if theirs else np.zeros_like(carried)
                out[:, at : at + 3] = own
                frames[-2 - parent] = carried + own
            continue
        first, second = tilts(rest.vectors[j])
        own = np.zeros((like.dimensions, 2))
        if paths[j]:
            moved = -_cross(carried, np.broadcast_to(_unit(rest.vectors[j]), carried.shape))
            for b in paths[j]:
                along = like.vectors[b] / _length(rest.vectors[j])
                moved = moved + _cross(turned[b], np.broadcast_to(along, carried.shape))
            for i, axis in enumerate((first, second)):
                own[:, i] = (moved[:, 0] * axis[0] + moved[:, 1] * axis[1]) + moved[:, 2] * axis[2]
        out[:, at : at + 2] = own
        frames[j] = carried + own[:, :1] * second - own[:, 1:] * first
    return out


def _length(v: Floats) -> Floats:
    return np.sqrt((v[0] * v[0] + v[1] * v[1]) + v[2] * v[2])


def _unit(v: Floats) -> Floats:
    return v / _length(v)
