"""Sections of a Vicon Nexus CSV: a title, a rate, names, axes, units, and rows that begin with frame and sub frame.

Trajectories ─► points
Devices, Model Outputs, Joints, Segments ─► `extras["sections"]`: a `Signal` each, cut together with the points
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..errors import BadInput
from ..motion import Signal
from ..typing import Floats

TITLES = ("trajectories", "devices", "model outputs", "joints", "segments", "events")
HEAD_ROWS = 5
"""Rows of a section before its numbers."""


def sections(rows: Sequence[list[str]], notes: list[str]) -> dict[str, list[list[str]]]:
    """The rows of each section by title; the first of repeated ones, the others are noted."""
    starts = [i for i, row in enumerate(rows) if row[0].lower() in TITLES and not any(row[1:])]
    found: dict[str, list[list[str]]] = {}
    for start, end in zip(starts, [*starts[1:], len(rows)], strict=True):
        title = rows[start][0].lower()
        if title in found:
            notes.append(f"another section {title} is not read")
        found.setdefault(title, list(rows[start:end]))
    return found


def rate_of(section: Sequence[Sequence[str]]) -> float:
    """The rate of a section, hertz; NaN if it has no head of rate, names, axes and units."""
    try:
        rate = float(section[1][0]) if len(section) >= HEAD_ROWS else math.nan
    except ValueError:
        return math.nan
    return rate if 0 < rate < math.inf else math.nan


def main_title(found: Mapping[str, Sequence[Sequence[str]]]) -> str:
    """The section that gives frames and rate: Trajectories, or the one of the lowest rate."""
    if "trajectories" in found:
        return "trajectories"
    rates = {title: rate_of(section) for title, section in found.items()}
    return min(found, key=lambda title: math.inf if math.isnan(rates[title]) else rates[title])


def signal(
    title: str,
    values: Floats,
    rate: float,
    labels: Sequence[str],
    units: Sequence[str],
    first: int,
    frames: int,
    frame_rate: float,
    notes: list[str],
) -> Signal | None:
    """A section as a signal of `frames` frames from number `first`; NaN where it has no row.

    values (rows, 2 + channels): frame, sub frame and samples. Rows of other frames are left out, and noted. None, and a
    note, if the rate is no multiple of the frames'.
    """
    per_frame = round(rate / frame_rate)
    if per_frame < 1 or abs(rate / frame_rate - per_frame) > 1e-3 * per_frame:
        notes.append(
            f"the section {title} is not read: {rate:g} Hz is no multiple of the {frame_rate:g} Hz of the frames"
        )
        return None
    numbers, sub = values[:, 0], np.nan_to_num(values[:, 1])
    place = (numbers - first) * per_frame + sub
    if not np.isfinite(place).all() or (place != np.rint(place)).any() or (sub >= per_frame).any() or (sub < 0).any():
        raise BadInput(f"the frame numbers of its section {title} do not fit its rate of {rate:g} Hz")
    inside = (place >= 0) & (place < frames * per_frame)
    if outside := int(np.count_nonzero(~inside)):
        notes.append(f"{outside} rows of the section {title} are of frames without points: they are left out")
    samples = np.full((frames * per_frame, values.shape[1] - 2), np.nan)
    samples[place[inside].astype(np.int64)] = values[inside, 2:]
    return Signal(samples, frame_rate * per_frame, tuple(labels), tuple(units))
