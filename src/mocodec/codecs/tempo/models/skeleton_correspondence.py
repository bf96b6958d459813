"""A skeleton under other names, through its correspondence to the prior's.

    the prior's joint that each joint corresponds to ──► small rotations of its bones for those of the prior's   W
    components of the prior · Wᵀ · metric root ─► bases              Σ over components ─► spreads

Skeletons differ in names, in fingers and toes, in how many joints a spine has; hips and knees they all have. A bone
starts from the direction that the prior's bone has at rest, in the frame that the prior expresses it in, and so moves
as the prior predicts. Bones without correspondence get a level (`predicted_motion`). `skeleton_matching` finds the
correspondence.

Spreads depend on all of this, so the arithmetic is `ordered`, on integers and the prior: the proportions of the file's
body have no part in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....entropy import coder
from ....errors import Corrupt
from ....fields import Record, array, flag, raw, signed, sized
from ....motion import Skeleton
from ....stages import basis
from ....typing import Booleans, Floats, Integers
from ..coding.rows import POSE
from ..pose import tree_fitting
from ..pose.bone_tree import BODY, BoneTree
from . import ordered, predicted_motion
from .build import LARGEST_M, MISSING_SKELETON, skeleton_offsets
from .coordinates import DirectionCoordinates
from .model import Model
from .predicted_motion import LARGEST_LEVEL, LEVEL_NAMES, LEVELS, PredictedMotion
from .prior import JointSet, Prior

FINEST_DIGITS = 40
DIRECTION_DIGITS = 7
"""Directions alone are stored in steps of 2^−(this) m."""
USUAL_LEVELS = (0, 0, -24, 0, -150, 0)
"""Levels of `predicted_motion`, and one more for coordinates that the prior predicts nothing of. Files store the
difference from these."""
NO_JOINT = -1
HUB, RELATIVE = 1, 2
"""Marks of a bone."""
LEAST_METRIC = 1e-6
"""Share of the metric's largest entry that is added to its diagonal, for coordinates that hardly move a point."""
LEAST_ENERGY = 1e-14
"""Squared length, of rows of length one, below which nothing of a row is left."""
ALL_LEVELS = (*LEVEL_NAMES, "unpredicted")

CORRESPONDENCE = Record(
    "tempo: the correspondence of a skeleton",
    signed("digits", most=FINEST_DIGITS, meaning="vectors are in steps of 2^(−digits) m"),
    *(signed(name, most=LARGEST_LEVEL, meaning="eighths of an octave, less the usual") for name in ALL_LEVELS),
    flag("has_tree", meaning="the tree and its proportions are stored, else they are the skeleton's"),
    *sized(array("joints", ("points", 3), meaning="the prior's joint, marks and parent, less their predictions")),
    raw("vectors", meaning="coded integers: for each bone the unknown part of its vector"),
)


@dataclass(frozen=True, eq=False)
class Correspondence:
    """The stored form, in the order of the points.

    digits: vectors are in steps of 2^(−digits) m. parents: −1 for the root; empty where tree and proportions are those
    of the file's skeleton. joint (points,): of the prior, or NO_JOINT. marks (points,): HUB, RELATIVE. levels (6,).
    vectors (points, 3), of the bone of each point:
        without a joint of the prior     the whole vector
        in a hub                         the difference from the prior's vector
        otherwise                        the difference of the lengths, and two zeros
    """

    digits: int
    parents: tuple[int, ...]
    joint: Integers
    marks: Integers
    vectors: Integers
    levels: Integers

    @property
    def stored(self) -> Booleans:
        """Which numbers of the vectors are stored, (points, 3)."""
        known = self.joint >= 0
        if not self.parents:
            return np.repeat(~known[:, None], 3, axis=1)
        length_only = known & (self.marks & HUB == 0)
        return ~length_only[:, None] | (np.arange(3) == 0)

    def pack(self, like: BoneTree) -> bytes:
        """like: the prior's tree."""
        expected = expected_parents(self.joint, like)
        parents = np.array(self.parents, np.int64) if self.parents else expected
        columns = (
            np.diff(self.joint, prepend=-1) - 1,
            self.marks - expected_marks(self.joint, like),
            parents - expected,
        )
        levels = dict(zip(ALL_LEVELS, self.levels - np.array(USUAL_LEVELS), strict=True))
        return CORRESPONDENCE.pack(
            {
                "digits": self.digits,
                **levels,
                "has_tree": bool(self.parents),
                "joints": np.stack(columns, axis=1),
                "vectors": coder.pack(self.vectors[self.stored][:, None]),
            }
        )

    @classmethod
    def unpack(cls, data: bytes, points: int, like: BoneTree) -> Correspondence:
        """Raises Corrupt."""
        values = CORRESPONDENCE.unpack(data, points=points)
        joints = values["joints"]
        joint = np.cumsum(joints[:, 0] + 1) - 1
        if joint.min() < NO_JOINT or joint.max() >= len(like.parents):
            raise Corrupt("tempo: correspondence to a joint that does not exist")
        marks = joints[:, 1] + expected_marks(joint, like)
        if (marks & ~(HUB | RELATIVE)).any() or (joints[:, 2].any() and not values["has_tree"]):
            raise Corrupt("tempo: the marks of a correspondence are out of range")
        parents = joints[:, 2] + expected_parents(joint, like)
        levels = np.array([values[name] for name in ALL_LEVELS], np.int64) + np.array(USUAL_LEVELS)
        tree = tuple(int(p) for p in parents) if values["has_tree"] else ()
        out = cls(values["digits"], tree, joint, marks, np.zeros((points, 3), np.int64), levels)
        out.vectors[out.stored] = coder.unpack(values["vectors"], (int(out.stored.sum()), 1))[:, 0]
        if not np.abs(out.vectors).max() < 1 << 40:
            raise Corrupt("tempo: the vectors of a correspondence are out of range")
        return out

    def ordered_tree(self, skeleton: Skeleton | None) -> tuple[tuple[int, ...], Integers]:
        """Parents, and the points in an order in which each comes after its parent. Raises Corrupt."""
        parents = self.parents
        if not parents:
            if skeleton is None:
                raise Corrupt(MISSING_SKELETON)
            parents = skeleton.parents
        columns = tree_fitting.topological_order(parents)
        if columns is None or len(parents) != len(self.joint):
            raise Corrupt("tempo: the bones are not one tree")
        return parents, columns


