"""Coordinates of a pose: where its points are, or where its bones point.

    pose (frames, points, 3), mean in the origin ─forward─► (frames, dimensions) ─inverse─► pose

`scale` makes an error of one in a coordinate about an error of one metre in the points, so that all can share one
quantisation step; it is linear, so it may come before or after a DCT.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....typing import Floats, Integers
from ..pose import bone_directions
from ..pose.bone_tree import BoneTree


@dataclass(frozen=True, eq=False)
class PointCoordinates:
    """Positions of points less their mean pose, (points, 3), metres, y up. Headings are relative to that pose."""

    pose: Floats

    @property
    def dimensions(self) -> int:
        return self.pose.size

    def forward(self, poses: Floats) -> Floats:
        return (poses - self.pose).reshape(len(poses), -1)

    def inverse(self, coordinates: Floats) -> Floats:
        return coordinates.reshape(-1, *self.pose.shape) + self.pose

    def scale(self, coordinates: Floats) -> Floats:
        return coordinates

    def analysing(self, basis: Floats) -> Floats:
        """The matrix (dimensions, components) that does `scale` and then takes components of a basis."""
        return basis.T

    def unscaled(self, bases: tuple[Floats, ...]) -> tuple[Floats, ...]:
        """Bases that undo `scale` too."""
        return bases


@dataclass(frozen=True, eq=False)
class DirectionCoordinates:
    """Directions of the bones of a tree.

    pose (points, 3): what headings are relative to. columns (points,): the points in the order of the tree.
    metric_root (dimensions, dimensions): Cholesky factor of the mean of JᵀJ (`bone_directions.metric`).
    """

    pose: Floats
    tree: BoneTree
    metric_root: Floats
    columns: Integers

    @classmethod
    def at_rest(cls, tree: BoneTree, metric_root: Floats, columns: Integers) -> DirectionCoordinates:
        """Headings are relative to the pose at rest."""
        rest = bone_directions.inverse(tree, np.zeros((1, tree.dimensions)))[0]
        return cls(rest[np.argsort(columns)], tree, metric_root, columns)

    @property
    def dimensions(self) -> int:
        return self.tree.dimensions

    @cached_property
    def _inverse_root(self) -> Floats:
        return np.asarray(np.linalg.inv(self.metric_root), np.float64)

    def forward(self, poses: Floats) -> Floats:
        return bone_directions.forward(self.tree, _reordered(poses, self.columns))

    def inverse(self, coordinates: Floats) -> Floats:
        return _reordered(bone_directions.inverse(self.tree, coordinates), np.argsort(self.columns))

    def scale(self, coordinates: Floats) -> Floats:
        return coordinates @ self.metric_root

    def analysing(self, basis: Floats) -> Floats:
        """The matrix (dimensions, components) that does `scale` and then takes components of a basis."""
        return self.metric_root @ basis.T

    def unscaled(self, bases: tuple[Floats, ...]) -> tuple[Floats, ...]:
        """Bases that undo `scale` too."""
        unscaled = {id(b): b @ self._inverse_root for b in bases}  # bands may share a basis
        return tuple(unscaled[id(b)] for b in bases)


Coordinates = PointCoordinates | DirectionCoordinates


def _reordered(poses: Floats, columns: Integers) -> Floats:
    """poses[:, columns], with the frames of a point next to each other in memory."""
    return np.take(poses.T, columns, axis=1).T
