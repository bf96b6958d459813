"""ARTICP: a skeleton of cylinders fitted to points link by link, then as a whole (Lien and Bajcsy 2006, section 3).

data ──cluster──► tree ──► queue from the root: ICP of each link about its joint, its transform applied to all below
                               │
                 segment the data, compare third moments with the model's ──► ICP again of the links that are off
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import icp
from .articulation import Body, Floats, Pose, from_world, joints_of, transforms
from .normals import estimate, outward

Labels = NDArray[Any]
ROUNDS = 5  # of fitting surfaces to links and giving points to the nearest


@dataclass(frozen=True, eq=False)
class Model:
    """Points P of the first frame with their links: positions (n, 3) and normals in the canonical pose, colours,
    links (n,).
    """

    points: Floats
    normals: Floats
    colours: NDArray[np.uint8] | None
    links: Labels


def closeness(body: Body, a: Floats, b: Floats, points: Floats, normals: Floats | None) -> Floats:
    """(links, n): equation (4), how close each point is to each link: 1 inside the cylinder, falling to 0 away from it.

    0 where the normal points at the link. Among links that a point lies inside of, the one whose axis is nearest by
    its radius counts most: the paper leaves ties open, so 1 becomes 1 + the share of the radius that is left.
    """
    away, foot, beyond = _cylindrical(body, a, b, points)
    radii = body.radii[:, None]
    distance = np.hypot(np.maximum(away - radii, 0), beyond)
    result = np.where(distance <= 0, 1.0 + np.maximum(1 - away / radii, 0), np.exp(-distance / radii))
    if normals is not None:
        result[_facing(body, a, b, points, normals, foot) <= 0] = 0.0
    return result


def _cylindrical(body: Body, a: Floats, b: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    """(links, n) each: points' distance from each link's line, the place of the closest point on its axis, and how far
    they are beyond the axis's ends."""
    origins, axes = joints_of(body, a, b), np.einsum("lij,lj->li", a, body.axes)
    along = axes @ points.T - np.sum(axes * origins, axis=1)[:, None]
    square = np.sum(points**2, axis=1) - 2 * origins @ points.T + np.sum(origins**2, axis=1)[:, None]
    foot = np.clip(along, 0, body.lengths[:, None])
    return np.sqrt(np.maximum(square - along**2, 0)), foot, along - foot


def _facing(body: Body, a: Floats, b: Floats, points: Floats, directions: Floats, foot: Floats) -> Floats:
    """(links, n): how far directions (n, 3) lead away from the links' axes, of which `foot` are the closest points."""
    origins, axes = joints_of(body, a, b), np.einsum("lij,lj->li", a, body.axes)
    return np.sum(points * directions, axis=1) - origins @ directions.T - foot * (axes @ directions.T)


def turned_out(body: Body, a: Floats, b: Floats, points: Floats, among: Floats | None = None) -> Floats:
    """(n, 3) unit normals, estimated among all the points of the frame, that turn away from the axis of the link whose
    surface is nearest.
    """
    n = estimate(points, among)
    away, foot, beyond = _cylindrical(body, a, b, points)
    nearest = (np.hypot(away, beyond) - body.radii[:, None]).argmin(axis=0)
    facing = np.take_along_axis(_facing(body, a, b, points, n, foot), nearest[None], axis=0)[0]
    return np.where(facing[:, None] < 0, -n, n)


def segment(body: Body, a: Floats, b: Floats, points: Floats, normals: Floats | None) -> Labels:
    """(n,): the link that each point is associated with: the one of greatest closeness (section 3.1).

    A point that turns away from every link goes to the closest, as if it had no normal.
    """
    close = closeness(body, a, b, points, normals)
    lost = close.max(axis=0) <= 0
    if lost.any():
        close[:, lost] = closeness(body, a, b, points[lost], None)
    return close.argmax(axis=0)