def expected_marks(joint: Integers, like: BoneTree) -> Integers:
    """The marks that the corresponding bones of the prior have."""
    return np.where(joint >= 0, HUB * like.hub[joint] + RELATIVE * like.relative[joint], 0)


def expected_parents(joint: Integers, like: BoneTree) -> Integers:
    """Parents if the points are linked as the prior's joints are; points without correspondence follow each other."""
    at = {int(v): j for j, v in enumerate(joint) if v >= 0}
    out = np.arange(len(joint)) - 1
    for j in np.flatnonzero(joint >= 0):
        above = like.parents[joint[j]]
        while above >= 0 and above not in at:
            above = like.parents[above]
        out[j] = at.get(above, -1)
    return out


def bone_paths(joint: Integers, parents: Sequence[int], like: BoneTree) -> list[tuple[int, ...]]:
    """The prior's bones that each bone corresponds to, the last first. Parents stand before their children.

    A bone spans all of the prior's from the joint that its start corresponds to, or the nearest joint above that does;
    pieces of one bone correspond to the same bones.
    """
    out: list[tuple[int, ...]] = []
    for j, at in enumerate(joint):
        above = parents[j]
        while above >= 0 and joint[above] < 0:
            above = parents[above]
        path = [int(at)] if at >= 0 and like.parents[at] >= 0 else []
        if path and above >= 0 and joint[above] == at:
            path = list(out[above]) or path
        elif path and above >= 0:
            line = path.copy()
            while like.parents[line[-1]] >= 0 and like.parents[line[-1]] != joint[above]:
                line.append(like.parents[line[-1]])
            path = line if like.parents[line[-1]] == joint[above] else path
        out.append(tuple(path))
    return out


def rest_tree(stored: Correspondence, like: BoneTree, skeleton: Skeleton | None) -> tuple[BoneTree, Integers]:
    """The file's tree with the prior's proportions, and the points in its order. Raises Corrupt."""
    parents, columns = stored.ordered_tree(skeleton)
    in_order, marks = tree_fitting.reordered_parents(parents, columns), stored.marks[columns]
    vectors = np.ldexp(stored.vectors[columns].astype(float), -stored.digits)
    for j, path in enumerate(bone_paths(stored.joint[columns], in_order, like)):
        if stored.joint[columns[j]] >= 0:
            vectors[j] = sum((like.vectors[b] for b in path), np.zeros(3))
    tree = BoneTree(in_order, vectors, marks & HUB != 0, marks & RELATIVE != 0)
    if not tree.has_rotations:
        raise Corrupt("tempo: a skeleton without bones, or a hub of one bone")
    return tree, columns


