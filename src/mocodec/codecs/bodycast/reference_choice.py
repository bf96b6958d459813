"""Which earlier frames an encoder refers to.

motion of the frame before is estimated ─► some choices are coded ─► the shortest is kept

Where a body shows the surface, earlier frames add little. So beside bodies a reference must save LEAST_SAVED, and
trials become rarer while none does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...geometry.body_matching import FramePoints
from ...typing import Floats, Integers
from .reference_points import LEAST_POINTS, MAX_FRAMES, MAX_MOTION, NO_REFERENCE, EarlierFrames, Reference
from .surface_hints import NORMAL_BITS, SUBUNIT_BITS

TRIED_FRAMES = (1, 2, MAX_FRAMES)  # numbers of earlier frames
TRIED_EVERY = 4  # frames from one trial of all choices to the next; between them the best of the last trial
FIRST_TRIALS = 3  # first frames without bodies in which all choices are tried
RAREST_TRIALS = 32  # frames from one trial to the next, at most
LEAST_SAVED = 0.005  # of a frame's bytes, from which a reference beside bodies, or without them, is worth its time
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
        self._next_trial, self._interval = 0, 1  # frames with bodies

    def candidates(self, earlier: EarlierFrames, cells: Integers, depth: int, has_bodies: bool) -> list[Reference]:
        """References worth trying for a frame of lattice points (n, 3), those that take less time to decode first."""
        if has_bodies and self._coded >= self._next_trial:
            return [NO_REFERENCE, *self._with_bodies(earlier, cells, depth)]
        if not has_bodies and (self._coded < FIRST_TRIALS or self._coded % TRIED_EVERY == 0):
            return [NO_REFERENCE, *self._moved(earlier, cells, depth, False, False, TRIED_FRAMES)]
        hides, frames = self._last.hides_bodies, self._last.frames
        moved = self._moved(earlier, cells, depth, has_bodies and not hides, hides, (frames,)) if frames else []
        return moved or [Reference(hides_bodies=hides)]

    def _with_bodies(self, earlier: EarlierFrames, cells: Integers, depth: int) -> list[Reference]:
        """References beside the bodies and without them, none where the bodies explain almost all points. One frame is
        the best choice for most: more are tried after it has won.
        """
        found, share = list[Reference](), earlier.unexplained_share()
        if share >= REFERRED_SHARE:
            wins = self._last.frames > 0 and not self._last.hides_bodies
            found += self._moved(earlier, cells, depth, True, False, TRIED_FRAMES if wins else TRIED_FRAMES[:1])
        if not self._coded:
            found.append(Reference(hides_bodies=True))
        elif share >= UNEXPLAINED_SHARE:
            hides = self._last.hides_bodies
            found += self._moved(earlier, cells, depth, False, True, TRIED_FRAMES if hides else TRIED_FRAMES[:1])
        return found

    def _moved(
        self, earlier: EarlierFrames, cells: Integers, depth: int, has_bodies: bool, hides: bool, frames: Sequence[int]
    ) -> list[Reference]:
        """A reference to each of these numbers of frames that means other frames than the number before, with their
        motion; none if there are too few points. frames: rising.
        """
        before = earlier.references(1, depth, has_bodies) if len(cells) >= LEAST_POINTS else None
        if before is None:
            return []
        places, normals = before.samples.places / (1 << SUBUNIT_BITS), before.samples.normals / (1 << NORMAL_BITS)
        motion = estimated_motion(places, normals, cells, self._last.motion)
        distinct = [count for before, count in zip((0, *frames), frames, strict=False) if before < len(earlier)]
        return [Reference(count, motion, hides) for count in distinct]

    def keep_best(self, candidates: Sequence[Reference], sizes: Sequence[int], has_bodies: bool) -> int:
        """Which of the candidates (n,) is kept for a frame; sizes (n,): its bytes with each."""
        most = min(sizes) / (1 - LEAST_SAVED) if has_bodies else min(sizes)
        best = next(k for k, size in enumerate(sizes) if size <= most)
        if has_bodies and any(candidate.frames for candidate in candidates):
            gains = candidates[best] != NO_REFERENCE
            self._interval = TRIED_EVERY if gains else min(2 * self._interval, RAREST_TRIALS)
            self._next_trial = self._coded + self._interval
        self._last, self._coded = candidates[best], self._coded + 1
        return best


def estimated_motion(places: Floats, normals: Floats, cells: Integers, first: Sequence[int]) -> tuple[int, int, int]:
    """The translation of samples (m, 3) with normals (m, 3) that brings them nearest to lattice points (n, 3), in whole
    units: iterated closest points, distances to planes. first: where the search starts.
    """
    data, motion = FramePoints.build(cells.astype(np.float64)), np.asarray(first, float)
    some = np.linspace(0, len(places) - 1, min(MATCHED_POINTS, len(places))).astype(int)
    places, normals = places[some], normals[some]
    for _ in range(ROUNDS):
        distance, row = data.nearest(places + motion, None, np.inf)
        near = distance <= FARTHEST_MEDIANS * np.median(distance)
        own, apart = normals[near], cells[row[near]] - places[near]
        weight = own.T @ own + DAMPING * len(own) * np.eye(3)
        residual = ((apart - motion) * own).sum(axis=1)
        motion = motion + np.linalg.solve(weight, own.T @ residual)
    whole = np.clip(np.rint(motion), -MAX_MOTION, MAX_MOTION).astype(int)
    if np.abs(whole).max() <= STILL:
        return 0, 0, 0
    return int(whole[0]), int(whole[1]), int(whole[2])
