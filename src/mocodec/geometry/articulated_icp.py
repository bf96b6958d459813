"""ARTICP: a skeleton of cylinders fitted to points link by link, then as a whole (Lien and Bajcsy 2006, section 3).

data ──cluster──► tree ──► queue from the root: ICP of each link about its joint, its transform applied to all below
                               │
                 segment the data, compare third moments with the model's ──► ICP again of the links that are off
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import icp
from .articulation import Body, Floats, Pose, from_world, joints_of, transforms
from .normals import estimate

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
    origins = joints_of(body, a, b)
    axes = np.einsum("lij,lj->li", a, body.axes)
    offset = points[None] - origins[:, None]
    along = np.einsum("lni,li->ln", offset, axes)
    foot = np.clip(along, 0, body.lengths[:, None])
    radial = offset - along[..., None] * axes[:, None]
    away = np.sqrt(np.einsum("lni,lni->ln", radial, radial))
    outside = np.maximum(away - body.radii[:, None], 0)
    distance = np.hypot(outside, along - foot)
    share = away / body.radii[:, None]
    result = np.where(distance <= 0, 1.0 + np.maximum(1 - share, 0), np.exp(-distance / body.radii[:, None]))
    if normals is not None:
        from_link = offset - foot[..., None] * axes[:, None]
        result = np.where(np.einsum("lni,ni->ln", from_link, normals) <= 0, 0.0, result)
    return result


def segment(body: Body, a: Floats, b: Floats, points: Floats, normals: Floats | None) -> Labels:
    """(n,): the link that each point is associated with: the one of greatest closeness (section 3.1).

    A point that turns away from every link goes to the closest, as if it had no normal.
    """
    close = closeness(body, a, b, points, normals)
    lost = close.max(axis=0) <= 0
    if lost.any():
        close[:, lost] = closeness(body, a, b, points[lost], None)
    return close.argmax(axis=0)


def outward(body: Body, a: Floats, b: Floats, points: Floats, normals: Floats) -> Floats:
    """The normals turned to point away from the axis of the closest link."""
    link = segment(body, a, b, points, None)
    origins = joints_of(body, a, b)[link]
    axes = np.einsum("lij,lj->li", a, body.axes)[link]
    offset = points - origins
    along = np.clip(np.sum(offset * axes, axis=1), 0, body.lengths[link])
    inward = np.sum((offset - along[:, None] * axes) * normals, axis=1) < 0
    return np.where(inward[:, None], -normals, normals)


def make_model(
    body: Body,
    points: Floats,
    colours: NDArray[np.uint8] | None,
    normals: Floats | None = None,
    by_surface: bool = False,
) -> tuple[Body, Model]:
    """The model of the first frame: its points by links; and the body with radii and lengths that fit them.

    by_surface: points go to the link whose surface is nearest, in metres, not by equation (4), which favours thick
    links and gives them a hand that hangs beside a thigh.
    """
    a, b = transforms(body, Pose.canonical(len(body)))
    n = outward(body, a, b, points, estimate(points)) if normals is None else normals

    if by_surface:
        for _ in range(3):
            links = nearest_surface(body, points, n)
            body = fit_cylinders(body, points, links, paired=True)
        links = nearest_surface(body, points, n)
        for _ in range(ROUNDS):
            links = nearest_surface(body, points, n, surface_shapes(body, points, links))
        return fit_cylinders(body, points, links, paired=True), Model(points, n, colours, links)
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
        radius = np.einsum("lnk,lk->ln", _harmonics(body, offset), shapes)
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
    for link in range(len(body)):
        own = points[links == link] - body.origins[link]
        if len(own) < 30:
            continue
        basis = _harmonics(body, own[None], [link])[0]
        along = np.clip(own @ body.axes[link], 0, body.lengths[link])
        away = np.linalg.norm(own - along[:, None] * body.axes[link], axis=1)
        ridge = np.diag([0.1, *[stiff] * 9])
        target = ridge @ shapes[link]
        for _ in range(4):
            off = away - basis @ shapes[link]
            weight = 1 / (1 + (off / 0.02) ** 2)
            shapes[link] = np.linalg.solve((basis.T * weight) @ basis + ridge, (basis.T * weight) @ away + target)
    return shapes


def _harmonics(body: Body, offset: Floats, links: Sequence[int] | slice = slice(None)) -> Floats:
    """(links, n, 10): 1, cos, sin, cos 2θ, sin 2θ around each link's axis, then times the place along it, −1 to 1."""
    axes, lengths = body.axes[links], body.lengths[links]
    side = np.cross(axes, np.where(np.abs(axes[:, :1]) < 0.9, [1.0, 0, 0], [0, 1.0, 0]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    x, y = (np.einsum("lni,li->ln", offset, u) for u in (side, np.cross(axes, side)))
    share = np.clip(np.einsum("lni,li->ln", offset, axes) / lengths[:, None], 0, 1) * 2 - 1
    turn = np.arctan2(y, x)
    around = np.stack([np.ones_like(x), np.cos(turn), np.sin(turn), np.cos(2 * turn), np.sin(2 * turn)], -1)
    return np.concatenate([around, around * share[..., None]], -1)


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


def third_moment(points: Floats, centre: Floats) -> Floats:
    """(3, 3, 3): μ3, the mean of x ⊗ x ⊗ x about `centre`, cubic metres; zero without points."""
    if not len(points):
        return np.zeros((3, 3, 3))
    x = points - centre
    return np.einsum("ni,nj,nk->ijk", x, x, x, optimize=True) / len(x)


def global_errors(
    body: Body, a: Floats, b: Floats, moments: Floats, points: Floats, links: Labels, *, fewest: int = 8
) -> Floats:
    """(links,): equation (5) by links, |μ3(P_l) − μ3(Q_l)| in the link's own frame; its cube root, so in metres.

    moments (links, 3, 3, 3): of the model. Links with fewer than `fewest` data points count as ∞.
    """
    errors = np.empty(len(body))
    for link in range(len(body)):
        own = (points[links == link] - b[link]) @ a[link]
        difference = third_moment(own, (body.origins[link] + body.tips[link]) / 2) - moments[link]
        errors[link] = np.cbrt(np.linalg.norm(difference)) if len(own) >= fewest else np.inf
    return errors


@dataclass(frozen=True)
class Settings:
    """How ARTICP runs. threshold_m: links whose global error is above it are fitted again; rounds: how often at
    most.
    """

    iterations: int = 12
    threshold_m: float = 0.035
    rounds: int = 3
    articulation: bool = True
    global_fitting: bool = True


class Tracker:
    """Follows the body of a model through frames of points: ARTICP(S, Q) for each, from where the last one left it."""

    def __init__(self, body: Body, model: Model, settings: Settings | None = None) -> None:
        self.body, self.model, self.settings = body, model, settings or Settings()
        self.pose = Pose.canonical(len(body))
        self.below = body.ancestors
        self.members = [np.flatnonzero(model.links == link) for link in range(len(body))]
        centres = (body.origins + body.tips) / 2
        self.moments = np.stack(
            [third_moment(model.points[rows], c) for rows, c in zip(self.members, centres, strict=True)]
        )

    def fit(self, points: Floats, colours: NDArray[np.uint8] | None, normals: Floats | None = None) -> Pose:
        """Algorithm 3.1 on one frame of points (n, 3), metres. Frames of fewer than 10 points leave the pose as it
        was.
        """
        if len(points) < 10:
            return self.pose
        body, model = self.body, self.model
        a, b = transforms(body, self.pose)
        n = outward(body, a, b, points, estimate(points)) if normals is None else normals
        turned = np.einsum("nij,nj->ni", a[model.links], model.normals)
        label = icp.labels(turned, None if colours is None else model.colours, len(model.points))
        tree = icp.ClusteredTree.build(points, n, None if model.colours is None else colours, label)
        queue = [0]
        while queue:  # a parent before its children
            link = queue.pop(0)
            self._fit_link(link, a, b, label, tree)
            queue += [child for child, parent in enumerate(body.parents) if parent == link]
        if self.settings.global_fitting:
            self._fit_globally(a, b, points, n, colours, label)
        self.pose = self._to_pose(a, b)
        return self.pose

    def _fit_link(self, link: int, a: Floats, b: Floats, label: Labels, tree: icp.ClusteredTree) -> None:
        """ICP of one link; its transform moves the link and all below it."""
        rows = self.members[link]
        if len(rows) < 6:
            return
        moved = self.model.points[rows] @ a[link].T + b[link]
        pivot = None
        if link and self.settings.articulation:
            pivot = a[link] @ self.body.origins[link] + b[link]
        r, t, _ = icp.icp(moved, label[rows], tree, pivot=pivot, iterations=self.settings.iterations)
        for other in np.flatnonzero(self.below[link]):
            a[other], b[other] = r @ a[other], r @ b[other] + t

    def _fit_globally(
        self, a: Floats, b: Floats, points: Floats, normals: Floats, colours: NDArray[Any] | None, label: Labels
    ) -> None:
        """Section 3.4: segment the data, and match links with intolerable errors to the points that are theirs."""
        before = np.inf
        for _ in range(self.settings.rounds):
            links = segment(self.body, a, b, points, normals)
            errors = global_errors(self.body, a, b, self.moments, points, links)
            bad = [link for link in np.argsort(-errors) if errors[link] > self.settings.threshold_m]
            total = float(np.minimum(errors, 1.0).sum())
            if not bad or total >= before:
                return
            before = total
            for link in sorted(bad):
                own = links == link
                if own.sum() >= 10:
                    mine = icp.ClusteredTree.build(points[own], None, None, np.zeros(0, np.int64))
                    self._fit_link(link, a, b, np.zeros_like(label), mine)

    def _to_pose(self, a: Floats, b: Floats) -> Pose:
        return from_world(self.body, a, a[0] @ self.body.origins[0] + b[0])
