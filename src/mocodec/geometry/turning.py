"""A motion turned so that another axis is vertical."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import BadInput
from ..motion import UP_AXES, Limits, Motion, Skeleton
from ..typing import Floats
from . import rigid


def turned(motion: Motion, up: str) -> Motion:
    """The motion turned by a quarter turn that brings its vertical axis to `up`; the third axis stays.

    The rest pose turns too: each rotation q becomes t q t⁻¹ and each offset t · offset, for the quarter turn t.
    Raises BadInput for an axis that is not x, y or z.
    """
    if up not in UP_AXES:
        raise BadInput(f"up is one of {', '.join(UP_AXES)}, not {up!r:.40}")
    if up == motion.up:
        return motion
    turn = quarter_turn(motion.up, up)
    skeleton, rotations = motion.skeleton, motion.rotations
    if skeleton is not None:
        limits = skeleton.limits
        if limits is not None:
            limits = Limits(limits.orders, rigid.multiply(turn, limits.axes), limits.ranges)
        skeleton = Skeleton(skeleton.names, skeleton.parents, _exact(rigid.rotate(turn, skeleton.offsets)), limits)
    if rotations is not None:
        rotations = rigid.multiply(rigid.multiply(turn, rotations), rigid.inverse(turn))
    return replace(
        motion,
        positions=rigid.rotate(turn, motion.positions),
        up=up,
        skeleton=skeleton,
        rotations=rotations,
        source=_source(motion.source),
    )


def quarter_turn(old: str, new: str) -> Floats:
    """The rotation (4,) by 90° that brings the axis `old` to `new`."""
    third = next(axis for axis in UP_AXES if axis not in (old, new))
    is_even = (UP_AXES.index(new) - UP_AXES.index(old)) % 3 == 1
    return rigid.about_axis(third, np.asarray(np.pi / 2 if is_even else -np.pi / 2))


def _exact(offsets: Floats) -> Floats:
    """Offsets without the rounding of a quarter turn: zeros stay zeros."""
    return np.where(np.abs(offsets) < 1e-15, 0.0, offsets)


def _source(source: Mapping[str, Any]) -> dict[str, Any]:
    """The source without what it says of single axes."""
    no_longer = ("up_guessed", "constant", "first_angles", "offset_digits")
    return {**{name: value for name, value in source.items() if name not in no_longer}, "up_given": True}
