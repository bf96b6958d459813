"""A skinned template matched to points: how far apart they are, and the pose that brings them together.

    pose ──► match ──► linearise ──► solve, with priors ──► pose ──► … ──► assess
              │
    data to model through tables of the template in each link's own coordinates, built once;
    model to data through a k-d tree, so that a limb without points is drawn to those that nothing explains

Every step here has a compiled twin (src/native/matching.cpp) that agrees to rounding and takes over where it is built.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import native
from . import joint_limits
from .articulation import Body, Floats, Pose, exp, joints_of, log, transforms
from .joint_limits import NO_LIMITS, LinkLimits
from .skinning import Skin

Labels = NDArray[Any]
Mask = NDArray[np.bool_]
CELL = 0.02  # metres between the entries of a link's table
MARGIN = 0.10  # metres that a table reaches beyond its link's points
CANDIDATES, REFRESH = 3, 3  # links that a point is matched to, and steps after which they are chosen anew if it moves
REACH = 3.0  # widths of the robust weight at which a template point looks for data
RIVAL = 0.08  # metres beyond the nearest link at which another does not count
CALM, EASE = 0.01, 0.6  # metres: after a step that moves nothing farther, those wider than this share are left out,
FINE = 0.05  # metres: unless they are narrower than this
FARTHEST = 0.2  # metres: a template point farther than this from all data is not said to be farther
SHADE = 0.04  # metres: what a difference in colour counts at most, where a point chooses its link
TRUNCATE = 0.12  # metres beyond which a distance costs no more
UPPER = np.triu_indices(6)
CROSS = np.zeros((3, 3, 3))  # CROSS @ v is the matrix of v ×
CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = -1.0
CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0
NO_SHADES = np.zeros((0, 3))
NOBODY = np.zeros((0, CANDIDATES), np.int64)
SOLVED = NOBODY.copy()  # stands for what the compiled twin has kept


class Step(NamedTuple):
    """One iteration: width of the robust weight, metres; how many points of the data and of the template are looked
    at.
    """

    width: float
    points: int
    template: int


class Prior(NamedTuple):
    """What a pose is held to. turn (links,): strength, one over radians squared, of the start; hold (links,): of the
    rotations `held` (links, 3, 3); root: of the root's place at the start, one over square metres; beyond: one over
    radians squared, of the nearest rotation that is allowed, for links beyond their limits.
    """

    turn: Floats
    hold: Floats
    held: Floats
    root: float = 0.3**-2
    limits: LinkLimits = NO_LIMITS
    beyond: float = 0.0


@dataclass(frozen=True, eq=False)
class Tables:
    """For every link, which template point is nearest to each cell of a grid in the link's canonical coordinates."""

    nearest: NDArray[np.int32]
    low: Floats
    size: NDArray[np.int32]
    start: NDArray[np.int64]

    @staticmethod
    def build(body: Body, skin: Skin) -> Tables:
        """Tables of the points that follow each link with a third of their weight or more."""
        shares = skin.shares(len(body))
        nearest, low, size, start = list[NDArray[np.int32]](), list[Floats](), list[Labels](), [0]
        for link in range(len(body)):
            rows = np.flatnonzero(shares[:, link] > 0.34)
            if not len(rows):
                nearest.append(np.full(1, -1, np.int32))
                low.append(np.zeros(3))
                size.append(np.ones(3, np.int32))
            else:
                points = skin.points[rows]
                low.append(points.min(axis=0) - MARGIN)
                size.append(np.ceil((np.ptp(points, axis=0) + 2 * MARGIN) / CELL).astype(np.int32))
                nearest.append(rows[_nearest_in_grid(points, low[-1], size[-1])].astype(np.int32))
            start.append(start[-1] + len(nearest[-1]))
        return Tables(np.concatenate(nearest), np.array(low), np.array(size, np.int32), np.array(start[:-1], np.int64))

    def look_up(self, link: Labels, local: Floats) -> Labels:
        """The template point nearest to `local` (…, 3), in the canonical coordinates of `link`; −1 where it has
        none.
        """
        cell = ((local - self.low[link]) * (1 / CELL)).astype(np.int32)
        size = self.size[link]
        np.minimum(cell, size - 1, out=cell)
        np.maximum(cell, 0, out=cell)
        strides = np.stack([size[..., 1] * size[..., 2], size[..., 2], np.ones_like(size[..., 0])], -1)
        return self.nearest[self.start[link] + np.sum(cell * strides, axis=-1)]


