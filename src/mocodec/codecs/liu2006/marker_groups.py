"""Division of the points into normalisation markers, feet and others. Liu & McMillan 2006, sections 3.1 and 3.3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...entropy import varint
from ...errors import CannotEncode, Corrupt
from ...geometry import body_frame
from ...motion import Motion
from ...typing import Integers

FOOT_LABELS = (
    "HEE", "HEEL", "CAL", "CALC", "CALCANEUS", "MT1", "MT2", "MT5", "MET1", "MET5", "META1", "META5", "MTP1", "MTP5",
    "1MT", "5MT", "1MTP", "5MTP", "5META", "TOE", "TOES", "TOEBASE", "TOEEND", "TOETIP", "HALLUX", "FOOT", "FOOTINDEX",
    "BIGTOE", "SMALLTOE",
)  # fmt: skip
"""Labels of foot markers without their side. The paper's six are heel, fifth metatarsal and toe of each foot."""


@dataclass(frozen=True, eq=False)
class MarkerGroups:
    """Columns of the points; each point belongs to exactly one group.

    normalisation: C7, left and right shoulder, or their substitutes; all points if the motion has fewer than three.
    feet, others: the non-normalisation markers, in two PCA groups with different tolerances; either may be empty.
    """

    normalisation: Integers
    feet: Integers
    others: Integers

    @property
    def pca_groups(self) -> list[Integers]:
        """Feet and others, without empty groups."""
        return [group for group in (self.feet, self.others) if len(group)]

    @property
    def points(self) -> int:
        """Number of points."""
        return len(self.normalisation) + len(self.feet) + len(self.others)


MAX_POINTS = 1 << 14
"""Finding each marker's nearest takes time that grows with the square of their number."""


def assign(motion: Motion, normalisation_names: Sequence[str], foot_names: Sequence[str]) -> MarkerGroups:
    """Groups by the given names; without names, by common labels or, for normalisation, by geometry.

    Raises CannotEncode for a name that the motion does not have.
    """
    if motion.points > MAX_POINTS:
        raise CannotEncode(f"liu2006 codes at most {MAX_POINTS:,} points, not {motion.points:,}")
    normalisation = _normalisation_columns(motion, normalisation_names)
    rest = [i for i in range(motion.points) if i not in normalisation]
    if foot_names:
        named = {_column(motion, name, "foot marker") for name in foot_names}
        feet = [i for i in rest if i in named]
    else:
        labels = {i: body_frame.side_and_part(motion.names[i]) for i in rest}
        feet = [i for i in rest if labels[i][0] and labels[i][1] in FOOT_LABELS]
    others = [i for i in rest if i not in feet]
    return MarkerGroups(*(np.array(columns, np.int64) for columns in (normalisation, feet, others)))


def _normalisation_columns(motion: Motion, names: Sequence[str]) -> list[int]:
    """Columns of origin, left and right marker; all points if the motion has fewer than three."""
    columns = [_column(motion, name, "normalisation marker") for name in names]
    if names and len(set(names)) != 3:
        raise CannotEncode(f"liu2006 needs three normalisation markers (origin, left, right), not {len(names)}")
    if columns:
        return columns
    found = body_frame.normalisation_markers(motion.names, motion.positions, motion.up)
    return list(found or range(motion.points))


def _column(motion: Motion, name: str, kind: str) -> int:
    """The column of a named marker. Raises CannotEncode."""
    column = find_marker(motion.names, name)
    if column is None:
        raise CannotEncode(f"no {kind} {name!r} in this motion; its points are: {', '.join(motion.names)}")
    return column


def find_marker(names: Sequence[str], wanted: str) -> int | None:
    """The column of the exact name, or else of a name that differs only in prefix, case and separators."""
    for matches in (
        lambda name: name == wanted,
        lambda name: body_frame.normalised_label(name) == body_frame.normalised_label(wanted),
    ):
        for column, name in enumerate(names):
            if matches(name):
                return column
    return None


def pack(groups: MarkerGroups) -> list[int]:
    """Numbers for varints: count and columns of the normalisation markers, count and columns of the feet."""
    return [len(groups.normalisation), *groups.normalisation, len(groups.feet), *groups.feet]


def unpack(data: bytes, points: int) -> tuple[MarkerGroups, int]:
    """The inverse of `pack`, from varints, and the offset after them. Raises Corrupt."""
    if points > MAX_POINTS:
        raise Corrupt(f"liu2006 codes at most {MAX_POINTS:,} points, not {points:,}")
    (count,), at = varint.read(data, 1)
    normalisation, at = varint.read(data, min(count, points + 1), at)
    (count,), at = varint.read(data, 1, at)
    feet, at = varint.read(data, min(count, points + 1), at)
    listed = {*normalisation, *feet}
    if len(listed) != len(normalisation) + len(feet):
        raise Corrupt("liu2006: a point is listed in two marker groups")
    if max(listed, default=-1) >= points:
        raise Corrupt(f"liu2006: a marker group lists point {max(listed)}, but the motion has {points} points")
    others = [i for i in range(points) if i not in listed]
    if len(normalisation) != 3 and (feet or others):
        raise Corrupt(f"liu2006: the file has {len(normalisation)} normalisation markers, not 3")
    return MarkerGroups(*(np.array(columns, np.int64) for columns in (normalisation, feet, others))), at
