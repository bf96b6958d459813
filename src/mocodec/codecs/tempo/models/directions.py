"""Models of bone directions.

with the prior      joints that it knows by name, or a skeleton of other names matched to its own
with a stored basis tree and basis of the recording
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .... import parallel
from ....errors import Corrupt
from ....fields import Record, array, flag, raw, signed, sized
from ....motion import Motion, Skeleton
from ....typing import Floats, Integers
from ..coding.rows import step_size
from ..pose import bone_directions, heading, tree_fitting
from ..pose.bone_tree import BoneTree
from . import build, prior, skeleton_matching, stored_basis
from .build import LARGEST_M, MISSING_SKELETON
from .coordinates import DirectionCoordinates
from .model import Model
from .prior import Prior
from .recording import FittedModel, Recording
from .skeleton_correspondence import HUB, LEAST_METRIC, RELATIVE, MatchedSkeleton
from .skeleton_matching import SAMPLED_FRAMES, STRETCH_STEPS
from .stored_basis import Components, StoredBasis

BY_NAME, BY_NAME_MEASURED, MATCHED = 0, 1, 2
"""First byte of a model with the prior: known names, with the skeleton's or stored proportions, or a matched skeleton.
Never change them."""
MOST_SAMPLED = 256
"""Frames of a recording, about, that show whether proportions fit, and measure them."""
POSE_FRAMES = 256
"""Frames of each chunk that the mean pose is computed from."""


@dataclass(frozen=True, eq=False)
class NamedDirections:
    """Joints that the prior knows by name. proportions: bytes of `build`, empty where they are the skeleton's."""

    prior: Prior
    proportions: bytes = b""

    @property
    def prior_id(self) -> bytes:
        return self.prior.id

    def pack(self) -> bytes:
        return bytes([BY_NAME_MEASURED if self.proportions else BY_NAME]) + self.proportions

    def model(self, like: Motion) -> Model:
        """Raises Corrupt."""
        known = self.prior.joints
        columns = known.columns(like.names)
        if columns is None:
            raise Corrupt("tempo: the names of the points are not those of the prior")
        if self.proportions:
            tree = build.unpack(self.proportions, known.tree)
        elif like.skeleton is None:
            raise Corrupt(MISSING_SKELETON)
        else:
            tree = _tree_of_offsets(self.prior, build.skeleton_offsets(like.skeleton, columns).tobytes())
        if not np.array_equal(tree.zero_length[1:], known.tree.zero_length[1:]) or not tree.lengths.max() < LARGEST_M:
            raise Corrupt("tempo: proportions with bones of other lengths than zero, or zero, than the prior's")
        assert isinstance(known.coordinates, DirectionCoordinates)
        pose = known.coordinates.pose[np.argsort(columns)]
        coordinates = DirectionCoordinates(pose, tree, known.coordinates.metric_root, columns)
        return Model(like.names, coordinates, known.statistics, self.prior.tables, like.rate)


@lru_cache(maxsize=8)
def _tree_of_offsets(known: Prior, offsets: bytes) -> BoneTree:
    """The prior's tree with these offsets, float64: its schedule of bones is made once."""
    return known.joints.tree.with_offsets(np.frombuffer(offsets).reshape(-1, 3))


@dataclass(frozen=True, eq=False)
class MatchedDirections:
    """A skeleton of other names, matched to the prior's."""

    skeleton: MatchedSkeleton

    @property
    def prior_id(self) -> bytes:
        return self.skeleton.prior.id

    def pack(self) -> bytes:
        return bytes([MATCHED]) + self.skeleton.stored.pack(self.skeleton.prior.joints.tree)

    def model(self, like: Motion) -> Model:
        return self.skeleton.model(like.names, like.rate)


def fit_with_prior(recording: Recording) -> Iterator[FittedModel]:
    known, like = prior.for_directions(), recording.like
    columns = known.joints.columns(like.names)
    if columns is None:
        if matched := skeleton_matching.match(recording.chunks, like, recording.step, known):
            yield MatchedDirections(matched)
    elif not recording.chunks:  # a stream that has not begun: only its skeleton is known
        if like.skeleton is not None:
            yield NamedDirections(known)
    elif named := _named(recording, known, columns):
        yield named


