"""Random search for standing and seated poses in a cloud of points, without a start.

    distance field of the points ──────┐
    random poses ──score both ways──► best of each heading ──► resample limbs one by one ──► best few

The cost of a pose is the mean squared distance of the points from its capsules, plus that of the capsules' surface from
the points, both truncated. A limb inside the trunk leaves the arm's points unexplained, and a limb in empty air is far
from all points: either costs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .. import native
from ..typing import AnyInteger, Booleans, Floats
from . import articulation, normals, stock_body
from .articulation import Body
from .capsules import DistanceField, surface_distances

TRUNCATION_M = 0.12
"""Distances count as this at most, metres, and as 2.5 times the points' spacing if that is more."""
HEADINGS = 8
"""Sectors of headings, each of which keeps its best poses."""
SIDES = {"Left": 1.0, "Right": -1.0}
CHAINS = (("Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot"))
"""Links of the limbs that are resampled, without their side."""
STOCK_HEIGHT_M = 1.75
SIZES = 0.8, 0.87, 0.94, 1.0, 1.0, 1.08, 1.18
"""Factors of the points' height from which a random pose's size is drawn: a crouching person is larger than that."""
KEPT, LIMB_SAMPLES, PERTURBATIONS, BATCH = 40, 80, 12, 250
"""PoseHypotheses kept in the first round, random rotations of a limb, perturbations of a pose, poses scored at once."""
SEATED_SHARE, SEATED_SIZE, SEATED_HIP_RAD = 0.3, 1.3, -1.25
"""Share of random poses that sit; the factor of their size, since they are less tall; how far their hips are bent
beyond those of people who stand."""
TWISTS_RAD = 0.06, 0.25
"""Standard deviations of a random trunk's turn about its length, at each of three joints."""
ROUGH_POINTS, ROUGH_STRIDE, ROUGH_KEPT = 70, 3, 300
"""Points that score the first random poses, of how many surface samples one does, and how many poses are kept."""
HINGE_COST, FREE_HINGE_RAD = 0.002, 0.1
"""Cost of a knee or elbow that bends the wrong way, square metres for each square radian, and radians without cost."""
DISTINCT_M = 0.12
"""Two poses are distinct if a joint differs by more than this, metres."""


class PoseHypotheses(NamedTuple):
    """k poses of the stock body: rotations (k, links, 3, 3), root (k, 3) of the hips in metres, size (k,) as a factor,
    cost (k,) in square metres.
    """

    rotations: Floats
    root: Floats
    size: Floats
    cost: Floats

    def take(self, rows: Any) -> PoseHypotheses:
        return PoseHypotheses(*(values[rows] for values in self))

    @staticmethod
    def join(parts: list[PoseHypotheses]) -> PoseHypotheses:
        return PoseHypotheses(*(np.concatenate(values) for values in zip(*parts, strict=True)))


