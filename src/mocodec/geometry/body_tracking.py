"""All joints of a body at once: Gauss–Newton on the distances between a skinned template and points.

constant velocity ──► pose ──► match ──► linearise ──► solve, with priors ──► pose ──► … ──► is a limb lost? ──►
search
                                 │
          data to model through tables of the template in each link's own coordinates, built once;
          model to data through a k-d tree, so that a limb without points is drawn to those that nothing explains
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .articulation import Body, Floats, Pose, exp, joints_of, log, transforms
from .skinning import Skin

Labels = NDArray[Any]
CELL = 0.02  # metres between the entries of a link's table
MARGIN = 0.10  # metres that a table reaches beyond its link's points


@dataclass(frozen=True)
class Settings:
    """How the tracker runs. Lengths in metres, turns in radians.

    widths: of the robust weight, one an iteration. points, model_points: of the data and of the template that are
    looked at, at most. pull: weight of the distance along the surface against that across it. turn, spine: how far a
    joint usually turns from where constant velocity puts it; `spine` for short bones, which are also held to `bend` of
    their first pose. velocity: the share of the last movement that is expected again.
    """

    widths: tuple[float, ...] = (0.16, 0.11, 0.08, 0.055, 0.038, 0.027, 0.02)
    points: int = 1000
    model_points: int = 400
    pull: float = 0.1
    noise: float = 0.01
    turn: float = 0.6
    spine: float = 0.12
    bend: float = 0.35
    velocity: float = 0.8
    colour: float = 0.20
    search: bool = True


@dataclass(frozen=True, eq=False)
class Tables:
    """For every link, which template point is nearest to each cell of a grid in the link's canonical coordinates."""

    nearest: NDArray[np.int32]
    low: Floats
    size: Labels
    start: Labels

    @staticmethod
    def build(body: Body, skin: Skin) -> Tables:
        """Tables of the points that follow each link with a third of their weight or more."""
        from scipy.spatial import KDTree

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
                axes = [low[-1][i] + CELL * (np.arange(size[-1][i]) + 0.5) for i in range(3)]
                grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
                nearest.append(rows[KDTree(points).query(grid)[1]].astype(np.int32))
            start.append(start[-1] + len(nearest[-1]))
        return Tables(np.concatenate(nearest), np.array(low), np.array(size), np.array(start[:-1]))

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


@dataclass(frozen=True, eq=False)
class Limb:
    """links of an arm or leg from its long bone on, and rows of the template that follow them."""

    links: Labels
    rows: Labels


DOUBT = 1.15  # times the usual cost, above which a fit is not trusted at once
LOST_POINTS, LOST_LIMB = 0.01, 0.15  # shares of the data, and of a limb's template, that make a search worth while
LOST = 0.045  # metres: a point farther than this from the template is not explained by it
UPPER = np.triu_indices(6)
CROSS = np.zeros((3, 3, 3))  # CROSS @ v is the matrix of v ×
CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = -1.0
CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0


