"""Hypotheses for poses of a body that is lost: of one limb, and of the whole body turned and moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..typing import AnyInteger, Floats
from . import limb_chains
from .articulation import Pose, exp, log, transforms
from .body_matching import Fit, FramePoints, Step
from .limb_chains import LimbChain
from .pose_solver import PoseSolver

UNEXPLAINED_M = 0.045
"""A data point farther than this from the template is explained by no link, metres."""
MOVED_M = 0.15
"""The body's centre must be farther than this from that of the points for it to be moved there, metres."""
HEADINGS = 8
"""Directions that a lost body is turned to."""
HYPOTHESES = 300
"""Random poses of a limb that are drawn at first."""
SPREADS_RAD, KEPT, DRAWN = (0.4, 0.2), 20, 8
"""Standard deviations of later draws, how many poses each of them starts from, and how many it draws near each."""
CONSIDERED, REFINED = 60, 4
"""How many of the best random poses are compared with one another, and how many of these are refined at most."""
DISTINCT_M = 0.08
"""A pose is another one if the bend or the end of the limb is farther away than this, metres."""
PROMISING = 1.2
"""Multiple of the limb's own score below which another pose is refined."""
BASE_TURNED_RAD = 0.3
"""A limb's base that has turned farther than this since the first pose may have been pulled away."""
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
    """The best of random poses of a limb, best first, each refined while all links but those of the limb and its base
    are fixed; none if the limb has few points that it could belong to, or already fits about as well as any other pose.
    fit: of the frame; previous: the pose of the frame before.

    Random poses are drawn once widely, then twice near the best so far.
    """
    links, first = limb.with_base, len(limb.base)
    free = np.flatnonzero((fit.residuals > 0.5 * UNEXPLAINED_M) | np.isin(fit.links, links))
    if len(free) < 10:
        return []
    unexplained = data.points[fit.residuals > UNEXPLAINED_M]
    unexplained = unexplained[:: max(1, len(unexplained) // MAX_UNEXPLAINED)]
    rng = np.random.default_rng([seed, int(limb.links[0])])
    hypotheses = _random_rotations(solver, limb, fit.pose, previous, unexplained, rng)
    places = FramePoints.build(data.points[free])
    matcher = solver.matcher

    def scores(rotations: Floats, rows: AnyInteger) -> Floats:
        return matcher.score_limb_poses(places, unexplained, fit.pose, links, rotations, rows)

    score = scores(hypotheses, limb.rows[::3])
    for spread in SPREADS_RAD:
        best = np.argsort(score)[:KEPT]
        turns = np.zeros((KEPT, DRAWN, len(links), 3))
        turns[:, :, first : first + 2] = spread * rng.normal(size=(KEPT, DRAWN, min(2, len(limb.links)), 3))
        more = (exp(turns) @ hypotheses[best][:, None]).reshape(-1, len(links), 3, 3)
        more[:, first:] = limb_chains.clamp_to_limits(solver.limits, limb, more[:, first:])
        hypotheses = np.concatenate([hypotheses[best], more])
        score = np.concatenate([score[best], scores(more, limb.rows[::3])])
    own = scores(fit.pose.rotations[links][None], limb.rows[::3])[0]
    chosen = _distinct(solver, limb, fit.pose, hypotheses, score, PROMISING * own)
    if not chosen:
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
    for i in chosen:
        rotations = fit.pose.rotations.copy()
        rotations[links] = hypotheses[i]
        poses.append(matcher.solve(near, Pose(rotations, fit.pose.root), steps, prior, limb.rows, allowed))
    score = scores(np.stack([pose.rotations[links] for pose in poses]), limb.rows)
    return [poses[i] for i in np.argsort(score)]


def _distinct(
    solver: PoseSolver, limb: LimbChain, pose: Pose, hypotheses: Floats, score: Floats, limit: float
) -> list[int]:
    """The best hypotheses, at most REFINED, whose score is below the limit, and in which bend and end of the limb are
    DISTINCT_M or more from those of the pose and of one another.
    """
    order = np.argsort(score)[:CONSIDERED]
    order = order[score[order] < limit]
    rotations = np.tile(pose.rotations, (1 + len(order), 1, 1, 1))
    rotations[1:, limb.with_base] = hypotheses[order]
    a, b = transforms(solver.body, Pose(rotations, np.tile(pose.root, (len(rotations), 1))))
    places = limb_chains.bend_and_end(solver.body, limb) if len(limb.links) > 1 else [_tip(solver, limb)]
    ends = np.concatenate([a[:, link] @ place + b[:, link] for link, place in places], axis=1)
    chosen = [0]  # the pose
    for i in range(1, len(ends)):
        if len(chosen) <= REFINED and np.linalg.norm(ends[chosen] - ends[i], axis=1).min() >= DISTINCT_M:
            chosen.append(i)
    return [int(order[i - 1]) for i in chosen[1:]]


def _tip(solver: PoseSolver, limb: LimbChain) -> tuple[int, Floats]:
    """The link of a limb of one link, and the canonical place (3,) of its end."""
    link = int(limb.links[0])
    return link, solver.body.tips[link]


def _random_rotations(
    solver: PoseSolver, limb: LimbChain, pose: Pose, previous: Pose, unexplained: Floats, rng: np.random.Generator
) -> Floats:
    """(hypotheses, links of base and limb, 3, 3): a third near the pose, a third near the previous one, and a third
    that reaches for unexplained points, if there are any; all within the joints' limits. HYPOTHESES with the base as it
    is, and if it is turned far, as many with the base back in the first pose: a limb on wrong points pulls its base.
    """
    third = HYPOTHESES // 3
    result, bases = list[Floats](), [pose]
    if len(limb.base) and np.linalg.norm(log(pose.rotations[limb.base])) > BASE_TURNED_RAD:
        rest = Pose(pose.rotations.copy(), pose.root)
        rest.rotations[limb.base] = np.eye(3)
        bases.append(rest)
    for base in bases:
        parts = [
            limb_chains.perturbed(limb, base, rng, third, *TWISTED),
            limb_chains.perturbed(limb, previous, rng, third, *NEARBY),
        ]
        if len(unexplained) and len(limb.links) > 1:
            targets = unexplained[rng.integers(len(unexplained), size=third)]
            parts.append(limb_chains.reaching(solver.body, limb, base, rng, targets))
        else:
            parts.append(limb_chains.perturbed(limb, base, rng, third, *NEARBY))
        rotations = limb_chains.clamp_to_limits(solver.limits, limb, np.concatenate(parts))
        carrier = np.broadcast_to(base.rotations[limb.base], (len(rotations), len(limb.base), 3, 3))
        result.append(np.concatenate([carrier, rotations], axis=1))
    return np.concatenate(result)


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