def make_model(
    body: Body,
    points: Floats,
    colours: NDArray[np.uint8] | None,
    normals: Floats | None = None,
    by_surface: bool = False,
    among: Floats | None = None,
) -> tuple[Body, Model]:
    """The model of the first frame: its points by links; and the body with radii and lengths that fit them.

    among (m, 3): all the points of the frame, from which normals are estimated where there are none.

    by_surface: points go to the link whose surface is nearest, in metres, not by equation (4), which favours thick
    links and gives them a hand that hangs beside a thigh.
    """
    a, b = transforms(body, Pose.canonical(len(body)))
    if by_surface:
        n = outward(points, neighbours=10) if normals is None else normals
        for _ in range(3):
            links = nearest_surface(body, points, n)
            body = fit_cylinders(body, points, links, paired=True)
        links = nearest_surface(body, points, n)
        for _ in range(ROUNDS):
            links = nearest_surface(body, points, n, surface_shapes(body, points, links))
        return fit_cylinders(body, points, links, paired=True), Model(points, n, colours, links)
    n = turned_out(body, a, b, points, among) if normals is None else normals
    for _ in range(2):
        body = fit_cylinders(body, points, segment(body, a, b, points, n))
    return body, Model(points, n, colours, segment(body, a, b, points, n))


def is_near(body: Body, points: Floats, within: float = 0.15) -> NDArray[np.bool_]:
    """(n,): whether canonical points are within so many metres of a link's cylinder."""
    offset = points[None] - body.origins[:, None]
    foot = np.clip(np.einsum("lni,li->ln", offset, body.axes), 0, body.lengths[:, None])
    away = np.linalg.norm(offset - foot[..., None] * body.axes[:, None], axis=2)
    return (away - body.radii[:, None]).min(axis=0) < within


def nearest_surface(body: Body, points: Floats, normals: Floats, shapes: Floats | None = None) -> Labels:
    """(n,): the link whose surface each canonical point is nearest to, and on whose outside it is: its cylinder's, or
    that of `surface_shapes`.
    """
    offset = points[None] - body.origins[:, None]
    along = np.einsum("lni,li->ln", offset, body.axes)
    foot = np.clip(along, 0, body.lengths[:, None])
    out = offset - foot[..., None] * body.axes[:, None]
    away = np.linalg.norm(out, axis=2)
    radius = body.radii[:, None]
    if shapes is not None:
        radius = np.einsum("kln,lk->ln", _harmonics(offset, body.axes[:, None], body.lengths[:, None]), shapes)
    distance = np.abs(away - radius) + 0.5 * np.abs(along - foot)
    facing = np.einsum("lni,ni->ln", out, normals) / np.maximum(away, 1e-6)
    return (distance + 0.05 * (1 - np.abs(facing))).argmin(axis=0)


def surface_shapes(body: Body, points: Floats, links: Labels, stiff: float = 12.0) -> Floats:
    """(links, 10): each link's distance of surface from axis as harmonics around and along it, from its points.

    A trunk is no cylinder: where a forearm rests on it, this says which points are still trunk's. Robust; what differs
    from a cylinder is held back as `stiff` points would.
    """
    shapes = np.zeros((len(body), 10))
    shapes[:, 0] = body.radii
    order = np.argsort(links, kind="stable")
    offset, axes, lengths = (points - body.origins[links])[order], body.axes[links[order]], body.lengths[links[order]]
    foot = np.clip(np.sum(offset * axes, axis=1), 0, lengths)
    away = np.linalg.norm(offset - foot[:, None] * axes, axis=1)
    harmonics, ridge = _harmonics(offset, axes, lengths), np.diag([0.1, *[stiff] * 9])
    ends = np.searchsorted(links[order], np.arange(len(body) + 1))
    for link in range(len(body)):
        own = slice(ends[link], ends[link + 1])
        if own.stop - own.start < 30:
            continue
        basis, target = harmonics[:, own], ridge @ shapes[link]
        for _ in range(4):
            off = away[own] - shapes[link] @ basis
            weighted = basis / (1 + (off / 0.02) ** 2)
            shapes[link] = np.linalg.solve(weighted @ basis.T + ridge, weighted @ away[own] + target)
    return shapes


