"""Which earlier frames an encoder refers to: their motion is estimated, then some choices are coded and the shortest kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...typing import Floats, Integers
from .reference_points import LEAST_POINTS, MAX_FRAMES, MAX_MOTION, NO_REFERENCE, EarlierFrames, Reference

TRIED_FRAMES = (1, 2, MAX_FRAMES)  # numbers of earlier frames
TRIED_EVERY = 4  # frames in which all numbers are tried; in the others the best of the last trial
MATCHED_POINTS = 1500  # of the frame before
ROUNDS = 6
FARTHEST_MEDIANS = 3.0  # distance of a match over the median distance
STILL = 1  # lattice units; a smaller motion is none
DAMPING = 0.02  # of the matches, that speak for no motion


class ReferenceChoice:
    """The choices of an encoder from frame to frame."""

    def __init__(self) -> None:
        self._frames, self._motion, self._coded = 1, (0, 0, 0), 0

    def candidates(self, earlier: EarlierFrames, cells: Integers, depth: int, has_bodies: bool) -> list[Reference]:
        """References worth trying for a frame of lattice points (n, 3); the first is none."""
        before = earlier.references(1, depth, has_bodies) if len(cells) >= LEAST_POINTS else None
        if before is None:
            return [NO_REFERENCE]
        samples = before.samples
        motion = estimated_motion(samples.places / 16.0, samples.normals / 1024.0, cells, self._motion)
        counts = TRIED_FRAMES if self._coded % TRIED_EVERY < 2 else tuple({self._frames} - {0})
        return [NO_REFERENCE, *(Reference(count, motion) for count in counts)]

    def keep(self, reference: Reference) -> None:
        """The reference of the frame that was coded."""
        self._frames, self._motion, self._coded = reference.frames, reference.motion, self._coded + 1


def estimated_motion(
    places: Floats, normals: Floats, cells: Integers, first: Sequence[int]
) -> tuple[int, int, int]:
    """The translation of samples (m, 3) with normals (m, 3) that brings them nearest to lattice points (n, 3), in whole
    units: iterated closest points, distances to planes. first: where the search starts.
    """
    from scipy.spatial import KDTree

    tree, motion = KDTree(cells), np.asarray(first, float)
    some = np.linspace(0, len(places) - 1, min(MATCHED_POINTS, len(places))).astype(int)
    places, normals = places[some], normals[some]
    for _ in range(ROUNDS):
        distance, row = tree.query(places + motion)
        near = distance <= FARTHEST_MEDIANS * np.median(distance)
        own, apart = normals[near], cells[row[near]] - places[near]
        weight = own.T @ own + DAMPING * len(own) * np.eye(3)
        residual = ((apart - motion) * own).sum(axis=1)
        motion = motion + np.linalg.solve(weight, own.T @ residual)
    whole = np.clip(np.rint(motion), -MAX_MOTION, MAX_MOTION).astype(int)
    if np.abs(whole).max() <= STILL:
        return 0, 0, 0
    return int(whole[0]), int(whole[1]), int(whole[2])
