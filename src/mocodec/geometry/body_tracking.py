"""Tracks all joints of a body at once: a skinned template is registered to the points of each frame.

constant velocity ──► solve ──► cost too high? re-acquire the body ──► limbs without points? re-acquire each ──► best
fit
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import native
from ..typing import AnyInteger, Bytes, Floats
from . import limb_chains, normals, reacquisition, skinning, smoothing
from .articulation import Body, Pose, exp, log, transforms
from .body_matching import Fit, FramePoints
from .joint_limits import NO_LIMITS, LinkLimits
from .limb_chains import LimbChain
from .pose_solver import PoseSolver, TrackerSettings
from .reacquisition import UNEXPLAINED_M
from .skinning import Skin

MIN_POINTS = 10
"""A frame of fewer points leaves the pose as it is."""
RETRY_COST = 1.25
"""A fit is retried if its cost is above this multiple of the typical cost; the lowest value of the retry threshold."""
LOST_COST = 1.6
"""The body counts as lost if the cost is above this multiple of the typical cost."""
SUSPICIOUS_COST = 1.35
"""All limbs are searched, not every other one, if the cost is above this multiple of the typical cost."""
THRESHOLD_RISE, THRESHOLD_DECAY = 1.1, 0.9
"""After a failed search the retry threshold becomes this multiple of the cost; its decay per frame."""
MAX_SLOWDOWN = 2
"""After n failed searches in a row the retry threshold takes n times as many frames to decay, at most this many."""
LIMB_LOST_SHARE = 0.12
"""Share of a limb's template without data, above which the limb counts as lost; the lowest value of its threshold."""
LIMB_RISE, LIMB_DECAY = 1.2, 0.85
"""After a failed search for a limb its threshold becomes this multiple of the share; its decay per frame."""
PAIR_LOST_SHARE = 0.05
"""Share without data, of both limbs of a pair, above which they may have been confused with each other."""
UNEXPLAINED_SHARE = 0.006
"""Share of unexplained data points below which no limb is searched for."""
PROMISING_COARSE, PROMISING_LIMB, PROMISING_FEW = 1.3, 1.03, 1.1
"""Multiples of the best cost below which a hypothesis is solved in full: one solved coarsely, one of a limb; and below
which a limb's is assessed in full, by costs on few points."""
PROMISING_SWAP = 1.3
"""Multiple of the best cost, on few points, below which swapped limbs are solved coarsely."""
BETTER = 0.97
"""Share of a cost below which another fit is clearly better."""
TURNED_SOLVED = 10
"""Poses of a lost body, turned and moved, that are solved coarsely."""
ABSENT_M = 0.10
"""The frame does not show the body if most of the data and of the template are farther than this from each other."""
COST_AVERAGE = 0.97, 0.03
"""Weights of the typical cost so far and of a frame that costs more, in the new typical cost."""


class Growth(NamedTuple):
    """Points to add to a sparse template: canonical (n, 3), their links (n,), their colours (n, 3)."""

    points: Floats
    links: AnyInteger
    colours: Bytes | None


def cost_of(fit: Fit) -> float:
    return fit.cost


def _clearly_better(fit: Fit, other: Fit) -> Fit:
    """The other fit if it is clearly better, this one otherwise."""
    return other if other.cost < BETTER * fit.cost else fit