class PoseSearch:
    """Searches for a body in points (n, 3), metres, y up, of which at most `max_points` are used.

    build: proportions of the body, the stock body's unless given. field: the points' distance field, if it is known.
    """

    def __init__(
        self,
        points: Floats,
        build: Floats | None = None,
        field: DistanceField | None = None,
        max_points: int = 220,
    ) -> None:
        self.rng = np.random.default_rng(0)
        self.model = stock_body.capsule_model()
        self.body = self.model.body
        self.links = len(self.body)
        build = np.ones(len(stock_body.PROPORTIONS)) if build is None else build
        self.joints, self.radii = self.model.joint_positions(build), self.model.radii(build)
        self.origins = self.joints[list(self.body.joints)]
        upright = np.tile(np.eye(3), (self.links, 1, 1))
        self.samples = self.model.surface_samples(upright, self.joints[self.model.ends], self.radii)[0]
        self.sample_links = self.model.link[self.model.capsule]
        self.field = field or DistanceField(points)
        self.points = points[self.rng.permutation(len(points))[:max_points]]
        self.low, self.high = np.percentile(points, [0.5, 99.5], axis=0)
        self.centre = np.median(points, axis=0)
        is_sparse = len(points) < max_points
        self.truncation = max(TRUNCATION_M, 2.5 * normals.spacing(self.points) if is_sparse else 0.0)
        self.limbs = [[self._link(side + name) for name in chain] for side in SIDES for chain in CHAINS]
        self.compiled = self._compiled_scorer()

    def best(self, count: int = 6, draws: int = 3000, rounds: int = 3) -> PoseHypotheses:
        """The best `count` distinct poses, best first, from `draws` random ones improved in some rounds."""
        rough = self._scored(self._random_poses(draws), ROUGH_POINTS, ROUGH_STRIDE)
        poses = self._best_of_headings(self._scored(self._best_of_headings(rough, ROUGH_KEPT)), KEPT)
        for number in range(rounds):
            spread = 0.6 * 0.5**number
            for limb in self.limbs:
                poses = self._resample_limb(poses, limb, LIMB_SAMPLES, spread)
            more = self._scored(self._perturbed(poses, PERTURBATIONS, spread))
            poses = self._best_of_headings(PoseHypotheses.join([poses, more]), KEPT >> number)
        return self._distinct(poses, count)

    def resample_limbs(self, poses: PoseHypotheses, draws: int = 200) -> PoseHypotheses:
        """PoseHypotheses with the best of random rotations of each limb."""
        for spread in (0.5, 0.25):
            for limb in self.limbs:
                poses = self._resample_limb(poses, limb, draws, spread)
        return poses

    def _link(self, name: str) -> int:
        return self.body.names.index(name)

    # --- random poses -----------------------------------------------------------------------------------------------

    def _random_poses(self, count: int) -> PoseHypotheses:
        """Random poses, not scored: any heading, arms anywhere, legs as in standing, walking, crouching and sitting."""
        rng, body = self.rng, self.body
        sits = rng.random(count) < SEATED_SHARE
        turns = np.zeros((count, self.links, 3))
        turns[:, 1:4, 0] = rng.normal(0.05, 0.1, (count, 1))
        turns[:, 1:4, 1] = rng.normal(0, 1, (count, 1)) * rng.choice(TWISTS_RAD, (count, 1))
        turns[:, 1:4, 2] = rng.normal(0, 0.06, (count, 1))
        turns[:, 0, 0] = rng.normal(0, 0.1, count)
        rotations = _rotations(turns)
        heading = np.zeros((count, 3))
        heading[:, 1] = rng.uniform(0, 2 * np.pi, count)
        rotations[:, 0] = _rotations(heading) @ rotations[:, 0]
        for limb in self.limbs:
            rotations[:, limb] = self._random_limb(limb, sits)
        size = (self.high[1] - self.low[1]) / STOCK_HEIGHT_M * rng.choice(SIZES, count) * np.where(sits, SEATED_SIZE, 1)
        root = self.centre + rng.normal(0, 0.05, (count, 3))
        poses = PoseHypotheses(rotations, root, size, np.zeros(count))
        a, b = self._transforms(poses)
        feet = [self._link(f"{side}Foot") for side in SIDES]
        soles = np.einsum("klij,lj->kli", a[:, feet], body.tips[feet]) + b[:, feet]
        root[:, 1] += self.low[1] + 0.03 * size - soles[:, :, 1].min(axis=1)
        return poses

    def _random_limb(self, limb: list[int], sits: Booleans) -> Floats:
        """(n, links of the limb, 3, 3): random rotations of an arm or a leg, sits (n,): of people who sit."""
        rng, body, count = self.rng, self.body, len(sits)
        side = SIDES["Left" if body.names[limb[0]].startswith("Left") else "Right"]
        turns = np.tile(np.eye(3), (count, len(limb), 1, 1))
        if "Arm" in body.names[limb[0]]:
            kind = rng.choice(3, count, p=[0.35, 0.2, 0.45])  # hanging, raised, anywhere in front
            to = np.array([[0.15 * side, -1, 0.05], [0.2 * side, 1, 0.1], [0.25 * side, 0, 0.3]])[kind]
            to = to + np.array([0.25, 0.3, 0.7])[kind, None] * rng.normal(size=(count, 3))
            to /= np.linalg.norm(to, axis=1, keepdims=True)
            along = body.axes[limb[0]]
            twist = rng.normal(0, 0.7, count)
            turns[:, 0] = _rotations(to * twist[:, None]) @ articulation.rotation_between(
                np.tile(along, (count, 1)), to
            )
            bend = np.where(rng.random(count) < 0.6, np.abs(rng.normal(0.2, 0.3, count)), rng.uniform(0, 2.4, count))
            turns[:, 1] = _rotations(bend[:, None] * _elbow_axis(along))
            return turns
        hip = rng.normal([-0.15, 0, 0.06 * side], [0.4, 0.2, 0.18], (count, 3))
        knee = np.abs(rng.normal(0, 0.5, count)) + np.maximum(-hip[:, 0] - 0.4, 0)
        hip[sits] += [SEATED_HIP_RAD, 0, 0]
        knee[sits] = np.abs(rng.normal(-SEATED_HIP_RAD, 0.5, int(sits.sum())))
        turns[:, 0] = _rotations(hip)
        turns[:, 1] = _rotations(np.outer(knee, [1.0, 0, 0]))
        turns[:, 2] = _rotations(np.outer(-hip[:, 0] - knee, [0.8, 0, 0]) + rng.normal(0, 0.15, (count, 3)))
        return turns

    def _perturbed(self, poses: PoseHypotheses, times: int, spread: float) -> PoseHypotheses:
        """Each pose `times` times with random changes of heading, trunk, place, size and limbs; not scored."""
        rng = self.rng
        repeated = poses.take(np.repeat(np.arange(len(poses.cost)), times))
        count = len(repeated.cost)
        turns = rng.normal(size=(count, self.links, 3)) * spread * 0.25
        turns[:, 0, 1] *= 2
        turns[:, 1:8] *= 0.5
        rotations = repeated.rotations @ _rotations(turns)
        root = repeated.root + rng.normal(0, 0.08 * spread, (count, 3))
        size = repeated.size * np.exp(rng.normal(0, 0.08 * spread, count))
        return PoseHypotheses(rotations, root, size, repeated.cost)

    # --- cost of poses ----------------------------------------------------------------------------------------------

    def _compiled_scorer(self) -> Any:
        """The costs of poses as the compiled module computes them, None without it."""
        if (scorer := native.kernel("PoseScorer")) is None:
            return None
        links, axes = zip(*hinges(self.body), strict=True)
        return scorer(
            np.array(self.body.parents), self.origins, self.model.link, self.joints[self.model.ends], self.radii,
            self.sample_links, self.samples, np.array(links), np.array(axes), np.array([HINGE_COST, FREE_HINGE_RAD]),
            self.field.compiled_distances(), self.points, self.truncation,
        )  # fmt: skip

    def _transforms(self, poses: PoseHypotheses) -> tuple[Floats, Floats]:
        """a (k, links, 3, 3), scaled by the size, and b (k, links, 3): transforms of the links of each pose."""
        a = np.empty_like(poses.rotations)
        b = np.empty((len(a), self.links, 3))
        for link in range(self.links):
            self._update_transform(poses, a, b, link)
        return a, b

    def _update_transform(self, poses: PoseHypotheses, a: Floats, b: Floats, link: int) -> None:
        """Set a and b of one link, in place, from its parent's."""
        parent, origin = self.body.parents[link], self.origins[link]
        if parent < 0:
            a[:, link] = poses.rotations[:, link] * poses.size[:, None, None]
            b[:, link] = poses.root - a[:, link] @ origin
        else:
            a[:, link] = a[:, parent] @ poses.rotations[:, link]
            b[:, link] = (a[:, parent] - a[:, link]) @ origin + b[:, parent]

    def _scored(self, poses: PoseHypotheses, points: int | None = None, stride: int = 1) -> PoseHypotheses:
        """The poses with their costs, by the first points and every `stride`th surface sample."""
        if self.compiled is not None and native.available():
            count = len(self.points) if points is None else points
            return poses._replace(cost=self.compiled.costs(poses.rotations, poses.root, poses.size, count, stride))
        cost = np.empty(len(poses.cost))
        for start in range(0, len(cost), BATCH):
            batch = poses.take(slice(start, start + BATCH))
            a, b = self._transforms(batch)
            from_points = self._point_costs(a, b, batch.size, slice(None), slice(points)).mean(axis=1)
            from_samples = self._sample_costs(a, b, slice(None, None, stride)).mean(axis=1)
            penalty = hinge_penalty(self.body, batch.rotations)
            cost[start : start + BATCH] = from_points + from_samples + penalty
        return poses._replace(cost=cost)

    def _point_costs(self, a: Floats, b: Floats, size: Floats, chosen: Any, points: slice = slice(None)) -> Floats:
        """(k, n): truncated squared distances of the points, or of some of them, from the chosen capsules."""
        link, ends = self.model.link[chosen], self.joints[self.model.ends[chosen]]
        placed = np.einsum("kcij,cej->kcei", a[:, link], ends) + b[:, link, None]
        radii = self.radii[None, chosen] * size[:, None, None]
        return np.minimum(surface_distances(self.points[points], placed, radii), self.truncation) ** 2

    def _sample_costs(self, a: Floats, b: Floats, chosen: Any) -> Floats:
        """(k, m): truncated squared distances of the chosen surface samples from the points."""
        link = self.sample_links[chosen]
        placed = np.einsum("kmij,mj->kmi", a[:, link], self.samples[chosen]) + b[:, link]
        return np.minimum(self.field(placed), self.truncation) ** 2

    def _resample_limb(self, poses: PoseHypotheses, limb: list[int], draws: int, spread: float) -> PoseHypotheses:
        """Each pose with the best of `draws` rotations of one limb: half of them at random, half near its own."""
        turns = self._limb_turns(poses, limb, draws, spread)
        chosen, cost = self._best_limbs(poses, limb, turns)
        rotations = poses.rotations.copy()
        rotations[:, limb] = turns[np.arange(len(chosen)), chosen]
        return poses._replace(rotations=rotations, cost=cost)

    def _limb_turns(self, poses: PoseHypotheses, limb: list[int], draws: int, spread: float) -> Floats:
        """(k, draws, links of the limb, 3, 3): rotations of a limb, half of them at random, half near that of the pose,
        which is the first.
        """
        k, fresh = len(poses.cost), draws // 2
        own = poses.rotations[:, None, limb]
        turns = np.empty((k, draws, len(limb), 3, 3))
        random = self._random_limb(limb, self.rng.random(k * fresh) < SEATED_SHARE)
        turns[:, :fresh] = random.reshape(k, fresh, len(limb), 3, 3)
        noise = self.rng.normal(size=(k, draws - fresh, len(limb), 3)) * spread
        turns[:, fresh:] = own @ _rotations(noise)
        turns[:, :1] = own
        return turns

    def _best_limbs(self, poses: PoseHypotheses, limb: list[int], turns: Floats) -> tuple[AnyInteger, Floats]:
        """Which rotations of a limb (k, draws, links of the limb, 3, 3) are best for each pose (k,), and its cost then
        (k,).
        """
        if self.compiled is not None and native.available():
            best, cost = self.compiled.best_limbs(poses.rotations, poses.root, poses.size, np.array(limb), turns)
            return best, cost
        k, draws = turns.shape[:2]
        a, b = self._transforms(poses)
        of_limb, own = np.isin(self.model.link, limb), np.isin(self.sample_links, limb)
        rest = self._point_costs(a, b, poses.size, ~of_limb)
        before = self._sample_costs(a, b, slice(None))
        tried = PoseHypotheses(*(np.repeat(values, draws, axis=0) for values in poses))
        tried.rotations[:, limb] = turns.reshape(k * draws, len(limb), 3, 3)
        aa, bb = np.repeat(a, draws, axis=0), np.repeat(b, draws, axis=0)
        for link in limb:
            self._update_transform(tried, aa, bb, link)
        points = self._point_costs(aa, bb, tried.size, of_limb).reshape(k, draws, -1)
        cost = np.minimum(points, rest[:, None]).mean(axis=2)
        samples = self._sample_costs(aa, bb, own).sum(axis=1).reshape(k, draws)
        cost += (samples + before[:, ~own].sum(axis=1)[:, None]) / before.shape[1]
        cost += hinge_penalty(self.body, tried.rotations).reshape(k, draws)
        best = cost.argmin(axis=1)
        return best, cost[np.arange(k), best]

    # --- selection --------------------------------------------------------------------------------------------------

    def _best_of_headings(self, poses: PoseHypotheses, count: int) -> PoseHypotheses:
        """The best `count` poses, best first, at most a quarter of them from one sector of headings."""
        forward = poses.rotations[:, 0, :, 2]
        sector = (np.arctan2(forward[:, 0], forward[:, 2]) / (2 * np.pi) % 1 * HEADINGS).astype(int) % HEADINGS
        order = np.argsort(poses.cost, kind="stable")
        rank = np.empty(len(order), np.int64)
        for heading in range(HEADINGS):
            here = order[sector[order] == heading]
            rank[here] = np.arange(len(here))
        most = max(1, count // 4)
        kept = [row for row in order if rank[row] < most][:count]
        return poses.take(np.array(kept))

    def _distinct(self, poses: PoseHypotheses, count: int) -> PoseHypotheses:
        """The best `count` poses, each of which differs from every better one by 12 cm or more at some joint."""
        a, b = self._transforms(poses)
        joints = np.einsum("klij,lj->kli", a, self.body.tips) + b
        kept = list[int]()
        for row in np.argsort(poses.cost, kind="stable"):
            distances = [np.linalg.norm(joints[row] - joints[other], axis=1).max() for other in kept]
            if not distances or min(distances) > DISTINCT_M:
                kept.append(int(row))
            if len(kept) == count:
                break
        return poses.take(np.array(kept))


def mirrored_name(name: str) -> str:
    """A joint's name with Left and Right exchanged."""
    return name.replace("Left", "~").replace("Right", "Left").replace("~", "Right")


def hinges(body: Body) -> list[tuple[int, Floats]]:
    """The links below elbows and knees of the stock body, and the axes (3,) about which they bend."""
    result = list[tuple[int, Floats]]()
    for side in SIDES:
        fore, shin = body.names.index(f"{side}ForeArm"), body.names.index(f"{side}Leg")
        result += [(fore, _elbow_axis(body.axes[body.parents[fore]])), (shin, np.array([1.0, 0, 0]))]
    return result


def _rotations(vectors: Floats) -> Floats:
    """`articulation.exp`, compiled: for very many."""
    if (kernel := native.kernel("rotation_matrices")) is not None:
        return np.asarray(kernel(vectors.reshape(-1, 3))).reshape(*vectors.shape, 3)
    return articulation.exp(vectors)


def _elbow_axis(arm: Floats) -> Floats:
    """The axis about which the elbow below an upper arm bends forwards."""
    axis = np.cross(arm, [0, 0, 1.0])
    return axis / np.linalg.norm(axis)


def hinge_penalty(body: Body, rotations: Floats) -> Floats:
    """(k,): cost in square metres of knees and elbows that bend the wrong way in rotations (k, links, 3, 3)."""
    cost = np.zeros(len(rotations))
    for link, hinge in hinges(body):
        turn = -articulation.log(rotations[:, link]) @ hinge
        cost += HINGE_COST * np.maximum(turn - FREE_HINGE_RAD, 0) ** 2
    return cost
