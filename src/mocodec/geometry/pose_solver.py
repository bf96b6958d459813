"""Gauss–Newton from a start to the pose that fits a frame: the template, priors and schedule that a tracker uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import Bytes, Floats
from . import limb_chains
from .articulation import Body, Pose
from .body_matching import Fit, FramePoints, Matcher, Step
from .gauss_newton import PosePrior
from .joint_limits import NO_LIMITS, LinkLimits
from .skinning import Skin

COARSE_POINTS, COARSE_TEMPLATE_POINTS = 400, 200
"""Points of data and template for a coarse fit; a step never takes fewer data points if there are more."""
ALL_BELOW_M, HALF_BELOW_M, COARSE_SHARE = 0.03, 0.05, 0.16
"""Steps narrower than the first use all points, those narrower than the second half of them, wider ones this share."""
SHORT_BONE = 0.12
"""A bone shorter than this share of the body's size is stiff if it carries others."""
FEW_POINTS = 0.01
"""A link with less than this share of the template is stiff: its points do not determine its rotation."""


@dataclass(frozen=True)
class TrackerSettings:
    """How a body is tracked. Lengths in metres, angles in radians.

    widths: of the robust weight, one an iteration. max_points, max_template_points: of data and template that an
    iteration uses, at most. template_points: to which a sparse template grows. tangential: weight of squared distances
    along the surface against those across it. noise: standard deviation of the data. turn: standard deviation of a
    joint's rotation about the predicted one; spine: that of stiff joints, which also keep within `bend` of the first
    pose. limit: standard deviation of a joint beyond its limits. velocity: share of the last movement that the
    prediction repeats. colour_m: length that a difference of 255 in a colour channel counts as. search: whether lost
    limbs and bodies are re-acquired.
    """

    widths: tuple[float, ...] = (0.2, 0.2, 0.2, 0.2, 0.16, 0.16, 0.11, 0.08, 0.055, 0.038, 0.027, 0.02)
    max_points: int = 2500
    max_template_points: int = 400
    template_points: int = 3000
    tangential: float = 0.1
    noise: float = 0.01
    turn: float = 1.0
    spine: float = 0.12
    bend: float = 0.35
    limit: float = 0.03
    velocity: float = 0.8
    colour_m: float = 0.20
    search: bool = True


class PoseSolver:
    """A template of a body, registered to frames of points one by one."""

    def __init__(
        self,
        body: Body,
        skin: Skin,
        normals: Floats,
        colours: Bytes | None = None,
        settings: TrackerSettings | None = None,
        limits: LinkLimits = NO_LIMITS,
    ) -> None:
        """skin, normals (n, 3), colours (n, 3): of the template's points; normals canonical, pointing outwards."""
        self.body, self.limits = body, limits
        self.settings = settings or TrackerSettings()
        self.set_template(skin, normals, colours)
        in_limbs = [int(limb.links[0]) for limb in self.limbs]
        self.above_hips = [link for link, parent in enumerate(body.parents) if parent == 0 and link not in in_limbs]
        upright = body.origins[self.above_hips or [0]].mean(axis=0) - body.origins[0]
        length = float(np.linalg.norm(upright))
        self.upright = upright / length if length > 1e-3 else body.axes[0]  # from the hips upwards, canonical

    def set_template(self, skin: Skin, normals: Floats, colours: Bytes | None) -> None:
        """Replace the template, and all that follows from it."""
        self.skin, self.normals, self.colours = skin, normals, colours
        self.scaled_colours = None if colours is None else self._scaled(colours)
        order = np.random.default_rng(0).permutation(len(skin.points))
        self.matcher = Matcher(
            self.body, skin, normals, self.scaled_colours, order[: self.settings.max_template_points],
            self.settings.tangential, self.settings.noise,
        )  # fmt: skip
        self.stiffness = self._stiffness()
        self.prior = self._prior()
        self.limbs = limb_chains.find(self.body, skin, self.matcher.sample)
        self.limb_pairs = limb_chains.mirrored_pairs(self.body, self.limbs)

    def _stiffness(self) -> Floats:
        """(links,): expected rotation of each joint, radians: small for short bones that carry others, and for links
        with few points.
        """
        share = np.bincount(self.skin.links[:, 0], minlength=len(self.body)) / len(self.skin.points)
        is_short = self.body.lengths < SHORT_BONE * np.ptp(self.body.origins, axis=0).max()
        carries = self.body.ancestors.sum(axis=1) > 3
        is_stiff = (is_short & carries) | (share < FEW_POINTS)
        is_stiff[0] = False
        return np.where(is_stiff, self.settings.spine, self.settings.turn)

    def _prior(self) -> PosePrior:
        """Towards the predicted pose; and stiff joints towards the canonical one, which keeps a spine from folding."""
        rest_strength = np.where(self.stiffness < self.settings.turn, self.settings.bend**-2, 0.0)
        rest = Pose.canonical(len(self.body)).rotations
        strength = self.settings.limit**-2
        return PosePrior(self.stiffness**-2.0, rest_strength, rest, limits=self.limits, limit_strength=strength)

    def _scaled(self, colours: Bytes) -> Floats:
        """(n, 3): colours in metres, so that they can be added to distances."""
        return colours.astype(np.float64) * (self.settings.colour_m / 255)

    def sample_frame(
        self, points: Floats, colours: Bytes | None, seed: int, max_points: int | None = None
    ) -> FramePoints:
        """At most `max_points` points of a frame (those of the settings unless given), drawn at random."""
        rows = np.random.default_rng(seed).permutation(len(points))[: max_points or self.settings.max_points]
        points, colours = points[rows], None if colours is None else colours[rows]
        scaled = None if colours is None or self.scaled_colours is None else self._scaled(colours)
        return FramePoints.build(points, scaled, colours)

    def solve(self, data: FramePoints, start: Pose, widths: tuple[float, ...] | None = None) -> Fit:
        """Gauss–Newton from a pose, with that pose as prior."""
        counts = len(data.points), len(self.matcher.sample)
        steps = list[Step]()
        for width in widths or self.settings.widths:
            share = 1.0 if width < ALL_BELOW_M else 0.5 if width < HALF_BELOW_M else COARSE_SHARE
            points, template_points = (max(COARSE_POINTS, round(share * count)) for count in counts)
            steps.append(Step(width, points, template_points))
        return self.matcher.fit(data, start, steps, self.prior)

    def coarse_solve(self, data: FramePoints, start: Pose) -> Fit:
        """How well a pose fits some of the data after a few steps on few points; data: see `coarse_sample`."""
        steps = [Step(width, COARSE_POINTS, COARSE_TEMPLATE_POINTS) for width in self.settings.widths[2:8]]
        return self.matcher.assess(data, self.matcher.solve(data, start, steps, self.prior))

    def coarse_sample(self, data: FramePoints) -> FramePoints:
        """As many of the points as a coarse fit takes."""
        return data.subset(np.arange(min(len(data.points), COARSE_POINTS)))

    def assess(self, data: FramePoints, pose: Pose) -> Fit:
        """How well a pose fits."""
        return self.matcher.assess(data, pose)