def with_proportions(stored: Correspondence, rest: BoneTree, columns: Integers, skeleton: Skeleton | None) -> BoneTree:
    """The tree with the proportions of the file's body. Raises Corrupt."""
    if not stored.parents:
        if skeleton is None:
            raise Corrupt(MISSING_SKELETON)
        out = rest.with_offsets(skeleton_offsets(skeleton, columns))
    else:
        numbers = np.ldexp(stored.vectors[columns].astype(float), -stored.digits)
        known = stored.joint[columns] >= 0
        longer = np.maximum(rest.lengths + numbers[:, 0], 0.0) / np.maximum(rest.lengths, 1e-30)
        whole = np.where(known[:, None], rest.vectors + numbers, numbers)
        vectors = np.where((known & ~rest.hub)[:, None], rest.vectors * longer[:, None], whole)
        out = replace(rest, vectors=vectors)
    if not np.array_equal(out.zero_length[1:], rest.zero_length[1:]) or not out.lengths.max() < LARGEST_M:
        raise Corrupt("tempo: bones that exist with some proportions only")
    return out


def predict(
    stored: Correspondence, rest: BoneTree, columns: Integers, like: JointSet
) -> tuple[PredictedMotion, Floats]:
    """What the prior predicts of the file's directions, and the metric root of these."""
    assert isinstance(like.coordinates, DirectionCoordinates)
    metric_root = ordered.cholesky(rest_metric(rest))
    paths = bone_paths(stored.joint[columns], rest.parents, like.tree)
    mapping = coordinate_map(rest, paths, like.tree)
    rows = rest.dimensions
    known = like.statistics
    strength = ordered.square_of_exp2(np.concatenate([known.means[POSE:, None], known.spreads[POSE:, 1:]], axis=1))
    bases, variances = [], []
    for band, modes in enumerate(known.bases):
        unscaled = ordered.times_inverse(modes, like.coordinates.metric_root)
        moved = ordered.matmul(ordered.matmul(unscaled, mapping), metric_root)
        inside = predicted_motion.frequencies_of(band)
        loudest = np.sqrt(strength[:, max(inside.start, 1) : inside.stop].max(axis=1))
        found = _spanning(ordered.principal_directions(moved * loudest[:, None], rows), moved)
        variance = np.zeros((rows, strength.shape[1]))
        variance[: len(found)] = ordered.matmul(ordered.matmul(found, moved.T.copy()) ** 2, strength)
        bases.append(basis.completed(found.T).T.copy())
        variances.append(variance)
    return PredictedMotion(tuple(bases), tuple(variances)), metric_root


@dataclass(frozen=True, eq=False)
class MatchedSkeleton:
    """A correspondence, the tree with the file's proportions, and what the prior predicts of it."""

    prior: Prior
    stored: Correspondence
    tree: BoneTree
    columns: Integers
    predicted: PredictedMotion
    metric_root: Floats

    @classmethod
    def of(cls, stored: Correspondence, prior: Prior, skeleton: Skeleton | None) -> MatchedSkeleton:
        """Raises Corrupt."""
        rest, columns = rest_tree(stored, prior.joints.tree, skeleton)
        tree = with_proportions(stored, rest, columns, skeleton)
        return cls(prior, stored, tree, columns, *predict(stored, rest, columns, prior.joints))

    @classmethod
    def unpack(cls, data: bytes, points: int, prior: Prior, skeleton: Skeleton | None) -> MatchedSkeleton:
        """Raises Corrupt."""
        return cls.of(Correspondence.unpack(data, points, prior.joints.tree), prior, skeleton)

    def pose_spreads(self, levels: Integers) -> Integers:
        """Spreads of the components, (rows, frequencies), at these levels."""
        known = self.prior.joints.statistics
        median = np.median(np.concatenate([known.means[POSE:, None], known.spreads[POSE:, 1:]], axis=1), axis=0)
        out = predicted_motion.spreads(self.predicted, median.astype(int), levels[:LEVELS])
        for band, variance in enumerate(self.predicted.variances):
            unpredicted = ~variance.any(axis=1)
            out[unpredicted, predicted_motion.frequencies_of(band)] += levels[LEVELS] * predicted_motion.LEVEL_UNIT
        return out

    def coordinates(self) -> DirectionCoordinates:
        return DirectionCoordinates.at_rest(self.tree, self.metric_root, self.columns)

    def model(self, names: tuple[str, ...], rate: float) -> Model:
        known, spreads = self.prior.joints, self.pose_spreads(self.stored.levels)
        statistics = predicted_motion.with_heading_and_place(
            known.statistics, len(known.names), len(names), self.predicted.bases, spreads, spreads[:, 0]
        )
        return Model(names, self.coordinates(), statistics, self.prior.tables, rate)


