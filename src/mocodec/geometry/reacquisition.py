"""Hypotheses for poses of a body that is lost: of one limb, and of the whole body turned and moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..typing import Floats
from . import limb_search
from .articulation import Pose, exp, transforms
from .body_matching import Fit, FramePoints, Step
from .limb_chains import LimbChain
from .pose_solver import PoseSolver

UNEXPLAINED_M = 0.045
"""A data point farther than this from the template is explained by no link, metres."""
MOVED_M = 0.15
"""The body's centre must be farther than this from that of the points for it to be moved there, metres."""
HEADINGS = 8
"""Directions that a lost body is turned to."""
MIN_FREE = 10
"""Points that a limb must have near it, or that are not explained, to be searched for."""
MAX_UNEXPLAINED, MAX_FREE = 50, 300
"""Data points that score hypotheses, and that refine them, about."""
LIMB_WIDTHS = 0.12, 0.08, 0.05, 0.035
"""Widths of the robust weight by which a limb's pose is refined, metres."""
FIXED = 1e8
"""Strength of the prior that holds all other links where they are."""


def limb_poses(
    solver: PoseSolver, limb: LimbChain, data: FramePoints, fit: Fit, previous: Pose, seed: int
) -> list[Pose]:
    """The best of random poses of a limb, each refined while all links but those of the limb and its base are fixed;
    none if the limb has few points that it could belong to, or already fits about as well as any other pose. fit: of
    the frame; previous: the pose of the frame before.
    """
    links = limb.with_base
    free = np.flatnonzero((fit.residuals > 0.5 * UNEXPLAINED_M) | np.isin(fit.links, links))
    if len(free) < MIN_FREE:
        return []
    unexplained = data.points[fit.residuals > UNEXPLAINED_M]
    unexplained = unexplained[:: max(1, len(unexplained) // MAX_UNEXPLAINED)]
    places = FramePoints.build(data.points[free])
    search = limb_search.LimbSearch(
        solver.matcher, limb, solver.limits, places, unexplained, fit.pose, previous, limb.rows[::3]
    )
    draws = limb_search.LimbDraws.of(limb, fit.pose, unexplained, np.random.default_rng([seed, int(limb.links[0])]))
    hypotheses = search.best(draws)
    if not len(hypotheses):
        return []
    free = free[:: max(1, len(free) // MAX_FREE)]
    strength = np.full(len(solver.body), FIXED)
    strength[links] = solver.stiffness[links] ** -2.0
    prior = solver.prior._replace(start_strength=strength, root_strength=FIXED)
    allowed = np.zeros(len(solver.body), bool)
    allowed[links] = True
    near = data.subset(free)
    steps = [Step(width, len(free), len(limb.rows)) for width in LIMB_WIDTHS]
    poses = list[Pose]()
    for hypothesis in hypotheses:
        rotations = fit.pose.rotations.copy()
        rotations[links] = hypothesis
        poses.append(solver.matcher.solve(near, Pose(rotations, fit.pose.root), steps, prior, limb.rows, allowed))
    return poses


def body_poses(solver: PoseSolver, data: FramePoints, poses: Sequence[Pose]) -> list[Pose]:
    """Poses turned to every heading, as a whole and below the hips only, and moved to the points if they are elsewhere:
    for a body that has turned, or has come back at another place.
    """
    centre = np.median(data.points, axis=0)
    starts = list[Pose]()
    for pose in poses:
        a, b = transforms(solver.body, pose)
        offset = centre - np.median(solver.skin.posed(a, b, solver.matcher.sample), axis=0)
        shift = offset if np.linalg.norm(offset) > MOVED_M else np.zeros(3)
        headings = exp(np.arange(HEADINGS)[:, None] * (2 * np.pi / HEADINGS) * (a[0] @ solver.upright))
        for number, heading in enumerate(headings):
            for fixed in ([], solver.above_hips) if number else ([],):  # unturned, both are the same
                starts.append(_turned(pose, heading, shift, fixed))
    return starts


def _turned(pose: Pose, heading: Floats, shift: Floats, fixed: Sequence[int]) -> Pose:
    """The pose with its root turned about itself and moved. fixed: children of the root that keep their rotation in the
    world.
    """
    rotations = pose.rotations.copy()
    rotations[0] = heading @ rotations[0]
    for link in fixed:
        rotations[link] = rotations[0].T @ pose.rotations[0] @ rotations[link]
    return Pose(rotations, pose.root + shift)
