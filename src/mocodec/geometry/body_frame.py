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

GIRDLES = (
    (
        ("SHO", "SHD", "ACR", "ACROMION", "ACROMIUM", "AC", "SAJ", "SHOULDERJOINT", "ARM", "UPPERARM", "UPARM",
         "SHOULDER", "HUMERUS", "COLLAR", "CLAVICLE"),
        ("C7", "CV7", "C7SPINE", "CERV7", "CERVICALE", "NECK", "LOWERNECK", "NECK1", "UPPERNECK", "UPPERBACK", "THORAX",
         "CHEST", "SPINE3", "SPINE2", "SPINE1", "T10", "TV8", "CLAV", "STRN"),
    ),
    (
        ("ASI", "ASIS", "IAS", "FWT", "PSI", "PSIS", "IPS", "BWT", "UPLEG", "HIP", "FEMUR", "THIGH"),
        ("SACR", "SACRUM", "VSACRAL", "SACRAL", "PELVIS", "HIPS", "ROOT", "L5", "LV5"),
    ),
)  # fmt: skip
"""Parts of plain labels, best first: left and right, and the origin between them; shoulders, then the pelvis."""

LEVEL_M = 1e-6
"""Shoulders above each other give no heading: below this length on the ground it is that of the world."""

CANDIDATES = 64
SAMPLES = 64
UNSTEADY = 10.0
"""The choice by geometry: points and frames looked at, and what a metre of varying distance costs, in metres."""


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
    if re.search(r"([ _.\-][LRlr]|[A-Z][lr])$", label):
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
    pair, origin = _by_label(names, present)
    if pair is not None and origin is not None:
        return origin, *pair
    return _by_geometry(positions, present, up, pair)


def _by_label(names: Sequence[str], present: Floats) -> tuple[tuple[int, int] | None, int | None]:
    """Left and right, and the origin, as far as labels tell."""
    sides = {side_and_part(name): i for i, name in reversed(list(enumerate(names))) if present[i] > 0.5}
    plains = {plain(name): i for i, name in reversed(list(enumerate(names))) if present[i] > 0.5}
    best: tuple[int, int] | None = None
    for parts, origins in GIRDLES:
        pair = next(((sides["L", p], sides["R", p]) for p in parts if {("L", p), ("R", p)} <= sides.keys()), None)
        origin = next((plains[o] for o in origins if o in plains), None)
        if pair is not None and origin is not None:
            return pair, origin
        best = best or pair
    return best, None


def _by_geometry(positions: Floats, present: Floats, up: str, pair: tuple[int, int] | None) -> tuple[int, int, int]:
    """Left and right: the pair farthest apart on the ground and most rigid; origin: the point most rigid to both."""
    columns = np.argsort(-np.minimum(present, 0.9), kind="stable")[:CANDIDATES]
    columns = columns[: max(3, int((present[columns] > 0.5).sum()))]
    columns = np.concatenate([np.array(pair or (), np.int64), columns[~np.isin(columns, pair or ())]])
    sample = np.unique(np.linspace(0, len(positions) - 1, SAMPLES).astype(int))
    points = positions[sample][:, columns]
    apart = points[:, :, None] - points[:, None]
    distance = np.sqrt((apart**2).sum(axis=-1))
    ground = np.sqrt((np.delete(apart, UP_AXES.index(up), axis=-1) ** 2).sum(axis=-1))
    seen = ~np.isnan(distance)
    count = np.maximum(seen.sum(axis=0), 1)
    mean = np.where(seen, distance, 0).sum(axis=0) / count
    varies = np.sqrt(np.where(seen, (distance - mean) ** 2, 0).sum(axis=0) / count)
    rigid = np.where(seen.any(axis=0), -UNSTEADY * varies, -1.0)
    score = np.where(seen, ground, np.inf).min(axis=0, initial=10.0) + rigid
    np.fill_diagonal(score, -np.inf)
    left, right = (0, 1) if pair else sorted(int(i) for i in np.unravel_index(int(np.argmax(score)), score.shape))
    third = np.minimum(rigid[left], rigid[right])
    third[[left, right]] = -np.inf
    return int(columns[int(np.argmax(third))]), int(columns[left]), int(columns[right])
