"""Links between points: the bones of a skeleton, or pairs of markers whose distance stays the same.

    sample frames → distance of every pair in each → rigid pairs → minimum spanning forest + near rigid neighbours

Used to draw marker sets as figures. Coding does not depend on it.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree

from ..motion import Motion
from ..typing import Floats, Integers

MOST_POINTS = 600
"""Motions of more points are drawn without links: every pair is looked at."""
RIGID_M, LONGEST_M = 0.012, 0.6
"""A pair may be linked if its distance varies by at most RIGID_M (standard deviation) and is at most LONGEST_M."""
FIRM_M = 0.004
"""Standard deviation up to which a near pair is linked although the forest joins its points already."""
WEIGHT_OF_SPREAD = 12.0
"""Metres of distance that a metre of standard deviation counts as."""


def links(motion: Motion, sample: Floats | None = None) -> list[tuple[int, int]]:
    """Pairs of points to connect when a motion is drawn, each with the smaller number first.

    sample (frames, points, 3): frames that the distances between markers are measured in, metres; by default 40 of the
    motion. Without a skeleton there are none for fewer than two frames or more than MOST_POINTS points.
    """
    if motion.skeleton is not None:
        return [(min(p, j), max(p, j)) for j, p in enumerate(motion.skeleton.parents) if p >= 0]
    if sample is None:
        sample = motion.positions[sample_frames(len(motion))]
    if len(sample) < 2 or not 2 <= motion.points <= MOST_POINTS:
        return []
    mean, spread = pair_distances(sample)
    weight = mean + WEIGHT_OF_SPREAD * spread
    rigid = (spread <= RIGID_M) & (mean <= LONGEST_M) & (mean > 1e-6)
    forest = minimum_spanning_tree(csr_array(np.where(np.triu(rigid, 1), weight, 0.0)))
    chosen = {(min(a, b), max(a, b)) for a, b in zip(*map(np.ndarray.tolist, forest.nonzero()), strict=True)}
    firm = np.where(rigid & (spread <= FIRM_M), weight, np.inf)
    for point, others in enumerate(np.argsort(firm, axis=1)[:, :2].tolist()):
        chosen |= {(min(point, o), max(point, o)) for o in others if np.isfinite(firm[point, o])}
    return sorted(chosen)


def sample_frames(frames: int) -> Integers:
    """Numbers of up to 40 of `frames` frames, spread evenly: distances are measured in these."""
    return np.unique(np.linspace(0, max(0, frames - 1), min(40, frames)).astype(int))


def pair_distances(sample: Floats) -> tuple[Floats, Floats]:
    """Mean and standard deviation (points, points) of the distances between points of (frames, points, 3), metres.

    Frames in which one of both is missing are left out; the deviation is infinite where fewer than two frames remain.
    """
    present = ~np.isnan(sample[:, :, 0])
    points = sample.shape[1]
    count, total, squares = np.zeros((points, points)), np.zeros((points, points)), np.zeros((points, points))
    for positions, here in zip(sample, present, strict=True):  # a frame at a time: pairs² of all would need much memory
        at = np.where(here[:, None], positions, 0.0)
        distance = np.sqrt(np.maximum(((at[:, None] - at[None]) ** 2).sum(axis=2), 0.0))
        both = here[:, None] & here[None]
        count += both
        total += np.where(both, distance, 0.0)
        squares += np.where(both, distance**2, 0.0)
    enough = count >= 2
    mean = np.divide(total, count, out=np.full_like(total, np.inf), where=enough)
    square = np.divide(squares, count, out=np.zeros_like(total), where=enough)
    spread = np.sqrt(np.maximum(square - np.where(enough, mean, 0.0) ** 2, 0.0))
    return mean, np.where(enough, spread, np.inf)
