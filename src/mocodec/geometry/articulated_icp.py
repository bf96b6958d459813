"""ARTICP: a skeleton of cylinders fitted to points link by link, then as a whole (Lien and Bajcsy 2006, section 3).

data ──cluster──► tree ──► from the root down: ICP of each link about its joint, applied to its whole subtree
                               │
                 segment the data, compare third moments with the model's ──► ICP again for links with large errors
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import native
from ..typing import AnyInteger, Booleans, Bytes, Floats
from . import icp
from .articulation import Body, Pose, joint_positions, pose_from_world, transforms
from .normals import estimate, outward

CYLINDER_ROUNDS, SHAPE_ROUNDS = 3, 5
"""Rounds of assigning points to links and fitting the links' surfaces: to cylinders, then to harmonic shapes."""
MIN_SHAPE_POINTS = 30
"""Points that a link must have for a shape of its own; otherwise it is a cylinder."""
SHAPE_NOISE_M = 0.02
"""Residual at which a point counts half when a shape is fitted, metres."""
BEYOND_WEIGHT, ACROSS_M = 0.5, 0.05
"""In the distance of a surface: the weight of what is beyond the ends of its axis, and what a surface across the
point's normal adds, metres."""
MIN_CYLINDER_POINTS = 20
"""Points that a link must have for its radius to be fitted."""
MIN_RADIUS_M, MAX_RADIUS_M, MIN_LENGTH_M = 0.02, 0.25, 0.04
"""Limits of fitted cylinders, metres."""
PAIR_RADIUS_RATIO = 1.1
"""A limb is at most this much thicker than its mirrored one."""
MIN_ICP_POINTS = 6
"""Model points that a link must have for an ICP."""
MIN_GLOBAL_POINTS, MIN_REFIT_POINTS = 8, 10
"""Data points that a link must have for a global error, and to be fitted again because of it."""
MIN_FRAME_POINTS = 10
"""A frame of fewer points leaves the pose as it is."""


@dataclass(frozen=True, eq=False)
class CylinderModel:
    """Points P of the first frame: positions (n, 3), metres, and normals (n, 3) in the canonical pose, colours (n, 3),
    and the link of each (n,).
    """

    points: Floats
    normals: Floats
    colours: Bytes | None
    links: AnyInteger


def closeness(body: Body, a: Floats, b: Floats, points: Floats, normals: Floats | None) -> Floats:
    """(links, n): equation (4), the closeness of each point to each link: 1 inside the cylinder, falling to 0 outside.

    0 if the normal points towards the link's axis. The paper leaves open to which of several overlapping cylinders a
    point belongs. Here closeness inside rises to 2 at the axis, so that the cylinder counts in which the point is
    deepest, relative to the radius.
    """
    radial, foot, beyond = _cylindrical(body, a, b, points)
    radii = body.radii[:, None]
    distance = np.hypot(np.maximum(radial - radii, 0), beyond)
    result = np.where(distance <= 0, 1.0 + np.maximum(1 - radial / radii, 0), np.exp(-distance / radii))
    if normals is not None:
        result[_facing(body, a, b, points, normals, foot) <= 0] = 0.0
    return result


