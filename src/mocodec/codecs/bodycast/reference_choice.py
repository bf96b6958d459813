"""Which earlier frames an encoder refers to.

motion of the frame before is estimated ─► some choices are coded ─► the shortest is kept
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...typing import Floats, Integers
from .reference_points import LEAST_POINTS, MAX_FRAMES, MAX_MOTION, NO_REFERENCE, EarlierFrames, Reference
from .surface_hints import NORMAL_BITS, SUBUNIT_BITS

TRIED_FRAMES = (1, 2, MAX_FRAMES)  # numbers of earlier frames
TRIED_EVERY = 4  # frames in which all choices are tried; in the others the best of the last trial
FIRST_TRIALS = 3  # first frames in which all choices are tried
REFERRED_SHARE, UNEXPLAINED_SHARE = 0.02, 0.03
"""Shares of the points of a frame that no body explains, from which earlier frames are tried for the next one: beside
the bodies, and without them.
"""
MATCHED_POINTS = 1500  # of the frame before
ROUNDS = 6
FARTHEST_MEDIANS = 3.0  # distance of a match over the median distance
STILL = 1  # lattice units; a smaller motion is none
DAMPING = 0.02  # of the matches, that speak for no motion


class ReferenceChoice:
    """The choices of an encoder from frame to frame."""

    def __init__(self) -> None:
        self._last, self._coded = NO_REFERENCE, 0

    def candidates(self, earlier: EarlierFrames, cells: Integers, depth: int, has_bodies: bool) -> list[Reference]:
        """References worth trying for a frame of lattice points (n, 3)."""
        if self._coded >= FIRST_TRIALS and self._coded % TRIED_EVERY:
            hides = self._last.hides_bodies
            return self._moved(earlier, cells, depth, has_bodies and not hides, hides, (self._last.frames,))
        found, share = [NO_REFERENCE], earlier.unexplained_share()
        if share >= REFERRED_SHARE or not has_bodies:
            found += self._moved(earlier, cells, depth, has_bodies, False, TRIED_FRAMES)
        if has_bodies and (share >= UNEXPLAINED_SHARE or not self._coded):
            found += [Reference(hides_bodies=True), *self._moved(earlier, cells, depth, False, True, TRIED_FRAMES)]
        return found

    def _moved(
        self, earlier: EarlierFrames, cells: Integers, depth: int, has_bodies: bool, hides: bool, frames: Sequence[int]
    ) -> list[Reference]:
        """A reference to each of these numbers of frames, with their motion; none if there are too few points."""
        before = earlier.references(1, depth, has_bodies) if any(frames) and len(cells) >= LEAST_POINTS else None
        if before is None:
            return [Reference(hides_bodies=hides)] if len(frames) == 1 else []
        places, normals = before.samples.places / (1 << SUBUNIT_BITS), before.samples.normals / (1 << NORMAL_BITS)
        motion = estimated_motion(places, normals, cells, self._last.motion)
        return [Reference(count, motion, hides) for count in frames]

    def keep(self, reference: Reference) -> None:
        """The reference of the frame that was coded."""
        self._last, self._coded = reference, self._coded + 1


def estimated_motion(places: Floats, normals: Floats, cells: Integers, first: Sequence[int]) -> tuple[int, int, int]:
    """The translation of samples (m, 3) with normals (m, 3) that brings them nearest to lattice points (n, 3), in whole
    units: iterated closest points, distances to planes. first: where the search starts.
    """
    from scipy.spatial import KDTree

    tree, motion = KDTree(cells), np.asarray(first, float)
    some = np.linspace(0, len(places) - 1, min(MATCHED_POINTS, len(places))).astype(int)
    places, normals = places[some], normals[some]
    for _ in range(ROUNDS):
        distance, row = map(np.asarray, tree.query(places + motion))
        near = distance <= FARTHEST_MEDIANS * np.median(distance)
        own, apart = normals[near], cells[row[near]] - places[near]
        weight = own.T @ own + DAMPING * len(own) * np.eye(3)
        residual = ((apart - motion) * own).sum(axis=1)
        motion = motion + np.linalg.solve(weight, own.T @ residual)
    whole = np.clip(np.rint(motion), -MAX_MOTION, MAX_MOTION).astype(int)
    if np.abs(whole).max() <= STILL:
        return 0, 0, 0
    return int(whole[0]), int(whole[1]), int(whole[2])
