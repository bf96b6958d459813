"""Markers and joints of any names, as points fixed to the bones that the prior knows.

    the bone of each point, and its offset from the bone's joint ──► weights of joint and three rotating points   W
    components of the bones · Wᵀ ─► bases of the points           Σ over components ─► spreads

A point fixed to a bone is linear in the position of the bone's joint and in the bone's rotation, so what the prior
knows of these it knows of any marker. `marker_fitting` finds the bones and offsets. Skin, noise and other people's
ways of moving get levels (`predicted_motion`). Spreads depend on all of this, so the arithmetic is `ordered`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....errors import Corrupt
from ....fields import Record, array, flag, signed, sized, unsigned
from ....stages import basis
from ....typing import Floats, Integers
from ..coding.rows import POSE
from . import ordered, predicted_motion
from .coordinates import PointCoordinates
from .model import Model
from .predicted_motion import LARGEST_LEVEL, LEVEL_NAMES, MEAN_BELOW, PredictedMotion
from .prior import BoneMotion, Prior
from .stored_basis import MOST_DIMENSIONS

SCALE_UNIT, OFFSET_UNIT_M = 1 / 64, 1 / 32
"""Steps of the body's size relative to the prior's, and of a point's offset from its joint."""
ARM_M = 0.15
"""Distance of the three rotating points from the joint: rotation then counts as it does at a usual marker."""
NO_BONE = -1


PLACEMENT = Record(
    "tempo: the placement of markers",
    signed("digits", most=60, meaning="the mean pose is in steps of 2^(−digits) m"),
    flag("on_body", meaning="the mean pose is a difference from the prior's body, else from the point before"),
    unsigned("scale", least=1, most=4096, meaning="size of the body relative to the prior's, in 1/64"),
    *(signed(name, most=LARGEST_LEVEL, meaning="eighths of an octave") for name in LEVEL_NAMES),
    *sized(
        array("pose", ("points", 3), most=1 << 40, meaning="mean pose"),
        array("bone", ("points",), least=0, most="bones", meaning="the bone of each point, plus one"),
        array("offsets", ("points", 3), most=1 << 16, meaning="from the bone's joint, in 1/32 m"),
    ),
)


@dataclass(frozen=True, eq=False)
class MarkerPlacement:
    """The stored form.

    digits: the mean pose is in steps of 2^(−digits) m. pose (points, 3): the mean pose, less that of the prior's body
    if `on_body`. scale: of the body, in `SCALE_UNIT`. bone (points,): of each point, or NO_BONE. offsets (points, 3):
    from the bone's joint, along the axes of the bone at rest, in `OFFSET_UNIT_M`. levels (5,).
    """

    digits: int
    pose: Integers
    on_body: bool
    scale: int
    bone: Integers
    offsets: Integers
    levels: Integers

    def pack(self) -> bytes:
        pose = self.pose if self.on_body else np.diff(self.pose, axis=0, prepend=0)
        levels = dict(zip(LEVEL_NAMES, self.levels, strict=True))
        return PLACEMENT.pack(vars(self) | levels | {"pose": pose, "bone": self.bone - NO_BONE})

    @classmethod
    def unpack(cls, data: bytes, points: int, bones: BoneMotion) -> MarkerPlacement:
        """Raises Corrupt."""
        values = PLACEMENT.unpack(data, points=points, bones=len(bones.names))
        levels = np.array([values.pop(name) for name in LEVEL_NAMES], np.int64)
        pose = values["pose"] if values["on_body"] else np.cumsum(values["pose"], axis=0)
        return cls(**values | {"pose": pose, "bone": values["bone"] + NO_BONE, "levels": levels})

    @property
    def weights(self) -> Floats:
        """(points, 4): each point is this weighted sum of its bone's joint and three rotating points."""
        return weights(self.bone, np.asarray(self.offsets * OFFSET_UNIT_M, np.float64), self.scale * SCALE_UNIT)

    def mean_pose(self, bones: BoneMotion) -> Floats:
        """(points, 3), metres."""
        stored = np.ldexp(self.pose.astype(np.float64), -self.digits)
        return stored + body_pose(self, bones) if self.on_body else stored


