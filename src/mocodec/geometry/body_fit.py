"""A first pose without a skeleton: a body of ordinary build fitted to one frame of points.

    points ──► headings × arm poses × sizes ──best few──► all joints at once, and the size ──best──► Figure

Any standing pose will do. It takes seconds, once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..errors import BadInput, CannotEncode
from . import articulation, body_tracking, skinning, stock_body
from .articulation import Body, Floats, Pose

FARTHEST = 0.3  # metres: a skeleton whose links are farther from the points than this is somewhere else
WORST = 0.08  # metres: a fit whose points are farther from the body than this on average is no fit
HEADINGS = 12
ARMS = (0.0, 0.75, -0.6, 1.9)  # radians about z that the stock body's arms are raised: as it is, straight out, down, up
SIZES = (1.0, 0.86)  # of what the height says, which raised arms make too large


class Figure(NamedTuple):
    """A skeleton in the pose of a frame: names, parents and places (joints, 3) of its joints, and how far it is off."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    places: Floats
    error_m: float

    def body(self, one_trunk: bool = False, shortest: float = 0.085) -> Body:
        """Its links."""
        return articulation.from_skeleton(self.names, self.parents, self.places, one_trunk=one_trunk, shortest=shortest)


def first_pose(points: Floats, up: str = "y") -> Figure:
    """The figure that stands in points (n, 3), metres. Raises CannotEncode where none of ordinary build does."""
    turn = {"x": np.array([[0, 1.0, 0], [1, 0, 0], [0, 0, -1]]), "y": np.eye(3)}.get(
        up, np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    )
    upright = points @ turn.T
    low, high = np.percentile(upright, [0.5, 99.5], axis=0)
    height = float(high[1] - low[1])
    if not 0.4 < height < 3.0:
        raise CannotEncode(f"the first frame is {height:.2f} m high: not a standing person in metres; give a skeleton")
    middle = np.median(upright, axis=0)
    rng = np.random.default_rng(0)
    some = upright[rng.permutation(len(upright))[:1500]]
    best: tuple[float, Figure] | None = None
    for share in SIZES:
        size = share * height / 1.75
        tracker = stock_tracker(size)
        data = tracker.look_at(some, None, 0)
        hips = np.array([middle[0], low[1] + 0.96 * size, middle[2]])
        starts = [(tracker.assess(data, p).cost, i, p) for i, p in enumerate(_starts(tracker.body, hips))]
        for _, _, pose in sorted(starts, key=lambda s: s[:2])[:2]:
            tried, found, scale = tracker, tracker.solve(data, pose, COARSE), size
            for _ in range(2):
                scale *= _growth(tried, found, data)
                tried = stock_tracker(scale)
                found = tried.solve(data, Pose(found.pose.rotations, _root(tried.body, tracker.body, found.pose)))
            if best is None or found.cost < best[0]:
                best = found.cost, _figure(tried.body, found, turn)
    assert best is not None
    if best[1].error_m > WORST:
        raise CannotEncode(
            f"no standing figure fits the first frame ({best[1].error_m * 100:.0f} cm off): give a skeleton"
        )
    return best[1]


COARSE = (0.4, 0.3, 0.25, 0.2, 0.16, 0.12, 0.1, 0.08, 0.06, 0.05)
FINE = body_tracking.Settings(points=1000, model_points=500, turn=1.5, spine=0.15, search=True)


def stock_tracker(size: float) -> body_tracking.Tracker:
    """A tracker of the stock body, `size` times its own."""
    stock = stock_body.joints()
    names = tuple(stock)
    parents = [names.index(joint.parent) if joint.parent else -1 for joint in stock.values()]
    places = np.array([joint.place for joint in stock.values()], float) * size
    body = articulation.from_skeleton(names, parents, places)
    link_of = np.zeros(len(names), np.int64)
    for joint in range(len(names)):
        link_of[joint] = body.joints.index(joint) if joint in body.joints else link_of[max(parents[joint], 0)]
    rng = np.random.default_rng(1)
    points, normals, links = list[Floats](), list[Floats](), list[Floats]()
    for start, stop, near, far, carrier in stock_body.bones():
        p, q = places[names.index(start)], places[names.index(stop)]
        count = int(2 * np.pi * (near + far) / 2 * (np.linalg.norm(q - p) / size + near) * 2500)
        share, turn = rng.random(count), rng.uniform(0, 2 * np.pi, count)
        axis = (q - p) / np.linalg.norm(q - p)
        side = np.cross(axis, [0.0, 0, 1] if abs(axis[2]) < 0.9 else [1.0, 0, 0])
        side /= np.linalg.norm(side)
        out = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(axis, side)
        radius = size * (near + share * (far - near))
        points.append(p + share[:, None] * (q - p) + radius[:, None] * out)
        normals.append(out)
        links.append(np.full(count, link_of[names.index(carrier)]))
    skin = skinning.skin(body, np.concatenate(points), np.concatenate(links).astype(np.int64))
    return body_tracking.Tracker(body, skin, np.concatenate(normals), settings=FINE)


def _starts(body: Body, hips: Floats) -> list[Pose]:
    """Poses to begin from: every heading, with the arms in every place."""
    poses = list[Pose]()
    for heading in range(HEADINGS):
        for raised in ARMS:
            turns = np.zeros((len(body), 3))
            turns[0, 1] = 2 * np.pi * heading / HEADINGS
            turns[body.names.index("LeftArm"), 2] = raised
            turns[body.names.index("RightArm"), 2] = -raised
            poses.append(Pose(articulation.exp(turns), hips - body.origins[0]))
    return poses


def _growth(tracker: body_tracking.Tracker, found: body_tracking.Fit, data: body_tracking.Data) -> float:
    """How much larger the body should be: the factor about the hips that brings its surface nearest to the points."""
    a, b = articulation.transforms(tracker.body, found.pose)
    row = tracker.nearest(data, found.pose)
    centre = a[0] @ tracker.body.origins[0] + b[0]
    normal = np.einsum("nij,nj->ni", a[tracker.skin.links[row, 0]], tracker.normals[row])
    ours = np.sum(normal * (tracker.skin.posed(a, b, row) - centre), axis=1)
    theirs = np.sum(normal * (data.points - centre), axis=1)
    near = found.residuals < 0.1
    if near.sum() < 50:
        return 1.0
    return float(np.clip(np.sum(ours[near] * theirs[near]) / np.sum(ours[near] ** 2), 0.85, 1.15))


def _root(body: Body, before: Body, pose: Pose) -> Floats:
    """The root's translation that puts the hips where they were."""
    return pose.root + before.origins[0] - body.origins[0]


def _figure(body: Body, found: body_tracking.Fit, turn: Floats) -> Figure:
    a, b = articulation.transforms(body, found.pose)
    joints = articulation.joints_of(body, a, b)
    ends = [link for link in range(len(body)) if link not in body.parents]
    tips = np.array([a[link] @ body.tips[link] + b[link] for link in ends])
    names = (*body.names, *(f"{body.names[link]}Tip" for link in ends))
    error = float(np.minimum(found.residuals, 0.3).mean())
    return Figure(names, (*body.parents, *ends), np.concatenate([joints, tips]) @ turn, error)


def require_near(body: Body, points: Floats) -> None:
    """Raises BadInput for a skeleton that does not stand in the points (n, 3)."""
    from scipy.spatial import KDTree

    middles = (body.origins + body.tips) / 2
    away, _ = KDTree(points).query(middles)
    if np.median(away) > FARTHEST:
        gap = f"{np.median(away):.2f} m"
        raise BadInput(f"the skeleton is {gap} from the first frame's points: it must have its place, pose and unit")
