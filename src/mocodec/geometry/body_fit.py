"""A first pose without a skeleton: the stock body fitted to one frame of points, in pose and proportions.

    points ──► pose hypotheses (pose_search) ──Gauss–Newton on joints and proportions, each──► best ──► FittedSkeleton

Works for people who stand or sit, in any heading. The costs of hypotheses and the steps are compiled
(src/native/first_pose.cpp).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .. import native
from ..errors import BadInput, CannotEncode
from ..typing import AnyInteger, Floats
from . import articulation, neighbours, pose_search, stock_body
from .articulation import Body
from .body_matching import FramePoints
from .capsules import capsule_distances, surface_distances
from .gauss_newton import cross, link_motions
from .pose_search import CHAINS, TRUNCATION_M, PoseHypotheses, PoseSearch

MAX_SKELETON_DISTANCE_M = 0.3
"""A skeleton is elsewhere if the median distance of its links from the points is more than this, metres."""
MAX_FIT_ERROR_M = 0.08
"""A fit is rejected if the points' mean distance from the body is more than this, metres."""
MIN_HEIGHT_M, MAX_HEIGHT_M = 0.4, 3.0
"""Height of a standing person, metres."""
CANDIDATES, FINALISTS = 8, 3
"""Hypotheses that are refined coarsely, and of these in full."""
BACK_WEIGHT = 0.3
"""Weight of the surface samples' distances from the points, against the points' distances from the surface."""
INDEPENDENT, NOISE_M = 150.0, 0.02
"""Neighbouring distances are correlated: all together count as this number of independent ones, of this noise in
metres."""
PROPORTION_SPREAD, PROPORTION_COST = 0.07, 2e-5
"""Standard deviation of a proportion about the mean of all, as a logarithm; the cost of one of them, square metres."""
MAX_TURN, MAX_GROWTH = 0.4, 0.05
"""Change of a joint, radians, and of a proportion, as a logarithm, in one step, at most."""
HINGE_SPREAD = 0.1
"""Standard deviation of a knee or elbow that bends the wrong way, radians."""
WIDTHS = tuple(np.geomspace(0.15, 0.03, 24).tolist())
"""Widths of the robust weight, metres, one an iteration."""
EXPECTED_TURN = {
    "LowerBack": 0.12, "Spine": 0.12, "Spine1": 0.12, "Neck": 0.15, "Neck1": 0.15, "Head": 0.2, "Shoulder": 0.15,
    "Hand": 0.3, "Foot": 0.35, "Arm": 1.5, "ForeArm": 1.0, "UpLeg": 1.2, "Leg": 1.0,
}  # fmt: skip
"""Standard deviation of a joint about the stock body's pose, radians."""
OTHER_TURN, ROOT_TURN = 4.0, 10.0
"""The same of all other joints, and of the root."""
UPRIGHT = {
    "x": np.array([[0, 1.0, 0], [1, 0, 0], [0, 0, -1]]),
    "y": np.eye(3),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}
"""The rotation that turns each vertical axis to y."""


