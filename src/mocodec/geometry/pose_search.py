"""Standing poses that could be the one in a cloud of points: found without a start, by drawing and improving many.

    distance field of the points ─┐
    random standing poses ──judge both ways──► best of every heading ──► limbs drawn anew, one by one ──► best few

A pose is judged by how far the points are from its capsules and its capsules from the points, none counted beyond a
reach: a limb that lies in the trunk leaves the arm's points unexplained, and a limb in empty air is far from all.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import articulation, stock_body
from .articulation import Body, Floats
from .capsules import Field, gaps

Ints = NDArray[Any]
REACH = 0.12  # metres: what is farther than this is not counted more
HEADINGS = 8  # sectors of which each keeps its best
SIDES = {"Left": 1.0, "Right": -1.0}


class Poses(NamedTuple):
    """Many poses of the stock body: rotations (k, links, 3, 3), root (k, 3) of the hips in metres, size (k,) of the
    body, cost (k,) in square metres."""

    rotations: Floats
    root: Floats
    size: Floats
    cost: Floats

    def take(self, rows: Any) -> Poses:
        return Poses(*(values[rows] for values in self))

    @staticmethod
    def join(parts: list[Poses]) -> Poses:
        return Poses(*(np.concatenate(values) for values in zip(*parts, strict=True)))


class Search:
    """Looks for a body in points (n, 3), metres, y up, of which at most so many are looked at.

    build: its proportions, the stock body's unless given. field: of the points, where it is known.
    """

    def __init__(
        self, points: Floats, build: Floats | None = None, field: Field | None = None, most: int = 220
    ) -> None:
        self.rng = np.random.default_rng(0)
        self.flesh = stock_body.flesh()
        self.body = self.flesh.body
        self.links = len(self.body)
        build = np.ones(len(stock_body.BUILD)) if build is None else build
        self.joints, self.radii = self.flesh.places(build), self.flesh.radii(build)
        self.origins = self.joints[list(self.body.joints)]
        upright = np.tile(np.eye(3), (self.links, 1, 1))
        self.places = self.flesh.surface(upright, self.joints[self.flesh.ends], self.radii)[0]
        self.owners = self.flesh.link[self.flesh.part]
        self.field = field or Field(points)
        self.points = points[self.rng.permutation(len(points))[:most]]
        self.low, self.high = np.percentile(points, [0.5, 99.5], axis=0)
        self.middle = np.median(points, axis=0)
        self.reach = max(REACH, 2.5 * _spacing(self.points) if len(points) < most else 0.0)
        self.limbs = [[self._link(side + name) for name in chain] for side in SIDES for chain in CHAINS]

    def best(self, count: int = 6, draws: int = 3000, rounds: int = 3) -> Poses:
        """The best poses found, best first, no two of them alike."""
        found = self._spread(self._judge(self._draw(draws)), 40)
        for turn in range(rounds):
            wide = 0.6 * 0.5**turn
            for limb in self.limbs:
                found = self._redraw(found, limb, 80, wide)
            found = self._spread(Poses.join([found, self._judge(self._shaken(found, 12, wide))]), 40 >> turn)
        return self._different(found, count)

    def with_limbs_anew(self, poses: Poses, draws: int = 200) -> Poses:
        """Poses of this build with the best of many random turns of every limb."""
        for wide in (0.5, 0.25):
            for limb in self.limbs:
                poses = self._redraw(poses, limb, draws, wide)
        return poses

    def _link(self, name: str) -> int:
        return self.body.names.index(name)

    # --- poses out of nothing ---------------------------------------------------------------------------------------

    def _draw(self, count: int) -> Poses:
        """Random standing poses: any heading, arms anywhere, legs as in standing, walking and crouching."""
        rng, body = self.rng, self.body
        turns = np.zeros((count, self.links, 3))
        turns[:, 1:4, 0] = rng.normal(0.05, 0.1, (count, 1))
        turns[:, 1:4, 1:] = rng.normal(0, 0.06, (count, 1, 2))
        turns[:, 0, 0] = rng.normal(0, 0.1, count)
        rotations = articulation.exp(turns)
        heading = np.zeros((count, 3))
        heading[:, 1] = rng.uniform(0, 2 * np.pi, count)
        rotations[:, 0] = articulation.exp(heading) @ rotations[:, 0]
        for limb in self.limbs:
            rotations[:, limb] = self._limb(limb, count)
        size = (self.high[1] - self.low[1]) / 1.75 * rng.choice([0.8, 0.87, 0.94, 1.0, 1.0, 1.08, 1.18], count)
        root = self.middle + rng.normal(0, 0.05, (count, 3))
        poses = Poses(rotations, root, size, np.zeros(count))
        a, b = self._transforms(poses)
        feet = [self._link(f"{side}Foot") for side in SIDES]
        soles = np.einsum("klij,lj->kli", a[:, feet], body.tips[feet]) + b[:, feet]
        root[:, 1] += self.low[1] + 0.03 * size - soles[:, :, 1].min(axis=1)
        return poses

    def _limb(self, limb: list[int], count: int) -> Floats:
        """(count, links of the limb, 3, 3): random turns of an arm or a leg."""
        rng, body = self.rng, self.body
        side = SIDES["Left" if body.names[limb[0]].startswith("Left") else "Right"]
        turns = np.tile(np.eye(3), (count, len(limb), 1, 1))
        if "Arm" in body.names[limb[0]]:
            kind = rng.choice(3, count, p=[0.35, 0.2, 0.45])  # hanging, raised, anywhere in front
            to = np.array([[0.15 * side, -1, 0.05], [0.2 * side, 1, 0.1], [0.25 * side, 0, 0.3]])[kind]
            to = to + np.array([0.25, 0.3, 0.7])[kind, None] * rng.normal(size=(count, 3))
            to /= np.linalg.norm(to, axis=1, keepdims=True)
            along = body.axes[limb[0]]
            twist = rng.normal(0, 0.7, count)
            turns[:, 0] = articulation.exp(to * twist[:, None]) @ articulation.between(np.tile(along, (count, 1)), to)
            bend = np.where(rng.random(count) < 0.6, np.abs(rng.normal(0.2, 0.3, count)), rng.uniform(0, 2.4, count))
            turns[:, 1] = articulation.exp(bend[:, None] * _elbow(along))
            return turns
        hip = rng.normal([-0.15, 0, 0.06 * side], [0.4, 0.2, 0.18], (count, 3))
        knee = np.abs(rng.normal(0, 0.5, count)) + np.maximum(-hip[:, 0] - 0.4, 0)
        turns[:, 0] = articulation.exp(hip)
        turns[:, 1] = articulation.exp(np.outer(knee, [1.0, 0, 0]))
        turns[:, 2] = articulation.exp(np.outer(-hip[:, 0] - knee, [0.8, 0, 0]) + rng.normal(0, 0.15, (count, 3)))
        return turns

    def _shaken(self, poses: Poses, times: int, wide: float) -> Poses:
        """Every pose so many times, each a little off: its heading, trunk, place, size and limbs."""
        rng = self.rng
        some = poses.take(np.repeat(np.arange(len(poses.cost)), times))
        count = len(some.cost)
        turns = rng.normal(size=(count, self.links, 3)) * wide * 0.25
        turns[:, 0, 1] *= 2
        turns[:, 1:8] *= 0.5
        rotations = some.rotations @ articulation.exp(turns)
        root = some.root + rng.normal(0, 0.08 * wide, (count, 3))
        return Poses(rotations, root, some.size * np.exp(rng.normal(0, 0.08 * wide, count)), some.cost)

    # --- what a pose is worth ---------------------------------------------------------------------------------------

    def _transforms(self, poses: Poses) -> tuple[Floats, Floats]:
        """a (k, links, 3, 3) with the size in it, b (k, links, 3): where the links of every pose are."""
        a = np.empty_like(poses.rotations)
        b = np.empty((len(a), self.links, 3))
        for link in range(self.links):
            self._place(poses, a, b, link)
        return a, b

    def _place(self, poses: Poses, a: Floats, b: Floats, link: int) -> None:
        parent, origin = self.body.parents[link], self.origins[link]
        if parent < 0:
            a[:, link] = poses.rotations[:, link] * poses.size[:, None, None]
            b[:, link] = poses.root - a[:, link] @ origin
        else:
            a[:, link] = a[:, parent] @ poses.rotations[:, link]
            b[:, link] = (a[:, parent] - a[:, link]) @ origin + b[:, parent]

    def _judge(self, poses: Poses, batch: int = 250) -> Poses:
        cost = np.empty(len(poses.cost))
        for start in range(0, len(cost), batch):
            some = poses.take(slice(start, start + batch))
            a, b = self._transforms(some)
            away, back = self._away(a, b, some.size, slice(None)), self._back(a, b, slice(None))
            cost[start : start + batch] = away.mean(axis=1) + back.mean(axis=1) + oddness(self.body, some.rotations)
        return poses._replace(cost=cost)

    def _away(self, a: Floats, b: Floats, size: Floats, chosen: Any) -> Floats:
        """(k, n): squares of the points' distances from these capsules."""
        link, ends = self.flesh.link[chosen], self.joints[self.flesh.ends[chosen]]
        placed = np.einsum("kcij,cej->kcei", a[:, link], ends) + b[:, link, None]
        radii = self.radii[None, chosen] * size[:, None, None]
        return np.minimum(gaps(self.points, placed, radii), self.reach) ** 2

    def _back(self, a: Floats, b: Floats, chosen: Any) -> Floats:
        """(k, m): squares of the distances of these places of the flesh from the points."""
        owner = self.owners[chosen]
        placed = np.einsum("kmij,mj->kmi", a[:, owner], self.places[chosen]) + b[:, owner]
        return np.minimum(self.field(placed), self.reach) ** 2

    def _redraw(self, poses: Poses, limb: list[int], draws: int, wide: float) -> Poses:
        """Every pose with the best of so many random turns of one limb: half of them anything, half near what it is."""
        k = len(poses.cost)
        a, b = self._transforms(poses)
        mine, own = np.isin(self.flesh.link, limb), np.isin(self.owners, limb)
        rest = self._away(a, b, poses.size, ~mine)
        before = self._back(a, b, slice(None))
        tried = Poses(*(np.repeat(values, draws, axis=0) for values in poses))
        turns = tried.rotations[:, limb]
        fresh = np.tile(np.arange(draws) < draws // 2, k)
        turns[fresh] = self._limb(limb, int(fresh.sum()))
        noise = self.rng.normal(size=(int((~fresh).sum()), len(limb), 3)) * wide
        turns[~fresh] = turns[~fresh] @ articulation.exp(noise)
        turns[::draws] = poses.rotations[:, limb]  # the first is as it was
        tried.rotations[:, limb] = turns
        aa, bb = np.repeat(a, draws, axis=0), np.repeat(b, draws, axis=0)
        for link in limb:
            self._place(tried, aa, bb, link)
        away = self._away(aa, bb, tried.size, mine).reshape(k, draws, -1)
        cost = np.minimum(away, rest[:, None]).mean(axis=2)
        back = self._back(aa, bb, own).sum(axis=1).reshape(k, draws)
        cost += (back + before[:, ~own].sum(axis=1)[:, None]) / before.shape[1]
        cost += oddness(self.body, tried.rotations).reshape(k, draws)
        chosen = cost.argmin(axis=1)
        rows = np.arange(k) * draws + chosen
        return tried.take(rows)._replace(cost=cost[np.arange(k), chosen])

    # --- which to keep ----------------------------------------------------------------------------------------------

    def _spread(self, poses: Poses, count: int) -> Poses:
        """The best of every heading, as many in all, best first."""
        forward = poses.rotations[:, 0, :, 2]
        sector = (np.arctan2(forward[:, 0], forward[:, 2]) / (2 * np.pi) % 1 * HEADINGS).astype(int) % HEADINGS
        order = np.argsort(poses.cost, kind="stable")
        rank = np.empty(len(order), np.int64)
        for one in range(HEADINGS):
            here = order[sector[order] == one]
            rank[here] = np.arange(len(here))
        most = max(1, count // 4)
        kept = [row for row in order if rank[row] < most][:count]
        return poses.take(np.array(kept))

    def _different(self, poses: Poses, count: int) -> Poses:
        """The best poses of which each has a joint that is 12 cm or more from where the better ones have it."""
        a, b = self._transforms(poses)
        joints = np.einsum("klij,lj->kli", a, self.body.tips) + b
        kept = list[int]()
        for row in np.argsort(poses.cost, kind="stable"):
            apart = [np.linalg.norm(joints[row] - joints[other], axis=1).max() for other in kept]
            if not apart or min(apart) > 0.12:
                kept.append(int(row))
            if len(kept) == count:
                break
        return poses.take(np.array(kept))


CHAINS = (("Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot"))


def other_side(name: str) -> str:
    """Right for Left, Left for Right."""
    return name.replace("Left", "~").replace("Right", "Left").replace("~", "Right")


def hinges(body: Body) -> list[tuple[int, Floats]]:
    """The elbows and knees of the stock body and the axes about which they bend."""
    found = list[tuple[int, Floats]]()
    for side in SIDES:
        fore, shin = body.names.index(f"{side}ForeArm"), body.names.index(f"{side}Leg")
        found += [(fore, _elbow(body.axes[body.parents[fore]])), (shin, np.array([1.0, 0, 0]))]
    return found


def _elbow(arm: Floats) -> Floats:
    """The axis about which the elbow below an upper arm bends forwards."""
    axis = np.cross(arm, [0, 0, 1.0])
    return axis / np.linalg.norm(axis)


def oddness(body: Body, rotations: Floats) -> Floats:
    """(k,): square metres that knees and elbows cost that bend the wrong way in rotations (k, links, 3, 3)."""
    cost = np.zeros(len(rotations))
    for link, hinge in hinges(body):
        cost += 0.002 * np.maximum(-articulation.log(rotations[:, link]) @ hinge - 0.1, 0) ** 2
    return cost


def _spacing(points: Floats) -> float:
    """The usual distance from a point to the nearest other, metres."""
    from scipy.spatial import KDTree

    if len(points) < 2:
        return 0.0
    return float(np.median(KDTree(points).query(points, k=2)[0][:, 1]))
