# pyright: strict
"""The joints of a motion: names, hierarchy, rest pose, and how far they can rotate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import BadInput
from .selection import counted
from .typing import Floats


@dataclass(frozen=True, eq=False)
class Limits:
    """How far the joints of a skeleton can rotate.

    A joint's rotation relative to its parent is C · R · C⁻¹. C is the orientation of the joint's axis frame, `axes`
    (joints, 4; unit quaternions, w first). R is a product of rotations about three axes in the order that `orders`
    names, with the convention of `geometry.rigid` ("zyx" is Rz · Ry · Rx). ranges (joints, 3, 2): smallest and largest
    angle about each of these axes, in that order, radians; −∞ and ∞ without a limit, 0 and 0 for an axis about which
    the joint does not rotate.
    """

    orders: tuple[str, ...]
    axes: Floats
    ranges: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "orders", tuple(self.orders))
        object.__setattr__(self, "axes", np.asarray(self.axes, np.float64))
        object.__setattr__(self, "ranges", np.asarray(self.ranges, np.float64))
        n = len(self.orders)
        if self.axes.shape != (n, 4) or self.ranges.shape != (n, 3, 2):
            raise BadInput(f"limits of {n} joints need axes ({n}, 4) and ranges ({n}, 3, 2)")
        if any(sorted(order) != ["x", "y", "z"] for order in self.orders):
            raise BadInput("each order of limits must contain x, y and z once")
        low, high = self.ranges[..., 0], self.ranges[..., 1]
        if not (np.isfinite(self.axes).all() and ((low <= high) & (low < np.inf) & (high > -np.inf)).all()):
            raise BadInput("limits need finite axes, and ranges from the smaller angle to the larger")


@dataclass(frozen=True, eq=False, repr=False)
class Skeleton:
    """A joint hierarchy in its rest pose.

    names: one per joint, in the order of the points of the motion. parents: index of each joint's parent, −1 for a
    root; a parent comes before its children. offsets (joints, 3): from parent to joint in the parent's frame, metres;
    in the rest pose all frames are parallel. If `source["format"]` is "amc", a joint is the end of a bone that rotates
    about its start, and its offset is in its own frame: bones that start in the same joint rotate separately, which one
    frame of that joint could not express (`geometry.kinematics.forward(…, own_frame=True)`). limits: how far the joints
    can rotate, if the source contains it (ASF); `rotations` may exceed them.

    Raises BadInput for arrays of other shapes and for a parent after its child.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Floats
    limits: Limits | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "parents", tuple(int(p) for p in self.parents))
        object.__setattr__(self, "offsets", np.asarray(self.offsets, np.float64))
        n = len(self.names)
        if len(self.parents) != n or self.offsets.shape != (n, 3):
            raise BadInput(f"skeleton of {n} joints needs {n} parents and offsets ({n}, 3), not {self.offsets.shape}")
        for joint, parent in enumerate(self.parents):
            if not -1 <= parent < joint:
                raise BadInput(f"skeleton joint {joint} ({self.names[joint]}): its parent must come before it")
        if self.limits is not None and len(self.limits.orders) != n:
            raise BadInput(f"skeleton of {n} joints with limits of {len(self.limits.orders)}")

    def __len__(self) -> int:
        """The number of joints."""
        return len(self.names)

    def __repr__(self) -> str:
        roots = ", ".join(name for name, parent in zip(self.names, self.parents, strict=True) if parent < 0)
        limits = ", with joint limits" if self.limits is not None else ""
        return f"<Skeleton: {counted(len(self), 'joint')}, root {roots or 'none'}{limits}>"
