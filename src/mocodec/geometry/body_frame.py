"""A coordinate frame that moves with the body: origin at one marker, heading by two others, vertical axis unchanged.

    three normalisation markers ──from_markers──► BodyFrame      positions ──to_body──► normalised ──to_world──►
    positions

Liu and McMillan 2006, section 3.1. The markers are C7 and the two shoulders if the labels name them, or the neck and
shoulders of a skeleton, otherwise three points that are far apart and keep their distances.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..motion import UP_AXES
from ..typing import Floats

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
"""For shoulders, then for the pelvis: names of the left and right markers without their side, and of the origin between
them, best first."""

LEVEL_M = 1e-6
"""Shoulders closer than this on the ground, metres, give no heading: the world's is used."""

MAX_POINTS, MAX_FRAMES = 64, 64
"""Points and frames that the choice by geometry uses, at most."""
VARIATION_COST = 10.0
"""Metres of distance between two markers that outweigh one metre of standard deviation of that distance."""


class BodyFrame(NamedTuple):
    """origin (frames, 3), metres; heading (frames, 2): cosine and sine of the rotation about the vertical axis `up`."""

    origin: Floats
    heading: Floats
    up: int

    def of_frames(self, frames: slice) -> BodyFrame:
        """The same of some frames."""
        return BodyFrame(self.origin[frames], self.heading[frames], self.up)


def normalised_label(label: str) -> str:
    """A label without subject prefix and separators, in capitals: "Male:L_SHO" → "LSHO"."""
    return re.sub(r"[^0-9A-Z]", "", re.split(r"[:|]", label)[-1].upper())


def side_and_part(label: str) -> tuple[str, str]:
    """Side, "L", "R" or "", and part of the body: "LeftToeBase" → ("L", "TOEBASE"), "Heel.R" → ("R", "HEEL")."""
    name = normalised_label(label)
    for pattern in (r"(?P<side>LEFT|RIGHT)(?P<part>.+)", r"(?P<part>.+)(?P<side>LEFT|RIGHT)"):
        if match := re.fullmatch(pattern, name):
            return match["side"][0], match["part"]
    if re.search(r"([ _.\-][LRlr]|[A-Z][lr])$", label):
        return name[-1], name[:-1]
    if len(name) > 2 and name[0] in "LR":
        return name[0], name[1:]
    return "", name


def from_markers(markers: Floats, up: str) -> BodyFrame:
    """The frame of three markers (frames, 3, 3): origin, left, right; x points from left to right on the ground."""
    vertical = UP_AXES.index(up)
    a, b = (vertical + 1) % 3, (vertical + 2) % 3
    across = (markers[:, 2] - markers[:, 1])[:, [a, b]]
    length = np.hypot(across[:, 0], across[:, 1])[:, None]
    heading = np.where(length > LEVEL_M, across / np.maximum(length, LEVEL_M), [1.0, 0.0])
    return BodyFrame(markers[:, 0], heading, vertical)


def to_body(positions: Floats, frame: BodyFrame) -> Floats:
    """World positions (frames, points, 3) in the body's frame."""
    return _rotate(positions - frame.origin[:, None], frame, 1.0)


def to_world(positions: Floats, frame: BodyFrame) -> Floats:
    """Positions (frames, points, 3) of the body's frame in the world; the inverse of `to_body`."""
    return _rotate(positions, frame, -1.0) + frame.origin[:, None]


def _rotate(positions: Floats, frame: BodyFrame, sign: float) -> Floats:
    """Positions rotated about the vertical by the heading, forwards or back by `sign`."""
    a, b = (frame.up + 1) % 3, (frame.up + 2) % 3
    cosine, sine = frame.heading[:, :1], sign * frame.heading[:, 1:]
    rotated = positions.copy()
    rotated[..., a] = cosine * positions[..., a] + sine * positions[..., b]
    rotated[..., b] = cosine * positions[..., b] - sine * positions[..., a]
    return rotated


def normalisation_markers(names: Sequence[str], positions: Floats, up: str) -> tuple[int, int, int] | None:
    """Columns of the origin, left and right markers: by label if possible, otherwise by geometry; None for fewer than
    three points.

    positions (frames, points, 3), NaN at gaps: a point that is mostly missing is chosen last.
    """
    if len(names) < 3:
        return None
    present = 1 - np.isnan(positions[..., 0]).mean(axis=0)
    pair, origin = _by_label(names, present)
    if pair is not None and origin is not None:
        return origin, *pair
    return _by_geometry(positions, present, up, pair)


def _by_label(names: Sequence[str], present: Floats) -> tuple[tuple[int, int] | None, int | None]:
    """Columns of left and right, and of the origin; None for what the labels do not name."""
    sides = {side_and_part(name): i for i, name in reversed(list(enumerate(names))) if present[i] > 0.5}
    labels = {normalised_label(name): i for i, name in reversed(list(enumerate(names))) if present[i] > 0.5}
    best: tuple[int, int] | None = None
    for parts, origins in GIRDLES:
        pair = next(((sides["L", p], sides["R", p]) for p in parts if {("L", p), ("R", p)} <= sides.keys()), None)
        origin = next((labels[o] for o in origins if o in labels), None)
        if pair is not None and origin is not None:
            return pair, origin
        best = best or pair
    return best, None


def _by_geometry(positions: Floats, present: Floats, up: str, pair: tuple[int, int] | None) -> tuple[int, int, int]:
    """Left and right: the pair far apart on the ground whose distance varies least, unless given as `pair`; origin: the
    point whose distances to both vary least.
    """
    columns = np.argsort(-np.minimum(present, 0.9), kind="stable")[:MAX_POINTS]
    columns = columns[: max(3, int((present[columns] > 0.5).sum()))]
    columns = np.concatenate([np.array(pair or (), np.int64), columns[~np.isin(columns, pair or ())]])
    frames = np.unique(np.linspace(0, len(positions) - 1, MAX_FRAMES).astype(int))
    points = positions[frames][:, columns]
    apart = points[:, :, None] - points[:, None]
    distance = np.sqrt((apart**2).sum(axis=-1))
    ground = np.sqrt((np.delete(apart, UP_AXES.index(up), axis=-1) ** 2).sum(axis=-1))
    seen = ~np.isnan(distance)
    count = np.maximum(seen.sum(axis=0), 1)
    mean = np.where(seen, distance, 0).sum(axis=0) / count
    deviation = np.sqrt(np.where(seen, (distance - mean) ** 2, 0).sum(axis=0) / count)
    rigidity = np.where(seen.any(axis=0), -VARIATION_COST * deviation, -1.0)
    score = np.where(seen, ground, np.inf).min(axis=0, initial=10.0) + rigidity
    np.fill_diagonal(score, -np.inf)
    left, right = (0, 1) if pair else sorted(int(i) for i in np.unravel_index(int(np.argmax(score)), score.shape))
    third = np.minimum(rigidity[left], rigidity[right])
    third[[left, right]] = -np.inf
    return int(columns[int(np.argmax(third))]), int(columns[left]), int(columns[right])
