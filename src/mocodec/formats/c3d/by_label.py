"""Model outputs that no list of the parameters names: found by their labels, where values or units confirm it.

labels that end in Angles, Force, Moment, Power ─► a unit of that kind in the parameters, or values that no point
of a body has ─► model outputs; otherwise they stay points, and a note names them
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...typing import Floats
from .parameters import Parameters

LABEL = re.compile(r"(?:.*:)?\w*[a-z0-9_](?P<word>Angle|Force|Moment|Power)s?")
"""LKneeAngles, Subject:RHipMoment, LAnklePower, …"""
KIND_OF_WORD = {"Angle": "ANGLES", "Force": "FORCES", "Moment": "MOMENTS", "Power": "POWERS"}
REACH_M = 1.5
"""A point of a body is within this distance of the box around the other points."""


def find_by_label(
    parameters: Parameters,
    labels: Sequence[str],
    found: Mapping[str, Sequence[int]],
    samples: NDArray[np.generic],
    unit_m: float,
    notes: list[str],
) -> dict[str, list[int]]:
    """The columns of outputs by kind that their labels name, none of which is in `found`; noted.

    samples (frames, points, 4): numbers of the file; unit_m: metres in one of its coordinates. A kind that the
    parameters list is taken from its list alone. If the units or the values of one kind confirm it, all kinds count.
    """
    taken = {column for columns in found.values() for column in columns}
    candidates: dict[str, list[int]] = {}
    for column, label in enumerate(labels):
        if column not in taken and (match := LABEL.fullmatch(label)):
            candidates.setdefault(KIND_OF_WORD[match["word"]], []).append(column)
    candidates = {kind: columns for kind, columns in candidates.items() if not parameters.texts("POINT", kind)}
    if not candidates:
        return {}
    listed = [column for columns in candidates.values() for column in columns]
    named = f"{len(listed)} points named like {labels[listed[0]]}"
    if any(_has_unit(parameters, kind) for kind in candidates):
        notes.append(f"{named} are taken for model outputs: the parameters have the unit of such values")
        return candidates
    others = np.setdiff1d(np.arange(samples.shape[1]), [*listed, *taken])
    values, gap = _coordinates(samples, unit_m)
    box = _box(values[:, others])
    impossible = {column: _is_no_point(values[:, column], gap[:, column], box) for column in listed}
    if any(2 * sum(impossible[column] for column in columns) >= len(columns) for columns in candidates.values()):
        notes.append(f"{named} are taken for model outputs: their values are not those of points of a body")
        return candidates
    notes.append(f"{named} may be model outputs; nothing in the file confirms it, so they are read as positions")
    return {}


def _has_unit(parameters: Parameters, kind: str) -> bool:
    """Whether the parameters have the unit of a kind of outputs: POINT:ANGLE_UNITS for ANGLES."""
    return any(text.strip() for text in parameters.texts("POINT", f"{kind.removesuffix('S')}_UNITS"))


def _coordinates(samples: NDArray[np.generic], unit_m: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Coordinates (frames, points, 3) in metres, NaN where missing or (0, 0, 0), and where that is (frames, points)."""
    values = samples[:, :, :3].astype(np.float64) * unit_m
    gap = (samples[:, :, 3].astype(np.float64) < 0) | ~np.isfinite(values).all(axis=2) | (values == 0).all(axis=2)
    values[gap] = np.nan
    return values, gap


def _box(values: Floats) -> tuple[Floats, Floats]:
    """The lowest and the highest coordinates of the points of each frame, (frames, 3) each; NaN without points."""
    low, high = np.where(np.isnan(values), np.inf, values), np.where(np.isnan(values), -np.inf, values)
    ends = low.min(axis=1, initial=np.inf), high.max(axis=1, initial=-np.inf)
    return tuple(np.where(np.isfinite(end), end, np.nan) for end in ends)  # type: ignore[return-value]


def _is_no_point(values: Floats, gap: NDArray[np.bool_], box: tuple[Floats, Floats]) -> bool:
    """Whether a column (frames, 3) is no point of the body in this box: two coordinates are always exactly 0, as those
    of a power are, or it is out of reach in half of its frames."""
    present = values[~gap]
    if not len(present):
        return False
    if (present == 0).all(axis=0).sum() >= 2:
        return True
    low, high = (end[~gap] for end in box)
    outside = np.linalg.norm(np.maximum(0.0, np.maximum(low - present, present - high)), axis=1)
    return bool(2 * np.count_nonzero(outside > REACH_M) >= len(present))
