"""Joints whose bones do not stretch: coded as where the bones point, on this body's build.

    names ─► the prior's limbs ─built as the file's skeleton, or as measured─► Model

The build is how long each bone is, and how those of a hub stand to each other. The skeleton beside the motion says it,
and it costs nothing then; else it is measured and stored.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry.body_frame import plain as plain_label
from ...motion import Floats, Skeleton
from .limbs import Limbs
from .model import Model, step_size
from .prior import PointSet, Prior

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
    if points is None or points.limbs is None or not runs:
        return None
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
        return Model(replace(points, limbs=points.limbs.built(skeleton.offsets[points.columns])), prior, rate)
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


def _builds(
    poses: Floats, like: Limbs, skeleton: Skeleton | None, columns: NDArray[np.int64] | None, fine: int
) -> Iterator[tuple[bytes, Limbs]]:
    """What is stored of a build, and limbs of that build."""
    if skeleton is not None:
        yield bytes([SKELETON]), like.built(skeleton.offsets[columns])
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
