"""A frame that follows the body: origin at one marker, heading by two, the vertical kept. Liu & McMillan 2006, 3.1.

    three normalisation markers ──of──► BodyFrame      positions ──into──► normalised ──out_of──► positions

The markers are C7 and the two shoulders where the labels say which these are, the neck and shoulders of a skeleton, and
otherwise the three points that stay farthest apart and most rigid to each other.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..motion import UP_AXES, Floats

ORIGINS = (
    "C7", "CV7", "C7SPINE", "CERV7", "CERVICALE", "NECK", "LOWERNECK", "NECK1", "UPPERNECK", "UPPERBACK", "THORAX",
    "CHEST", "SPINE3", "SPINE2", "SPINE1", "T10", "CLAV", "STRN",
)  # fmt: skip
SHOULDERS = (
    "SHO", "SHD", "ACR", "ACROMION", "ACROMIUM", "AC", "SHOULDERJOINT", "ARM", "UPPERARM", "UPARM", "SHOULDER",
    "HUMERUS", "COLLAR", "CLAVICLE",
)  # fmt: skip
"""Parts of plain labels, best first."""

LEVEL_M = 1e-6
"""Shoulders above each other give no heading: below this length on the ground it is that of the world."""

CANDIDATES = 64
SAMPLES = 64


class BodyFrame(NamedTuple):
    """origin (frames, 3); heading (frames, 2): cosine and sine of the turn about the vertical; up: that axis."""

    origin: Floats
    heading: Floats
    up: int


def plain(label: str) -> str:
    """A label without its subject's prefix, case and separators: "Male:L_SHO" → "LSHO"."""
    return re.sub(r"[^0-9A-Z]", "", re.split(r"[:|]", label)[-1].upper())


def side_and_part(label: str) -> tuple[str, str]:
    """Side, "L", "R" or "", and part of the body: "LeftToeBase" → ("L", "TOEBASE"), "Heel.R" → ("R", "HEEL")."""
    name = plain(label)
    for pattern in (r"(?P<side>LEFT|RIGHT)(?P<part>.+)", r"(?P<part>.+)(?P<side>LEFT|RIGHT)"):
        if match := re.fullmatch(pattern, name):
            return match["side"][0], match["part"]
    if re.search(r"[ _.\-][LRlr]$", label):
        return name[-1], name[:-1]
    if len(name) > 2 and name[0] in "LR":
        return name[0], name[1:]
    return "", name


def of(markers: Floats, up: str) -> BodyFrame:
    """The frame of three markers (frames, 3, 3): origin, left, right. x goes from left to right on the ground."""
    vertical = UP_AXES.index(up)
    a, b = (vertical + 1) % 3, (vertical + 2) % 3
    across = (markers[:, 2] - markers[:, 1])[:, [a, b]]
    length = np.hypot(across[:, 0], across[:, 1])[:, None]
    heading = np.where(length > LEVEL_M, across / np.maximum(length, LEVEL_M), [1.0, 0.0])
    return BodyFrame(markers[:, 0], heading, vertical)


def into(positions: Floats, frame: BodyFrame) -> Floats:
    """Positions (frames, points, 3) of the world in the body's frame."""
    return _turn(positions - frame.origin[:, None], frame, 1.0)


def out_of(positions: Floats, frame: BodyFrame) -> Floats:
    """Positions (frames, points, 3) of the body's frame in the world."""
    return _turn(positions, frame, -1.0) + frame.origin[:, None]


def _turn(positions: Floats, frame: BodyFrame, sign: float) -> Floats:
    a, b = (frame.up + 1) % 3, (frame.up + 2) % 3
    cosine, sine = frame.heading[:, :1], sign * frame.heading[:, 1:]
    turned = positions.copy()
    turned[..., a] = cosine * positions[..., a] + sine * positions[..., b]
    turned[..., b] = cosine * positions[..., b] - sine * positions[..., a]
    return turned


def normalisation_markers(names: Sequence[str], positions: Floats, up: str) -> tuple[int, int, int] | None:
    """Columns of origin, left and right: by label where labels say, by geometry otherwise; None below three points.

    positions (frames, points, 3), NaN at gaps: a point that is mostly missing is not chosen where there is another.
    """
    if len(names) < 3:
        return None
    present = 1 - np.isnan(positions[..., 0]).mean(axis=0)
    return _by_label(names, present) or _by_geometry(positions, present, up)


def _by_label(names: Sequence[str], present: Floats) -> tuple[int, int, int] | None:
    found = {side_and_part(name): i for i, name in reversed(list(enumerate(names))) if present[i] > 0.5}
    centre = {plain(name): i for i, name in reversed(list(enumerate(names))) if present[i] > 0.5}
    shoulders = next((p for p in SHOULDERS if ("L", p) in found and ("R", p) in found), None)
    origin = next((o for o in ORIGINS if o in centre), None)
    if shoulders is None or origin is None:
        return None
    return centre[origin], found["L", shoulders], found["R", shoulders]


def _by_geometry(positions: Floats, present: Floats, up: str) -> tuple[int, int, int]:
    """Left and right: the pair farthest apart on the ground and most rigid; origin: the point most rigid to both."""
    columns = np.argsort(-np.minimum(present, 0.9), kind="stable")[:CANDIDATES]
    columns = columns[: max(3, int((present[columns] > 0.5).sum()))]
    sample = np.unique(np.linspace(0, len(positions) - 1, SAMPLES).astype(int))
    points = positions[sample][:, columns]
    middle = np.nan_to_num(points).sum(axis=0) / np.maximum((~np.isnan(points)).sum(axis=0), 1)
    points = np.where(np.isnan(points), middle, points)
    apart = points[:, :, None] - points[:, None]
    distance = np.sqrt((apart**2).sum(axis=-1))
    level = np.delete(apart, UP_AXES.index(up), axis=-1)
    ground = np.sqrt((level**2).sum(axis=-1)).min(axis=0)
    varies = distance.std(axis=0)
    score = ground - 10 * varies
    np.fill_diagonal(score, -np.inf)
    left, right = sorted(int(i) for i in np.unravel_index(int(np.argmax(score)), score.shape))
    third = distance.mean(axis=0)[[left, right]].min(axis=0) - 10 * varies[[left, right]].max(axis=0)
    third[[left, right]] = -np.inf
    return int(columns[int(np.argmax(third))]), int(columns[left]), int(columns[right])
