"""Rules of joints that recordings of one skeleton share: stored rules are departures from them.

Append only: reference rules that a release has never move, never change, never go.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ....typing import Integers


class Reference(NamedTuple):
    """joints (joints, 5) and usual (joints, 3): as `record` stores them."""

    joints: Integers
    usual: Integers


CMU_JOINTS = (
    (1, 0, 0, 0, 1), (0, 0, 0, 0, 0), (2, 0, 0, 0, 0), (4, 0, 7, 0, 0), (6, 0, 7, 0, 0), (4, 0, 7, 0, 0),
    (0, 0, 0, 0, 0), (2, 0, 0, 0, 0), (4, 0, 7, 0, 0), (6, 0, 7, 0, 0), (4, 0, 7, 0, 0), (2, 0, 0, 0, 0),
    (2, 0, 0, 0, 0), (1, 0, 0, 0, 33), (2, 0, 0, 0, 0), (2, 0, 0, 0, 0), (2, 0, 0, 0, 0), (0, 0, 0, 0, 0),
    (2, 0, 0, 0, 0), (4, 0, 7, 0, 0), (5, 0, 7, 0, 0), (6, 0, 7, 0, 0), (0, 0, 7, 0, 0), (6, 0, 7, 0, 0),
    (0, 0, 0, 0, 0), (2, 0, 0, 0, 0), (4, 0, 7, 0, 0), (5, 0, 7, 0, 0), (6, 0, 7, 0, 0), (0, 0, 7, 0, 0),
    (6, 0, 7, 0, 0),
)  # fmt: skip
"""Carnegie Mellon, AMC, 31 joints: rule · flags · form · locked · pair."""
CMU_USUAL = (
    (2, 1, -1), (0, 0, 0), (-6, 0, -4), (10, 4, 0), (-3, -1, 0), (0, 0, 0), (0, 0, 0), (-8, 1, 5), (12, -4, 0),
    (-2, -1, 0), (1, 0, 0), (2, 0, 0), (0, 0, 0), (-1, 0, 1), (-3, 0, -1), (5, 0, 0), (2, 0, 0), (0, 0, 0),
    (4, -7, -18), (0, -11, 6), (-2, 0, 0), (0, 3, 5), (0, 0, 0), (2, 9, -1), (0, 0, 0), (2, 5, 19), (0, 13, -7),
    (-2, 0, 0), (0, 0, -6), (0, 0, 0), (1, -8, 1),
)  # fmt: skip
"""Usual rotations of its joints, rotation vectors in 1/16 rad: means over eight people."""

REFERENCES: tuple[Reference, ...] = (Reference(np.array(CMU_JOINTS), np.array(CMU_USUAL)),)
"""By number, from 1."""


def numbers(joints: int) -> list[int]:
    """The references with this number of joints, and 0 for none."""
    return [0, *(n for n, known in enumerate(REFERENCES, 1) if len(known.joints) == joints)]


def by_number(number: int, joints: int) -> Reference:
    """The reference of a number out of `numbers(joints)`; zeros for 0."""
    if number:
        return REFERENCES[number - 1]
    return Reference(np.zeros((joints, len(CMU_JOINTS[0])), np.int64), np.zeros((joints, 3), np.int64))
