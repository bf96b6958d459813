"""Registration of a skinned template to a frame's points: the pose that fits best, and how well a pose fits.

    pose ──► correspondences ──► Gauss–Newton step (gauss_newton) ──► pose ──► … ──► assess
                    │
    data to template by link_grids; template to data by a k-d tree, so that a limb far from its points is drawn to those
    that no other link explains

Every step here has a compiled twin (src/native/matching.cpp), used where it is built; both agree to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .. import native
from ..typing import AnyInteger, Booleans, Bytes, Floats
from .articulation import Body, Pose, transforms
from .gauss_newton import NormalEquations, PosePrior
from .link_grids import CELL_M, MARGIN_M, NO_COLOURS, LinkGrids
from .skinning import Skin

CANDIDATES = 3
"""Links that a data point may be matched to."""
REFRESH_STEPS = 3
"""Steps after which the candidates are found anew, while the pose still moves."""
CANDIDATE_MARGIN_M = 0.08
"""A link farther from a point than its nearest link by more than this is no candidate, metres."""
SEARCH_WIDTHS = 3.0
"""How far a template point searches for data, as a multiple of the robust weight's width."""
CONVERGED_M = 0.01
"""A step that moves no link farther than this has converged, metres."""
SKIP_RATIO = 0.6
"""After a converged step, steps wider than this share of its width are skipped."""
NEVER_SKIPPED_M = 0.05
"""Steps of this width or less are never skipped, metres."""
MAX_GAP_M = 0.2
"""Upper bound of a template point's distance from the data, metres."""
MAX_COLOUR_M = 0.04
"""Upper bound of what a difference in colour counts when a point chooses its link, metres."""
TRUNCATION_M = 0.12
"""Distances count as this at most in a cost, metres."""
NO_CANDIDATES = np.zeros((0, CANDIDATES), np.int64)
KEPT_BY_KERNEL = NO_CANDIDATES.copy()
"""Stands for the candidates of the last solution, which the compiled twin keeps."""


class Step(NamedTuple):
    """One Gauss–Newton iteration: width of the robust weight, metres; how many points of the data and of the template
    it uses.
    """

    width: float
    data_points: int
    template_points: int


@dataclass(frozen=True, eq=False)
class FramePoints:
    """Points (n, 3) of a frame, metres, with a k-d tree of places and colours. scaled_colours (n, 3): colours in
    metres, so that differences in place and colour add up.
    """

    points: Floats
    scaled_colours: Floats | None
    colours: Bytes | None
    tree: Any

    @staticmethod
    def build(points: Floats, scaled_colours: Floats | None = None, colours: Bytes | None = None) -> FramePoints:
        points = np.ascontiguousarray(points, np.float64)
        if tree := native.kernel("KdTree"):
            built = tree(points, NO_COLOURS if scaled_colours is None else scaled_colours)
            return FramePoints(points, scaled_colours, colours, built)
        from scipy.spatial import KDTree

        both = points if scaled_colours is None else np.concatenate([points, scaled_colours], axis=1)
        tree = KDTree(both, leafsize=16, compact_nodes=False, balanced_tree=False)
        return FramePoints(points, scaled_colours, colours, tree)

    def subset(self, rows: AnyInteger) -> FramePoints:
        """Some of the points, with a tree of their own."""
        scaled = None if self.scaled_colours is None else self.scaled_colours[rows]
        return FramePoints.build(self.points[rows], scaled, None if self.colours is None else self.colours[rows])

    def nearest(self, points: Floats, scaled_colours: Floats | None, limit: float) -> tuple[Floats, AnyInteger]:
        """Distance (k,) and row (k,) of the data point nearest to each of points (k, 3), in place and colour; ∞ and n
        where none is nearer than `limit`, metres.
        """
        both = points
        if self.scaled_colours is not None and scaled_colours is not None:
            both = np.concatenate([points, scaled_colours], axis=1)
        return self.tree.query(both, distance_upper_bound=limit)

    def with_colour_distance(self, distance: Floats, scaled_colours: Floats | None, rows: AnyInteger) -> Floats:
        """(n,): distances of the data points from template points `rows`, combined with the difference in colour."""
        if self.scaled_colours is None or scaled_colours is None:
            return distance
        return np.sqrt(distance**2 + np.sum((self.scaled_colours - scaled_colours[rows]) ** 2, axis=1))


