"""Motions for the test of tempo: bodies of rigid bones, posed by the second decoder's own arithmetic."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocodec.motion import Motion, Skeleton
from mocodec.testing import synthetic

from .payloads import Array
from .tempo_statistics import prior
from .trees import Tree, prior_tree

DIRECTIONS_PRIOR = "1be90053"
TREE = prior_tree(prior(DIRECTIONS_PRIOR))
NAMES = tuple(str(n) for n in prior(DIRECTIONS_PRIOR)["names"])


def named_points(frames: int) -> Motion:
    """As many markers of a figure as the prior has joints, under their names."""
    motion = synthetic.markers(frames=frames, seed=1)
    return Motion(motion.positions[:, : len(NAMES)], motion.rate, NAMES, motion.up)


def curves(frames: int, columns: int, seed: int, size: float) -> Array:
    """Slow waves (frames, columns)."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None, None] / 120
    waves = rng.normal(0, size, (columns, 4)) * np.sin(2 * np.pi * rng.uniform(0.1, 2.5, (columns, 4)) * t)
    return waves.sum(axis=2)


def named_joints(frames: int, seed: int = 0, size: float = 0.15) -> Motion:
    """A body of rigid bones under the prior's names, with its skeleton."""
    scale = np.random.default_rng(seed).uniform(0.85, 1.15, (len(NAMES), 1))
    tree = TREE.resized(TREE.vectors * scale)
    poses = tree.positions(curves(frames, tree.dimensions, seed, size))
    place = np.cumsum(curves(frames, 3, seed + 1, 0.15), axis=0)[:, None] / 60
    return Motion(poses + place, 120.0, NAMES, "y", Skeleton(NAMES, tuple(tree.parents), tree.vectors))


def with_tails(frames: int) -> Motion:
    """A body under other names, with two chains of bones that the prior does not know, and a bone without length."""
    more = [TREE.parents.index(0), 31, 32, NAMES.index("head"), 34]
    vectors = np.array([[0.1, -0.2, -0.2], [0, -0.2, -0.1], [0, 0, 0], [0.1, 0.1, 0], [0, 0.2, 0.05]])
    none, both = np.zeros(5, bool), np.array([False, True, False, False, True])
    tree = Tree(
        [*TREE.parents, *more],
        np.concatenate([TREE.vectors, vectors]),
        np.concatenate([TREE.hub, none]),
        np.concatenate([TREE.relative, both]),
    )
    names = tuple(f"Bone {i}" for i in range(len(tree.parents)))
    skeleton = Skeleton(names, tuple(tree.parents), tree.vectors)
    return Motion(tree.positions(curves(frames, tree.dimensions, 7, 0.1)), 60.0, names, "y", skeleton)


def renamed_joints(
    frames: int, with_skeleton: bool, gone: Sequence[str] = (), shuffled: bool = False, size: float = 0.15
) -> Motion:
    """Named joints under other names, without some of them."""
    motion = named_joints(frames, 5, size)
    kept = [j for j, name in enumerate(NAMES) if name not in gone]
    parents = []
    for j in kept:
        above = TREE.parents[j]
        while above >= 0 and above not in kept:
            above = TREE.parents[above]
        parents.append(kept.index(above) if above >= 0 else -1)
    positions = motion.positions[:, kept]
    names = tuple(f"Bone {i}" for i in range(len(kept)))
    offsets = positions[0] - positions[0, np.maximum(parents, 0)]
    skeleton = Skeleton(names, tuple(parents), offsets) if with_skeleton else None
    if shuffled:
        positions = positions[:, np.random.default_rng(9).permutation(len(kept))]
    return Motion(positions, 60.0, names, "y", skeleton)
