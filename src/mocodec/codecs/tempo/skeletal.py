"""Joints whose bones do not stretch: coded as where the bones point, on this body's build.

    names ─► the prior's limbs ─built as the file's skeleton, or as measured─► Model

The build is how long each bone is, and how those of a hub stand to each other. The skeleton beside the motion says it,
and it costs nothing then; else it is measured and stored.

    any other joints ─► a tree of bones, the skeleton's or one that is found ─► limbs, stored ─► a basis of their own

Points whose distances never change are one body's joints, whatever they are called. Their limbs are stored in a few
bytes a bone, and `own` makes a model of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry.body_frame import normalised_label as plain_label
from ...motion import Floats, Skeleton
from . import body
from .limbs import Limbs, fit
from .model import Model, step_size
from .prior import PointSet, Prior

Integers = NDArray[np.int64]

SKELETON, MEASURED = 0, 1
"""Where the build comes from. Never change them."""
FINER = 160
"""A build is rounded to the step of the coefficients made finer by this, 1/32 octave: it is wrong in every frame."""
STRETCH = 0.1
"""Bones that stretch by more than this, in steps, in more than a hundredth of the samples, are no limbs."""
SAMPLED = 64
"""About so many frames of each run are looked at."""


def candidate(
    runs: Sequence[Floats], names: tuple[str, ...], rate: float, step: int, skeleton: Skeleton | None, prior: Prior
) -> tuple[bytes, Model] | None:
    """What is stored of the model for runs of positions (frames, points, 3), and that; none where they are no limbs'.

    step: about how coarsely the coefficients will be rounded, log₂ in 1/32 octave.
    """
    points = of_names(names, prior)
    if points is None or points.limbs is None:
        return None
    if not runs:  # a stream, of which nothing is known yet but its skeleton
        stored = bytes([SKELETON])
        return None if skeleton is None else (stored, unpack(stored, names, rate, skeleton, prior))
    poses = np.concatenate([r[:: max(1, len(r) // SAMPLED)] for r in runs])[:, points.columns]
    poses = poses - poses.mean(axis=1, keepdims=True)
    for stored, limbs in _builds(poses, points.limbs, skeleton, points.columns, step - FINER):
        off = np.sqrt(((limbs.inverse(limbs.forward(poses)) - poses) ** 2).sum(axis=2))
        if (off > STRETCH * step_size(step)).mean() < 0.01:
            return stored, Model(replace(points, limbs=limbs), prior, rate)
    return None


def unpack(data: bytes, names: tuple[str, ...], rate: float, skeleton: Skeleton | None, prior: Prior) -> Model:
    """The model again. Raises Corrupt."""
    points = of_names(names, prior)
    if points is None or points.limbs is None or not data or data[0] > MEASURED:
        raise Corrupt("tempo: the shared bytes do not fit the names of the points")
    if data[0] == SKELETON:
        if skeleton is None or len(data) > 1:
            raise Corrupt("tempo: the motion lacks the skeleton that it was coded with")
        return Model(replace(points, limbs=points.limbs.built(offsets_of(skeleton, points.columns))), prior, rate)
    return Model(replace(points, limbs=_unpack_build(data[1:], points.limbs)), prior, rate)


def of_names(names: tuple[str, ...], prior: Prior) -> PointSet | None:
    """The prior's limbs of these names, in any order; none where it has no such set."""
    labels = [plain_label(n) for n in names]
    for points in prior.sets:
        known = [plain_label(n) for n in points.names]
        if points.limbs is not None and len(set(labels)) == len(labels) and sorted(labels) == sorted(known):
            columns = np.array([labels.index(label) for label in known])
            return replace(points, names=names, pose=points.pose[np.argsort(columns)], columns=columns)
    return None


