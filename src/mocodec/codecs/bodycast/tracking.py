"""One person over time: a template body, a tracker that fits its pose to each frame, and points in the canonical pose.

first points ──start_tracking──► template body and tracker
frame ──fit──► pose ──refine_pose──► pose that fits more points
frame, pose ──to_canonical──► points as they lay in the canonical pose
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ...errors import BadInput
from ...geometry import (
    articulated_icp,
    articulation,
    body_fit,
    body_tracking,
    human_limits,
    joint_limits,
    skinning,
    smoothing,
)
from ...geometry.articulation import Body, Pose
from ...geometry.body_matching import FramePoints, Step
from ...typing import AnyInteger, Bytes, Floats
from ..clouds.body_record import round_body
from ..clouds.raw_frames import Cloud
from ..clouds.tracked_motion import skeleton_motion

MIN_BODY_POINTS = 50  # frames with fewer points show no body
MAX_FIRST_POINTS, MAX_NEAR_POINTS = 8000, 6000  # of the first frame: drawn, and kept of those near the body
MIN_HELD_OUT_POINTS = 500  # of the first frame, beside the template, to estimate the usual cost of a fit
HALF_COST = 0.75  # usual cost of a fit, as a share of the cost with half the template and half the points
DENSE_POINTS = 5000  # of a frame, for refined poses and the surface
MAX_SURFACE_DISTANCE_M = 0.04  # from the template, of points that show the surface
FOLD_TOLERANCE = 1.5  # MAX_SURFACE_DISTANCE_M by which skinning may miss a point when it is inverted
MAX_LINK_COST_M = 0.08  # distance at which the cost of a link for a template point is capped
LINK_CANDIDATES = 5
MIN_LINK_GAIN_M = 0.006  # root mean square distance by which another link must fit better
REFINE_WIDTHS_M = (0.027, 0.02)  # of the robust weight
SKELETON_LIMIT_RAD = 0.03  # standard deviation of a joint beyond the limits of its skeleton
HUMAN_LIMIT_RAD = 0.15  # and beyond those of people in general, which some people and some clothes exceed
SMALL_SHARE = 0.05  # of the surface: joints that move less are held near their first rotation in refined poses
SMALL_SPREAD_RAD = 0.1  # standard deviation of that prior


class CanonicalPoints(NamedTuple):
    """Points of a frame in the canonical pose: points (n, 3), links (n,), colours (n, 3)."""

    points: Floats
    links: AnyInteger
    colours: Floats


def start_tracking(
    points: Floats, colours: Bytes | None, skeleton: Any, up: str, tracked_points: int
) -> tuple[Body, body_tracking.BodyTracker]:
    """The body in points (n, 3), rounded as it is stored, and its tracker.

    skeleton: a Motion or a file of one in the points' pose; None fits a body. Raises CannotEncode if no body is found,
    BadInput for a skeleton that does not fit.
    """
    limits = joint_limits.NO_LIMITS
    if skeleton is None:
        body = body_fit.first_pose(points, up).body()
    else:
        motion = skeleton_motion(skeleton)
        assert motion.skeleton is not None
        body = articulation.from_skeleton(motion.skeleton.names, motion.skeleton.parents, motion.positions[0])
        body_fit.require_near(body, points)
        limits = joint_limits.of_links(body, motion)
    limit_spread = SKELETON_LIMIT_RAD
    if not len(limits.links):
        limits, limit_spread = human_limits.of_body(body), HUMAN_LIMIT_RAD
    rows = np.random.default_rng(0).permutation(len(points))[:MAX_FIRST_POINTS]
    rows = rows[articulated_icp.is_near(body, points[rows])][:MAX_NEAR_POINTS]
    if len(rows) < MIN_BODY_POINTS:
        raise BadInput("the skeleton does not stand in the first frame's points: it must have its place, pose and unit")
    template_colours = None if colours is None else colours[rows]
    surface = smoothing.project_to_surface(points[rows], points)
    body, model = articulated_icp.make_model(body, surface, template_colours, by_surface=True)
    body = round_body(body)
    settings = body_tracking.TrackerSettings(max_points=tracked_points, limit=limit_spread)
    some = slice(0, settings.template_points)
    skin = skinning.skin(body, model.points[some], model.links[some])
    template_colours = None if model.colours is None else model.colours[some]
    tracker = body_tracking.BodyTracker(body, skin, model.normals[some], template_colours, settings, limits)
    _calibrate_cost(tracker, points[rows], None if colours is None else colours[rows])
    return body, tracker


def _calibrate_cost(tracker: body_tracking.BodyTracker, points: Floats, colours: Bytes | None) -> None:
    """Estimate the usual cost of a fit from points (n, 3) of the first frame, of which the template has the first.

    If the template has all points, half of them are compared with the other half: both are sparser, so it costs more.
    """
    wanted = tracker.settings.template_points
    if len(points) >= wanted + MIN_HELD_OUT_POINTS:
        tracker.calibrate_cost(points[wanted:], None if colours is None else colours[wanted:])
    elif len(points) >= 2 * MIN_HELD_OUT_POINTS:
        half, skin = len(points) // 2, tracker.skin
        half_skin = skinning.Skin(skin.points[:half], skin.links[:half], skin.weights[:half])
        half_colours = None if tracker.colours is None else tracker.colours[:half]
        few = body_tracking.BodyTracker(
            tracker.body, half_skin, tracker.normals[:half], half_colours, tracker.settings, tracker.limits
        )
        cost = few.assess_frame(points[half:], None if colours is None else colours[half:]).cost
        tracker.typical_cost = HALF_COST * cost


class PersonTracker:
    """A template body and the tracker that fits its pose to frames."""

    def __init__(self, cloud: Cloud, skeleton: Any, up: str, tracked_points: int) -> None:
        """As `start_tracking`."""
        self.body, self.tracker = start_tracking(*cloud, skeleton, up, tracked_points)

    def fit_of_first_pose(self, cloud: Cloud, frame: int) -> body_tracking.Fit:
        """How well the current pose fits a frame; the pose stays."""
        return self.tracker.assess_frame(*cloud, frame)

    def fit(self, cloud: Cloud, frame: int) -> body_tracking.Fit:
        """The next frame's pose. frame: its number, the seed of the points drawn."""
        return self.tracker.fit(*cloud, frame)

    def dense_data(self, cloud: Cloud, frame: int) -> FramePoints:
        """More points of a frame than the tracker uses, for `refine_pose` and `to_canonical`."""
        return self.tracker.sample_frame(*cloud, frame, DENSE_POINTS)

    def refine_pose(self, data: FramePoints, pose: Pose) -> Pose:
        """A pose fitted to more points. Joints with little surface, such as hands, would follow noise: a prior holds
        them near their first rotation.
        """
        matcher, prior = self.tracker.matcher, self.tracker.prior
        owned = np.bincount(self.tracker.skin.links[:, 0], minlength=len(self.body))
        is_small = self.body.ancestors @ owned < SMALL_SHARE * len(self.tracker.skin.points)
        strength = np.where(is_small, np.maximum(prior.rest_strength, SMALL_SPREAD_RAD**-2), prior.rest_strength)
        strong_prior = prior._replace(rest_strength=strength)
        steps = [Step(width, len(data.points), len(matcher.sample)) for width in REFINE_WIDTHS_M]
        return matcher.solve(data, pose, steps, strong_prior)

    def posed_template(self, pose: Pose) -> Floats:
        """(n, 3): the template's points in a pose."""
        return self.tracker.skin.posed(*articulation.transforms(self.body, pose))

    def to_canonical(self, data: FramePoints, pose: Pose) -> CanonicalPoints:
        """The inliers of a frame, moved back into the canonical pose by inverse skinning. pose: as it is decoded."""
        skin = self.tracker.skin
        fit = self.tracker.assess(data, pose)
        a, b = articulation.transforms(self.body, pose)
        inlier = fit.residuals < MAX_SURFACE_DISTANCE_M
        rows = fit.rows[inlier]
        canonical = skin.unposed(a, b, rows, data.points[inlier])
        # in a folded joint the blend of two rotations is nearly singular: its inverse throws points far off
        error = np.linalg.norm(canonical - skin.points[rows], axis=1)
        near = error < FOLD_TOLERANCE * MAX_SURFACE_DISTANCE_M
        inlier[inlier] = near
        count = int(inlier.sum())
        colours = np.full((count, 3), 128.0) if data.colours is None else data.colours[inlier].astype(float)
        return CanonicalPoints(canonical[near], skin.links[rows[near], 0], colours)

    def learn_links(self, clouds: Sequence[Cloud], poses: Sequence[Pose]) -> None:
        """Assign each template point to the link that it moves with, from frames in which the body has moved.

        Of the links nearest to a point, the one wins that brings it and its neighbours nearest to the data over all
        frames. So a sleeve that touched the trunk in the first frame follows the arm. A point keeps its link unless
        another one is clearly better.
        """
        tracker, skin = self.tracker, self.tracker.skin
        points, own = skin.points, skin.links[:, 0]
        links = self._nearest_links(points, own)
        costs = np.zeros(links.shape)
        for frame, (cloud, pose) in enumerate(zip(clouds, poses, strict=True)):
            data = self.dense_data(cloud, frame)
            a, b = articulation.transforms(self.body, pose)
            for k in range(links.shape[1]):
                posed = np.einsum("nij,nj->ni", a[links[:, k]], points) + b[links[:, k]]
                distance, _ = data.nearest(posed, tracker.scaled_colours, MAX_LINK_COST_M)
                costs[:, k] += np.minimum(distance, MAX_LINK_COST_M) ** 2 / len(clouds)
        all_links = np.full((len(points), len(self.body)), MAX_LINK_COST_M**2)
        np.put_along_axis(all_links, links, costs, axis=1)
        smooth = skinning.averaged(self.body, points, tracker.normals, all_links)
        smooth[np.arange(len(points)), own] -= MIN_LINK_GAIN_M**2
        learned = skinning.blended(self.body, points, smooth.argmin(axis=1), tracker.normals)
        self.tracker = body_tracking.BodyTracker(
            self.body, learned, tracker.normals, tracker.colours, tracker.settings, tracker.limits
        )
        self.tracker.typical_cost = tracker.typical_cost

    def _nearest_links(self, points: Floats, own: AnyInteger) -> AnyInteger:
        """(n, LINK_CANDIDATES): links whose axes are nearest to each point, its own first."""
        along = self.body.tips - self.body.origins
        offset = points[:, None] - self.body.origins
        share = np.clip(np.einsum("nlk,lk->nl", offset, along) / np.sum(along**2, axis=1), 0, 1)
        distance = np.linalg.norm(offset - share[..., None] * along, axis=2)
        distance[np.arange(len(points)), own] = -1.0
        return np.argsort(distance, axis=1, kind="stable")[:, : min(LINK_CANDIDATES, len(self.body))]
