"""From points to bodies in motion: who stands in the first frame, where each goes, and what was seen of its surface.

first frame ─► people ─► a body and a tracker each ─► poses, frame by frame
                                 points, poses ─► sight ─► points in the canonical pose
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput, CannotEncode
from ...geometry import articulated_icp, articulation, body_fit, body_tracking, joint_limits, skinning, smoothing
from ...geometry.articulation import Body, Floats, Pose
from ...geometry.body_matching import FramePoints, Step
from .. import body_stream

Labels = NDArray[Any]
Cloud = tuple[Floats, NDArray[np.uint8] | None]
FEWEST = 50  # points that a frame must have to be a body
OTHERS = 500  # points beyond those of the template, at least, that say how well a frame is to fit
DETAIL = 5000  # points of a frame that the surface is made from
NEAR = 0.04  # metres from the template that a point of the surface may be
APART = 0.12  # metres between two people, at least, in the first frame
PERSON = 0.25  # of the points of the largest of them, and of its height twice that, that a person has
ASTRAY = 0.08  # metres: farther than this is as far as any, where links of points are learned
DECIDED = 0.006  # metres that another link must be nearer to the data, root mean square
CLOSE = (0.027, 0.02)  # metres: widths of the robust weight where poses are refined
SLIGHT = 0.05  # share of the surface below which what hangs on a joint is held there to its first pose
HELD = 0.1  # radians that it usually is from that
ARM = 0.4  # metres from a body beyond which a point is nobody's


class Sighting(NamedTuple):
    """What was seen of the body in a frame: canonical points (n, 3), links, colours."""

    points: Floats
    links: Labels
    colours: Floats


def begin(
    points: Floats, colours: NDArray[np.uint8] | None, skeleton: Any, up: str, looked_at: int
) -> tuple[Body, body_tracking.BodyTracker]:
    """The body that stands in points (n, 3), as its bytes will give it back, and a tracker that follows it.

    Raises CannotEncode where nobody stands there, BadInput for a skeleton that does not fit.
    """
    limits = joint_limits.NO_LIMITS
    if skeleton is None:
        body = body_fit.first_pose(points, up).body()
    else:
        motion = body_stream.skeleton_motion(skeleton)
        assert motion.skeleton is not None
        body = articulation.from_skeleton(motion.skeleton.names, motion.skeleton.parents, motion.positions[0])
        body_fit.require_near(body, points)
        limits = joint_limits.of_links(body, motion)
    some = np.random.default_rng(0).permutation(len(points))[:8000]
    some = some[articulated_icp.is_near(body, points[some])][:6000]
    if len(some) < FEWEST:
        raise BadInput("the skeleton does not stand in the first frame's points: it must have its place, pose and unit")
    shades = None if colours is None else colours[some]
    surface = smoothing.project_to_surface(points[some], points)
    body, model = articulated_icp.make_model(body, surface, shades, by_surface=True)
    body = body_stream.rounded(body)
    settings = body_tracking.TrackerSettings(max_points=looked_at)
    few = slice(0, settings.template_points)
    skin = skinning.skin(body, model.points[few], model.links[few])
    shades = None if model.colours is None else model.colours[few]
    tracker = body_tracking.BodyTracker(body, skin, model.normals[few], shades, settings, limits)
    if len(some) >= settings.template_points + OTHERS:
        others = some[settings.template_points :]
        tracker.calibrate_cost(points[others], None if colours is None else colours[others])
    return body, tracker


class Follower:
    """A body and the tracker that follows it."""

    def __init__(
        self, points: Floats, colours: NDArray[np.uint8] | None, skeleton: Any, up: str, looked_at: int
    ) -> None:
        """As `begin`."""
        self.body, self.tracker = begin(points, colours, skeleton, up, looked_at)

    def begin(self, points: Floats, colours: NDArray[np.uint8] | None, frame: int) -> body_tracking.Fit:
        """How the pose of the first frame fits it."""
        return self.tracker.assess_frame(points, colours, frame)

    def fit(self, points: Floats, colours: NDArray[np.uint8] | None, frame: int) -> body_tracking.Fit:
        return self.tracker.fit(points, colours, frame)

    def learn(self, clouds: Sequence[Cloud], poses: Sequence[Pose]) -> None:
        """What each point of the template moves with, from frames in which it has moved.

        Of the links nearest to a point, the one is taken that brings it, and those around it, nearest to the data over
        all frames; a sleeve that lay at the trunk in the first frame leaves it with the arm. It stays with its own
        where that says little.
        """
        tracker, skin = self.tracker, self.tracker.skin
        points, own = skin.points, skin.links[:, 0]
        links = self._nearest_links(points, own)
        costs = np.zeros(links.shape)
        for frame, ((place, colours), pose) in enumerate(zip(clouds, poses, strict=True)):
            data = self.look_closely(place, colours, frame)
            a, b = articulation.transforms(self.body, pose)
            for k in range(links.shape[1]):
                there = np.einsum("nij,nj->ni", a[links[:, k]], points) + b[links[:, k]]
                away, _ = data.nearest(there, tracker.scaled_colours, ASTRAY)
                costs[:, k] += np.minimum(away, ASTRAY) ** 2 / len(clouds)
        every = np.full((len(points), len(self.body)), ASTRAY**2)
        np.put_along_axis(every, links, costs, axis=1)
        around = np.asarray(skinning.neighbourhood(self.body, points, tracker.normals) @ every)
        around[np.arange(len(points)), own] -= DECIDED**2
        better = skinning.blended(self.body, points, around.argmin(axis=1), tracker.normals)
        self.tracker = body_tracking.BodyTracker(
            self.body, better, tracker.normals, tracker.colours, tracker.settings, tracker.limits
        )
        self.tracker.typical_cost = tracker.typical_cost

    def look_closely(self, points: Floats, colours: NDArray[np.uint8] | None, frame: int) -> FramePoints:
        """More of a frame's points than a tracker looks at, for `refined` and `sight`."""
        return self.tracker.sample_frame(points, colours, frame, DETAIL)

    def refined(self, data: FramePoints, pose: Pose) -> Pose:
        """A pose brought closer to a frame's points. What has few of them, as hands, turns by their noise, and is held
        to its first pose.
        """
        matcher, prior = self.tracker.matcher, self.tracker.prior
        owners = np.bincount(self.tracker.skin.links[:, 0], minlength=len(self.body))
        slight = self.body.ancestors @ owners < SLIGHT * len(self.tracker.skin.points)
        held = prior._replace(
            rest_strength=np.where(slight, np.maximum(prior.rest_strength, HELD**-2), prior.rest_strength)
        )
        steps = [Step(width, len(data.points), len(matcher.sample)) for width in CLOSE]
        return matcher.solve(data, pose, steps, held)

    def _nearest_links(self, points: Floats, own: Labels) -> Labels:
        """(n, 5): links whose axes are nearest to each point, its own among them."""
        along = self.body.tips - self.body.origins
        offset = points[:, None] - self.body.origins
        share = np.clip(np.einsum("nlk,lk->nl", offset, along) / np.sum(along**2, axis=1), 0, 1)
        away = np.linalg.norm(offset - share[..., None] * along, axis=2)
        away[np.arange(len(points)), own] = -1.0
        return np.argsort(away, axis=1, kind="stable")[:, : min(5, len(self.body))]

    def surface(self, pose: Pose) -> Floats:
        """(n, 3): the template in a pose."""
        return self.tracker.skin.posed(*articulation.transforms(self.body, pose))

    def sight(self, data: FramePoints, pose: Pose) -> Sighting:
        """The points of a frame brought back into the canonical pose, from the pose as it is stored."""
        skin = self.tracker.skin
        found = self.tracker.assess(data, pose)
        a, b = articulation.transforms(self.body, pose)
        rows = found.rows
        good = found.residuals < NEAR
        canonical = skin.unposed(a, b, rows[good], data.points[good])
        # where a joint folds the blend of two turns, almost nothing comes back near to where it came from
        held = np.linalg.norm(canonical - skin.points[rows[good]], axis=1) < 1.5 * NEAR
        good[good] = held
        shades = np.full((int(good.sum()), 3), 128.0) if data.colours is None else data.colours[good].astype(float)
        return Sighting(canonical[held], skin.links[rows[good], 0], shades)