def _nearest_in_grid(points: Floats, low: Floats, size: Labels) -> Labels:
    """The row of the point nearest to the middle of each cell of a grid, the last axis fastest."""
    if tree := native.kernel("BodyPoints"):
        return tree(np.ascontiguousarray(points), NO_SHADES).grid(low, size, CELL)
    from scipy.spatial import KDTree

    axes = [low[i] + CELL * (np.arange(size[i]) + 0.5) for i in range(3)]
    return np.asarray(KDTree(points).query(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3))[1])


@dataclass(frozen=True, eq=False)
class Data:
    """Points (n, 3) of a frame that are looked at, their colours as lengths, and a k-d tree of both."""

    points: Floats
    shades: Floats | None
    colours: NDArray[np.uint8] | None
    tree: Any

    @staticmethod
    def build(points: Floats, shades: Floats | None, colours: NDArray[np.uint8] | None) -> Data:
        points = np.ascontiguousarray(points, np.float64)
        if tree := native.kernel("BodyPoints"):
            return Data(points, shades, colours, tree(points, NO_SHADES if shades is None else shades))
        from scipy.spatial import KDTree

        both = points if shades is None else np.concatenate([points, shades], axis=1)
        return Data(points, shades, colours, KDTree(both, leafsize=16, compact_nodes=False, balanced_tree=False))

    def some(self, rows: Labels) -> Data:
        """Some of the points."""
        shades = None if self.shades is None else self.shades[rows]
        return Data.build(self.points[rows], shades, None if self.colours is None else self.colours[rows])

    def nearest(self, points: Floats, shades: Floats | None, within: float) -> tuple[Floats, Labels]:
        """Distance and row of the data point nearest to each of these, in place and colour; ∞ where none is so near."""
        both = points if self.shades is None or shades is None else np.concatenate([points, shades], axis=1)
        return self.tree.query(both, distance_upper_bound=within)

    def away(self, distance: Floats, shades: Floats | None, row: Labels) -> Floats:
        """(n,): distances of the data points from template points of these rows, with that of their colours added."""
        if self.shades is None or shades is None:
            return distance
        return np.sqrt(distance**2 + np.sum((self.shades - shades[row]) ** 2, axis=1))


@dataclass(frozen=True, eq=False)
class Fit:
    """How well a pose fits the data: residuals (m,), the distance of each data point from the template, metres; rows
    and links (m,), the template point and the link that explain it; gaps (k,), how far template points are from the
    data; cost: mean squared distances both ways, in place and colour, none counted beyond 12 cm, square metres.
    """

    pose: Pose
    data: Data
    residuals: Floats
    rows: Labels
    links: Labels
    gaps: Floats
    cost: float

    @staticmethod
    def nothing(pose: Pose) -> Fit:
        """A pose that no data speak for."""
        none = np.zeros(0, np.int64)
        return Fit(pose, Data.build(np.zeros((0, 3)), None, None), np.zeros(0), none, none, np.zeros(0), 0.0)