@dataclass(frozen=True, eq=False)
class Fit:
    """How well a pose fits the data.

    residuals (n,): distance of each data point from the template, metres; rows, links (n,): the corresponding template
    point and its link. gaps (k,): distance of each sampled template point from the data. cost: mean squared distances
    both ways, in place and colour, each truncated at 12 cm, square metres.
    """

    pose: Pose
    data: FramePoints
    residuals: Floats
    rows: AnyInteger
    links: AnyInteger
    gaps: Floats
    cost: float

    @staticmethod
    def without_data(pose: Pose) -> Fit:
        """A pose without correspondences."""
        none = np.zeros(0, np.int64)
        return Fit(pose, FramePoints.build(np.zeros((0, 3))), np.zeros(0), none, none, np.zeros(0), 0.0)


class Matcher:
    """Registers one template: a body with a skin, its normals (n, 3) and scaled colours (n, 3).

    sample (k,): the template points that search for data, in the order in which steps take them. tangential: weight of
    squared distances along the surface against those across it. noise: of the data, metres.
    """

    def __init__(
        self,
        body: Body,
        skin: Skin,
        normals: Floats,
        scaled_colours: Floats | None,
        sample: AnyInteger,
        tangential: float,
        noise: float,
    ) -> None:
        self.body, self.skin, self.scaled_colours, self.sample = body, skin, scaled_colours, sample
        self.grids = LinkGrids.build(body, skin)
        self.equations = NormalEquations(body, skin, normals, tangential, noise)
        self.has_points = self.grids.nearest[self.grids.start] >= 0
        self.all_links = np.ones(len(body), bool)
        self.compiled: Any = None
        if matcher := native.kernel("BodyMatcher"):
            grids, links = self.grids, np.asarray(skin.links, np.int64)
            colours = NO_COLOURS if scaled_colours is None else scaled_colours
            arrays = [
                np.array(body.parents, np.int64), body.origins, body.lengths, skin.points, links, skin.weights, normals,
                colours, grids.nearest, grids.low, grids.size, grids.start,
            ]  # fmt: skip
            self.compiled = matcher(*(np.ascontiguousarray(x) for x in arrays), CELL_M, MARGIN_M)

    def solve(
        self,
        data: FramePoints,
        start: Pose,
        steps: Sequence[Step],
        prior: PosePrior,
        sample: AnyInteger | None = None,
        allowed: Booleans | None = None,
    ) -> Pose:
        """The pose after Gauss–Newton steps from `start`. sample: template points that search for data, instead of the
        matcher's. allowed (links,): those that data may be matched to.
        """
        return self._solve(data, start, steps, prior, sample, allowed)[0]

    def fit(self, data: FramePoints, start: Pose, steps: Sequence[Step], prior: PosePrior) -> Fit:
        """`solve`, then `assess`."""
        return self.assess(data, *self._solve(data, start, steps, prior, None, None))

    def _solve(
        self,
        data: FramePoints,
        start: Pose,
        steps: Sequence[Step],
        prior: PosePrior,
        sample: AnyInteger | None,
        allowed: Booleans | None,
    ) -> tuple[Pose, AnyInteger]:
        """As `solve`; and the candidate links (n, CANDIDATES) of the first n points."""
        sample = self.sample if sample is None else sample
        allowed = self.all_links if allowed is None else allowed
        if self.compiled and native.available():
            strengths = np.stack([prior.start_strength, prior.rest_strength])
            rotations, root = self.compiled.solve(
                data.tree, start.rotations, start.root, np.array(steps, float).reshape(-1, 3), sample, allowed,
                prior.rest, strengths, prior.limits.links, prior.limits.table, prior.limit_strength,
                prior.root_strength, self.equations.tangential, self.equations.noise, SEARCH_WIDTHS, CONVERGED_M,
                SKIP_RATIO, NEVER_SKIPPED_M,
            )  # fmt: skip
            return Pose(rotations, root), KEPT_BY_KERNEL
        pose = start
        a, b = transforms(self.body, pose)
        candidates = NO_CANDIDATES
        limited_axes = np.zeros((len(prior.limits.links), 3))
        since_refresh, converged_at = 0, np.inf  # steps since; width of the last step if it has converged
        for step in steps:
            if step.width > max(NEVER_SKIPPED_M, SKIP_RATIO * converged_at):
                continue
            points = data.points[: step.data_points]
            since_refresh += 1
            if since_refresh > REFRESH_STEPS and np.isinf(converged_at):
                candidates, since_refresh = NO_CANDIDATES, 1
            if len(candidates) < len(points):
                more = self._candidates(points[len(candidates) :], a, b, allowed)
                candidates = np.concatenate([candidates, more]) if len(candidates) else more
            targets, rows = self._correspondences(data, a, b, candidates[: len(points)], sample, step)
            pose, moved = self.equations.step(targets, rows, pose, start, a, b, step.width, prior, limited_axes)
            converged_at = step.width if moved < CONVERGED_M else np.inf
            a, b = transforms(self.body, pose)
        return pose, candidates

    def assess(self, data: FramePoints, pose: Pose, candidates: AnyInteger = NO_CANDIDATES) -> Fit:
        """How well a pose fits. candidates: links of each data point, where they are known."""
        sample = self.sample
        if self.compiled and native.available():
            return Fit(pose, data, *self.compiled.assess(
                data.tree, pose.rotations, pose.root, sample, self.all_links, candidates is KEPT_BY_KERNEL, MAX_GAP_M,
                TRUNCATION_M,
            ))  # fmt: skip
        a, b = transforms(self.body, pose)
        if len(candidates) != len(data.points):
            candidates = self._candidates(data.points, a, b, self.all_links)
        rows, links = self._match(data, a, b, candidates)
        residuals = np.linalg.norm(data.points - self.skin.posed(a, b, rows), axis=1)
        posed = self.skin.posed(a, b, sample)
        colours = None if self.scaled_colours is None else self.scaled_colours[sample]
        distance, index = data.nearest(posed, colours, MAX_GAP_M)
        index = np.minimum(index, len(data.points) - 1)  # where no point is so near
        gaps = np.where(np.isfinite(distance), np.linalg.norm(posed - data.points[index], axis=1), MAX_GAP_M)
        with_colour = data.with_colour_distance(residuals, self.scaled_colours, rows)
        cost = np.mean(np.minimum(with_colour, TRUNCATION_M) ** 2)
        cost += np.mean(np.minimum(distance, TRUNCATION_M) ** 2)
        return Fit(pose, data, residuals, rows, links, gaps, float(cost))

    def _candidates(self, points: Floats, a: Floats, b: Floats, allowed: Booleans) -> AnyInteger:
        """(n, CANDIDATES): the links whose template is nearest to each point; the nearest again in place of links
        farther than it by `CANDIDATE_MARGIN_M`.
        """
        links = np.flatnonzero(self.has_points & allowed)
        local = (points[None] - b[links, None]) @ a[links]
        row = self.grids.look_up(links[:, None], local)
        gap = local - self.skin.points[row]
        square = np.einsum("lni,lni->ln", gap, gap)
        count = min(CANDIDATES, len(links))
        order = np.argpartition(square, count - 1, axis=0)[:count]
        nearest = square.argmin(axis=0)
        distance = np.sqrt(np.take_along_axis(square, order, axis=0))
        limit = np.sqrt(square[nearest, np.arange(len(points))]) + CANDIDATE_MARGIN_M
        return links[np.where(distance > limit, nearest, order)].T

    def _correspondences(
        self, data: FramePoints, a: Floats, b: Floats, candidates: AnyInteger, sample: AnyInteger, step: Step
    ) -> tuple[Floats, AnyInteger]:
        """Places (m, 3) of data points and the template rows (m,) that should move there, found from either side."""
        matched, _ = self._match(data, a, b, candidates)
        rows = sample[: step.template_points]
        colours = None if self.scaled_colours is None else self.scaled_colours[rows]
        distance, index = data.nearest(self.skin.posed(a, b, rows), colours, SEARCH_WIDTHS * step.width)
        near = np.isfinite(distance)
        targets = np.concatenate([data.points[: len(candidates)], data.points[index[near]]])
        return targets, np.concatenate([matched, rows[near]])

    def _match(self, data: FramePoints, a: Floats, b: Floats, candidates: AnyInteger) -> tuple[AnyInteger, AnyInteger]:
        """For each of the first points, the template row nearest in place and colour among its candidate links, and
        its link.
        """
        points = data.points[: len(candidates)]
        local = np.einsum("nki,nkij->nkj", points[:, None] - b[candidates], a[candidates])
        row = self.grids.look_up(candidates, local)
        gap = local - self.skin.points[row]
        square = np.einsum("nki,nki->nk", gap, gap)
        if self.scaled_colours is not None and data.scaled_colours is not None:
            colour = data.scaled_colours[: len(candidates), None] - self.scaled_colours[row]
            square += np.minimum(np.einsum("nki,nki->nk", colour, colour), MAX_COLOUR_M**2)
        best = square.argmin(axis=1)
        n = np.arange(len(points))
        return row[n, best], candidates[n, best]
