# pyright: strict
"""Features of motion as networks take them: float32 arrays whose first axis is time.

positions     (frames, points, 3)   metres
velocities    (frames, points, 3)   metres a second: half the way from the frame before to the frame after
rotations6d   (frames, joints, 6)   first two columns of the rotation against the parent, one after the other
root          (frames, 5)           position of the root (m); sine and cosine of the heading about the vertical
contacts      (frames, 4)           1 while a foot is slow: left heel, left toes, right heel, right toes
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..geometry import rigid
from ..geometry.body_frame import normalised_label, side_and_part
from ..motion import UP_AXES, Motion
from ..typing import Floats

Float32 = NDArray[np.float32]

CONTACT_M_S = 0.25
"""A foot that is slower than this stands on something."""
ACROSS = re.compile(r"HIPJOINT|HIP|UPLEG|UPPERLEG|THIGH|FEMUR|ASI|PSI|ASIS|PSIS|SHO|SHOULDER|CLAVICLE|COLLAR")
"""Parts of the body whose left and right points show where it faces."""
ROOTS = ("ROOT", "PELVIS", "HIPS", "HIP", "SACR", "SACRUM")
HEELS = ("HEEL", "HEE", "ANKLE", "ANK", "FOOT")
TOES = ("TOES", "TOE", "TOEBASE", "BALL", "MT2", "MT5", "FOOTMOD", "TOEEND")


def positions(motion: Motion) -> Floats:
    """(frames, points, 3), metres."""
    return motion.positions


def velocities(motion: Motion) -> Floats:
    """(frames, points, 3), metres a second; at the ends of a recording from one side."""
    if len(motion) < 2:
        return np.zeros_like(motion.positions)
    return np.gradient(motion.positions, 1 / motion.rate, axis=0)


def rotations6d(motion: Motion) -> Floats:
    """(frames, joints, 6): the columns x and y of each rotation matrix. Raises BadInput without rotations."""
    if motion.rotations is None:
        raise BadInput("rotations6d needs recordings with rotations; choose them by a query: rotations == 1")
    matrices = rigid.to_matrix(motion.rotations)
    return np.concatenate([matrices[..., 0], matrices[..., 1]], axis=-1)


def root(motion: Motion) -> Floats:
    """(frames, 5): position of the root, and sine and cosine of the heading.

    The heading is the angle about the vertical from the first horizontal axis (z for y up, x for z up) to where hips
    and shoulders face. Raises BadInput without left and right hips or shoulders.
    """
    across = _left_minus_right(motion)
    up = UP_AXES.index(motion.up)
    vertical = np.eye(3)[up]
    facing = np.cross(across, vertical)
    angle = np.arctan2(facing[:, (up + 2) % 3], facing[:, (up + 1) % 3])
    place = motion.positions[:, root_column(motion)]
    return np.concatenate([place, np.sin(angle)[:, None], np.cos(angle)[:, None]], axis=1)


def contacts(motion: Motion) -> Floats:
    """(frames, 4) zeros and ones: a foot is in contact while it is slower than CONTACT_M_S.

    Raises BadInput without heels (or ankles) and toes on both sides.
    """
    columns = [_foot(motion.names, side, parts) for side in "LR" for parts in (HEELS, TOES)]
    speed = np.linalg.norm(velocities(motion)[:, columns], axis=2)
    return (speed < CONTACT_M_S).astype(np.float64)


FEATURES: dict[str, Callable[[Motion], Floats]] = {
    "positions": positions,
    "velocities": velocities,
    "rotations6d": rotations6d,
    "root": root,
    "contacts": contacts,
}


def known(names: str | Sequence[str]) -> tuple[str, ...]:
    """The names of features, as a tuple. Raises BadInput if one is not in FEATURES."""
    wanted = (names,) if isinstance(names, str) else tuple(names)
    if unknown := [name for name in wanted if name not in FEATURES]:
        raise BadInput(f"no feature named {', '.join(unknown)}; there are: {', '.join(FEATURES)}")
    return wanted


def root_column(motion: Motion) -> int:
    """The point that is the root: of the skeleton, or by its name, or the first."""
    if motion.skeleton is not None:
        return motion.skeleton.parents.index(-1)
    labels = [normalised_label(name) for name in motion.names]
    return next((labels.index(name) for name in ROOTS if name in labels), 0)


def _left_minus_right(motion: Motion) -> Floats:
    """(frames, 3): sum of the vectors from right to left hips and shoulders."""
    sides = {side_and_part(name): column for column, name in enumerate(motion.names)}
    pairs = [
        (column, sides["R", part])
        for (side, part), column in sides.items()
        if side == "L" and ACROSS.fullmatch(part) and ("R", part) in sides
    ]
    if not pairs:
        raise BadInput("the heading of root needs points named as left and right hips or shoulders")
    left, right = ([pair[i] for pair in pairs] for i in (0, 1))
    return (motion.positions[:, left] - motion.positions[:, right]).sum(axis=1)


def _foot(names: Sequence[str], side: str, parts: Sequence[str]) -> int:
    """The column of the first of these parts on a side. Raises BadInput."""
    found = {side_and_part(name): column for column, name in reversed(list(enumerate(names)))}
    column = next((found[side, part] for part in parts if (side, part) in found), None)
    if column is None:
        where = "left" if side == "L" else "right"
        raise BadInput(f"contacts needs a point on the {where} foot named as one of: {', '.join(parts).lower()}")
    return column