def _named(recording: Recording, known: Prior, columns: Integers) -> NamedDirections | None:
    """With the proportions of the skeleton, or measured ones, whichever fit the positions first."""
    each = max(1, min(SAMPLED_FRAMES, MOST_SAMPLED // len(recording.chunks)))
    sampled = (r[:: max(1, len(r) // each)] for r in recording.chunks[:: max(1, len(recording.chunks) // MOST_SAMPLED)])
    poses = heading.centred([r[:, columns] for r in sampled])
    tolerance = _tolerance(recording.step)

    def candidates() -> Iterator[NamedDirections]:
        if recording.like.skeleton is not None:
            yield NamedDirections(known)
        yield NamedDirections(known, build.pack(poses, known.joints.tree, recording.step - build.FINER))

    for candidate in candidates():
        try:
            coordinates = candidate.model(recording.like).coordinates
        except Corrupt:  # proportions that a decoder would refuse
            continue
        assert isinstance(coordinates, DirectionCoordinates)
        if tree_fitting.represents(coordinates.tree, poses, tolerance):
            return candidate
    return None


def unpack_with_prior(data: bytes, known: Prior, like: Motion) -> FittedModel:
    """Raises Corrupt."""
    if not known.for_directions:
        raise Corrupt("tempo: bone directions, of a prior that knows none")
    if data == bytes([BY_NAME]):
        return NamedDirections(known)
    if data[:1] == bytes([BY_NAME_MEASURED]) and len(data) > 1:
        return NamedDirections(known, data[1:])
    if data[:1] == bytes([MATCHED]):
        return MatchedDirections(MatchedSkeleton.unpack(data[1:], like.points, known, like.skeleton))
    raise Corrupt("tempo: a model of bone directions of an unknown kind")


TREE = Record(
    "tempo: a stored tree of bones",
    signed("fine", most=2000, meaning="vectors are in steps of 2^(fine / 32) m"),
    flag("has_tree", meaning="the tree is stored, else it and the lengths are the skeleton's"),
    *sized(
        array("parents", ("points",), meaning="less the index", when=lambda known: known["has_tree"]),
        array("vectors", ("points", 3), meaning="rest vector of each bone"),
        array("marks", ("points",), least=0, most=HUB | RELATIVE, meaning="1: in a hub, 2: relative"),
    ),
    raw("basis"),
)


@dataclass(frozen=True, eq=False)
class StoredDirections:
    """A tree that no prior knows, in the order of the points.

    parents: −1 for the root; empty where they and the lengths are the skeleton's. vectors (points, 3): in steps of
    2^(fine / 32) m. marks (points,): HUB, RELATIVE.
    """

    prior: Prior
    fine: int
    parents: tuple[int, ...]
    vectors: Integers
    marks: Integers
    basis: StoredBasis | None = None

    @property
    def prior_id(self) -> bytes:
        return self.prior.id

    def pack(self) -> bytes:
        assert self.basis is not None
        return TREE.pack(
            {
                "fine": self.fine,
                "has_tree": bool(self.parents),
                "parents": np.array(self.parents, np.int64) - np.arange(len(self.parents)),
                "vectors": self.vectors,
                "marks": self.marks,
                "basis": self.basis.pack(),
            }
        )

    def coordinates(self, skeleton: Skeleton | None) -> DirectionCoordinates:
        """Raises Corrupt."""
        if not self.parents and skeleton is None:
            raise Corrupt(MISSING_SKELETON)
        parents = skeleton.parents if skeleton is not None and not self.parents else self.parents
        columns = tree_fitting.topological_order(parents)
        if columns is None or len(parents) != len(self.marks):
            raise Corrupt("tempo: the bones are not one tree")
        marks = self.marks[columns]
        tree = BoneTree(
            tree_fitting.reordered_parents(parents, columns),
            self.vectors[columns] * step_size(self.fine),
            marks & HUB != 0,
            marks & RELATIVE != 0,
        )
        if not tree.has_rotations:
            raise Corrupt("tempo: a tree without bones, or a hub of one bone")
        if skeleton is not None and not self.parents:
            tree = tree.with_offsets(build.skeleton_offsets(skeleton, columns))
        if not tree.dimensions or not tree.lengths.max() < LARGEST_M:
            raise Corrupt("tempo: a tree whose bones are out of range")
        metric = bone_directions.metric(tree, np.zeros((1, tree.dimensions)))
        metric_root = np.linalg.cholesky(metric + LEAST_METRIC * metric.max() * np.eye(tree.dimensions))
        return DirectionCoordinates.at_rest(tree, np.asarray(metric_root, np.float64), columns)

    def model(self, like: Motion) -> Model:
        """Raises Corrupt."""
        assert self.basis is not None
        coordinates = self.coordinates(like.skeleton)
        statistics = self.basis.statistics(self.prior, coordinates.dimensions, None)
        return Model(like.names, coordinates, statistics, self.prior.tables, like.rate)


def fit_stored(recording: Recording) -> Iterator[FittedModel]:
    """Only for points whose distances show that they are joints of one body."""
    if recording.frames < tree_fitting.FEWEST_FRAMES or recording.like.points < tree_fitting.FEWEST_POINTS:
        return
    found = _fit_tree(recording)
    if found is not None:
        stored, coordinates = found
        rate, step = recording.like.rate, recording.step
        components = Components.of_positions(recording.chunks, coordinates, rate)
        fitted = stored_basis.fit(components, stored.prior, rate, step)
        yield StoredDirections(stored.prior, stored.fine, stored.parents, stored.vectors, stored.marks, fitted)


def _fit_tree(recording: Recording) -> tuple[StoredDirections, DirectionCoordinates] | None:
    skeleton, known = recording.like.skeleton, prior.for_directions()
    sample = [chunk[:: max(1, len(chunk) // POSE_FRAMES)] for chunk in recording.chunks]
    pose = heading.mean_pose(heading.centred(sample))
    aligned = list(parallel.over(lambda chunk: _aligned_sample(chunk, pose), recording.chunks))
    every = np.concatenate(aligned)
    tolerance = _tolerance(recording.step)
    for parents, of_skeleton in tree_fitting.trees(every, skeleton, tolerance):
        columns = tree_fitting.topological_order(parents)
        if columns is None:
            continue
        builds = [skeleton.offsets[columns]] * len(aligned) if skeleton is not None and of_skeleton else None
        in_order = [a[:, columns] for a in aligned]
        tree = tree_fitting.fit(in_order, tree_fitting.reordered_parents(parents, columns), builds)
        if not tree.dimensions:
            continue
        fine, back = recording.step - build.FINER, np.argsort(columns)
        vectors = np.rint(tree.vectors / step_size(fine)).astype(np.int64)[back]
        marks = (HUB * (tree.hub & ~tree.zero_length) + RELATIVE * tree.relative)[back]
        stored = StoredDirections(known, fine, () if of_skeleton else tuple(parents), vectors, marks.astype(np.int64))
        try:
            coordinates = stored.coordinates(skeleton)
        except Corrupt:  # bones shorter than their rounding
            continue
        if tree_fitting.represents(coordinates.tree, every[:, columns], 2 * tolerance):
            return stored, coordinates
    return None


def form_a_tree(poses: Floats, step: int) -> bool:
    """Whether distances show that the points of poses (frames, points, 3) may be joints of one body, in this step."""
    if len(poses) < tree_fitting.FEWEST_FRAMES or poses.shape[1] < tree_fitting.FEWEST_POINTS:
        return False
    return any(True for _ in tree_fitting.trees(poses, None, _tolerance(step)))


def _tolerance(step: int) -> float:
    return float(STRETCH_STEPS * step_size(step))


def _aligned_sample(chunk: Floats, pose: Floats) -> Floats:
    return heading.align(heading.centred([chunk[:: max(1, len(chunk) // SAMPLED_FRAMES)]]), pose)


def unpack_stored(data: bytes, known: Prior, like: Motion) -> FittedModel:
    """Raises Corrupt."""
    if not known.for_directions:
        raise Corrupt("tempo: bone directions, of a prior that knows none")
    values = TREE.unpack(data, points=like.points)
    parents = values["parents"]
    tree = () if parents is None else tuple(int(p) for p in parents + np.arange(like.points))
    stored = StoredDirections(known, values["fine"], tree, values["vectors"], values["marks"])
    dimensions = stored.coordinates(like.skeleton).dimensions
    basis = StoredBasis.unpack(values["basis"], dimensions)
    return StoredDirections(known, stored.fine, tree, stored.vectors, stored.marks, basis)