def _cylindrical(body: Body, a: Floats, b: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    """(links, n) each, metres: points' distance from the line through each link's axis, the place along the axis that
    is closest to them, and how far they are beyond the axis's ends.
    """
    origins, axes, _, _ = _cylinders(body, a, b)
    along = axes @ points.T - np.sum(axes * origins, axis=1)[:, None]
    square = np.sum(points**2, axis=1) - 2 * origins @ points.T + np.sum(origins**2, axis=1)[:, None]
    foot = np.clip(along, 0, body.lengths[:, None])
    return np.sqrt(np.maximum(square - along**2, 0)), foot, along - foot


def _cylinders(body: Body, a: Floats, b: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """The posed cylinders as the compiled module takes them: joints and axes (links, 3), lengths and radii (links,)."""
    return joint_positions(body, a, b), np.einsum("lij,lj->li", a, body.axes), body.lengths, body.radii


def _facing(body: Body, a: Floats, b: Floats, points: Floats, directions: Floats, foot: Floats) -> Floats:
    """(links, n): positive where directions (n, 3) point away from a link's axis; `foot` as `_cylindrical` gives it."""
    origins, axes, _, _ = _cylinders(body, a, b)
    return np.sum(points * directions, axis=1) - origins @ directions.T - foot * (axes @ directions.T)


def outward_normals(body: Body, a: Floats, b: Floats, points: Floats, among: Floats | None = None) -> Floats:
    """(n, 3): unit normals of points (n, 3), pointing away from the axis of the link with the nearest surface.

    among (m, 3): all the points of the frame, from which normals are estimated; `points` unless given.
    """
    n = estimate(points, among)
    if (kernel := native.kernel("turned_outward")) is not None:
        return np.asarray(kernel(points, n, *_cylinders(body, a, b)))
    radial, foot, beyond = _cylindrical(body, a, b, points)
    nearest = (np.hypot(radial, beyond) - body.radii[:, None]).argmin(axis=0)
    facing = np.take_along_axis(_facing(body, a, b, points, n, foot), nearest[None], axis=0)[0]
    return np.where(facing[:, None] < 0, -n, n)


def segment(body: Body, a: Floats, b: Floats, points: Floats, normals: Floats | None) -> AnyInteger:
    """(n,): the link of greatest closeness to each point (section 3.1).

    For a point whose normal faces every link's axis, the normal is ignored.
    """
    if (kernel := native.kernel("closest_links")) is not None:
        of_points = np.zeros((0, 3)) if normals is None else normals
        return np.asarray(kernel(points, of_points, *_cylinders(body, a, b)))
    close = closeness(body, a, b, points, normals)
    faces_all = close.max(axis=0) <= 0
    if faces_all.any():
        close[:, faces_all] = closeness(body, a, b, points[faces_all], None)
    return close.argmax(axis=0)


def make_model(
    body: Body,
    points: Floats,
    colours: Bytes | None,
    normals: Floats | None = None,
    by_surface: bool = False,
    among: Floats | None = None,
) -> tuple[Body, CylinderModel]:
    """The body with radii and lengths fitted to the points (n, 3) of the first frame, and the model of these points.

    normals (n, 3): estimated from `among` (m, 3), all the points of the frame, unless given. by_surface: assign points
    to the link with the nearest surface in metres, and not by equation (4), which favours thick links: it would assign
    a hand beside the thigh to the thigh.
    """
    a, b = transforms(body, Pose.canonical(len(body)))
    if by_surface:
        n = outward(points, neighbours=10) if normals is None else normals
        for _ in range(CYLINDER_ROUNDS):
            links = nearest_surface(body, points, n)
            body = fit_cylinders(body, points, links, paired=True)
        links = nearest_surface(body, points, n)
        for _ in range(SHAPE_ROUNDS):
            links = nearest_surface(body, points, n, surface_shapes(body, points, links))
        return fit_cylinders(body, points, links, paired=True), CylinderModel(points, n, colours, links)
    n = outward_normals(body, a, b, points, among) if normals is None else normals
    for _ in range(2):
        body = fit_cylinders(body, points, segment(body, a, b, points, n))
    return body, CylinderModel(points, n, colours, segment(body, a, b, points, n))


def is_near(body: Body, points: Floats, within: float = 0.15) -> Booleans:
    """(n,): whether canonical points (n, 3) are within a distance of any link's cylinder, metres."""
    offset = points[None] - body.origins[:, None]
    foot = np.clip(np.einsum("lni,li->ln", offset, body.axes), 0, body.lengths[:, None])
    away = np.linalg.norm(offset - foot[..., None] * body.axes[:, None], axis=2)
    return (away - body.radii[:, None]).min(axis=0) < within


def nearest_surface(body: Body, points: Floats, normals: Floats, shapes: Floats | None = None) -> AnyInteger:
    """(n,): the link with the nearest surface to each canonical point (n, 3): a cylinder, or of `shapes` as
    `surface_shapes` returns them. Links whose surface faces across the point's normal count as farther.
    """
    if (kernel := native.kernel("nearest_surfaces")) is not None:
        given = np.zeros((0, 10)) if shapes is None else shapes
        cylinders = body.origins, body.axes, body.lengths, body.radii
        return np.asarray(kernel(points, normals, *cylinders, given, BEYOND_WEIGHT, ACROSS_M))
    offset = points[None] - body.origins[:, None]
    along = np.einsum("lni,li->ln", offset, body.axes)
    foot = np.clip(along, 0, body.lengths[:, None])
    out = offset - foot[..., None] * body.axes[:, None]
    away = np.linalg.norm(out, axis=2)
    radius = body.radii[:, None]
    if shapes is not None:
        radius = np.einsum("kln,lk->ln", _harmonics(offset, body.axes[:, None], body.lengths[:, None]), shapes)
    distance = np.abs(away - radius) + BEYOND_WEIGHT * np.abs(along - foot)
    facing = np.einsum("lni,ni->ln", out, normals) / np.maximum(away, 1e-6)
    return (distance + ACROSS_M * (1 - np.abs(facing))).argmin(axis=0)


def surface_shapes(body: Body, points: Floats, links: AnyInteger, prior_points: float = 12.0) -> Floats:
    """(links, 10): the distance of each link's surface from its axis as coefficients of harmonics around and along it.

    A trunk is not a cylinder: its shape separates its own points from those of a forearm that rests on it. Fitted
    robustly, with a prior towards the cylinder that weighs as much as `prior_points` points.
    """
    shapes = np.zeros((len(body), 10))
    shapes[:, 0] = body.radii
    order = np.argsort(links, kind="stable")
    offset, axes, lengths = (points - body.origins[links])[order], body.axes[links[order]], body.lengths[links[order]]
    foot = np.clip(np.sum(offset * axes, axis=1), 0, lengths)
    radial = np.linalg.norm(offset - foot[:, None] * axes, axis=1)
    harmonics, ridge = _harmonics(offset, axes, lengths), np.diag([0.1, *[prior_points] * 9])
    ends = np.searchsorted(links[order], np.arange(len(body) + 1))
    for link in range(len(body)):
        own = slice(ends[link], ends[link + 1])
        if own.stop - own.start < MIN_SHAPE_POINTS:
            continue
        basis, target = harmonics[:, own], ridge @ shapes[link]
        for _ in range(4):
            residual = radial[own] - shapes[link] @ basis
            weighted = basis / (1 + (residual / SHAPE_NOISE_M) ** 2)
            shapes[link] = np.linalg.solve(weighted @ basis.T + ridge, weighted @ radial[own] + target)
    return shapes


def _harmonics(offset: Floats, axes: Floats, lengths: Floats) -> Floats:
    """(10, …): 1, cos θ, sin θ, cos 2θ, sin 2θ, then these times the place along the axis, −1 to 1, of offsets (…, 3)
    from the origins of links with axes (…, 3) and lengths (…).
    """
    side = np.cross(axes, np.where(np.abs(axes[..., :1]) < 0.9, [1.0, 0, 0], [0, 1.0, 0]))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    x, y, along = (np.einsum("...i,...i->...", offset, u) for u in (side, np.cross(axes, side), axes))
    share = np.clip(along / lengths, 0, 1) * 2 - 1
    radial = np.sqrt(x * x + y * y)
    divisor = np.where(radial > 0, radial, 1.0)
    cos, sin = np.where(radial > 0, x, 1.0) / divisor, y / divisor
    around = np.stack([np.ones_like(x), cos, sin, cos * cos - sin * sin, 2 * sin * cos])
    return np.concatenate([around, around * share])


def mirrored_links(body: Body) -> list[tuple[int, int]]:
    """Pairs of links that are left and right of each other: of equal depth, equal length and equally large subtrees."""
    depth = np.zeros(len(body), int)
    for link, parent in enumerate(body.parents):
        depth[link] = depth[parent] + 1 if parent >= 0 else 0
    below = body.ancestors.sum(axis=1)
    pairs = list[tuple[int, int]]()
    for one in range(len(body)):
        same = (depth == depth[one]) & (below == below[one])
        same &= np.abs(body.lengths - body.lengths[one]) < 0.06 * body.lengths[one]
        if same.sum() == 2 and one == np.flatnonzero(same)[0]:
            pairs.append((one, int(np.flatnonzero(same)[1])))
    return pairs


def fit_cylinders(body: Body, points: Floats, links: AnyInteger, paired: bool = False) -> Body:
    """The body with each link's radius set to the median distance of its points from its axis, and each leaf's length
    to the extent of its points; links with few points keep theirs.

    paired: limit the radius of a limb by that of its mirrored one: a thicker limb has points of what it touches.
    """
    radii, tips, axes, lengths = body.radii.copy(), body.tips.copy(), body.axes, body.lengths
    fitted = np.zeros(len(body), bool)
    leaf = ~np.isin(np.arange(len(body)), body.parents)
    for link in range(len(body)):
        own = points[links == link] - body.origins[link]
        if len(own) < MIN_CYLINDER_POINTS:
            continue
        along = own @ axes[link]
        radial = np.linalg.norm(own - along[:, None] * axes[link], axis=1)
        radii[link] = np.clip(np.median(radial), MIN_RADIUS_M, MAX_RADIUS_M)
        fitted[link] = True
        if leaf[link]:
            length = np.clip(np.percentile(along, 97), MIN_LENGTH_M, 2.0 * lengths[link])
            tips[link] = body.origins[link] + length * axes[link]
    if paired:
        for one, other in mirrored_links(body):
            if fitted[one] and fitted[other]:
                radii[[one, other]] = np.minimum(radii[[one, other]], PAIR_RADIUS_RATIO * radii[[other, one]])
    return Body(body.names, body.parents, body.origins, tips, radii, body.joints)


def third_moments(points: Floats, links: AnyInteger, count: int) -> Floats:
    """(count, 3, 3, 3): μ3 of every link, cubic metres: the mean of x ⊗ x ⊗ x over its points (n, 3), relative to the
    link's centre; zero without points.
    """
    if (kernel := native.kernel("third_moments")) is not None:
        return np.asarray(kernel(points, links, count))
    moments, points_of = np.empty((count, 3, 3, 3)), np.maximum(np.bincount(links, minlength=count), 1)
    for i, j, k in itertools.combinations_with_replacement(range(3), 3):
        product = points[:, i] * points[:, j] * points[:, k]
        mean = np.bincount(links, product, count) / points_of
        for order in itertools.permutations((i, j, k)):
            moments[:, *order] = mean
    return moments


def global_errors(body: Body, a: Floats, b: Floats, moments: Floats, points: Floats, links: AnyInteger) -> Floats:
    """(links,): equation (5) for each link, |μ3(P_l) − μ3(Q_l)| in the link's own frame, as a cube root relative to the
    link's size; ∞ for links with few data points. moments (links, 3, 3, 3): of the model.
    """
    local = np.einsum("nji,nj->ni", a[links], points - b[links]) - ((body.origins + body.tips) / 2)[links]
    difference = third_moments(local, links, len(body)) - moments
    errors = np.cbrt(np.linalg.norm(difference.reshape(len(body), -1), axis=1)) / np.hypot(body.lengths / 2, body.radii)
    return np.where(np.bincount(links, minlength=len(body)) >= MIN_GLOBAL_POINTS, errors, np.inf)


@dataclass(frozen=True)
class ArticpSettings:
    """How ARTICP runs. iterations: of each ICP. threshold: links with a global error above it are fitted again; two
    samples of the same surface differ by a good part of it. rounds: of that, at most. articulation: links turn about
    their joints; otherwise they move freely. global_fitting: section 3.4.
    """

    iterations: int = 12
    threshold: float = 0.8
    rounds: int = 3
    articulation: bool = True
    global_fitting: bool = True


class ArticpTracker:
    """Follows the body of a model through frames of points: ARTICP(S, Q) for each, from the pose of the last."""

    def __init__(self, body: Body, model: CylinderModel, settings: ArticpSettings | None = None) -> None:
        self.body, self.model, self.settings = body, model, settings or ArticpSettings()
        self.pose = Pose.canonical(len(body))
        self.subtrees = body.ancestors
        depth = body.ancestors.sum(axis=0)
        self.levels = [np.flatnonzero(depth == level).tolist() for level in range(1, depth.max() + 1)]
        self.rows_of_link = [np.flatnonzero(model.links == link) for link in range(len(body))]
        self.rows = np.concatenate(self.rows_of_link)
        self.points = model.points[self.rows]
        self.starts = np.cumsum([0, *map(len, self.rows_of_link)])
        self.colour_cluster = None if model.colours is None else icp.colour_cluster(model.colours)
        self.is_free = np.array([not (link and self.settings.articulation) for link in range(len(body))])
        centres = (body.origins + body.tips) / 2
        self.moments = third_moments(model.points - centres[model.links], model.links, len(body))

    def fit(
        self,
        points: Floats,
        colours: Bytes | None,
        normals: Floats | None = None,
        among: Floats | None = None,
    ) -> Pose:
        """Algorithm 3.1 on one frame of points (n, 3), metres; a frame of fewer than 10 points leaves the pose as it
        is.

        normals (n, 3): estimated from `among` (m, 3), all the points of the frame, unless given.
        """
        if len(points) < MIN_FRAME_POINTS:
            return self.pose
        body, model = self.body, self.model
        a, b = transforms(body, self.pose)
        n = outward_normals(body, a, b, points, among) if normals is None else normals
        model_normals = np.einsum("nij,nj->ni", a[model.links], model.normals)
        label = icp.labels(model_normals, None if colours is None else self.colour_cluster, len(model.points))
        tree = icp.ClusteredTree.build(points, n, None if model.colours is None else colours, label)
        self._fit_links(self.levels, a, b, label, tree)
        if self.settings.global_fitting:
            self._fit_globally(a, b, points, n, colours, label)
        self.pose = self._to_pose(a, b)
        return self.pose

    def _fit_links(
        self, levels: Sequence[Sequence[int]], a: Floats, b: Floats, label: AnyInteger, tree: icp.ClusteredTree
    ) -> None:
        """ICP of links, level by level: the paper's queue. The transform of each moves its whole subtree, in place."""
        levels = [[link for link in level if len(self.rows_of_link[link]) >= MIN_ICP_POINTS] for level in levels]
        if (compiled := tree.compiled) is not None:
            compiled.fit_links(
                a, b, np.array(list(itertools.chain(*levels)), np.int64), self.points, self.starts,
                tree.allowed(label[self.rows]), self.body.origins, self.is_free.view(np.uint8),
                self.subtrees.view(np.uint8), self.settings.iterations, icp.TOLERANCE_M,
            )  # fmt: skip
            return
        for level in levels:
            if level:
                self._fit_level(level, a, b, label, tree)

    def _fit_level(
        self, links: Sequence[int], a: Floats, b: Floats, label: AnyInteger, tree: icp.ClusteredTree
    ) -> None:
        """`_fit_links` of links of one level, which do not move one another, at once."""
        rows = np.concatenate([self.rows_of_link[link] for link in links])
        owner = self.model.links[rows]
        moved = np.einsum("nij,nj->ni", a[owner], self.model.points[rows]) + b[owner]
        pivots = np.einsum("lij,lj->li", a[links], self.body.origins[links]) + b[links]
        pivots[self.is_free[links]] = np.nan
        sizes = [len(self.rows_of_link[link]) for link in links]
        r, t, _ = icp.icp_many(moved, label[rows], sizes, tree, pivots, iterations=self.settings.iterations)
        for i, link in enumerate(links):
            subtree = self.subtrees[link]
            a[subtree], b[subtree] = r[i] @ a[subtree], b[subtree] @ r[i].T + t[i]

    def _fit_globally(
        self, a: Floats, b: Floats, points: Floats, normals: Floats, colours: Bytes | None, label: AnyInteger
    ) -> None:
        """Section 3.4: segment the data, and fit links with large errors to their own points, in place.

        Stops when the total error rises, and restores the transforms with the smallest error.
        """
        best, best_transforms = np.inf, (a.copy(), b.copy())
        for number in range(self.settings.rounds + 1):
            links = segment(self.body, a, b, points, normals)
            errors = global_errors(self.body, a, b, self.moments, points, links)
            total = float(np.minimum(errors, 1.0).sum())
            if total >= best:
                break
            best, best_transforms = total, (a.copy(), b.copy())
            bad = (errors > self.settings.threshold) & (np.bincount(links, minlength=len(errors)) >= MIN_REFIT_POINTS)
            if number == self.settings.rounds or not bad.any():
                break
            own = icp.ClusteredTree.of_groups(points, links, len(errors))
            wanted = [[link for link in level if bad[link]] for level in self.levels]
            self._fit_links(wanted, a, b, self.model.links, own)
        a[:], b[:] = best_transforms

    def _to_pose(self, a: Floats, b: Floats) -> Pose:
        return pose_from_world(self.body, a, a[0] @ self.body.origins[0] + b[0])