def _harmonics(offset: Floats, axes: Floats, lengths: Floats) -> Floats:
    """(10, …): 1, cos, sin, cos 2θ, sin 2θ around links' axes (…, 3), then times the place along them, −1 to 1, of
    offsets (…, 3) from their origins.
    """
    side = np.cross(axes, np.where(np.abs(axes[..., :1]) < 0.9, [1.0, 0, 0], [0, 1.0, 0]))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    x, y, along = (np.einsum("...i,...i->...", offset, u) for u in (side, np.cross(axes, side), axes))
    share = np.clip(along / lengths, 0, 1) * 2 - 1
    away = np.sqrt(x * x + y * y)
    some = np.where(away > 0, away, 1.0)
    cos, sin = np.where(away > 0, x, 1.0) / some, y / some
    around = np.stack([np.ones_like(x), cos, sin, cos * cos - sin * sin, 2 * sin * cos])
    return np.concatenate([around, around * share])


def mirrored(body: Body) -> list[tuple[int, int]]:
    """Pairs of links that are left and right of each other: as deep in the tree, as long, with as much below."""
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


def fit_cylinders(body: Body, points: Floats, links: Labels, paired: bool = False) -> Body:
    """The body with each link's radius the median distance of its points from its axis; links without points stay.

    paired: an arm or leg is hardly thicker than the other: what it touches has been taken for a part of it.
    """
    radii, tips = body.radii.copy(), body.tips.copy()
    fitted = np.zeros(len(body), bool)
    leaf = ~np.isin(np.arange(len(body)), body.parents)
    for link in range(len(body)):
        own = points[links == link] - body.origins[link]
        if len(own) < 20:
            continue
        along = own @ body.axes[link]
        away = np.linalg.norm(own - along[:, None] * body.axes[link], axis=1)
        radii[link] = np.clip(np.median(away), 0.02, 0.25)
        fitted[link] = True
        if leaf[link]:
            length = np.clip(np.percentile(along, 97), 0.04, 2.0 * body.lengths[link])
            tips[link] = body.origins[link] + length * body.axes[link]
    if paired:
        for one, other in mirrored(body):
            if fitted[one] and fitted[other]:
                radii[[one, other]] = np.minimum(radii[[one, other]], 1.1 * radii[[other, one]])
    return Body(body.names, body.parents, body.origins, tips, radii, body.joints)


def third_moments(points: Floats, links: Labels, count: int) -> Floats:
    """(count, 3, 3, 3): μ3 of every link's points (n, 3), which are given from its middle: the mean of x ⊗ x ⊗ x, cubic
    metres; zero without points."""
    moments, many = np.empty((count, 3, 3, 3)), np.maximum(np.bincount(links, minlength=count), 1)
    for i, j, k in itertools.combinations_with_replacement(range(3), 3):
        product = points[:, i] * points[:, j] * points[:, k]
        mean = np.bincount(links, product, count) / many
        for order in itertools.permutations((i, j, k)):
            moments[:, *order] = mean
    return moments


def global_errors(
    body: Body, a: Floats, b: Floats, moments: Floats, points: Floats, links: Labels, *, fewest: int = 8
) -> Floats:
    """(links,): equation (5) by links, |μ3(P_l) − μ3(Q_l)| in the link's own frame; its cube root, by the link's size.

    moments (links, 3, 3, 3): of the model. Links with fewer than `fewest` data points count as ∞.
    """
    local = np.einsum("nji,nj->ni", a[links], points - b[links]) - ((body.origins + body.tips) / 2)[links]
    difference = third_moments(local, links, len(body)) - moments
    errors = np.cbrt(np.linalg.norm(difference.reshape(len(body), -1), axis=1)) / np.hypot(body.lengths / 2, body.radii)
    return np.where(np.bincount(links, minlength=len(body)) >= fewest, errors, np.inf)


FEWEST = 6  # points that a link must have to be fitted


@dataclass(frozen=True)
class Settings:
    """How ARTICP runs. threshold: links whose global error is above it are fitted again, and two samples of one surface
    differ by much of it; rounds: how often at most.
    """

    iterations: int = 12
    threshold: float = 0.8
    rounds: int = 3
    articulation: bool = True
    global_fitting: bool = True