def people(points: Floats, up: str, most: int) -> list[Labels]:
    """Rows of the points of each person in a frame, the one with most points first; all are one's if there is one."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    if most < 2:
        return [np.arange(len(points))]
    cell, which = np.unique(np.floor(points / (APART / 2)).astype(np.int64), axis=0, return_inverse=True)
    pairs = KDTree(cell).query_pairs(APART / (APART / 2) + 0.5, output_type="ndarray")
    ones = np.ones(len(pairs), bool)
    _, label = connected_components(coo_array((ones, tuple(pairs.T)), shape=(len(cell),) * 2), directed=False)
    group = np.asarray(label)[which.reshape(-1)]
    size = np.bincount(group)
    largest = int(size.argmax())
    vertical = points[:, "xyz".index(up)]
    height = np.ptp(vertical[group == largest])
    chosen = [
        g
        for g in np.argsort(-size, kind="stable").tolist()
        if size[g] >= max(PERSON * size[largest], 4 * FEWEST) and np.ptp(vertical[group == g]) >= 2 * PERSON * height
    ]
    if len(chosen) < 2:
        return [np.arange(len(points))]
    return [np.flatnonzero(group == g) for g in chosen[:most]]


def enter(first: Cloud, skeletons: list[Any], up: str, looked_at: int, most: int) -> list[Follower]:
    """Followers of the people in a frame: of those whose skeletons are given, and of all others that stand.

    Raises CannotEncode where nobody stands there, BadInput for a skeleton that fits nobody.
    """
    points, colours = first
    groups = people(points, up, max(most, len(skeletons)))
    result = list[Follower]()
    for skeleton in skeletons:
        if len(groups) > 1:
            middle = body_stream.skeleton_motion(skeleton).positions[0].mean(axis=0)
            away = [float(np.linalg.norm(points[rows].mean(axis=0) - middle)) for rows in groups]
            rows = groups.pop(int(np.argmin(away)))
        else:
            rows = groups.pop() if groups else np.arange(len(points))
        result.append(Follower(points[rows], None if colours is None else colours[rows], skeleton, up, looked_at))
    for rows in groups:
        try:
            result.append(Follower(points[rows], None if colours is None else colours[rows], None, up, looked_at))
        except (CannotEncode, BadInput):
            if not result and rows is groups[-1]:
                raise
    return result


def shared_out(points: Floats, followers: list[Follower]) -> Labels:
    """(n,): whose each point is, by where each body is to be expected; −1 for nobody's. One body has all."""
    from scipy.spatial import KDTree

    if len(followers) == 1:
        return np.zeros(len(points), np.int64)
    away = [KDTree(f.surface(f.tracker.predict())[::3]).query(points, distance_upper_bound=ARM)[0] for f in followers]
    nearest = np.argmin(away, axis=0)
    return np.where(np.isfinite(np.min(away, axis=0)), nearest, -1)
