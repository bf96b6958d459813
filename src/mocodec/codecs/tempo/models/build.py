"""Proportions of a body: from the skeleton that stands in the file beside the motion, or measured and stored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ....entropy import coder, varint
from ....errors import Corrupt
from ....motion import Skeleton
from ....typing import Booleans, Floats, Integers
from ..coding.rows import step_size
from ..pose.bone_tree import BoneTree

LARGEST_M = 1e9
OFFSETS_PER_M = 100_000
"""Offsets are rounded to 10 µm: a file may store no more of them, and both sides must use the same."""
FINER = 160
"""Proportions are rounded to the coefficients' step made finer by this, 1/32 octave: they are wrong in every frame."""
MISSING_SKELETON = "tempo: the motion lacks the skeleton that it was coded with"


def skeleton_offsets(skeleton: Skeleton, columns: Integers) -> Floats:
    """Offsets (points, 3) of a skeleton's joints in this order, rounded to 10 µm."""
    return np.rint(skeleton.offsets[columns] * OFFSETS_PER_M) / OFFSETS_PER_M


def median_lengths(poses: Floats, parents: Sequence[int]) -> tuple[Floats, Floats]:
    """Median length (points,) of each bone in poses (frames, points, 3), and the offsets (points, 3) of one frame."""
    offsets = poses - poses[:, [max(p, 0) for p in parents]]
    return np.median(np.sqrt((offsets**2).sum(axis=2)), axis=0), offsets[len(offsets) // 2]


def pack(poses: Floats, like: BoneTree, fine: int) -> bytes:
    """Proportions measured in poses (frames, points, 3), as differences from those of the prior's tree.

    Of a bone its length, of a hub's bone its vector, in steps of 2^(fine / 32) m.
    """
    lengths, offsets = median_lengths(poses, like.parents)
    measured = like.with_offsets(offsets)
    numbers = np.where(_in_hub(like), measured.vectors - like.vectors, (lengths - like.lengths)[:, None])
    integers = np.rint(numbers[_stored(like)] / step_size(fine)).astype(np.int64)
    return varint.write([varint.signed(fine)]) + coder.pack(integers[:, None])


def unpack(data: bytes, like: BoneTree) -> BoneTree:
    """The tree of `pack`. Raises Corrupt."""
    (folded,), at = varint.read(data, 1)
    stored = _stored(like)
    fine = varint.unsigned(folded)
    integers = coder.unpack(data[at:], (int(stored.sum()), 1))[:, 0]
    if abs(fine) > 6000 or (np.abs(integers) > 1 << 40).any():
        raise Corrupt("tempo: the proportions of the body are out of range")
    numbers = np.zeros(stored.shape)
    numbers[stored] = integers * step_size(fine)
    lengths = np.maximum(like.lengths + numbers[:, 0], 0.0)
    offsets = like.vectors * (lengths / np.maximum(like.lengths, 1e-30))[:, None]
    return replace(like, vectors=np.where(_in_hub(like), like.vectors + numbers, offsets))


def _in_hub(like: BoneTree) -> Booleans:
    """(points, 1)"""
    return (like.hub & ~like.zero_length)[:, None]


def _stored(like: BoneTree) -> Booleans:
    """Which of (points, 3) numbers are stored: one of a bone, three of a hub's bone."""
    moves = (np.array(like.parents) >= 0) & ~like.zero_length
    return moves[:, None] & (_in_hub(like) | (np.arange(3) == 0))
