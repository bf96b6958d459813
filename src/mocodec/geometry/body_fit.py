"""A first pose without a skeleton: a body of ordinary build fitted to one frame of points.

    points ──► poses that could be it (pose_search) ──each──► all joints and proportions at once ──best──► Figure

Any standing pose will do, and any heading. It takes seconds, once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput, CannotEncode
from . import articulation, pose_search, stock_body
from .articulation import Body, Floats
from .capsules import gaps
from .pose_search import Poses

Ints = NDArray[Any]
FARTHEST = 0.3  # metres: a skeleton whose links are farther from the points than this is somewhere else
WORST = 0.08  # metres: a fit whose points are farther from the body than this on average is no fit
UPRIGHT = {
    "x": np.array([[0, 1.0, 0], [1, 0, 0], [0, 0, -1]]),
    "y": np.eye(3),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}
"""What turns each vertical axis into y."""


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
    turn = UPRIGHT[up]
    upright = largest_group(points @ turn.T)
    low, high = np.percentile(upright, [0.5, 99.5], axis=0)
    height = float(high[1] - low[1])
    if not 0.4 < height < 3.0:
        unit = "say their unit (--unit mm)" if height > 100 else "give a skeleton"
        raise CannotEncode(f"the first frame is {height:.4g} m high: not a standing person in metres; {unit}")
    search = pose_search.Search(upright)
    person = Person(upright, search)
    found = search.best(CANDIDATES)
    rough = sorted((person.settled(begin(found, row), WIDTHS[::2]) for row in range(len(found.cost))), key=cost_of)
    best = min((person.settled(person.with_limbs_anew(stand), WIDTHS) for stand in rough[:FINALISTS]), key=cost_of)
    best = min(best, person.settled(person.turned_around(best), WIDTHS), key=cost_of)
    figure = person.figure(best, turn)
    if figure.error_m > WORST:
        raise CannotEncode(
            f"no standing figure fits the first frame ({figure.error_m * 100:.0f} cm off): give a skeleton"
        )
    return figure


def largest_group(points: Floats, apart: float = 0.15) -> Floats:
    """Those of points (n, 3) that hang together with the most others across gaps of `apart` metres or less: one person
    of several, without what flies about."""
    from scipy.ndimage import label

    low = np.percentile(points, 1, axis=0) - 2.0
    cell = np.clip((points - low) / apart, 0, 60).astype(np.int64)  # nine metres: what is outside is not the person
    filled = np.zeros((61, 61, 61), bool)
    filled[tuple(cell.T)] = True
    names = np.empty(filled.shape, np.int32)
    label(filled, np.ones((3, 3, 3)), names)
    inside = ((cell > 0) & (cell < 60)).all(axis=1)
    group = np.where(inside, names[tuple(cell.T)], 0)
    count = np.bincount(group)
    count[0] = 0
    mine = group == count.argmax()
    return points[mine] if mine.any() else points


CANDIDATES, FINALISTS = 8, 3
BACK = 0.3  # weight of the distances from the body to the points
GROW = 0.01  # by which a proportion changes for its slope
ALIKE, NOISE_M = 150.0, 0.02  # how many distances are as good as independent, and how much each is usually off
SPREAD, ODD = 0.07, 2e-5  # of a proportion about the average of them all, and the square metres that it costs
REACH = pose_search.REACH
CROSS = np.zeros((3, 3, 3))  # CROSS · y is the matrix of ω ↦ ω × y
CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0
CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = -1.0
WIDTHS = tuple(np.geomspace(0.15, 0.03, 24).tolist())  # metres, of the robust weight, one an iteration
STIFF = {
    "LowerBack": 0.12, "Spine": 0.12, "Spine1": 0.12, "Neck": 0.15, "Neck1": 0.15, "Head": 0.2, "Shoulder": 0.15,
    "Hand": 0.3, "Foot": 0.35, "Arm": 1.5, "ForeArm": 1.0, "UpLeg": 1.2, "Leg": 1.0,
}  # fmt: skip
"""Radians that a joint usually turns, from the stock body's pose."""


