"""An ASF from a skeleton, its limits and what `source` remembers of the file that it came from.

channels   the dof of each bone in file order, as in a BVH: "XYZxyz" for TX TY TZ RX RY RZ, "xz*2" for two bones
           with rx rz; left out where the limits tell (an axis with the limits 0 and 0 is no dof)
axes       the axis frames, "0 0 20 XYZ", where the skeleton has no limits to hold them; "" for 0 0 0 XYZ
angle      "rad" if the ASF is in radians
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..motion import Limits, Motion, Skeleton
from .asf import Acclaim, Bone, acclaim_axes
from .bvh.memory import CHANNEL_RUN, expanded, runs

ROOT_CHANNELS = "XYZxyz"
AXIS_RUN = re.compile(r"(?:(?:[-+.e\d]{1,24} ){3}[XYZ]{3})?(?:\*\d{1,4})?")
DIGITS = 9
"""Decimals of degrees: what conversion to quaternions and back leaves exact."""


def remembered(acclaim: Acclaim) -> dict[str, Any]:
    """The entries of `source` for a skeleton file."""
    skeleton = acclaim.skeleton
    channels = ["".join(dof[1].upper() if dof[0] == "t" else dof[1] for dof in bone.dof) for bone in acclaim.bones]
    entries: dict[str, Any] = {}
    if channels != _usual_channels(skeleton):
        entries["channels"] = runs(channels)
    if skeleton.limits is None:
        axes = [_axis_entry(bone) for bone in acclaim.bones]
        entries |= {"axes": runs(axes)} if any(axes) else {}
    return entries | ({} if acclaim.degrees else {"angle": "rad"})


def acclaim_of(motion: Motion, unit_m: float) -> Acclaim:
    """The inverse of `remembered`: the skeleton file of a motion in own frames; unit_m: metres in its unit of length.

    Raises BadInput for a source with entries that cannot be read.
    """
    skeleton, source = motion.skeleton, motion.source
    assert skeleton is not None
    degrees = source.get("angle") != "rad"
    channels = _usual_channels(skeleton)
    if "channels" in source:
        stored = expanded(source["channels"], CHANNEL_RUN, "channels")
        channels = stored if len(stored) == len(skeleton) and "end" not in stored else channels
    frames = _axes(skeleton, source, degrees)
    bones: list[Bone] = []
    for joint, (letters, (axis, order)) in enumerate(zip(channels, frames, strict=True)):
        x, y, z = (skeleton.offsets[joint] / unit_m).tolist()
        dof = tuple(f"t{letter.lower()}" if letter.isupper() else f"r{letter}" for letter in letters)
        limits = _limits_of(skeleton.limits, joint, dof, degrees) if joint else ()
        bones.append(Bone(skeleton.names[joint], (x, y, z), axis, order, dof, limits))
    return Acclaim(tuple(bones), skeleton.parents, 0.0254 / unit_m, degrees)


def _usual_channels(skeleton: Skeleton) -> list[str]:
    """The channels that a skeleton has unless its source says others."""
    rest = ["xyz"] * (len(skeleton) - 1)
    if (limits := skeleton.limits) is not None:
        free = (limits.ranges != 0).any(axis=2)
        rest = ["".join(a for a in "xyz" if free[j, limits.orders[j].index(a)]) for j in range(1, len(skeleton))]
    return [ROOT_CHANNELS, *rest]


def _axis_entry(bone: Bone) -> str:
    is_usual = bone.axis == (0.0, 0.0, 0.0) and bone.order == "xyz"
    return "" if is_usual else " ".join(f"{angle:.12g}" for angle in bone.axis) + f" {bone.order.upper()}"


def _axes(
    skeleton: Skeleton, source: Mapping[str, Any], degrees: bool
) -> Sequence[tuple[tuple[float, float, float], str]]:
    """The angles of each bone's axis frame, in the file's unit, and its order, the first rotation first."""
    if skeleton.limits is not None:
        return [
            (acclaim_axes(order, frame, degrees, DIGITS), order[::-1])
            for order, frame in zip(skeleton.limits.orders, skeleton.limits.axes, strict=True)
        ]
    usual = [((0.0, 0.0, 0.0), "xyz")] * len(skeleton)
    if "axes" not in source:
        return usual
    entries = [entry.split() for entry in expanded(source["axes"], AXIS_RUN, "axes")]
    if len(entries) != len(skeleton):
        return usual
    return [((float(e[0]), float(e[1]), float(e[2])), e[3].lower()) if e else usual[0] for e in entries]


def _limits_of(limits: Limits | None, joint: int, dof: Sequence[str], degrees: bool) -> tuple[tuple[float, float], ...]:
    """(least, greatest) of each dof in the file's unit; nothing for an unlimited bone."""
    if limits is None or not dof:
        return ()
    ranges = [limits.ranges[joint, limits.orders[joint].index(axis[1])] for axis in dof]
    if not np.isfinite(ranges).any():
        return ()
    factor = math.degrees(1) if degrees else 1.0
    return tuple((round(low * factor, DIGITS), round(high * factor, DIGITS)) for low, high in np.array(ranges).tolist())
