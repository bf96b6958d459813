"""Rotations beside positions: a layer outside everything else that tempo does.

    motion ─positions─► inner stream ─decode─► targets ─┐
       └─rotations─► rules, side values ─► integers ────┴─solve─► rotations, positions ─checked, mended─► chunks

Positions cost what they cost without rotations; the layer adds what they leave open: twists, mostly. Joints and *shell
points* are checked: three points at a set distance off each joint along the axes of its frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ....encoded import Chunk, Encoded, restore
from ....errors import BadInput, Corrupt
from ....motion import Motion, Skeleton
from ....typing import Floats
from .. import chunk as chunks_
from . import payload, record, side
from .payload import Layer

PARTS = 2
"""Shared bytes of a stream with rotations: the inner stream's, then the layer's."""
UNIT_WITHIN = 1e-3
"""Quaternions whose length differs from 1 by no more are normalised."""


def has_rotations(encoded: Encoded[Motion]) -> bool:
    """Whether a stream has rotations."""
    return len(encoded.shared) == PARTS


def bytes_by_use(encoded: Encoded[Motion]) -> dict[str, int]:
    """Bytes of a stream that positions take, and that rotations take beside them; empty without rotations. Raises
    Corrupt."""
    if not has_rotations(encoded):
        return {}
    positions, rotations = map(len, encoded.shared)
    for chunk in encoded.chunks:
        rest = len(payload.split(chunk.payload)[1])
        positions += rest
        rotations += len(chunk.payload) - rest
    return {"positions": positions, "rotations": rotations}


def lost_rotations(motion: Motion) -> str | None:
    """Why the rotations of a motion are not kept, in words; None where they are."""
    if motion.skeleton is None:
        return "it has no skeleton"
    return "it has gaps" if motion.gaps.any() else None


def unit_rotations(rotations: Floats, names: Sequence[str]) -> Floats:
    """Rotations (frames, joints, 4) as unit quaternions. Raises BadInput for NaN and other lengths."""
    length = np.sqrt((rotations**2).sum(axis=2))
    if not (np.abs(length - 1) < UNIT_WITHIN).all():
        frame, joint = np.argwhere(~(np.abs(length - 1) < UNIT_WITHIN))[0]
        size = float(length[frame, joint])
        what = "missing" if np.isnan(size) else f"no unit quaternion (its length is {size:.4g})"
        raise BadInput(f"the rotation of {names[joint]} at frame {frame} is {what}")
    return rotations / length[..., None]


def decode(encoded: Encoded[Motion], frames: slice | None, decode_inner: Callable[[Encoded[Motion]], Motion]) -> Motion:
    """The motion with rotations, or a slice of its frames. Raises Corrupt."""
    start, stop = encoded.range(frames)
    like = encoded.about
    layer = unpack(encoded.shared[1], like)
    local = np.empty((stop - start, like.points, 4))
    positions = np.empty((stop - start, like.points, 3))
    covering = encoded.covering(start, stop)
    for first in range(0, len(covering), chunks_.BATCH):
        batch = covering[first : first + chunks_.BATCH]
        offset = batch[0].start
        parts = [payload.split(c.payload) for c in batch]
        inner = replace(
            encoded,
            shared=encoded.shared[:1],
            chunks=[Chunk(c.start - offset, c.frames, rest) for c, (_, rest) in zip(batch, parts, strict=True)],
        )
        decoded = decode_inner(inner).positions
        if np.isnan(decoded).any():
            raise Corrupt("tempo: gaps in a stream with rotations")
        own = [Chunk(c.start, c.frames, part) for c, (part, _) in zip(batch, parts, strict=True)]
        targets = [decoded[c.start - offset : c.stop - offset] for c in batch]
        for one, (q, p) in zip(batch, payload.decode(layer, own, targets), strict=True):
            a, b = max(start, one.start), min(stop, one.stop)
            local[a - start : b - start] = q[a - one.start : b - one.start]
            positions[a - start : b - start] = p[a - one.start : b - one.start]
    return restore(encoded, positions, start, local)


def unpack(data: bytes, like: Motion) -> Layer:
    """The layer of a stream's second shared bytes, for a motion with this skeleton. Raises Corrupt, UnknownCodec."""
    return _unpack(data, like.rate, _SkeletonKey.of(like.skeleton))


class _SkeletonKey:
    """Compares skeletons by value: each opening of a file reads a skeleton of its own."""

    def __init__(self, key: tuple[Any, ...], skeleton: Skeleton | None) -> None:
        self.key, self.skeleton = key, skeleton

    @classmethod
    def of(cls, tree: Skeleton | None) -> _SkeletonKey:
        if tree is None:
            return cls((), None)
        limits = () if tree.limits is None else (tree.limits.orders, tree.limits.axes.tobytes())
        return cls((tree.parents, tree.offsets.tobytes(), *limits), tree)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _SkeletonKey) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


@lru_cache(maxsize=8)
def _unpack(data: bytes, rate: float, skeleton: _SkeletonKey) -> Layer:
    rules, reach_m, statistics = record.unpack(data, skeleton.skeleton)
    stored, known = record.unpack_statistics(statistics, rules.side_values)
    factor = side.coordinates(rules, reach_m)
    return Layer(rules, reach_m, side.SideModel.of(stored, known, rules, factor, rate))