@dataclass(frozen=True, eq=False)
class Stored:
    """What is stored of limbs that no prior knows: in the order of the points, (points,) and (points, 3).

    parents: −1 for the root; empty where they are the skeleton's, and so are the lengths then. vectors: in steps of
    2^(fine / 32) m. marks: 1 of a hub, 2 carried.
    """

    fine: int
    parents: tuple[int, ...]
    vectors: Integers
    marks: Integers

    def pack(self) -> bytes:
        tree = np.array(self.parents, np.int64)[:, None] - np.arange(len(self.parents))[:, None]
        parts = [coder.pack(tree), coder.pack(self.vectors), coder.pack(self.marks[:, None])]
        return varint.write([varint.signed(self.fine), bool(self.parents), *map(len, parts)]) + b"".join(parts)

    @classmethod
    def unpack(cls, data: bytes, points: int) -> tuple[Stored, bytes]:
        """What is stored, and the bytes after it. Raises Corrupt."""
        (fine, has_tree, *sizes), at = varint.read(data, 5)
        if has_tree > 1 or fine > 4000 or at + sum(sizes) > len(data):
            raise Corrupt("tempo: limbs that are out of range")
        blobs = []
        for size in sizes:
            blobs.append(data[at : at + size])
            at += size
        tree = coder.unpack(blobs[0], (points * has_tree, 1))[:, 0] + np.arange(points * has_tree)
        vectors, marks = coder.unpack(blobs[1], (points, 3)), coder.unpack(blobs[2], (points, 1))[:, 0]
        long = np.abs(vectors).max(initial=0) * float(step_size(varint.unsigned(fine)))
        if not long < LONGEST_M or (marks != marks.clip(0, 3)).any():
            raise Corrupt("tempo: limbs that are out of range")
        return cls(varint.unsigned(fine), tuple(int(p) for p in tree), vectors, marks), data[at:]

    def points(self, names: tuple[str, ...], skeleton: Skeleton | None) -> PointSet:
        """The points as limbs, with no bases yet. Raises Corrupt."""
        if not self.parents and skeleton is None:
            raise Corrupt("tempo: the motion lacks the skeleton that it was coded with")
        parents = self.parents
        if skeleton is not None and not parents:
            parents = skeleton.parents
        columns = ordered(parents)
        if columns is None or len(parents) != len(names):
            raise Corrupt("tempo: bones that make no tree")
        place = np.argsort(columns)
        vectors = self.vectors[columns] * step_size(self.fine)
        marks = self.marks[columns]
        limbs = Limbs(
            tuple(int(place[parents[c]]) if parents[c] >= 0 else -1 for c in columns),
            vectors,
            marks % 2 == 1,
            marks > 1,
        )
        if not limbs.dimensions or any(len(children) < 2 for children in limbs.plan.children.values()):
            raise Corrupt("tempo: limbs without bones, or a hub of one")
        if skeleton is not None and not self.parents:
            limbs = limbs.built(offsets_of(skeleton, columns))
            if not limbs.dimensions or not limbs.lengths.max() < LONGEST_M:
                raise Corrupt("tempo: a skeleton without bones")
        still = np.zeros((1, limbs.dimensions))
        metric = limbs.metric(still)
        reach = np.asarray(np.linalg.cholesky(metric + LEAST * metric.max() * np.eye(limbs.dimensions)), np.float64)
        empty = np.zeros((0, 0), np.int64)
        return PointSet(names, limbs.inverse(still)[0][np.argsort(columns)], (), empty, empty, limbs, reach, columns)


LEAST = 1e-6
"""A coordinate that hardly moves a point is taken to move it by the root of this, of what the strongest moves it."""
LONGEST_M = 1e9