def weights(bone: Integers, offsets: Floats, scale: float) -> Floats:
    """(points, 4): each point is this weighted sum of its bone's joint and three points that rotate with the bone.

    Zero for points without a bone.
    """
    arms = offsets / ARM_M
    joint = scale - ((arms[:, :1] + arms[:, 1:2]) + arms[:, 2:])
    return np.where((bone >= 0)[:, None], np.concatenate([joint, arms], axis=1), 0.0)


def body_pose(placement: MarkerPlacement, bones: BoneMotion) -> Floats:
    """Where the points are on the prior's body in its mean pose, about their mean: (points, 3)."""
    return moved_points(bones.pose.reshape(1, -1), placement.weights, placement.bone).reshape(-1, 3)


def moved_points(modes: Floats, weights_: Floats, bone: Integers) -> Floats:
    """Components (modes, 4 bones · 3) as movements of the points about their mean: (modes, 3 points)."""
    of_bone = modes.reshape(len(modes), -1, 4, 3)[:, bone]
    moved = of_bone[:, :, 0] * weights_[:, 0, None]
    for i in range(1, 4):
        moved = moved + of_bone[:, :, i] * weights_[:, i, None]
    mean = ordered.sum_first_axis(moved.swapaxes(0, 1)) / len(weights_)
    return (moved - mean[:, None]).reshape(len(modes), -1)


def predict(placement: MarkerPlacement, bones: BoneMotion) -> PredictedMotion:
    """Bases (3 points − 3, 3 points) and variances of the points. No point set moves its own mean."""
    weights_ = placement.weights
    rows = 3 * len(weights_) - 3
    strength = ordered.square_of_exp2(bones.statistics.spreads[POSE:])
    translations = np.tile(np.eye(3), len(weights_)) / np.sqrt(len(weights_))
    bases, variances = [], []
    for band, modes in enumerate(bones.statistics.bases):
        moved = moved_points(modes, weights_, placement.bone)
        loudest = np.sqrt(strength[:, predicted_motion.frequencies_of(band)].max(axis=1))
        found = ordered.principal_directions(moved * loudest[:, None], rows)
        variance = np.zeros((rows, len(bones.median_spread)))
        variance[: len(found)] = ordered.matmul(ordered.matmul(found, moved.T.copy()) ** 2, strength)
        bases.append(basis.completed(found.T, rows, translations.T).T.copy())
        variances.append(variance)
    return PredictedMotion(tuple(bases), tuple(variances))


@dataclass(frozen=True, eq=False)
class MarkersOnBones:
    """A placement and what the prior predicts of it."""

    prior: Prior
    placement: MarkerPlacement
    predicted: PredictedMotion

    @classmethod
    def unpack(cls, data: bytes, points: int, prior: Prior) -> MarkersOnBones:
        """Raises Corrupt."""
        if prior.bones is None:
            raise Corrupt("tempo: markers on bones, of a prior that knows no bones")
        if 3 * points > MOST_DIMENSIONS:
            raise Corrupt(f"tempo: {points} markers on bones, more than {MOST_DIMENSIONS // 3}")
        placement = MarkerPlacement.unpack(data, points, prior.bones)
        return cls(prior, placement, predict(placement, prior.bones))

    def model(self, names: tuple[str, ...], rate: float) -> Model:
        bones = self.prior.bones
        assert bones is not None
        spreads = predicted_motion.spreads(self.predicted, bones.median_spread, self.placement.levels)
        statistics = predicted_motion.with_heading_and_place(
            bones.statistics,
            len(bones.pose),
            len(names),
            self.predicted.bases,
            spreads,
            spreads[:, 2] - MEAN_BELOW,
        )
        return Model(names, PointCoordinates(self.placement.mean_pose(bones)), statistics, self.prior.tables, rate)