class Tracker:
    """Follows a body through frames of points, each from where constant velocity would put it."""

    def __init__(
        self,
        body: Body,
        skin: Skin,
        normals: Floats,
        colours: NDArray[np.uint8] | None = None,
        settings: Settings | None = None,
    ) -> None:
        self.body, self.skin, self.normals = body, skin, normals
        self.settings = settings or Settings()
        self.shades = None if colours is None else self._shades(colours)
        self.tables = Tables.build(body, skin)
        self.moves = body.ancestors
        self.has_points = self.tables.nearest[self.tables.start] >= 0
        self.parents = np.maximum(np.array(body.parents), 0)
        self.is_root = np.array(body.parents) < 0
        rng = np.random.default_rng(0)
        self.some = rng.permutation(len(skin.points))[: self.settings.model_points]
        self.pairs, self.pair = np.unique(skin.links, axis=0, return_inverse=True)
        self.pair = self.pair.reshape(-1)
        self.stiffness = self._stiffness()
        self.limbs = self._limbs()
        self.pose = Pose.canonical(len(body))
        self.before = self.pose
        self.usual = np.inf  # cost of a frame that fits

    def _stiffness(self) -> Floats:
        """(links,): the expected turn of each joint: little for short bones that carry others, and those without
        points.
        """
        own = np.bincount(self.skin.links[:, 0], minlength=len(self.body)) / len(self.skin.points)
        short = self.body.lengths < 0.12 * np.ptp(self.body.origins, axis=0).max()
        carries = self.moves.sum(axis=1) > 3
        stiff = (short & carries) | (own < 0.004)
        stiff[0] = False
        return np.where(stiff, self.settings.spine, self.settings.turn)

    def _shades(self, colours: NDArray[np.uint8]) -> Floats:
        """(n, 3): colours as lengths, so that they can be added to distances."""
        return colours.astype(np.float64) * (self.settings.colour / 255)

    def predict(self) -> Pose:
        """Where constant velocity puts the body."""
        share = self.settings.velocity
        step = log(self.before.rotations.transpose(0, 2, 1) @ self.pose.rotations) * share
        root = self.pose.root + share * (self.pose.root - self.before.root)
        return Pose(self.pose.rotations @ exp(step), root)

    def fit(self, points: Floats, colours: NDArray[np.uint8] | None = None, seed: int = 0) -> Fit:
        """The pose of one frame of points (n, 3), metres. A frame of fewer than 10 leaves the pose as it was."""
        if len(points) < 10:
            self.before = self.pose
            return Fit.nothing(self.pose)
        data = self.look_at(points, colours, seed)
        found = self.solve(data, self.predict())
        if found.cost > DOUBT * self.usual:  # it may have turned back: start from where it was
            found = min(found, self.solve(data, self.pose), key=lambda fit: fit.cost)
        better = self._search(data, found, seed) if self.settings.search else found
        self.before, self.pose = self.pose if better is found else better.pose, better.pose
        self.usual = min(better.cost, 0.9 * self.usual + 0.1 * better.cost)
        return better

    def see(
        self, points: Floats, colours: NDArray[np.uint8] | None = None, seed: int = 0, most: int | None = None
    ) -> Fit:
        """How the pose that the tracker has fits a frame, of which at most `most` points are looked at."""
        return self.assess(self.look_at(points, colours, seed, most), self.pose)

    def look_at(self, points: Floats, colours: NDArray[np.uint8] | None, seed: int, most: int | None = None) -> Data:
        """The points of a frame that the tracker looks at, drawn at random where there are more than it wants."""
        if len(points) > (most := most or self.settings.points):
            some = np.random.default_rng(seed).integers(0, len(points), most)
            points, colours = points[some], None if colours is None else colours[some]
        shades = None if colours is None or self.shades is None else self._shades(colours)
        return Data.build(points, shades, colours)

    def solve(self, data: Data, start: Pose, widths: tuple[float, ...] | None = None) -> Fit:
        """Gauss–Newton from a pose, with the start as prior."""
        pose, points = start, data.points
        a, b = transforms(self.body, pose)
        candidates = self._candidates(points, a, b)
        for width in widths or self.settings.widths:
            row, _ = self._match(data, a, b, candidates)
            distance, index = data.nearest(*self._seen_template(a, b), 3 * width)
            near = np.isfinite(distance)
            target = np.concatenate([points, points[index[near]]])
            source = np.concatenate([row, self.some[near]])
            pose = self._step(target, source, pose, start, a, b, width)
            a, b = transforms(self.body, pose)
        return self.assess(data, pose, candidates)

    def assess(self, data: Data, pose: Pose, candidates: Labels | None = None) -> Fit:
        """How well a pose fits. candidates: links for each data point, where they are known."""
        a, b = transforms(self.body, pose)
        if candidates is None:
            candidates = self._candidates(data.points, a, b)
        row, link = self._match(data, a, b, candidates)
        residuals = np.linalg.norm(data.points - self.skin.posed(a, b, row), axis=1)
        seen, shades = self._seen_template(a, b)
        both, index = data.nearest(seen, shades, 0.5)
        index = np.minimum(index, len(data.points) - 1)  # where none is so near
        gaps = np.where(np.isfinite(both), np.linalg.norm(seen - data.points[index], axis=1), 0.5)
        cost = np.mean(np.minimum(data.away(residuals, self.shades, row), 0.12) ** 2)
        cost += np.mean(np.minimum(both, 0.12) ** 2)
        return Fit(pose, data, residuals, row, link, gaps, float(cost))

    def nearest(self, data: Data, pose: Pose) -> Labels:
        """(n,): the template point that each data point is matched to."""
        a, b = transforms(self.body, pose)
        return self._match(data, a, b, self._candidates(data.points, a, b))[0]

    def _seen_template(self, a: Floats, b: Floats) -> tuple[Floats, Floats | None]:
        """The template points that are looked at, where transforms put them, and their colours."""
        return self.skin.posed(a, b, self.some), None if self.shades is None else self.shades[self.some]

    def _limbs(self) -> list[Limb]:
        """Arms and legs: chains of links without branches, of a quarter of the body's size or more, from their long
        bone.
        """
        children = [[c for c, p in enumerate(self.body.parents) if p == link] for link in range(len(self.body))]
        size = float(np.ptp(np.concatenate([self.body.origins, self.body.tips]), axis=0).max())
        limbs = list[Limb]()
        for link in range(1, len(self.body)):
            chain = [link]
            while len(children[chain[-1]]) == 1:
                chain += children[chain[-1]]
            is_path = not children[chain[-1]]
            inside = any(link in limb.links for limb in limbs)
            if (
                inside
                or not is_path
                or self.body.lengths[link] < 0.12 * size
                or self.body.lengths[chain].sum() < 0.25 * size
            ):
                continue
            mine = np.flatnonzero(np.isin(self.skin.links[:, 0], chain))
            if len(mine) >= 30:
                limbs.append(Limb(np.array(chain), mine[:: max(1, len(mine) // 80)]))
        return limbs

    def _search(self, data: Data, found: Fit, seed: int) -> Fit:
        """A limb that has left its points, while other points are left without a limb, is looked for all around.

        Poses of its two long bones are drawn at random and judged by how near they bring the limb to points that no
        other link explains, and those points to the limb; the best are refined, and the best of all poses is kept.
        """
        lost_points = found.residuals > LOST
        if lost_points.sum() < LOST_POINTS * len(data.points):
            return found
        owner = self.skin.links[self.some, 0]
        best = found
        for limb in self.limbs:
            gaps = best.gaps[np.isin(owner, limb.links)]
            if not len(gaps) or np.mean(gaps > LOST) < LOST_LIMB:
                continue
            for pose in self._draw(limb, data, best, seed):
                other = self.solve(data, pose, self.settings.widths[1:])
                if other.cost < 0.97 * best.cost:
                    best = other
        return best

    def _draw(self, limb: Limb, data: Data, found: Fit, seed: int, draws: int = 160, kept: int = 2) -> list[Pose]:
        """The best of random poses of a limb."""
        from scipy.spatial import KDTree

        free = data.points[(found.residuals > 0.5 * LOST) | np.isin(found.links, limb.links)]
        unexplained = data.points[found.residuals > LOST]
        unexplained = unexplained[:: max(1, len(unexplained) // 60)]
        if len(free) < 10 or not len(unexplained):
            return []
        rng = np.random.default_rng([seed, int(limb.links[0])])
        turns = np.zeros((draws, len(self.body), 3))
        turns[:, limb.links[0]] = rng.normal(scale=0.9, size=(draws, 3))
        turns[:, limb.links[1]] = rng.normal(scale=0.7, size=(draws, 3))
        rotations = exp(turns) @ found.pose.rotations
        a, b = transforms(self.body, found.pose)
        a, b = np.tile(a, (draws, 1, 1, 1)), np.tile(b, (draws, 1, 1))
        for link in limb.links:
            parent, origin = self.body.parents[link], self.body.origins[link]
            turn = rotations[:, link]
            a[:, link] = a[:, parent] @ turn
            b[:, link] = np.einsum("nij,nj->ni", a[:, parent], origin - turn @ origin) + b[:, parent]
        owner = self.skin.links[limb.rows, 0]
        placed = np.einsum("nkij,kj->nki", a[:, owner], self.skin.points[limb.rows]) + b[:, owner]
        away, _ = KDTree(free).query(placed.reshape(-1, 3), distance_upper_bound=0.12)
        score = (np.minimum(away, 0.12) ** 2).reshape(draws, -1).mean(axis=1)
        back = np.sqrt(((placed[:, ::2, None] - unexplained[None, None]) ** 2).sum(axis=-1)).min(axis=1)
        score += (np.minimum(back, 0.12) ** 2).mean(axis=1)
        return [Pose(rotations[i], found.pose.root) for i in np.argsort(score)[:kept]]

    def _candidates(self, points: Floats, a: Floats, b: Floats, count: int = 3) -> Labels:
        """(n, count): the links whose template is nearest to each point."""
        links = np.flatnonzero(self.has_points)
        local = (points[None] - b[links, None]) @ a[links]
        row = self.tables.look_up(links[:, None], local)
        gap = local - self.skin.points[row]
        distance = np.einsum("lni,lni->ln", gap, gap)
        count = min(count, len(links))
        return links[np.argpartition(distance, count - 1, axis=0)[:count]].T

    def _match(self, data: Data, a: Floats, b: Floats, candidates: Labels) -> tuple[Labels, Labels]:
        """For each point (n, 3), the nearest template point among those of its candidate links, and that link."""
        local = np.einsum("nki,nkij->nkj", data.points[:, None] - b[candidates], a[candidates])
        row = self.tables.look_up(candidates, local)
        gap = local - self.skin.points[row]
        distance = np.einsum("nki,nki->nk", gap, gap)
        if self.shades is not None and data.shades is not None:
            shade = data.shades[:, None] - self.shades[row]
            distance += np.einsum("nki,nki->nk", shade, shade)
        best = distance.argmin(axis=1)
        rows = np.arange(len(data.points))
        return row[rows, best], candidates[rows, best]

    def _step(self, target: Floats, row: Labels, pose: Pose, start: Pose, a: Floats, b: Floats, width: float) -> Pose:
        """One Gauss–Newton step: a turn of every joint, in the world, and a translation of the root.

        A template point that follows link l moves by v_l + ω_l × y; its distance across the surface changes by f ·
        (v, ω) with f = (n, y × n). Sums of f fᵀ by links give the normal equations of the links' motions, and the
        tree turns those into the joints'.
        """
        y = self.skin.posed(a, b, row)
        normal = np.einsum("nij,nj->ni", a[self.skin.links[row, 0]], self.normals[row])
        gap = target - y
        weight = (width**2 / (width**2 + np.einsum("ni,ni->n", gap, gap))) ** 2 / self.settings.noise**2
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
        self._add_priors(h, g, pose, start, a)
        step = np.linalg.solve(h, g)
        turns = step[3:].reshape(-1, 3)
        angle = np.linalg.norm(turns, axis=1, keepdims=True)
        turns = turns * np.minimum(1.0, 0.7 / np.maximum(angle, 1e-9))
        return Pose(exp(np.einsum("lji,lj->li", self._above(a), turns)) @ pose.rotations, pose.root + step[:3])

    def _links_equations(
        self, y: Floats, normal: Floats, gap: Floats, weight: Floats, row: Labels
    ) -> tuple[Floats, Floats]:
        """Normal equations of the links' motions (v, ω): (6 links, 6 links) and (6 links,)."""
        pull, links = self.settings.pull, len(self.body)
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

    def _add_priors(self, h: Floats, g: Floats, pose: Pose, start: Pose, a: Floats) -> None:
        """Towards the expected pose; and stiff joints towards the canonical one, which keeps a spine from folding."""
        above = self._above(a)
        off = log(np.stack([pose.rotations @ start.rotations.transpose(0, 2, 1), pose.rotations]))
        bend = np.where(self.stiffness < self.settings.turn, self.settings.bend**-2, 0.0)
        strength = np.stack([self.stiffness**-2.0, bend])
        world = np.einsum("lij,klj,kl->li", above, off, strength)
        diagonal = np.concatenate([np.full(3, 0.3**-2), np.repeat(strength.sum(axis=0), 3)])
        g[:3] -= (pose.root - start.root) * 0.3**-2
        g[3:] -= world.ravel()
        h[np.diag_indices_from(h)] += diagonal


@dataclass(frozen=True, eq=False)
class Data:
    """Points (n, 3) of a frame that are looked at, their colours as lengths, and a k-d tree of both."""

    points: Floats
    shades: Floats | None
    colours: NDArray[np.uint8] | None
    tree: Any

    @staticmethod
    def build(points: Floats, shades: Floats | None, colours: NDArray[np.uint8] | None) -> Data:
        from scipy.spatial import KDTree

        both = points if shades is None else np.concatenate([points, shades], axis=1)
        return Data(points, shades, colours, KDTree(both, leafsize=16, compact_nodes=False, balanced_tree=False))

    def nearest(self, points: Floats, shades: Floats | None, within: float) -> tuple[Floats, Labels]:
        """Distance and row of the data point nearest to each of these, in place and colour; ∞ where none is so near."""
        if self.shades is None or shades is None:
            return self.tree.query(points, distance_upper_bound=within)
        return self.tree.query(np.concatenate([points, shades], axis=1), distance_upper_bound=within)

    def away(self, distance: Floats, shades: Floats | None, row: Labels) -> Floats:
        """(n,): distances of the data points from template points of these rows, with that of their colours added."""
        if self.shades is None or shades is None:
            return distance
        return np.sqrt(distance**2 + np.sum((self.shades - shades[row]) ** 2, axis=1))


def _cross(u: Floats, v: Floats) -> Floats:
    """u × v of (n, 3) and (n, 3)."""
    out = np.empty_like(u)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, i] = u[:, j] * v[:, k] - u[:, k] * v[:, j]
    return out