class Stand(NamedTuple):
    """A pose and a build: rotations (links, 3, 3), root (3,) of the hips, build (stock_body.BUILD,), cost, square
    metres."""

    rotations: Floats
    root: Floats
    build: Floats
    cost: float


def begin(poses: Poses, row: int) -> Stand:
    """One of the poses found, all proportions alike."""
    return Stand(poses.rotations[row], poses.root[row], np.full(len(stock_body.BUILD), poses.size[row]), np.inf)


def cost_of(stand: Stand) -> float:
    return stand.cost


class Placed(NamedTuple):
    """World rotations a (links, 3, 3), joints (…, links, 3), and the capsules' ends (…, c, 2, 3), radii (…, c, 2)."""

    a: Floats
    joints: Floats
    ends: Floats
    radii: Floats


class Person:
    """Fits pose and proportions of the stock body's capsules to points (n, 3), y up, by Gauss–Newton."""

    def __init__(self, points: Floats, search: pose_search.Search, most: int = 1200) -> None:
        from scipy.spatial import KDTree

        self.body, self.flesh, self.field = search.body, search.flesh, search.field
        some = np.random.default_rng(3).permutation(len(points))[:most]
        self.points = points[some]
        self.tree = KDTree(self.points)
        self.moves = self.body.ancestors
        bare = [name.removeprefix("Left").removeprefix("Right") for name in self.body.names]
        self.stiff = np.array([STIFF.get(name, 4.0) for name in bare])
        self.stiff[0] = 10.0

    def with_limbs_anew(self, stand: Stand) -> Stand:
        """The stand with other limbs where a search of its own build finds better ones."""
        search = pose_search.Search(self.points, stand.build, self.field, most=500)
        pose = Poses(stand.rotations[None], stand.root[None], np.ones(1), np.zeros(1))
        found = search.with_limbs_anew(pose)
        return stand._replace(rotations=found.rotations[0])

    def turned_around(self, stand: Stand) -> Stand:
        """The body facing the other way, its right limbs where the left ones were."""
        body = self.body
        a = self._stand(stand.rotations, stand.root, stand.build).a
        around = np.diag([-1.0, 1, -1])
        world = np.array(a)
        for link, (name, parent) in enumerate(zip(body.names, body.parents, strict=True)):
            other = pose_search.other_side(name)
            if parent < 0:
                world[link] = a[link] @ around
            elif other != name and not name.endswith(("Shoulder", "Hand", "Foot")):
                way = a[body.names.index(other)] @ body.axes[body.names.index(other)]
                near = world[parent] @ body.axes[link]
                world[link] = articulation.between(near, way) @ world[parent]
            else:
                world[link] = world[parent]
        rotations = [world[link] if p < 0 else world[p].T @ world[link] for link, p in enumerate(body.parents)]
        return stand._replace(rotations=np.array(rotations))

    def settled(self, stand: Stand, widths: tuple[float, ...]) -> Stand:
        """The best near a stand, by so many steps."""
        for width in widths:
            stand = self._step(stand, width)
        return stand._replace(cost=self._cost(stand))

    def _stand(self, rotations: Floats, root: Floats, build: Floats) -> Placed:
        """Where a pose (links, 3, 3), (3,) puts people of builds (…, BUILD)."""
        places, body, flesh = self.flesh.places(build), self.body, self.flesh
        a, b = np.empty((len(body), 3, 3)), np.empty((*build.shape[:-1], len(body), 3))
        for link, (parent, joint) in enumerate(zip(body.parents, body.joints, strict=True)):
            a[link] = rotations[link] if parent < 0 else a[parent] @ rotations[link]
            turned = places[..., joint, :] @ ((a[parent] if parent >= 0 else 0.0) - a[link]).T
            b[..., link, :] = turned + (b[..., parent, :] if parent >= 0 else root)
        ends = np.einsum("cij,...cej->...cei", a[flesh.link], places[..., flesh.ends, :]) + b[..., flesh.link, None, :]
        joints = np.einsum("lij,...lj->...li", a, places[..., list(body.joints), :]) + b
        return Placed(a, joints, ends, flesh.radii(build))

    def _step(self, stand: Stand, width: float) -> Stand:
        """One step: a turn of every joint, in the world, a move of the root, and the logarithms of the proportions.

        Distances of points from the capsules count across the surface; those of places of the capsules from the points
        in every direction, so that a limb in empty air is drawn to where there are points.
        """
        body, links = self.body, len(self.body)
        now = self._stand(stand.rotations, stand.root, stand.build)
        capsule, share, normal = self._feet(now.ends, now.radii)
        places, out = self.flesh.surface(now.a, now.ends, now.radii)
        distance, index = self.tree.query(places)
        near = np.flatnonzero(distance < 3 * width)
        capsules = np.concatenate([capsule, self.flesh.part[near]])
        shares = np.concatenate([share, self.flesh.shares[near]])[:, None]
        outs = np.concatenate([normal, out[near]])

        def surface(ends: Floats, radii: Floats) -> Floats:
            p, r = ends[..., capsules, :, :], radii[..., capsules, :]
            radius = r[..., :1] + shares * (r[..., 1:] - r[..., :1])
            return p[..., 0, :] + shares * (p[..., 1, :] - p[..., 0, :]) + radius * outs

        y = surface(now.ends, now.radii)
        larger = self._stand(stand.rotations, stand.root, stand.build * (1 + GROW * np.eye(len(stand.build))))
        gap = np.concatenate([self.points, self.points[np.asarray(index)[near]]]) - y
        weight = (width**2 / (width**2 + np.einsum("ni,ni->n", gap, gap))) ** 2
        jacobian = np.zeros((len(y), 3, 3 + 3 * links + len(stand.build)))
        jacobian[:, [0, 1, 2], [0, 1, 2]] = 1.0
        levers = (y[:, None] - now.joints[None]) * self.moves[:, self.flesh.link[capsules]].T[..., None]
        jacobian[:, :, 3 : 3 + 3 * links] = np.einsum("ijk,nlj->nilk", CROSS, levers).reshape(len(y), 3, 3 * links)
        jacobian[:, :, 3 + 3 * links :] = ((surface(larger.ends, larger.radii) - y) / GROW).transpose(1, 2, 0)
        first = len(share)
        across = np.einsum("npi,np->ni", jacobian[:first], outs[:first]) * weight[:first, None]
        every = jacobian[first:] * (BACK * first / len(places) * weight[first:])[:, None, None]
        alike = ALIKE / first / NOISE_M**2  # neighbours err alike: so many of them count as one
        h = across.T @ np.einsum("npi,np->ni", jacobian[:first], outs[:first])
        h += np.einsum("npi,npj->ij", every, jacobian[first:], optimize=True)
        g = across.T @ np.einsum("ni,ni->n", outs[:first], gap[:first]) + np.einsum("npi,np->i", every, gap[first:])
        h, g = h * alike, g * alike
        above = np.stack([now.a[p] if p >= 0 else np.eye(3) for p in body.parents])
        self._add_priors(h, g, stand, above)
        step = np.linalg.solve(h, g)
        turns = step[3 : 3 + 3 * links].reshape(-1, 3)
        turns *= np.minimum(1.0, 0.4 / np.maximum(np.linalg.norm(turns, axis=1, keepdims=True), 1e-9))
        rotations = articulation.exp(np.einsum("lji,lj->li", above, turns)) @ stand.rotations
        build = stand.build * np.exp(np.clip(step[3 + 3 * links :], -0.05, 0.05))
        return Stand(rotations, stand.root + step[:3], build, np.inf)

    def _add_priors(self, h: Floats, g: Floats, stand: Stand, above: Floats) -> None:
        """Joints turn little from the stock body's pose, the trunk's least; knees and elbows one way; proportions are
        alike."""
        vectors = articulation.log(stand.rotations)
        at = np.arange(3, 3 + 3 * len(self.body))
        h[at, at] += np.repeat(self.stiff**-2, 3)
        g[at] -= (np.einsum("lij,lj->li", above, vectors) * self.stiff[:, None] ** -2).ravel()
        for link, hinge in pose_search.hinges(self.body):
            bent = float(vectors[link] @ hinge)
            if bent < 0:
                axis = above[link] @ hinge
                rows = slice(3 + 3 * link, 6 + 3 * link)
                h[rows, rows] += np.outer(axis, axis) / 0.1**2
                g[rows] -= axis * bent / 0.1**2
        level = np.eye(len(stand.build)) - 1 / len(stand.build)  # their average is free
        rows = slice(3 + 3 * len(self.body), None)
        h[rows, rows] += level / SPREAD**2 + 0.1 * np.eye(len(level))
        g[rows] -= level @ np.log(stand.build) / SPREAD**2

    def _feet(self, ends: Floats, radii: Floats) -> tuple[Ints, Floats, Floats]:
        """For each point the nearest capsule, the share of its axis where the point stands, and the way out there."""
        along = ends[:, 1] - ends[:, 0]
        share = np.einsum("cni,ci->cn", self.points[None] - ends[:, :1], along)
        share = np.clip(share / np.maximum(np.sum(along**2, axis=1), 1e-9)[:, None], 0, 1)
        out = self.points[None] - ends[:, :1] - share[..., None] * along[:, None]
        away = np.linalg.norm(out, axis=2)
        gap = np.abs(away - radii[:, :1] - share * (radii[:, 1:] - radii[:, :1]))
        best = gap.argmin(axis=0)
        n = np.arange(len(self.points))
        return best, share[best, n], out[best, n] / np.maximum(away[best, n], 1e-6)[:, None]

    def _gaps(self, placed: Placed) -> Floats:
        """(n,): the points' distances from the body."""
        return gaps(self.points, placed.ends[None], placed.radii[None])[0]

    def _cost(self, stand: Stand) -> float:
        placed = self._stand(stand.rotations, stand.root, stand.build)
        back = self.field(self.flesh.surface(placed.a, placed.ends, placed.radii)[0])
        cost = np.mean(np.minimum(self._gaps(placed), REACH) ** 2) + np.mean(np.minimum(back, REACH) ** 2)
        cost += ODD * np.sum(((np.log(stand.build) - np.log(stand.build).mean()) / SPREAD) ** 2)
        return float(cost + pose_search.oddness(self.body, stand.rotations[None])[0])

    def figure(self, stand: Stand, turn: Floats) -> Figure:
        """The skeleton, turned back to the file's axes."""
        placed, body = self._stand(stand.rotations, stand.root, stand.build), self.body
        ends = [link for link in range(len(body)) if link not in body.parents]
        places = self.flesh.places(stand.build)
        tips = list[Floats]()
        for link in ends:
            stop = int(np.argmin(np.linalg.norm(self.flesh.stock - body.tips[link], axis=1)))
            tips.append(placed.a[link] @ (places[stop] - places[body.joints[link]]) + placed.joints[link])
        names = (*body.names, *(f"{body.names[link]}Tip" for link in ends))
        error = float(np.minimum(self._gaps(placed), 0.3).mean())
        return Figure(names, (*body.parents, *ends), np.concatenate([placed.joints, np.array(tips)]) @ turn, error)


def require_near(body: Body, points: Floats) -> None:
    """Raises BadInput for a skeleton that does not stand in the points (n, 3)."""
    from scipy.spatial import KDTree

    middles = (body.origins + body.tips) / 2
    away, _ = KDTree(points).query(middles)
    if np.median(away) > FARTHEST:
        gap = f"{np.median(away):.4g} m"
        raise BadInput(f"the skeleton is {gap} from the first frame's points: it must have its place, pose and unit")
