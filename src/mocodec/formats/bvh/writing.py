"""Motion to BVH.

own frames ─► joints at the starts of bones ─► depth-first order ─► channels of each joint ─► angles over time ─► text
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BadInput
from ...geometry import bone_frames, euler_curves, kinematics, part, rigid
from ...motion import Motion, Skeleton
from ...typing import Floats
from .. import replace_whole
from ..c3d.labels import original_labels
from ..conventions import unit_of, unit_option
from . import memory
from .hierarchy import lines
from .reading import UNITS_M, rate_of

USUAL_ORDER = "zxy"
"""Rotation channels of joints that had none."""
MAX_OFF_DEGREES = 5.0
"""How far rotations may be from those that a joint's channels can make: coding errors, not more."""
MAX_OFF_M = 0.01
"""How far a position channel may be from the value that it always had in the file."""
STILL_M = 2e-6
"""A joint that moves farther against its parent needs position channels: more than 32-bit floats make."""


def write(path: str | Path, motion: Motion, unit: str | float | None = None) -> None:
    """Write a BVH in the source's unit, channels and digits (cm, z x y, seven decimals for other sources).

    unit: a name or metres, in place of the source's. Angles are continuous over the frames and begin near those of the
    source; channels that the source never changed stay as they were. Motions of ASF/AMC get a joint at the start of
    each bone. Raises BadInput for a motion without skeleton or rotations, for gaps, and for rotations that the joints'
    channels cannot make.
    """
    motion = _depth_first(bone_frames.to_starts(_required(path, motion)))
    skeleton, source = _skeleton(motion), motion.source if motion.source.get("format") == "bvh" else {}
    unit_m = unit_of(source) if source else 0.01
    if unit is not None:
        chosen_m = unit_option(unit, UNITS_M)[1]
        source = source if chosen_m == unit_m else {**source, "offset_digits": None, "constant": None}
        unit_m = chosen_m
    translations = _translations(motion)
    channels = _channels(motion, source, translations)
    table = _table(path, motion, source, channels, translations, unit_m)
    offsets = memory.offset_texts(source.get("offset_digits"), skeleton.offsets, unit_m)
    text = lines(original_labels(skeleton.names, source), skeleton.parents, offsets, channels)
    text += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {_frame_time(source, motion.rate)}"]
    form = " ".join(["%.7f"] * table.shape[1])
    text += [form % tuple(row) for row in (np.round(table, 7) + 0.0).tolist()]
    replace_whole(path, ("\n".join(text) + "\n").encode("utf-8"))


def _required(path: str | Path, motion: Motion) -> Motion:
    """The motion. Raises BadInput if it lacks what a BVH consists of."""
    if motion.skeleton is None or motion.rotations is None:
        has = "positions on a skeleton" if motion.skeleton is not None else "positions of points"
        raise BadInput(
            f"{path}: a BVH needs a skeleton and rotations, and this motion has only {has}; "
            "write a .c3d, .trc, .npz or .glb"
        )
    if motion.gaps.any():
        raise BadInput(f"{path}: a BVH cannot hold gaps")
    return motion


def _skeleton(motion: Motion) -> Skeleton:
    assert motion.skeleton is not None
    return motion.skeleton


def _depth_first(motion: Motion) -> Motion:
    """The motion with its joints in depth-first order, children in the order that they have."""
    skeleton = _skeleton(motion)
    children: dict[int, list[int]] = {}
    for joint, parent in enumerate(skeleton.parents):
        children.setdefault(parent, []).append(joint)
    order: list[int] = []
    waiting = children.get(-1, [])[::-1]
    while waiting:
        order.append(waiting.pop())
        waiting += children.get(order[-1], [])[::-1]
    if order == list(range(len(skeleton))):
        return motion
    source = {name: value for name, value in motion.source.items() if name not in ("constant", "offset_digits")}
    kept = part.part(skeleton, motion.rotations, order)
    assert kept is not None  # all joints, parents first
    names = tuple(motion.names[joint] for joint in order)
    return replace(
        motion, positions=motion.positions[:, order], names=names, skeleton=kept[0], rotations=kept[1], source=source
    )


def _translations(motion: Motion) -> Floats:
    """Positions of joints in their parents' frames (frames, joints, 3); of roots, in the world."""
    assert motion.rotations is not None
    skeleton = _skeleton(motion)
    world = kinematics.world_rotations(skeleton, motion.rotations)
    result = motion.positions.copy()
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            apart = motion.positions[:, joint] - motion.positions[:, parent]
            result[:, joint] = rigid.rotate(rigid.inverse(world[:, parent]), apart)
    return result