def _spanning(found: Floats, moved: Floats) -> Floats:
    """Orthonormal rows extended to span the rows `moved`, however faint these are."""
    rest = moved / np.sqrt(np.maximum(ordered.sum_first_axis(moved.T**2), 1e-30))[:, None]
    for _ in range(2):
        rest = rest - ordered.matmul(ordered.matmul(rest, found.T.copy()), found)
    return np.concatenate([found, ordered.orthonormal(rest, found.shape[1] - len(found), LEAST_ENERGY)])


def _rotations(tree: BoneTree) -> Iterator[tuple[Floats, list[int]]]:
    """For each coordinate, the axis that it rotates about at rest, and the points whose bones it rotates."""
    schedule = tree.schedule
    moved_by: dict[int, list[int]] = {}
    for b in (j for j in range(len(tree.parents)) if tree.parents[j] >= 0 and not tree.zero_length[j]):
        by = -2 - tree.parents[b] if tree.hub[b] else b
        while True:
            moved_by.setdefault(by, []).append(b)
            if by == BODY:
                break
            first = schedule.hub_bones[-2 - by][0] if by < BODY else by
            by = schedule.reference[first]
    for b in schedule.bones:
        first, second = tilt_axes(tree.vectors[b])
        yield second, moved_by[b]
        yield -first, moved_by[b]
    for h in schedule.hubs:
        for axis in np.eye(3):
            yield axis, moved_by[-2 - h]


def tilt_axes(vector: Floats) -> tuple[Floats, Floats]:
    """The first two axes of a bone's frame at rest, as `rotations.frame_along` has them."""
    d = ordered.unit(vector)
    helper = np.eye(3)[np.abs(d).argmin()]
    along = (helper[0] * d[0] + helper[1] * d[1]) + helper[2] * d[2]
    first = ordered.unit(helper - d * along)
    return first, ordered.cross(d, first)


def rest_metric(tree: BoneTree) -> Floats:
    """`bone_directions.metric` at rest, in fixed order, made safely positive definite."""
    moved = np.zeros((tree.dimensions, len(tree.parents), 3))
    for row, (axis, bones) in zip(moved, _rotations(tree), strict=True):
        row[bones] = ordered.cross(np.broadcast_to(axis, (len(bones), 3)), tree.vectors[bones])
        for j, p in enumerate(tree.parents):
            if p >= 0:
                row[j] += row[p]
    mean = ordered.sum_first_axis(moved.swapaxes(0, 1)) / len(tree.parents)
    flat = (moved - mean[:, None]).reshape(len(moved), -1)
    metric = ordered.matmul(flat, flat.T.copy())
    return metric + LEAST_METRIC * metric.max() * np.eye(len(metric))


def coordinate_map(rest: BoneTree, paths: Sequence[tuple[int, ...]], like: BoneTree) -> Floats:
    """Coordinates of the prior's tree to those of the file's, (theirs, these), for small rotations about the rest."""
    rotated = np.zeros((len(like.parents), like.dimensions, 3))  # how the prior's bones rotate with its coordinates
    for number, (axis, bones) in enumerate(_rotations(like)):
        rotated[bones, number] += axis
    schedule = rest.schedule
    number = {b: 2 * i for i, b in enumerate(schedule.bones)}
    number |= {-2 - h: 2 * len(schedule.bones) + 3 * i for i, h in enumerate(schedule.hubs)}
    frames: dict[int, Floats] = {BODY: np.zeros((like.dimensions, 3))}
    out = np.zeros((like.dimensions, rest.dimensions))
    for j, parent in enumerate(rest.parents):
        if parent < 0 or rest.zero_length[j]:
            continue
        reference = frames[schedule.reference[j]]
        at = number[-2 - parent if rest.hub[j] else j]
        if rest.hub[j]:
            theirs = [b for c in schedule.hub_bones[parent] for b in paths[c][-1:] if like.hub[b]]
            if -2 - parent not in frames:
                own = rotated[theirs[0]] - reference if theirs else np.zeros_like(reference)
                out[:, at : at + 3] = own
                frames[-2 - parent] = reference + own
            continue
        first, second = tilt_axes(rest.vectors[j])
        own = np.zeros((like.dimensions, 2))
        if paths[j]:
            moved = -ordered.cross(reference, np.broadcast_to(ordered.unit(rest.vectors[j]), reference.shape))
            for b in paths[j]:
                along = like.vectors[b] / ordered.length(rest.vectors[j])
                moved = moved + ordered.cross(rotated[b], np.broadcast_to(along, reference.shape))
            for i, axis in enumerate((first, second)):
                own[:, i] = (moved[:, 0] * axis[0] + moved[:, 1] * axis[1]) + moved[:, 2] * axis[2]
        out[:, at : at + 2] = own
        frames[j] = reference + own[:, :1] * second - own[:, 1:] * first
    return out
