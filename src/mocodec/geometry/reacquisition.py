"""Hypotheses for poses of a body that is lost: of one limb, and of the whole body turned and moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..typing import Floats
from . import limb_chains
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
HYPOTHESES, REFINED, RETURNED = 300, 3, 2
"""Random poses of a limb, how many of them are refined, and how many of these are returned."""
MAX_UNEXPLAINED, MAX_FREE = 50, 300
"""Data points that score hypotheses, and that refine them, about."""
LIMB_WIDTHS = 0.12, 0.08, 0.05, 0.035
"""Widths of the robust weight by which a limb's pose is refined, metres."""
FIXED = 1e8
"""Strength of the prior that holds all other links where they are."""
TWISTED, NEARBY = (0.15, 2.0), (0.9, 0.7)
"""Standard deviations of a limb's first and second rotation, radians: bent anew, or turned as a whole."""


def limb_poses(
    solver: PoseSolver, limb: LimbChain, data: FramePoints, fit: Fit, previous: Pose, seed: int
) -> Sequence[Pose]:
    """The best of random poses of a limb, each refined while all other links are fixed; none if the limb has few points
    that it could belong to. fit: of the frame; previous: the pose of the frame before.
    """
    free = np.flatnonzero((fit.residuals > 0.5 * UNEXPLAINED_M) | np.isin(fit.links, limb.links))
    if len(free) < 10:
        return []
    unexplained = data.points[fit.residuals > UNEXPLAINED_M]
    unexplained = unexplained[:: max(1, len(unexplained) // MAX_UNEXPLAINED)]
    hypotheses = _random_rotations(solver, limb, fit.pose, previous, unexplained, seed)
    places = FramePoints.build(data.points[free])
    matcher = solver.matcher
    score = matcher.score_limb_poses(places, unexplained, fit.pose, limb.links, hypotheses, limb.rows[::3])
    free = free[:: max(1, len(free) // MAX_FREE)]
    strength = np.full(len(solver.body), FIXED)
    strength[limb.links] = solver.stiffness[limb.links] ** -2.0
    prior = solver.prior._replace(start_strength=strength, root_strength=FIXED)
    allowed = np.zeros(len(solver.body), bool)
    allowed[limb.links] = True
    near = data.subset(free)
    steps = [Step(width, len(free), len(limb.rows)) for width in LIMB_WIDTHS]
    poses = list[Pose]()
    for i in np.argsort(score)[:REFINED]:
        rotations = fit.pose.rotations.copy()
        rotations[limb.links] = hypotheses[i]
        poses.append(matcher.solve(near, Pose(rotations, fit.pose.root), steps, prior, limb.rows, allowed))
    refined = np.stack([pose.rotations[limb.links] for pose in poses])
    score = matcher.score_limb_poses(places, unexplained, fit.pose, limb.links, refined, limb.rows)
    return [poses[i] for i in np.argsort(score)[:RETURNED]]


def _random_rotations(
    solver: PoseSolver, limb: LimbChain, pose: Pose, previous: Pose, unexplained: Floats, seed: int
) -> Floats:
    """(HYPOTHESES, links of the limb, 3, 3): a third near the pose, a third near the previous one, and a third that
    reaches for unexplained points, if there are any; all within the joints' limits.
    """
    rng = np.random.default_rng([seed, int(limb.links[0])])
    third = HYPOTHESES // 3
    parts = [
        limb_chains.perturbed(limb, pose, rng, third, *TWISTED),
        limb_chains.perturbed(limb, previous, rng, third, *NEARBY),
    ]
    if len(unexplained) and len(limb.links) > 1:
        targets = unexplained[rng.integers(len(unexplained), size=third)]
        parts.append(limb_chains.reaching(solver.body, limb, pose, rng, targets))
    else:
        parts.append(limb_chains.perturbed(limb, pose, rng, third, *NEARBY))
    return limb_chains.clamp_to_limits(solver.limits, limb, np.concatenate(parts))


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
        for heading in headings:
            for fixed in ([], solver.above_hips):
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
