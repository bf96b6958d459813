"""Models of positions.

with the prior      joints that it knows by name, or any points as markers on its bones
with a stored basis mean pose and basis of the recording
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ....errors import Corrupt
from ....fields import Record, array, raw, signed, sized
from ....motion import Motion
from ....typing import Floats, Integers
from ..coding.rows import step_size
from . import marker_fitting, prior, stored_basis
from .coordinates import PointCoordinates
from .markers_on_bones import MarkersOnBones
from .model import Model
from .prior import Prior
from .recording import FittedModel, Recording
from .stored_basis import StoredBasis

BY_NAME, ON_BONES = 0, 1
"""First byte of a model with the prior. Never change them."""
POSE_COARSER = 64
"""The mean pose is rounded to steps of Δ/√frames, made coarser by this (1/32 octave)."""
FINER_STEPS = (0, 32)
"""A stored basis is rounded for the step, or for one finer by this (1/32 octave)."""
MANY_POINTS = 400
"""With more points the finer basis is fitted first. None are placed on the prior's bones: no marker set has more."""

NEAREST_BLOCK = 64
"""Points worked on at a time."""

POINTS = Record(
    "tempo: stored points",
    signed("noise", most=3000, meaning="log₂ of Δ/√frames, m, in 1/32 octave"),
    *sized(array("pose", ("points", 3), most=1 << 40, meaning="mean pose, differences, in 4 Δ/√frames")),
    raw("basis"),
)


@dataclass(frozen=True, eq=False)
class NamedPoints:
    """Joints that the prior knows by name."""

    prior: Prior

    @property
    def prior_id(self) -> bytes:
        return self.prior.id

    def pack(self) -> bytes:
        return bytes([BY_NAME])

    def model(self, like: Motion) -> Model:
        """Raises Corrupt."""
        known = self.prior.joints
        columns = known.columns(like.names)
        if columns is None or self.prior.for_directions:
            raise Corrupt("tempo: the names of the points are not those of the prior")
        order = np.argsort(columns)
        entries = (order[:, None] * 3 + np.arange(3)).ravel()
        statistics = replace(known.statistics, bases=tuple(b[:, entries] for b in known.statistics.bases))
        coordinates = PointCoordinates(known.coordinates.pose[order])
        return Model(like.names, coordinates, statistics, self.prior.tables, like.rate)


@dataclass(frozen=True, eq=False)
class PlacedMarkers:
    """Markers on the prior's bones."""

    markers: MarkersOnBones

    @property
    def prior_id(self) -> bytes:
        return self.markers.prior.id

    def pack(self) -> bytes:
        return bytes([ON_BONES]) + self.markers.placement.pack()

    def model(self, like: Motion) -> Model:
        return self.markers.model(like.names, like.rate)


def fit_with_prior(recording: Recording) -> Iterator[FittedModel]:
    known, like = prior.for_points(), recording.like
    if known.joints.columns(like.names) is not None:
        yield NamedPoints(known)
    elif markers := marker_fitting.fit(recording.chunks, known, like.names, like.rate, recording.step):
        yield PlacedMarkers(markers)


def unpack_with_prior(data: bytes, known: Prior, like: Motion) -> FittedModel:
    """Raises Corrupt."""
    if data == bytes([BY_NAME]):
        return NamedPoints(known)
    if data[:1] != bytes([ON_BONES]):
        raise Corrupt("tempo: a model of points of an unknown kind")
    return PlacedMarkers(MarkersOnBones.unpack(data[1:], like.points, known))


@dataclass(frozen=True, eq=False)
class StoredPoints:
    """noise: see `stored_basis.noise_step`. pose (points, 3): in steps of 2^((noise + POSE_COARSER) / 32) m.

    similar (3 points,): what `_nearest_before` finds, if it is known."""

    prior: Prior
    noise: int
    pose: Integers
    basis: StoredBasis
    similar: Integers | None = None

    @property
    def prior_id(self) -> bytes:
        return self.prior.id

    def pack(self) -> bytes:
        pose = np.diff(self.pose, axis=0, prepend=0)
        return POINTS.pack({"noise": self.noise, "pose": pose, "basis": self.basis.pack()})

    def model(self, like: Motion) -> Model:
        """Raises Corrupt."""
        coordinates = PointCoordinates(_metres(self.pose, self.noise))
        similar = _nearest_before(self.pose) if self.similar is None else self.similar
        statistics = self.basis.statistics(self.prior, coordinates.dimensions, similar)
        return Model(like.names, coordinates, statistics, self.prior.tables, like.rate)


def fit_stored(recording: Recording) -> Iterator[FittedModel]:
    if recording.frames >= 2 and 3 * recording.like.points <= stored_basis.MOST_DIMENSIONS:
        steps = FINER_STEPS if recording.like.points <= MANY_POINTS else FINER_STEPS[::-1]
        for finer in steps:
            yield stored_points(recording, recording.step - finer)


def stored_points(recording: Recording, step: int) -> StoredPoints:
    """Mean pose and basis of the recording, rounded for this step (log₂, 1/32 octave)."""
    known, noise = prior.for_points(), stored_basis.noise_step(step, recording.frames)
    pose = np.rint(recording.mean_pose / step_size(noise + POSE_COARSER)).astype(np.int64)
    similar = _nearest_before(pose)
    fitted = stored_basis.fit(recording.components, known, recording.like.rate, step, similar)
    return StoredPoints(known, noise, pose, fitted, similar)


def unpack_stored(data: bytes, known: Prior, like: Motion) -> FittedModel:
    """Raises Corrupt."""
    values = POINTS.unpack(data, points=like.points)
    pose = np.cumsum(values["pose"], axis=0)
    if (np.abs(pose) > 1 << 40).any():
        raise Corrupt("tempo: a mean pose that is out of range")
    return StoredPoints(known, values["noise"], pose, StoredBasis.unpack(values["basis"], 3 * like.points))


def _metres(pose: Integers, noise: int) -> Floats:
    return pose * step_size(noise + POSE_COARSER)


def _nearest_before(pose: Integers) -> Integers:
    """For each coordinate that of the nearest point before it in the list, (3 points,); −1 for the first point's."""
    out = np.full((len(pose), 3), -1, np.int64)
    near, of_pose = np.zeros(len(pose), np.int64), pose.astype(np.float64)
    for first in range(0, len(pose), NEAREST_BLOCK):
        some = slice(first, first + NEAREST_BLOCK)
        apart = of_pose[None, : some.stop] - of_pose[some, None]
        squares = (apart[..., 0] ** 2 + apart[..., 1] ** 2) + apart[..., 2] ** 2
        rows, columns = squares.shape
        near[some] = np.where(np.tri(rows, columns, first - 1, dtype=bool), squares, np.inf).argmin(axis=1)
    out[1:] = 3 * near[1:, None] + np.arange(3)
    return out.ravel()