def unknown(
    runs: Sequence[Floats], pose: Floats, names: tuple[str, ...], rate: float, step: int, skeleton: Skeleton | None
) -> tuple[Stored, PointSet] | None:
    """Limbs of runs of positions (frames, points, 3) whose points no prior knows; none where there are none.

    pose: what the headings are counted from, (points, 3).
    """
    if len(names) < FEWEST_POINTS:
        return None
    sample = [r[:: max(1, len(r) // SAMPLED)] for r in runs]
    tolerance = float(STRETCH * step_size(step))
    headed = [body.turn(c, -body.heading(c, pose)) for c in (s - s.mean(axis=1, keepdims=True) for s in sample)]
    every = np.concatenate(headed)
    for parents, fine in trees(every, skeleton, tolerance, step):
        columns = ordered(parents)
        if columns is None:
            continue
        place = np.argsort(columns)
        builds = [skeleton.offsets[columns]] * len(headed) if skeleton is not None and fine is None else None
        found = fit([h[:, columns] for h in headed], in_order(parents, columns), builds)
        if not found.dimensions:
            continue
        grid = step - FINER if fine is None else fine
        vectors = np.rint(found.vectors / step_size(grid)).astype(np.int64)[place]
        marks = (found.hub & ~found.still) + 2 * found.carried
        stored = Stored(grid, () if fine is None else tuple(parents), vectors, marks[place].astype(np.int64))
        try:
            points = stored.points(names, skeleton)
        except Corrupt:  # bones shorter than their rounding
            continue
        assert points.limbs is not None
        poses = every[:, columns] - every.mean(axis=1, keepdims=True)
        off = np.sqrt(((points.limbs.inverse(points.limbs.forward(poses)) - poses) ** 2).sum(axis=2))
        if (off > 2 * tolerance).mean() < 0.01:
            return stored, points
    return None


def trees(
    poses: Floats, skeleton: Skeleton | None, tolerance: float, step: int
) -> Iterator[tuple[Sequence[int], int | None]]:
    """Parents of each point, and how finely the bones must be stored, log₂ in 1/32 octave; none for a skeleton's."""
    if skeleton is not None:
        yield skeleton.parents, None
    if 2 <= poses.shape[1] <= MOST_POINTS and (found := _rigid_tree(poses, tolerance)) is not None:
        yield found, step - FINER


FEWEST_FRAMES, FEWEST_POINTS = 16, 4
"""Of fewer nobody can tell whether the points are a body's."""
MOST_POINTS = 128
"""Among more points than this no bones are looked for."""


def _rigid_tree(poses: Floats, tolerance: float) -> tuple[int, ...] | None:
    """The shortest links whose lengths stay the same, as the parent of each point; none where they do not reach all."""
    apart = np.sqrt(((poses[:, :, None] - poses[:, None]) ** 2).sum(axis=3))
    middle = np.median(apart, axis=0)
    stiff = (np.abs(apart - middle) > tolerance).mean(axis=0) < 0.01
    cost = np.where(stiff, middle, np.inf)
    root = int(middle.sum(axis=0).argmin())
    parents = np.full(len(cost), -1)
    nearest, link = cost[root].copy(), np.full(len(cost), root)
    out = np.ones(len(cost), bool)
    out[root] = False
    while out.any():
        at = int(np.where(out, nearest, np.inf).argmin())
        if not out[at] or not np.isfinite(nearest[at]):
            return None
        parents[at], out[at] = link[at], False
        closer = cost[at] < nearest
        nearest[closer], link[closer] = cost[at][closer], at
    return tuple(int(p) for p in parents)


def ordered(parents: Sequence[int]) -> Integers | None:
    """Points so that each comes after its parent; none where that is not one tree."""
    children: dict[int, list[int]] = {}
    for point, parent in enumerate(parents):
        children.setdefault(parent, []).append(point)
    order = list(children.get(-1, []))
    if len(order) != 1:
        return None
    for at in order:
        order += children.get(at, [])
    return np.array(order) if len(order) == len(parents) else None


def offsets_of(skeleton: Skeleton, columns: Integers | None) -> Floats:
    """Offsets (points, 3) in steps of 10 µm: a file may keep no more of them, and both sides must build the same."""
    return np.rint(skeleton.offsets[columns] * OFFSETS_PER_M) / OFFSETS_PER_M


OFFSETS_PER_M = 100_000


def in_order(parents: Sequence[int], columns: Integers) -> tuple[int, ...]:
    """The parents of points that stand in this order now."""
    place = np.append(np.argsort(columns), -1)  # the root's parent, −1, stays
    return tuple(int(place[parents[c]]) for c in columns)


def _builds(
    poses: Floats, like: Limbs, skeleton: Skeleton | None, columns: Integers | None, fine: int
) -> Iterator[tuple[bytes, Limbs]]:
    """What is stored of a build, and limbs of that build."""
    if skeleton is not None:
        yield bytes([SKELETON]), like.built(offsets_of(skeleton, columns))
    stored = _pack_build(poses, like, fine)
    yield bytes([MEASURED]) + stored, _unpack_build(stored, like)


def _pack_build(poses: Floats, like: Limbs, fine: int) -> bytes:
    """What differs from the prior's build, in steps: of a bone its length, of a hub's bone its vector."""
    offsets = poses - poses[:, [max(p, 0) for p in like.parents]]
    lengths = np.median(np.sqrt((offsets**2).sum(axis=2)), axis=0)
    measured = like.built(offsets[len(offsets) // 2])
    numbers = np.where(_of_hub(like), measured.vectors - like.vectors, (lengths - like.lengths)[:, None])[_told(like)]
    whole = np.rint(numbers / step_size(fine)).astype(np.int64)
    return varint.write([varint.signed(fine)]) + coder.pack(whole[:, None])


def _unpack_build(data: bytes, like: Limbs) -> Limbs:
    """Raises Corrupt."""
    (folded,), at = varint.read(data, 1)
    told = _told(like)
    fine = varint.unsigned(folded)
    whole = coder.unpack(data[at:], (int(told.sum()), 1))[:, 0]
    if abs(fine) > 6000 or (np.abs(whole) > 1 << 40).any():
        raise Corrupt("tempo: a build that is out of range")
    numbers = np.zeros(told.shape)
    numbers[told] = whole * step_size(fine)
    lengths = np.maximum(like.lengths + numbers[:, 0], 0.0)
    offsets = like.vectors * (lengths / np.maximum(like.lengths, 1e-30))[:, None]
    return replace(like, vectors=np.where(_of_hub(like), like.vectors + numbers, offsets))


def _of_hub(like: Limbs) -> NDArray[np.bool_]:
    """(points, 1)"""
    return (like.hub & ~like.still)[:, None]


def _told(like: Limbs) -> NDArray[np.bool_]:
    """Which of (points, 3) numbers say a build: one of a bone, three of a hub's bone."""
    moves = (np.array(like.parents) >= 0) & ~like.still
    return moves[:, None] & (_of_hub(like) | (np.arange(3) == 0))