class FittedSkeleton(NamedTuple):
    """A skeleton in the pose of a frame: names, parents and positions (joints, 3) of its joints, metres; error_m: the
    points' mean distance from the fitted body.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    positions: Floats
    error_m: float

    def body(self, one_trunk: bool = False, shortest: float = 0.085) -> Body:
        """The links of the skeleton; see `articulation.from_skeleton`."""
        return articulation.from_skeleton(
            self.names, self.parents, self.positions, one_trunk=one_trunk, shortest=shortest
        )


def first_pose(points: Floats, up: str = "y") -> FittedSkeleton:
    """The figure of the standing or seated person in points (n, 3), metres. Raises CannotEncode if there is none."""
    turn = UPRIGHT[up]
    upright = largest_group(points @ turn.T)
    low, high = np.percentile(upright, [0.5, 99.5], axis=0)
    height = float(high[1] - low[1])
    if not MIN_HEIGHT_M < height < MAX_HEIGHT_M:
        unit = "give the unit of the points (--unit mm)" if height > 100 else "give a skeleton (--skeleton)"
        raise CannotEncode(f"the first frame is {height:.4g} m high: not a standing person in metres; {unit}")
    search = PoseSearch(upright)
    fitter = StockBodyFitter(upright, search)
    poses = search.best(CANDIDATES)
    starts = [estimate_of(poses, row) for row in range(len(poses.cost))]
    coarse = sorted((fitter.refine(start, WIDTHS[::2]) for start in starts), key=cost_of)
    best = min((fitter.refine(fitter.resample_limbs(one), WIDTHS) for one in coarse[:FINALISTS]), key=cost_of)
    others = [fitter.turned_around(best), *fitter.limbs_exchanged(best)]
    best = min([best, *(fitter.refine(other, WIDTHS) for other in others)], key=cost_of)
    figure = fitter.figure(best, turn)
    if figure.error_m > MAX_FIT_ERROR_M:
        raise CannotEncode(
            f"no standing or seated figure fits the first frame ({figure.error_m * 100:.0f} cm off): give a skeleton"
        )
    return figure


def largest_group(points: Floats, gap: float = 0.15) -> Floats:
    """The largest connected group of points (n, 3), where gaps of about `gap` metres still connect: one person of
    several, without outliers. Points more than seven metres from the others are ignored.
    """
    low = np.percentile(points, 1, axis=0) - 2.0
    cell = np.clip((points - low) / gap, 0, 60).astype(np.int64)  # nine metres
    _, first, cell_of = np.unique(
        (cell[:, 0] * 61 + cell[:, 1]) * 61 + cell[:, 2], return_index=True, return_inverse=True
    )
    group = neighbours.groups(cell[first], 3)[cell_of.reshape(-1)]
    inside = ((cell > 0) & (cell < 60)).all(axis=1)
    is_largest = inside & (group == np.bincount(group[inside], minlength=1).argmax())
    return points[is_largest] if is_largest.any() else points


class BodyEstimate(NamedTuple):
    """A pose and a build: rotations (links, 3, 3), root (3,) of the hips in metres, build (PROPORTIONS,) as factors,
    cost in square metres.
    """

    rotations: Floats
    root: Floats
    build: Floats
    cost: float


def estimate_of(poses: PoseHypotheses, row: int) -> BodyEstimate:
    """One of several hypotheses, with all proportions equal to its size."""
    build = np.full(len(stock_body.PROPORTIONS), poses.size[row])
    return BodyEstimate(poses.rotations[row], poses.root[row], build, np.inf)


def cost_of(estimate: BodyEstimate) -> float:
    return estimate.cost


class PosedCapsules(NamedTuple):
    """World rotations a (links, 3, 3), joints (…, links, 3), capsule ends (…, c, 2, 3) and radii (…, c, 2), metres."""

    a: Floats
    joints: Floats
    ends: Floats
    radii: Floats


class Correspondences(NamedTuple):
    """Pairs of a place on a capsule and a point. capsules (p,), shares (p, 1) of their axes, and normals (p, 3)
    determine the places; targets (p, 3): the points. The first `points` pairs belong to points, the others to surface
    samples.
    """

    capsules: AnyInteger
    shares: Floats
    normals: Floats
    targets: Floats
    points: int

    def places(self, ends: Floats, radii: Floats) -> Floats:
        """(…, p, 3): the places on capsules with ends (…, c, 2, 3) and radii (…, c, 2)."""
        p, r = ends[..., self.capsules, :, :], radii[..., self.capsules, :]
        radius = r[..., :1] + self.shares * (r[..., 1:] - r[..., :1])
        return p[..., 0, :] + self.shares * (p[..., 1, :] - p[..., 0, :]) + radius * self.normals


class StockBodyFitter:
    """Fits pose and proportions of the stock body's capsules to points (n, 3), y up, by Gauss–Newton; at most
    `max_points` of them are used. search: the pose search on the same points.
    """

    def __init__(self, points: Floats, search: PoseSearch, max_points: int = 1200) -> None:
        self.body, self.model, self.field = search.body, search.model, search.field
        rows = np.random.default_rng(3).permutation(len(points))[:max_points]
        self.points = points[rows]
        self.data = FramePoints.build(self.points)
        self.is_ancestor = self.body.ancestors
        without_side = [name.removeprefix("Left").removeprefix("Right") for name in self.body.names]
        self.expected_turn = np.array([EXPECTED_TURN.get(name, OTHER_TURN) for name in without_side])
        self.expected_turn[0] = ROOT_TURN
        self.compiled = self._compiled_fitter()

    def _compiled_fitter(self) -> Any:
        """The steps of `refine` as the compiled module takes them, None without it."""
        if (fitter := native.kernel("CapsuleFitter")) is None:
            return None
        body, model = self.body, self.model
        above = np.where(np.array(model.parents)[:, None] < 0, 0.0, model.stock[list(model.parents)])
        hinges, axes = zip(*pose_search.hinges(body), strict=True)
        constants = [BACK_WEIGHT, INDEPENDENT / NOISE_M**2, PROPORTION_SPREAD, HINGE_SPREAD, MAX_TURN, MAX_GROWTH]
        return fitter(
            np.array(body.parents), np.array(body.joints), np.array(model.parents), model.stock - above,
            model.joint_scales, model.link, model.ends, model.stock_radii, model.radius_scales, model.capsule,
            model.shares, model.outward, self.expected_turn, np.array(hinges), np.array(axes), np.array(constants),
            self.data.tree, self.field.compiled_hidden(),
        )  # fmt: skip

    def resample_limbs(self, estimate: BodyEstimate) -> BodyEstimate:
        """The estimate with better limbs, if a random search with its proportions finds any."""
        search = PoseSearch(self.points, estimate.build, self.field, max_points=500)
        pose = PoseHypotheses(estimate.rotations[None], estimate.root[None], np.ones(1), np.zeros(1))
        return estimate._replace(rotations=search.resample_limbs(pose).rotations[0])

    def turned_around(self, estimate: BodyEstimate) -> BodyEstimate:
        """The body facing the other way, with its right limbs where the left ones were."""
        still = np.tile(np.eye(3), (len(self.body), 1, 1))
        still[0] = estimate.rotations[0] @ np.diag([-1.0, 1, -1])
        return self._exchanged(estimate, still, sum(CHAINS, ()))

    def limbs_exchanged(self, estimate: BodyEstimate) -> list[BodyEstimate]:
        """The estimate with left and right arms exchanged, and with left and right legs exchanged."""
        return [self._exchanged(estimate, estimate.rotations, chain) for chain in CHAINS]

    def _exchanged(self, estimate: BodyEstimate, rotations: Floats, chain: tuple[str, ...]) -> BodyEstimate:
        """The estimate with these rotations (links, 3, 3), but the long bones of some limbs, named without their side,
        in the directions of the other side's.
        """
        body, result = self.body, rotations.copy()
        a = self._posed(estimate.rotations, estimate.root, estimate.build).a
        world = np.array(a)
        for link, (name, parent) in enumerate(zip(body.names, body.parents, strict=True)):
            above = world[parent] if parent >= 0 else np.eye(3)
            other = pose_search.mirrored_name(name)
            if other != name and name.endswith(chain) and not name.endswith(("Hand", "Foot")):
                direction = a[body.names.index(other)] @ body.axes[body.names.index(other)]
                result[link] = above.T @ articulation.rotation_between(above @ body.axes[link], direction) @ above
            world[link] = above @ result[link]
        return estimate._replace(rotations=result)

    def refine(self, estimate: BodyEstimate, widths: tuple[float, ...]) -> BodyEstimate:
        """The estimate after one Gauss–Newton step per width, with its cost."""
        if self.compiled is not None and native.available():
            rotations, root, build = self.compiled.refine(*estimate[:3], np.array(widths))
            estimate = BodyEstimate(rotations, root, build, np.inf)
        else:
            for width in widths:
                estimate = self._step(estimate, width)
        return estimate._replace(cost=self._cost(estimate))

    def _posed(self, rotations: Floats, root: Floats, build: Floats) -> PosedCapsules:
        """The capsules of people of builds (…, PROPORTIONS) in a pose (links, 3, 3), (3,)."""
        positions, body, model = self.model.joint_positions(build), self.body, self.model
        a, b = np.empty((len(body), 3, 3)), np.empty((*build.shape[:-1], len(body), 3))
        for link, (parent, joint) in enumerate(zip(body.parents, body.joints, strict=True)):
            a[link] = rotations[link] if parent < 0 else a[parent] @ rotations[link]
            shift = positions[..., joint, :] @ ((a[parent] if parent >= 0 else 0.0) - a[link]).T
            b[..., link, :] = shift + (b[..., parent, :] if parent >= 0 else root)
        ends = np.einsum("cij,...cej->...cei", a[model.link], positions[..., model.ends, :])
        ends = ends + b[..., model.link, None, :]
        joints = np.einsum("lij,...lj->...li", a, positions[..., list(body.joints), :]) + b
        return PosedCapsules(a, joints, ends, model.radii(build))

    def _step(self, estimate: BodyEstimate, width: float) -> BodyEstimate:
        """One step: a rotation of every joint, in the world, a translation of the root, and the logarithms of the
        proportions.

        Distances of points from the capsules count across the surface (point-to-plane). Distances of surface samples
        from the points count in every direction, so that a limb in empty air is drawn to the points.
        """
        links = len(self.body)
        posed = self._posed(estimate.rotations, estimate.root, estimate.build)
        pairs = self._correspondences(posed, width)
        y = pairs.places(posed.ends, posed.radii)
        gap = pairs.targets - y
        weight = (width**2 / (width**2 + np.einsum("ni,ni->n", gap, gap))) ** 2
        weight[pairs.points :] *= BACK_WEIGHT * pairs.points / len(self.model.shares)
        h, g = self._equations(posed, pairs, y, gap, weight, self._growth(estimate, pairs))
        scale = INDEPENDENT / pairs.points / NOISE_M**2
        h, g = h * scale, g * scale
        parents = np.stack([posed.a[p] if p >= 0 else np.eye(3) for p in self.body.parents])
        self._add_priors(h, g, estimate, parents)
        step = np.linalg.solve(h, g)
        turns = step[3 : 3 + 3 * links].reshape(-1, 3)
        turns *= np.minimum(1.0, MAX_TURN / np.maximum(np.linalg.norm(turns, axis=1, keepdims=True), 1e-9))
        rotations = articulation.exp(np.einsum("lji,lj->li", parents, turns)) @ estimate.rotations
        build = estimate.build * np.exp(np.clip(step[3 + 3 * links :], -MAX_GROWTH, MAX_GROWTH))
        return BodyEstimate(rotations, estimate.root + step[:3], build, np.inf)

    def _correspondences(self, posed: PosedCapsules, width: float) -> Correspondences:
        """The nearest capsule of each point; and the nearest point of each surface sample that is not hidden,
        within three widths.
        """
        capsule, share, normal = self._nearest_capsules(posed.ends, posed.radii)
        samples, outward = self.model.surface_samples(posed.a, posed.ends, posed.radii)
        distance, index = self.data.nearest(samples, None, 3 * width)
        near = np.flatnonzero(np.isfinite(distance) & ~self.field.is_hidden(samples))
        return Correspondences(
            np.concatenate([capsule, self.model.capsule[near]]),
            np.concatenate([share, self.model.shares[near]])[:, None],
            np.concatenate([normal, outward[near]]),
            np.concatenate([self.points, self.points[np.asarray(index)[near]]]),
            len(share),
        )

    def _growth(self, estimate: BodyEstimate, pairs: Correspondences) -> Floats:
        """(p, 3, PROPORTIONS): derivatives of the places by the logarithms of the proportions. Places are linear in
        the proportions and the root.
        """
        single = self._posed(estimate.rotations, np.zeros(3), np.diag(estimate.build))
        return pairs.places(single.ends, single.radii).transpose(1, 2, 0)

    def _equations(
        self, posed: PosedCapsules, pairs: Correspondences, y: Floats, gap: Floats, weight: Floats, growth: Floats
    ) -> tuple[Floats, Floats]:
        """h and g of root, joints and proportions, from places y (p, 3), gaps (p, 3), weights (p,) and growth.

        A place counts along one direction n, a sample along three. Its distance changes by f · (v, ω, proportions) with
        f = (n, y × n, n · growth); sums of f fᵀ by links become those of the joints, as in `gauss_newton`.
        """
        n, p = pairs.points, len(y)
        pair = np.concatenate([np.arange(n), np.repeat(np.arange(n, p), 3)])
        across = np.concatenate([pairs.normals[:n], np.tile(np.eye(3), (p - n, 1))])
        grown = np.einsum("rij,ri->rj", growth[pair], across)
        rows = np.concatenate([across, cross(y[pair], across), grown], axis=1)
        right = weight[pair] * np.einsum("ri,ri->r", across, gap[pair])
        order = np.argsort(self.model.link[pairs.capsules[pair]], kind="stable")
        borders = np.searchsorted(self.model.link[pairs.capsules[pair]][order], np.arange(len(self.body) + 1))
        rows, weighted, right = rows[order], (rows * weight[pair, None])[order], right[order]
        motions = link_motions(self.is_ancestor, posed.joints)  # (links, 6, unknowns)
        parts = [slice(*borders[link : link + 2]) for link in range(len(motions))]
        squares = np.stack([weighted[part].T @ rows[part] for part in parts])  # sums of f fᵀ by links
        vectors = np.stack([right[part] @ rows[part] for part in parts])
        joints, unknowns = motions.reshape(-1, motions.shape[2]), motions.shape[2]
        h, g = np.empty((unknowns + growth.shape[2],) * 2), np.empty(unknowns + growth.shape[2])
        h[:unknowns, :unknowns] = joints.T @ (squares[:, :6, :6] @ motions).reshape(joints.shape)
        h[:unknowns, unknowns:] = joints.T @ squares[:, :6, 6:].reshape(len(joints), -1)
        h[unknowns:, :unknowns] = h[:unknowns, unknowns:].T
        h[unknowns:, unknowns:] = squares[:, 6:, 6:].sum(axis=0)
        g[:unknowns] = joints.T @ vectors[:, :6].ravel()
        g[unknowns:] = vectors[:, 6:].sum(axis=0)
        return h, g

    def _add_priors(self, h: Floats, g: Floats, estimate: BodyEstimate, parents: Floats) -> None:
        """Add penalties to h and g, in place: of rotations from the stock body's pose, of knees and elbows that bend
        the wrong way, and of differences between the proportions. parents (links, 3, 3): world rotations of the
        parents.
        """
        vectors = articulation.log(estimate.rotations)
        at = np.arange(3, 3 + 3 * len(self.body))
        h[at, at] += np.repeat(self.expected_turn**-2, 3)
        g[at] -= (np.einsum("lij,lj->li", parents, vectors) * self.expected_turn[:, None] ** -2).ravel()
        for link, hinge in pose_search.hinges(self.body):
            bend = float(vectors[link] @ hinge)
            if bend < 0:
                axis = parents[link] @ hinge
                rows = slice(3 + 3 * link, 6 + 3 * link)
                h[rows, rows] += np.outer(axis, axis) / HINGE_SPREAD**2
                g[rows] -= axis * bend / HINGE_SPREAD**2
        deviation = np.eye(len(estimate.build)) - 1 / len(estimate.build)  # from the mean, which is free
        rows = slice(3 + 3 * len(self.body), None)
        h[rows, rows] += deviation / PROPORTION_SPREAD**2 + 0.1 * np.eye(len(deviation))
        g[rows] -= deviation @ np.log(estimate.build) / PROPORTION_SPREAD**2

    def _nearest_capsules(self, ends: Floats, radii: Floats) -> tuple[AnyInteger, Floats, Floats]:
        """For each point the capsule with the nearest surface (n,), the share of its axis nearest to the point (n,),
        and the normal there (n, 3).
        """
        distances, shares = capsule_distances(self.points, ends, radii)
        best, n = np.abs(distances).argmin(axis=0), np.arange(len(self.points))
        share = shares[best, n].astype(np.float64)
        out = self.points - ends[best, 0] - share[:, None] * (ends[best, 1] - ends[best, 0])
        return best, share, out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-6)

    def _point_distances(self, posed: PosedCapsules) -> Floats:
        """(n,): distances of the points from the body, metres."""
        return surface_distances(self.points, posed.ends[None], posed.radii[None])[0]

    def _cost(self, estimate: BodyEstimate) -> float:
        posed = self._posed(estimate.rotations, estimate.root, estimate.build)
        samples = self.field(self.model.surface_samples(posed.a, posed.ends, posed.radii)[0])
        cost = np.mean(np.minimum(self._point_distances(posed), TRUNCATION_M) ** 2)
        cost = cost + np.mean(np.minimum(samples, TRUNCATION_M) ** 2)
        log_build = np.log(estimate.build)
        cost += PROPORTION_COST * np.sum(((log_build - log_build.mean()) / PROPORTION_SPREAD) ** 2)
        return float(cost + pose_search.hinge_penalty(self.body, estimate.rotations[None])[0])

    def figure(self, estimate: BodyEstimate, turn: Floats) -> FittedSkeleton:
        """The skeleton in the file's axes. turn (3, 3): the rotation from these to y up."""
        posed, body = self._posed(estimate.rotations, estimate.root, estimate.build), self.body
        leaves = [link for link in range(len(body)) if link not in body.parents]
        positions = self.model.joint_positions(estimate.build)
        tips = list[Floats]()
        for link in leaves:
            stop = int(np.argmin(np.linalg.norm(self.model.stock - body.tips[link], axis=1)))
            tips.append(posed.a[link] @ (positions[stop] - positions[body.joints[link]]) + posed.joints[link])
        names = (*body.names, *(f"{body.names[link]}Tip" for link in leaves))
        error = float(np.minimum(self._point_distances(posed), 0.3).mean())
        return FittedSkeleton(
            names, (*body.parents, *leaves), np.concatenate([posed.joints, np.array(tips)]) @ turn, error
        )


def require_near(body: Body, points: Floats) -> None:
    """Raises BadInput for a skeleton that is not among the points (n, 3), metres."""
    from scipy.spatial import KDTree

    centres = (body.origins + body.tips) / 2
    distance, _ = KDTree(points).query(centres)
    if np.median(distance) > MAX_SKELETON_DISTANCE_M:
        gap = f"{np.median(distance):.4g} m"
        raise BadInput(f"the skeleton is {gap} from the first frame's points: it must have its place, pose and unit")
