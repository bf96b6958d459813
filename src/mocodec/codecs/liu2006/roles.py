"""Which point plays which part: normalisation markers, feet, others. Liu & McMillan 2006, sections 3.1 and 3.3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...entropy import varint
from ...errors import CannotEncode, Corrupt
from ...geometry import body_frame
from ...motion import Motion

FEET = (
    "HEE", "HEEL", "CAL", "CALC", "CALCANEUS", "MT1", "MT2", "MT5", "MET1", "MET5", "META1", "META5", "MTP1", "MTP5",
    "1MT", "5MT", "1MTP", "5MTP", "5META", "TOE", "TOES", "TOEBASE", "TOEEND", "TOETIP", "HALLUX", "FOOT", "FOOTINDEX",
    "BIGTOE", "SMALLTOE",
)  # fmt: skip
"""Parts of plain labels that are of a foot: the paper's six are heel, fifth metatarsal and toe of each."""


@dataclass(frozen=True, eq=False)
class Roles:
    """Columns of the points: every point stands in exactly one place.

    normalisation: C7, left and right shoulder, or whatever stands in for them; below three points, all there are.
    feet, others: what goes through PCA, each group with its own tolerance; either may be empty.
    """

    normalisation: NDArray[np.int64]
    feet: NDArray[np.int64]
    others: NDArray[np.int64]

    @property
    def groups(self) -> list[NDArray[np.int64]]:
        """The groups that have points."""
        return [group for group in (self.feet, self.others) if len(group)]

    @property
    def points(self) -> int:
        return len(self.normalisation) + len(self.feet) + len(self.others)


def of(motion: Motion, normalisation: Sequence[str], feet: Sequence[str]) -> Roles:
    """Roles by the names given, or found by the usual labels. Raises CannotEncode for a name that is not there."""
    for what, wanted in (("normalisation marker", normalisation), ("foot marker", feet)):
        for name in wanted:
            if find(motion.names, name) is None:
                raise CannotEncode(f"no {what} {name!r} in this motion; its points are: {', '.join(motion.names)}")
    if normalisation and len(set(normalisation)) != 3:
        raise CannotEncode(f"three normalisation markers are needed (origin, left, right), not {len(normalisation)}")
    chosen = [c for c in (find(motion.names, n) for n in normalisation) if c is not None]
    frame = (
        chosen or body_frame.normalisation_markers(motion.names, motion.positions, motion.up) or range(motion.points)
    )
    rest = [i for i in range(motion.points) if i not in frame]
    if feet:
        wanted = {find(motion.names, name) for name in feet}
        on_foot = [i for i in rest if i in wanted]
    else:
        parts = {i: body_frame.side_and_part(motion.names[i]) for i in rest}
        on_foot = [i for i in rest if parts[i][0] and parts[i][1] in FEET]
    others = [i for i in rest if i not in on_foot]
    return Roles(*(np.array(columns, np.int64) for columns in (list(frame), on_foot, others)))


def find(names: Sequence[str], wanted: str) -> int | None:
    """The column of a name as it stands, or else as a plain label, without prefix, case and separators."""
    for same in (
        lambda name: name == wanted,
        lambda name: body_frame.normalised_label(name) == body_frame.normalised_label(wanted),
    ):
        for column, name in enumerate(names):
            if same(name):
                return column
    return None


def pack(roles: Roles) -> list[int]:
    """Small whole numbers: how many columns of normalisation, these, how many of feet, these."""
    return [len(roles.normalisation), *roles.normalisation, len(roles.feet), *roles.feet]


def unpack(data: bytes, points: int) -> tuple[Roles, int]:
    """The roles of `pack`'s numbers as varints, and where they end. Raises Corrupt where a point has two roles."""
    (count,), at = varint.read(data, 1)
    normalisation, at = varint.read(data, min(count, points + 1), at)
    (count,), at = varint.read(data, 1, at)
    feet, at = varint.read(data, min(count, points + 1), at)
    taken = {*normalisation, *feet}
    if len(taken) != len(normalisation) + len(feet) or max(taken, default=-1) >= points:
        raise Corrupt("liu2006: a point with two roles, or one that the motion does not have")
    others = [i for i in range(points) if i not in taken]
    if len(normalisation) != 3 and (feet or others):
        raise Corrupt(f"liu2006: {len(normalisation)} normalisation markers, not 3")
    return Roles(*(np.array(columns, np.int64) for columns in (normalisation, feet, others))), at