class Matcher:
    """A body with the points of its surface. pull: weight of the distance along the surface against that across it.
    noise: of the data, metres. some: the template points that look for data, in the order in which they are taken.
    """

    def __init__(
        self, body: Body, skin: Skin, normals: Floats, shades: Floats | None, some: Labels, pull: float, noise: float
    ) -> None:
        self.body, self.skin, self.normals, self.shades = body, skin, normals, shades
        self.some, self.pull, self.noise = some, pull, noise
        self.tables = Tables.build(body, skin)
        self.moves = body.ancestors
        self.has_points = self.tables.nearest[self.tables.start] >= 0
        self.everywhere = np.ones(len(body), bool)
        self.parents = np.maximum(np.array(body.parents), 0)
        self.is_root = np.array(body.parents) < 0
        self.pairs, self.pair = np.unique(skin.links, axis=0, return_inverse=True)
        self.pair = self.pair.reshape(-1)
        self.compiled: Any = None
        if matcher := native.kernel("BodyMatcher"):
            arrays = skin.points, np.asarray(skin.links, np.int64), skin.weights, normals
            colours = NO_SHADES if shades is None else shades
            t = self.tables
            arrays = [
                np.array(body.parents, np.int64),
                body.origins,
                body.lengths,
                *arrays,
                colours,
                t.nearest,
                t.low,
                t.size,
            ]
            self.compiled = matcher(*(np.ascontiguousarray(x) for x in arrays), t.start, CELL, MARGIN)

    def solve(
        self,
        data: Data,
        start: Pose,
        steps: Sequence[Step],
        prior: Prior,
        some: Labels | None = None,
        allowed: Mask | None = None,
    ) -> Pose:
        """Gauss–Newton from a pose. some: template points that look for data. allowed (links,): those that data may
        belong to.
        """
        return self._solve(data, start, steps, prior, some, allowed)[0]

    def fit(self, data: Data, start: Pose, steps: Sequence[Step], prior: Prior) -> Fit:
        """Gauss–Newton from a pose, and how well that fits."""
        return self.assess(data, *self._solve(data, start, steps, prior, None, None))

    def _solve(
        self,
        data: Data,
        start: Pose,
        steps: Sequence[Step],
        prior: Prior,
        some: Labels | None,
        allowed: Mask | None,
    ) -> tuple[Pose, Labels]:
        """As `solve`; and the links (n, candidates) that the first n points were matched to."""
        some = self.some if some is None else some
        allowed = self.everywhere if allowed is None else allowed
        if self.compiled and native.available():
            strengths = np.stack([prior.turn, prior.hold])
            rotations, root = self.compiled.solve(
                data.tree, start.rotations, start.root, np.array(steps, float).reshape(-1, 3), some, allowed,
                prior.held, strengths, prior.limits.links, prior.limits.table, prior.beyond, prior.root, self.pull,
                self.noise, REACH, CALM, EASE, FINE,
            )  # fmt: skip
            return Pose(rotations, root), SOLVED
        pose = start
        a, b = transforms(self.body, pose)
        candidates = NOBODY
        resisted = np.zeros((len(prior.limits.links), 3))  # axes of turns that led beyond limits
        since, calm_at = 0, np.inf  # steps since links were chosen anew; the width of a calm step
        for step in steps:
            if step.width > max(FINE, EASE * calm_at):
                continue
            points = data.points[: step.points]
            since += 1
            if since > REFRESH and np.isinf(calm_at):
                candidates, since = NOBODY, 1
            if len(candidates) < len(points):
                more = self._candidates(points[len(candidates) :], a, b, allowed)
                candidates = np.concatenate([candidates, more]) if len(candidates) else more
            row, _ = self._match(data, a, b, candidates[: len(points)])
            rows = some[: step.template]
            shades = None if self.shades is None else self.shades[rows]
            distance, index = data.nearest(self.skin.posed(a, b, rows), shades, REACH * step.width)
            near = np.isfinite(distance)
            target = np.concatenate([points, data.points[index[near]]])
            row = np.concatenate([row, rows[near]])
            pose, moved = self._step(target, row, pose, start, a, b, step.width, prior, resisted)
            calm_at = step.width if moved < CALM else np.inf
            a, b = transforms(self.body, pose)
        return pose, candidates

    def assess(self, data: Data, pose: Pose, candidates: Labels = NOBODY) -> Fit:
        """How well a pose fits. candidates: links for each data point, where they are known."""
        some = self.some
        if self.compiled and native.available():
            return Fit(pose, data, *self.compiled.assess(
                data.tree, pose.rotations, pose.root, some, self.everywhere, candidates is SOLVED, FARTHEST, TRUNCATE
            ))  # fmt: skip
        a, b = transforms(self.body, pose)
        if len(candidates) != len(data.points):
            candidates = self._candidates(data.points, a, b, self.everywhere)
        row, link = self._match(data, a, b, candidates)
        residuals = np.linalg.norm(data.points - self.skin.posed(a, b, row), axis=1)
        seen = self.skin.posed(a, b, some)
        both, index = data.nearest(seen, None if self.shades is None else self.shades[some], FARTHEST)
        index = np.minimum(index, len(data.points) - 1)  # where none is so near
        gaps = np.where(np.isfinite(both), np.linalg.norm(seen - data.points[index], axis=1), FARTHEST)
        cost = np.mean(np.minimum(data.away(residuals, self.shades, row), TRUNCATE) ** 2)
        cost += np.mean(np.minimum(both, TRUNCATE) ** 2)
        return Fit(pose, data, residuals, row, link, gaps, float(cost))

    def distances(self, data: Data, wanted: Floats, pose: Pose, limb: Labels, draws: Floats, rows: Labels) -> Floats:
        """(draws,): mean squared distance of template points `rows` from data without colours, and of points `wanted`
        (w, 3) from those, where each draw turns the links of a limb, each after its parent, by rotations
        (draws, links of the limb, 3, 3) of its own.
        """
        if self.compiled and native.available():
            return self.compiled.distances(
                data.tree, wanted, pose.rotations, pose.root, limb, draws, rows, TRUNCATE
            )  # fmt: skip
        a, b = transforms(self.body, pose)
        a, b = np.tile(a, (len(draws), 1, 1, 1)), np.tile(b, (len(draws), 1, 1))
        for i, link in enumerate(limb):
            parent, origin = self.body.parents[link], self.body.origins[link]
            a[:, link] = a[:, parent] @ draws[:, i]
            b[:, link] = np.einsum("nij,nj->ni", a[:, parent], origin - draws[:, i] @ origin) + b[:, parent]
        owner = self.skin.links[rows, 0]
        placed = np.einsum("nkij,kj->nki", a[:, owner], self.skin.points[rows]) + b[:, owner]
        away, _ = data.nearest(placed.reshape(-1, 3), None, TRUNCATE)
        score = (np.minimum(away, TRUNCATE) ** 2).reshape(len(draws), -1).mean(axis=1)
        if len(wanted):
            squares = (placed**2).sum(axis=2)[:, :, None] + (wanted**2).sum(axis=1)
            back = (squares - 2 * placed @ wanted.T).min(axis=1)
            score += np.minimum(np.maximum(back, 0), TRUNCATE**2).mean(axis=1)
        return score

    def _candidates(self, points: Floats, a: Floats, b: Floats, allowed: Mask) -> Labels:
        """(n, candidates): the links whose template is nearest to each point; for those farther than the nearest
        by RIVAL, the nearest again.
        """
        links = np.flatnonzero(self.has_points & allowed)
        local = (points[None] - b[links, None]) @ a[links]
        row = self.tables.look_up(links[:, None], local)
        gap = local - self.skin.points[row]
        distance = np.einsum("lni,lni->ln", gap, gap)
        count = min(CANDIDATES, len(links))
        order = np.argpartition(distance, count - 1, axis=0)[:count]
        nearest = distance.argmin(axis=0)
        there = np.sqrt(np.take_along_axis(distance, order, axis=0))
        order = np.where(there > np.sqrt(distance[nearest, np.arange(len(points))]) + RIVAL, nearest, order)
        return links[order].T

    def _match(self, data: Data, a: Floats, b: Floats, candidates: Labels) -> tuple[Labels, Labels]:
        """For each of the first points, the nearest template point among those of its candidate links, and that
        link.
        """
        points = data.points[: len(candidates)]
        local = np.einsum("nki,nkij->nkj", points[:, None] - b[candidates], a[candidates])
        row = self.tables.look_up(candidates, local)
        gap = local - self.skin.points[row]
        distance = np.einsum("nki,nki->nk", gap, gap)
        if self.shades is not None and data.shades is not None:
            shade = data.shades[: len(candidates), None] - self.shades[row]
            distance += np.minimum(np.einsum("nki,nki->nk", shade, shade), SHADE**2)
        best = distance.argmin(axis=1)
        rows = np.arange(len(points))
        return row[rows, best], candidates[rows, best]

    def _step(
        self,
        target: Floats,
        row: Labels,
        pose: Pose,
        start: Pose,
        a: Floats,
        b: Floats,
        width: float,
        prior: Prior,
        resisted: Floats,
    ) -> tuple[Pose, float]:
        """One Gauss–Newton step: a turn of every joint, in the world, and a translation of the root; and how far it
        moves the root, or the far end of a link by its own turn, at most. resisted (limited links, 3): see
        `_pull_back`, which notes there what it resists.

        A template point that follows link l moves by v_l + ω_l × y; its distance across the surface changes by f ·
        (v, ω) with f = (n, y × n). Sums of f fᵀ by links give the normal equations of the links' motions, and the
        tree turns those into the joints'.
        """
        y = self.skin.posed(a, b, row)
        normal = np.einsum("nij,nj->ni", a[self.skin.links[row, 0]], self.normals[row])
        gap = target - y
        weight = (width**2 / (width**2 + np.einsum("ni,ni->n", gap, gap))) ** 2 / self.noise**2
        matrix, vector = self._links_equations(y, normal, gap, weight, row)
        joints = joints_of(self.body, a, b)
        links = len(self.body)
        motion = np.zeros((links, 6, 1 + links, 3))  # how each link moves with the root's place and the joints' turns
        motion[:, :3, 0] = np.eye(3)
        motion[:, :3, 1:] = self.moves.T[:, None, :, None] * (CROSS @ joints.T).transpose(0, 2, 1)[None]
        motion[:, 3:, 1:] = self.moves.T[:, None, :, None] * np.eye(3)[:, None, :]
        s = motion.reshape(6 * links, 3 + 3 * links)
        h = s.T @ matrix @ s
        g = s.T @ vector
        self._add_priors(h, g, pose, start, a, prior, resisted)
        step = np.linalg.solve(h, g)
        turns = step[3:].reshape(-1, 3)
        angle = np.linalg.norm(turns, axis=1, keepdims=True)
        turns = turns * np.minimum(1.0, 0.7 / np.maximum(angle, 1e-9))
        turned = exp(np.einsum("lji,lj->li", self._above(a), turns)) @ pose.rotations
        moved = max(float(np.linalg.norm(step[:3])), float((angle[:, 0] * self.body.lengths).max()))
        return Pose(turned, pose.root + step[:3]), moved

    def _links_equations(
        self, y: Floats, normal: Floats, gap: Floats, weight: Floats, row: Labels
    ) -> tuple[Floats, Floats]:
        """Normal equations of the links' motions (v, ω): (6 links, 6 links) and (6 links,)."""
        pull, links = self.pull, len(self.body)
        f = np.concatenate([normal, _cross(y, normal)], axis=1)
        outer = f[:, UPPER[0]] * f[:, UPPER[1]]
        square = np.einsum("ni,ni->n", y, y)
        x, v, z = y.T
        # (I, −[y]×)ᵀ (I, −[y]×): the distance along the surface too, weakly
        outer[:, [0, 6, 11]] += pull
        outer[:, [4, 5, 8, 10, 12, 13]] += pull * np.stack([z, -v, -z, x, v, -x], 1)
        outer[:, [15, 18, 20]] += pull * (square[:, None] - y**2)
        outer[:, [16, 17, 19]] -= pull * np.stack([x * v, x * z, v * z], 1)
        right = f * np.einsum("ni,ni->n", normal, gap)[:, None]
        right += pull * np.concatenate([gap, _cross(y, gap)], axis=1)
        first = self.skin.weights[row]
        second = 1 - first
        wide = np.concatenate([outer, right], axis=1) * weight[:, None]
        pair = self.pair[row]
        order = np.argsort(pair, kind="stable")
        wide, first, second = wide[order], first[order, None], second[order, None]
        present, starts = np.unique(pair[order], return_index=True)
        sums = [
            np.add.reduceat(wide[:, :21] * share, starts) for share in (first * first, first * second, second * second)
        ]
        right_sums = [np.add.reduceat(wide[:, 21:] * share, starts) for share in (first, second)]
        l0, l1 = self.pairs[present].T
        matrix, vector = np.zeros((links, links, 6, 6)), np.zeros((links, 6))
        for i, j, block in ((l0, l0, sums[0]), (l0, l1, sums[1]), (l1, l0, sums[1]), (l1, l1, sums[2])):
            full = np.empty((len(block), 6, 6))
            full[:, UPPER[0], UPPER[1]] = block
            full[:, UPPER[1], UPPER[0]] = block
            np.add.at(matrix, (i, j), full)
        np.add.at(vector, l0, right_sums[0])
        np.add.at(vector, l1, right_sums[1])
        return matrix.transpose(0, 2, 1, 3).reshape(6 * links, 6 * links), vector.ravel()

    def _above(self, a: Floats) -> Floats:
        """(links, 3, 3): world rotations of the links' parents."""
        above = a[self.parents]
        above[self.is_root] = np.eye(3)
        return above

    def _add_priors(
        self, h: Floats, g: Floats, pose: Pose, start: Pose, a: Floats, prior: Prior, resisted: Floats
    ) -> None:
        """Towards the pose at the start, towards the one that joints are held to, and back within limits."""
        other = np.stack([start.rotations, prior.held])
        off = log(pose.rotations @ other.transpose(0, 1, 3, 2))
        strength = np.stack([prior.turn, prior.hold])
        world = np.einsum("lij,klj,kl->li", self._above(a), off, strength)
        diagonal = np.concatenate([np.full(3, prior.root), np.repeat(strength.sum(axis=0), 3)])
        g[:3] -= (pose.root - start.root) * prior.root
        g[3:] -= world.ravel()
        h[np.diag_indices_from(h)] += diagonal
        if len(prior.limits.links):
            self._pull_back(h, g, pose, self._above(a), prior, resisted)

    def _pull_back(self, h: Floats, g: Floats, pose: Pose, above: Floats, prior: Prior, resisted: Floats) -> None:
        """Towards the nearest rotation that is allowed, where a link is beyond its limits; the distance changes with
        the turn about one axis alone. That turn is resisted in later steps too, which else would go out again as far.
        """
        links = prior.limits.links
        allowed, outside = joint_limits.nearest(prior.limits, pose.rotations[links])
        off = log(pose.rotations[links] @ allowed.transpose(0, 2, 1))
        for k, link in enumerate(links):
            at = slice(3 + 3 * link, 6 + 3 * link)
            if outside[k]:
                g[at] -= prior.beyond * (above[link] @ off[k])
                resisted[k] = off[k] / max(float(np.linalg.norm(off[k])), 1e-12)
            if resisted[k].any():
                axis = above[link] @ resisted[k]
                h[at, at] += prior.beyond * np.outer(axis, axis)


def _cross(u: Floats, v: Floats) -> Floats:
    """u × v of (n, 3) and (n, 3)."""
    out = np.empty_like(u)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, i] = u[:, j] * v[:, k] - u[:, k] * v[:, j]
    return out