class BodyTracker(PoseSolver):
    """Follows a body through frames of points, each from the prediction of constant velocity."""

    def __init__(
        self,
        body: Body,
        skin: Skin,
        normals: Floats,
        colours: Bytes | None = None,
        settings: TrackerSettings | None = None,
        limits: LinkLimits = NO_LIMITS,
    ) -> None:
        super().__init__(body, skin, normals, colours, settings, limits)
        self.is_sparse = len(skin.points) < self.settings.template_points / 2
        self.growth = list[Growth]()
        self.pose = Pose.canonical(len(body))
        self.previous_pose = self.last_good_pose = self.pose
        self.retry_threshold = RETRY_COST  # multiple of the typical cost above which a search is worth while
        self.failed_searches = 0  # in a row
        self.typical_cost = np.inf  # of a frame that fits, square metres

    def set_template(self, skin: Skin, normals: Floats, colours: Bytes | None) -> None:
        super().set_template(skin, normals, colours)
        self.limb_thresholds = np.full(len(self.limbs), LIMB_LOST_SHARE)

    def predict(self) -> Pose:
        """The pose that constant velocity predicts."""
        share = self.settings.velocity
        root = self.pose.root + share * (self.pose.root - self.previous_pose.root)
        if (kernel := native.kernel("extrapolated_rotations")) is not None:
            return Pose(kernel(self.previous_pose.rotations, self.pose.rotations, share), root)
        step = log(self.previous_pose.rotations.transpose(0, 2, 1) @ self.pose.rotations) * share
        return Pose(self.pose.rotations @ exp(step), root)

    def fit(self, points: Floats, colours: Bytes | None = None, seed: int = 0) -> Fit:
        """The pose of one frame of points (n, 3), metres, and how well it fits. Points that are not finite are ignored.

        A frame that does not show the body leaves the pose as it is: one of fewer than 10 points, or one in which most
        points are elsewhere.
        """
        if not np.isfinite(points).all():
            finite = np.isfinite(points).all(axis=1)
            points, colours = points[finite], None if colours is None else colours[finite]
        if len(points) < MIN_POINTS:
            self.previous_pose = self.pose
            return Fit.without_data(self.pose)
        data = self.sample_frame(points, colours, seed)
        first = self._solve_from_known_poses(data)
        best = first
        if self.settings.search:
            limit = max(LOST_COST, self.retry_threshold) * self.typical_cost
            if first.cost > limit:
                first = self._reacquire_body(data, first, limit)
            best = self._reacquire_limbs(data, first, seed)
        if np.mean(best.residuals > ABSENT_M) > 0.5 and np.mean(best.gaps > ABSENT_M) > 0.5:
            self.previous_pose = self.pose
            return self.assess(data, self.pose)
        # a pose found by a search has no velocity yet
        self.previous_pose, self.pose = self.pose if best is first else best.pose, best.pose
        if best.cost < LOST_COST * self.typical_cost:
            self.last_good_pose = best.pose
        old, new = COST_AVERAGE
        average = best.cost if np.isinf(self.typical_cost) else old * self.typical_cost + new * best.cost
        self.typical_cost = min(best.cost, average)
        if self.is_sparse:
            self._grow_template(best)
        return best

    def calibrate_cost(self, points: Floats, colours: Bytes | None) -> None:
        """Set the typical cost from points of the first frame that the template was not made from."""
        self.typical_cost = self.assess_frame(points, colours).cost

    def assess_frame(
        self, points: Floats, colours: Bytes | None = None, seed: int = 0, max_points: int | None = None
    ) -> Fit:
        """How well the tracker's pose fits a frame, of which at most `max_points` points are used."""
        return self.assess(self.sample_frame(points, colours, seed, max_points), self.pose)

    def _solve_from_known_poses(self, data: FramePoints) -> Fit:
        """The fit from the predicted pose; if that is bad, the best from it, the last pose and the last good pose."""
        fit = self.solve(data, self.predict())
        if fit.cost > min(self.retry_threshold, LOST_COST) * self.typical_cost:
            starts = [self.pose] if self.last_good_pose is self.pose else [self.pose, self.last_good_pose]
            fit = min([fit, *(self.solve(data, start) for start in starts)], key=cost_of)
        return fit

    def _reacquire_body(self, data: FramePoints, fit: Fit, limit: float) -> Fit:
        """The best of a fit and of the body turned and moved; see `reacquisition.body_poses`.

        A solution from the fit itself comes first: its prior is the fit and no longer the prediction, which is all that
        a fast movement needs. No other pose is tried if that costs less than `limit`, square metres. Others are ranked
        by their costs on few points; the best are solved coarsely, and the best of these in full.
        """
        best = min(fit, self.solve(data, fit.pose), key=cost_of)
        if best.cost < limit:
            return best
        few = self.coarse_sample(data)
        starts = [self.assess(few, pose) for pose in reacquisition.body_poses(self, data, [best.pose, self.pose])]
        coarse = [self.coarse_solve(few, start.pose) for start in sorted(starts, key=cost_of)[:TURNED_SOLVED]]
        finalists = sorted(coarse, key=cost_of)[:2]
        return min([best, *(self.solve(data, fit.pose) for fit in finalists)], key=cost_of)

    def _reacquire_limbs(self, data: FramePoints, first: Fit, seed: int) -> Fit:
        """Searches for every limb that has no points near it, while other points are not explained by any link.

        After a failed search the threshold of the limb rises, and decays per frame; so does the tracker's retry
        threshold if nothing was found at a high cost, and it decays the more slowly the more often that happened.
        """
        if np.mean(first.residuals > UNEXPLAINED_M) < UNEXPLAINED_SHARE:
            return first
        best, few = first, self.coarse_sample(data)
        is_costly = first.cost > self.retry_threshold * self.typical_cost  # a limb may lie on another's points
        is_suspicious = first.cost > SUSPICIOUS_COST * self.typical_cost
        for number, limb in enumerate(self.limbs):
            share = self._share_without_data(limb, best)
            self.limb_thresholds[number] = max(LIMB_DECAY * self.limb_thresholds[number], LIMB_LOST_SHARE)
            is_turn = is_costly and (is_suspicious or (seed + number) % 2)  # otherwise every other limb, alternating
            if share < self.limb_thresholds[number] and not is_turn:
                continue
            before = best
            best = self._best_of_limb_poses(data, few, best, limb, seed)
            if best is before:  # the missing part is hidden, or not in the template
                self.limb_thresholds[number] = max(self.limb_thresholds[number], LIMB_RISE * share)
        best = self._swap_confused_limbs(data, few, best, is_costly and is_suspicious)
        has_failed = is_costly and best is first
        self.failed_searches = 0 if best is not first else self.failed_searches + has_failed
        decay = THRESHOLD_DECAY ** (1 / min(max(self.failed_searches, 1), MAX_SLOWDOWN))
        raised = THRESHOLD_RISE * first.cost / self.typical_cost
        self.retry_threshold = raised if has_failed else max(min(decay * self.retry_threshold, raised), RETRY_COST)
        return best

    def _best_of_limb_poses(self, data: FramePoints, few: FramePoints, best: Fit, limb: LimbChain, seed: int) -> Fit:
        """The best fit with other poses of a limb; see `reacquisition.limb_poses`. few: some of the data, by which the
        poses are ranked.
        """
        poses = reacquisition.limb_poses(self, limb, data, best, self.pose, seed)
        if not poses:
            return best
        limit = PROMISING_FEW * self.assess(few, best.pose).cost
        ranked = sorted((self.assess(few, pose) for pose in poses), key=cost_of)
        for coarse in ranked[:2]:
            if coarse.cost < limit:
                fit = self.assess(data, coarse.pose)
                if fit.cost < PROMISING_LIMB * best.cost:
                    best = _clearly_better(best, self.solve(data, fit.pose, self.settings.widths[-5:]))
        return best

    def _swap_confused_limbs(self, data: FramePoints, few: FramePoints, best: Fit, is_suspicious: bool) -> Fit:
        """Swaps the limbs of a pair, left and right, if that fits clearly better. few: some of the data; is_suspicious:
        whether pairs are tried that have data.
        """
        for pair in self.limb_pairs:
            share = min(self._share_without_data(self.limbs[number], best) for number in pair)
            if share >= PAIR_LOST_SHARE or is_suspicious:
                pose = limb_chains.swapped(self.body, best.pose, *(self.limbs[i] for i in pair))
                if self.assess(few, pose).cost > PROMISING_SWAP * self.assess(few, best.pose).cost:
                    continue
                if self.coarse_solve(few, pose).cost < PROMISING_COARSE * best.cost:
                    best = _clearly_better(best, self.solve(data, pose, self.settings.widths[-6:]))
        return best

    def _share_without_data(self, limb: LimbChain, fit: Fit) -> float:
        """The share of a limb's template without data near it: of the whole limb, or of the part beyond its first bone,
        whichever is larger.
        """
        lacks = fit.gaps > UNEXPLAINED_M
        return max(np.count_nonzero(lacks[rows]) / max(len(rows), 1) for rows in limb.samples)

    def _grow_template(self, fit: Fit) -> None:
        """Grow a sparse template with inlier points, brought into the canonical pose.

        They are added whenever they are half as many as the template has, until it has enough points, and then once
        more, so that few points a frame add up to a whole surface.
        """
        if fit.cost > RETRY_COST * self.typical_cost or (fit.data.colours is None) != (self.colours is None):
            return
        a, b = transforms(self.body, fit.pose)
        inliers = np.flatnonzero(fit.residuals < UNEXPLAINED_M)
        places = self.skin.unposed(a, b, fit.rows[inliers], fit.data.points[inliers])
        # the inverse of a blend of two rotations is unstable where a joint is folded
        is_stable = np.linalg.norm(places - self.skin.points[fit.rows[inliers]], axis=1) < UNEXPLAINED_M
        inliers = inliers[is_stable]
        colours = None if fit.data.colours is None else fit.data.colours[inliers]
        self.growth.append(Growth(places[is_stable], fit.links[inliers], colours))
        wanted, count = self.settings.template_points, len(self.skin.points)
        if sum(len(part.points) for part in self.growth) < (count / 2 if count < wanted else 2 * wanted):
            return
        self.is_sparse = count < wanted
        parts = [Growth(self.skin.points, self.skin.links[:, 0], self.colours), *self.growth]
        self.growth.clear()
        points, links = np.concatenate([p.points for p in parts]), np.concatenate([p.links for p in parts])
        rows = np.sort(np.random.default_rng(0).permutation(len(points))[:wanted])
        colours = None if self.colours is None else np.concatenate([p.colours for p in parts if p.colours is not None])
        surface = smoothing.project_to_surface(points[rows], points)
        skin = skinning.skin(self.body, surface, links[rows])
        outward = normals.outward(surface, neighbours=10)
        self.set_template(skin, outward, None if colours is None else colours[rows])
