"""Motions that tempo's tests share: markers, joints that the prior knows, skeletons under other names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mocodec import metrics
from mocodec.codecs.tempo import Tempo
from mocodec.codecs.tempo.coding.rows import HEADING, step_size
from mocodec.codecs.tempo.header import StreamHeader
from mocodec.codecs.tempo.models import prior
from mocodec.codecs.tempo.models.coordinates import DirectionCoordinates
from mocodec.codecs.tempo.models.model import Model
from mocodec.codecs.tempo.pose import bone_directions
from mocodec.codecs.tempo.pose.bone_tree import BoneTree
from mocodec.encoded import Encoded
from mocodec.motion import Motion, Skeleton
from mocodec.testing import synthetic
from mocodec.typing import Floats

JOINTS = prior.for_directions().joints
"""What the prior knows by name."""
NAMES = JOINTS.names
LEAVES = ("ltoes", "rtoes", "lfingers", "rfingers", "lthumb", "rthumb", "head")


def error(motion: Motion, decoded: Motion) -> Floats:
    return metrics.distances(motion.positions, decoded.positions)


def through(motion: Motion, **settings: Any) -> tuple[Motion, int]:
    """Decoded motion, and bytes."""
    encoded = Tempo(**settings).encode(motion)
    return Tempo.decode(encoded), encoded.payload_bytes


def header(encoded: Encoded[Motion]) -> StreamHeader:
    return StreamHeader.unpack(encoded.shared, encoded.about.points)


def named_points(frames: int = 480, seed: int = 1) -> Motion:
    """As many markers of a figure as the prior's skeleton has joints, under their names."""
    motion = synthetic.markers(frames=frames, seed=seed)
    return Motion(motion.positions[:, : len(NAMES)], motion.rate, NAMES, motion.up)


def smooth(frames: int, columns: int, seed: int) -> Floats:
    """Curves (frames, columns) of slow waves, about as large as people's rotations, radians."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None, None] / 120
    waves = rng.normal(0, 0.15, (columns, 4)) * np.sin(2 * np.pi * rng.uniform(0.1, 2.5, (columns, 4)) * t)
    return np.asarray(waves.sum(axis=2))


def body(seed: int = 0) -> BoneTree:
    """The prior's tree with somebody else's proportions."""
    scale = np.random.default_rng(seed).uniform(0.85, 1.15, (len(NAMES), 1))
    return JOINTS.tree.with_offsets(JOINTS.tree.vectors * scale)


def named_skeleton(frames: int = 400, seed: int = 0, with_skeleton: bool = True) -> Motion:
    """A body of rigid bones under the prior's names."""
    tree = body(seed)
    poses = bone_directions.inverse(tree, smooth(frames, tree.dimensions, seed))
    place = np.cumsum(smooth(frames, 3, seed + 1), axis=0)[:, None] / 60
    skeleton = Skeleton(NAMES, tree.parents, tree.vectors) if with_skeleton else None
    return Motion(poses + place, 120.0, NAMES, "y", skeleton)


def renamed_skeleton(with_skeleton: bool, frames: int = 600, rate: float = 60.0) -> Motion:
    """The same under other names; without a skeleton its joints are shuffled."""
    motion = named_skeleton(frames, 5)
    assert motion.skeleton is not None
    names = tuple(f"Bone {i}" for i in range(motion.points))
    skeleton = Skeleton(names, motion.skeleton.parents, motion.skeleton.offsets) if with_skeleton else None
    order = np.arange(motion.points) if with_skeleton else np.random.default_rng(9).permutation(motion.points)
    return Motion(motion.positions[:, order], rate, names, "y", skeleton)


def person(frames: int = 150, rate: float = 30.0, seed: int = 0) -> Floats:
    """Positions (frames, points, 3) of somebody who moves as the prior expects, with proportions of their own."""
    rng = np.random.default_rng(seed)
    tree = JOINTS.tree.with_offsets(JOINTS.tree.vectors * rng.uniform(0.9, 1.12, (len(NAMES), 1)))
    assert isinstance(JOINTS.coordinates, DirectionCoordinates)
    coordinates = replace(JOINTS.coordinates, tree=tree)
    model = Model(NAMES, coordinates, JOINTS.statistics, prior.for_directions().tables, rate)
    usual = step_size(model.expected(frames, 0))
    usual[:, HEADING] = 0.0
    return model.synthesise(0.7 * rng.normal(size=usual.shape) * usual, frames)


def stranger(
    gone: Sequence[str] = (), frames: int = 150, rate: float = 30.0, with_skeleton: bool = True, seed: int = 0
) -> Motion:
    """The person under other names, without some joints; joints above and below a missing one are linked."""
    kept = [i for i, name in enumerate(NAMES) if name not in gone]
    parents = parents_without([i for i in range(len(NAMES)) if i not in kept])
    positions = person(frames, rate, seed)[:, kept]
    names = tuple(f"Bone {i}" for i in range(len(kept)))
    offsets = positions[0] - positions[0, np.maximum(parents, 0)]
    return Motion(positions, rate, names, "y", Skeleton(names, tuple(parents), offsets) if with_skeleton else None)


def parents_without(gone: Sequence[int]) -> list[int]:
    """Parents in the prior's tree without some joints."""
    kept = [i for i in range(len(NAMES)) if i not in gone]
    parents = []
    for i in kept:
        above = JOINTS.tree.parents[i]
        while above in gone:
            above = JOINTS.tree.parents[above]
        parents.append(kept.index(above) if above >= 0 else -1)
    return parents