class Tracker:
    """Follows the body of a model through frames of points: ARTICP(S, Q) for each, from where the last one left it."""

    def __init__(self, body: Body, model: Model, settings: Settings | None = None) -> None:
        self.body, self.model, self.settings = body, model, settings or Settings()
        self.pose = Pose.canonical(len(body))
        self.below = body.ancestors
        depth = body.ancestors.sum(axis=0)
        self.levels = [np.flatnonzero(depth == level).tolist() for level in range(1, depth.max() + 1)]
        self.members = [np.flatnonzero(model.links == link) for link in range(len(body))]
        centres = (body.origins + body.tips) / 2
        self.moments = third_moments(model.points - centres[model.links], model.links, len(body))

    def fit(
        self,
        points: Floats,
        colours: NDArray[np.uint8] | None,
        normals: Floats | None = None,
        among: Floats | None = None,
    ) -> Pose:
        """Algorithm 3.1 on one frame of points (n, 3), metres. Frames of fewer than 10 points leave the pose as it
        was.

        among (m, 3): all the points of the frame, from which normals are estimated where there are none.
        """
        if len(points) < 10:
            return self.pose
        body, model = self.body, self.model
        a, b = transforms(body, self.pose)
        n = turned_out(body, a, b, points, among) if normals is None else normals
        turned = np.einsum("nij,nj->ni", a[model.links], model.normals)
        label = icp.labels(turned, None if colours is None else model.colours, len(model.points))
        tree = icp.ClusteredTree.build(points, n, None if model.colours is None else colours, label)
        for links in self.levels:  # the queue, a parent before its children: links of a level do not move one another
            self._fit_links(links, a, b, label, tree)
        if self.settings.global_fitting:
            self._fit_globally(a, b, points, n, colours, label)
        self.pose = self._to_pose(a, b)
        return self.pose

    def _fit_links(self, links: Sequence[int], a: Floats, b: Floats, label: Labels, tree: icp.ClusteredTree) -> None:
        """ICP of links; the transform of each moves it and all below it."""
        links = [link for link in links if len(self.members[link]) >= FEWEST]
        if not links:
            return
        rows = np.concatenate([self.members[link] for link in links])
        owner = self.model.links[rows]
        moved = np.einsum("nij,nj->ni", a[owner], self.model.points[rows]) + b[owner]
        pivots = np.einsum("lij,lj->li", a[links], self.body.origins[links]) + b[links]
        pivots[[not (link and self.settings.articulation) for link in links]] = np.nan
        sizes = [len(self.members[link]) for link in links]
        r, t, _ = icp.icp_many(moved, label[rows], sizes, tree, pivots, iterations=self.settings.iterations)
        for i, link in enumerate(links):
            below = self.below[link]
            a[below], b[below] = r[i] @ a[below], b[below] @ r[i].T + t[i]

    def _fit_globally(
        self, a: Floats, b: Floats, points: Floats, normals: Floats, colours: NDArray[Any] | None, label: Labels
    ) -> None:
        """Section 3.4: segment the data, and match links with intolerable errors to the points that are theirs.

        Of the states on the way the one with the least error stays: a step that makes it larger is taken back.
        """
        best, kept = np.inf, (a.copy(), b.copy())
        for turn in range(self.settings.rounds + 1):
            links = segment(self.body, a, b, points, normals)
            errors = global_errors(self.body, a, b, self.moments, points, links)
            total = float(np.minimum(errors, 1.0).sum())
            if total >= best:
                break
            best, kept = total, (a.copy(), b.copy())
            bad = (errors > self.settings.threshold) & (np.bincount(links, minlength=len(errors)) >= 10)
            if turn == self.settings.rounds or not bad.any():
                break
            own = icp.ClusteredTree.of_groups(points, links, len(errors))
            for level in self.levels:
                self._fit_links([link for link in level if bad[link]], a, b, self.model.links, own)
        a[:], b[:] = kept

    def _to_pose(self, a: Floats, b: Floats) -> Pose:
        return from_world(self.body, a, a[0] @ self.body.origins[0] + b[0])