def _channels(motion: Motion, source: Mapping[str, Any], translations: Floats) -> list[str | None]:
    """The channels of each joint, None for End Sites: the source's, else new ones.

    New ones are all rotations, and positions where a joint moves against its parent. End Sites are leaves named
    "<parent>_end" that neither rotate nor move.
    """
    assert motion.rotations is not None
    skeleton = _skeleton(motion)
    order = USUAL_ORDER
    if "channels" in source:
        known = memory.channels_of(source["channels"], skeleton.names, skeleton.parents)
        if known is not None:
            return known
        entries = memory.expanded(source["channels"], memory.CHANNEL_RUN, "channels")
        orders = Counter("".join(c for c in entry if c.islower()) for entry in entries if entry != "end")
        order = next((usual for usual, _ in orders.most_common() if len(usual) == 3), USUAL_ORDER)
    moves = np.abs(translations - skeleton.offsets).max(axis=(0, 2), initial=0.0) > STILL_M
    rotates = np.abs(motion.rotations[..., 1:]).max(axis=(0, 2), initial=0.0) > bone_frames.STILL
    has_child = set(skeleton.parents)
    channels: list[str | None] = []
    for joint, parent in enumerate(skeleton.parents):
        name = skeleton.names[joint]
        is_named_end = parent >= 0 and name.rstrip("0123456789") == f"{skeleton.names[parent]}_end"
        is_end = is_named_end and joint not in has_child and not moves[joint] and not rotates[joint]
        channels.append(None if is_end else ("XYZ" if parent < 0 or moves[joint] else "") + order)
    return channels


def _table(
    path: str | Path,
    motion: Motion,
    source: Mapping[str, Any],
    channels: list[str | None],
    translations: Floats,
    unit_m: float,
) -> Floats:
    """The channels of all frames (frames, channels), in degrees and the file's unit."""
    assert motion.rotations is not None
    columns: list[Floats] = [np.empty((len(motion), 0))]
    constants = memory.constant_of(source.get("constant"), channels)
    for joint, letters in enumerate(channels):
        if not letters:
            continue
        name, order = motion.names[joint], "".join(letter for letter in letters if letter.islower())
        q = motion.rotations[:, joint]
        angles, off = _angles(order, q, memory.first_angles_of(source, name, order), constants[joint])
        if off > np.radians(MAX_OFF_DEGREES):
            raise BadInput(
                f"{path}: joint {name} has the rotation channels {order.upper() or 'none'}, which cannot make its "
                f"rotations: they would be {np.degrees(off):.3g}° off on average"
            )
        values = np.empty((len(motion), len(letters)))
        for i, letter in enumerate(letters):
            if letter.islower():
                values[:, i] = np.degrees(angles[:, order.index(letter)])
            else:
                values[:, i] = translations[:, joint, "XYZ".index(letter)] / unit_m
                still = constants[joint].get(letter)
                if still is not None and np.abs(values[:, i] - still).max(initial=0.0) * unit_m <= MAX_OFF_M:
                    values[:, i] = still
        columns.append(values)
    return np.concatenate(columns, axis=1)


def _angles(order: str, q: Floats, near: Floats | None, constants: Mapping[str, float]) -> tuple[Floats, float]:
    """Angles over time (frames, len(order)), radians, and how far they are from q (frames, 4) on average.

    Constant channels stay as they are if the other channels then make the rotations within `MAX_OFF_DEGREES`.
    """
    if not len(q):
        return np.empty((0, len(order))), 0.0
    fixed = {order.index(letter): float(np.radians(value)) for letter, value in constants.items() if letter in order}
    if fixed:
        angles = euler_curves.along_time(order, q, near, fixed)
        if euler_curves.distance(order, angles, q).max() <= np.radians(MAX_OFF_DEGREES):
            return angles, 0.0
    angles = euler_curves.along_time(order, q, near)
    return angles, float(euler_curves.distance(order, angles, q).mean())


def _frame_time(source: Mapping[str, Any], rate: float) -> str:
    """The source's own digits if they still mean the motion's rate."""
    text = source.get("frame_time")
    try:
        if isinstance(text, str) and rate_of(text, "source") == rate:
            return text
    except BadInput:
        pass
    return memory.frame_time_text(rate)
