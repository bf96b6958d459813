"""All joints of a body at once, from frame to frame: a skinned template brought to the points of each.

constant velocity ──► solve (body_matching) ──► is a limb lost? ──► poses of it at random ──► the best of all
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import limbs, normals, skinning, smoothing
from .articulation import Body, Floats, Labels, Pose, exp, log, transforms
from .body_matching import Data, Fit, Matcher, Prior, Step
from .joint_limits import NO_LIMITS, LinkLimits
from .limbs import Limb
from .skinning import Skin


@dataclass(frozen=True)
class Settings:
    """How the tracker runs. Lengths in metres, turns in radians.

    widths: of the robust weight, one an iteration. points, model_points: of the data and of the template that are
    looked at, at most. template: points that a template of few points grows to. pull: weight of the distance along the
    surface against that across it. turn, spine: how far a joint usually turns from where constant velocity puts it;
    `spine` for short bones, which are also held to `bend` of their first pose. velocity: the share of the last movement
    that is expected again. beyond: how far a joint usually is beyond its limits, where it has any.
    """

    widths: tuple[float, ...] = (0.2, 0.2, 0.2, 0.2, 0.16, 0.16, 0.11, 0.08, 0.055, 0.038, 0.027, 0.02)
    points: int = 2500
    model_points: int = 400
    template: int = 3000
    pull: float = 0.1
    noise: float = 0.01
    turn: float = 1.0
    spine: float = 0.12
    bend: float = 0.35
    beyond: float = 0.03
    velocity: float = 0.8
    colour: float = 0.20
    search: bool = True


class Growth(NamedTuple):
    """What a template is to take up: canonical points (n, 3), links (n,), colours (n, 3)."""

    points: Floats
    links: Labels
    colours: NDArray[np.uint8] | None


DOUBT, ASTRAY = 1.25, 1.6  # times the usual cost, above which a fit is not trusted at once, or not at all
ROUGHLY = 1.3  # times the cost of the best pose, below which one that was solved of a few points is solved as a whole
HOPE = 1.03  # times the cost of the best pose, below which one of which only a limb is solved is solved as a whole
ELSEWHERE, SIDES, ROUGH = 0.15, 8, 400  # metres; sides that a body is turned to; points for a first look
# shares of the data, of a limb's template and of both limbs' of a pair, that make a search worth while
LOST_POINTS, LOST_LIMB, LOST_TWINS = 0.006, 0.12, 0.05
# after a search in vain, times what was amiss is put up with, of a limb and of the cost; the share of it a frame later
PUT_UP, AGAIN, FORGET, TRUST = 1.2, 1.1, 0.85, 0.9
FINE, COARSE = 0.03, 0.05  # metres: wider weights look at half of the points, or at a few
FEW = 0.01  # share of the template below which a link has too little to turn by
ABSENT = 0.10  # metres from each other at which most of the data and of the template are not of one body
LOST = 0.045  # metres: a point farther than this from the template is not explained by it


def _unit(vector: Floats, otherwise: Floats) -> Floats:
    """The vector's direction; `otherwise` where it has none."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-3 else otherwise


def _better(fit: Fit, other: Fit) -> Fit:
    """The other fit if it is clearly better."""
    return other if other.cost < 0.97 * fit.cost else fit


class Tracker:
    """Follows a body through frames of points, each from where constant velocity would put it."""

    def __init__(
        self,
        body: Body,
        skin: Skin,
        outward: Floats,
        colours: NDArray[np.uint8] | None = None,
        settings: Settings | None = None,
        limits: LinkLimits = NO_LIMITS,
    ) -> None:
        self.body, self.limits = body, limits
        self.settings = settings or Settings()
        self._wear(skin, outward, colours)
        self.is_sparse = len(skin.points) < self.settings.template / 2
        self.growth = list[Growth]()
        in_limbs = [int(limb.links[0]) for limb in self.limbs]
        self.above_hips = [link for link, parent in enumerate(body.parents) if parent == 0 and link not in in_limbs]
        self.upright = _unit(body.origins[self.above_hips or [0]].mean(axis=0) - body.origins[0], body.axes[0])
        self.pose = Pose.canonical(len(body))
        self.before = self.sure = self.pose  # sure: the last pose that fitted well
        self.doubt = DOUBT  # times the usual cost that are put up with
        self.usual = np.inf  # cost of a frame that fits

    def _wear(self, skin: Skin, outward: Floats, colours: NDArray[np.uint8] | None) -> None:
        """Take a template, and what follows from it."""
        self.skin, self.normals, self.colours = skin, outward, colours
        self.shades = None if colours is None else self._shades(colours)
        some = np.random.default_rng(0).permutation(len(skin.points))[: self.settings.model_points]
        self.matcher = Matcher(self.body, skin, outward, self.shades, some, self.settings.pull, self.settings.noise)
        self.stiffness = self._stiffness()
        self.prior = self._prior()
        self.limbs = limbs.find(self.body, skin, self.matcher.some)
        self.twins = limbs.twins(self.body, self.limbs)
        self.patience = np.full(len(self.limbs), LOST_LIMB)  # shares of limbs without data that are put up with

    def _grow(self, fit: Fit) -> None:
        """A template of few points takes up those of frames that fit, in the canonical pose: whenever they are half as
        many as it has, until it has enough, and then once more. Rather few points a frame then show a whole surface.
        """
        if fit.cost > DOUBT * self.usual or (fit.data.colours is None) != (self.colours is None):
            return
        a, b = transforms(self.body, fit.pose)
        good = np.flatnonzero(fit.residuals < LOST)
        places = self.skin.unposed(a, b, fit.rows[good], fit.data.points[good])
        held = np.linalg.norm(places - self.skin.points[fit.rows[good]], axis=1) < LOST
        good = good[held]
        self.growth.append(
            Growth(places[held], fit.links[good], None if fit.data.colours is None else fit.data.colours[good])
        )
        most, have = self.settings.template, len(self.skin.points)
        if sum(len(part.points) for part in self.growth) < (have / 2 if have < most else 2 * most):
            return
        self.is_sparse = have < most
        parts = [Growth(self.skin.points, self.skin.links[:, 0], self.colours), *self.growth]
        self.growth.clear()
        points, links = np.concatenate([p.points for p in parts]), np.concatenate([p.links for p in parts])
        some = np.sort(np.random.default_rng(0).permutation(len(points))[:most])
        colours = None if self.colours is None else np.concatenate([p.colours for p in parts if p.colours is not None])
        surface = smoothing.smoothed(points[some], points)
        skin = skinning.skin(self.body, surface, links[some])
        self._wear(skin, normals.outward(surface, neighbours=10), None if colours is None else colours[some])

    def _stiffness(self) -> Floats:
        """(links,): the expected turn of each joint: little for short bones that carry others, and those without
        points.
        """
        own = np.bincount(self.skin.links[:, 0], minlength=len(self.body)) / len(self.skin.points)
        short = self.body.lengths < 0.12 * np.ptp(self.body.origins, axis=0).max()
        carries = self.body.ancestors.sum(axis=1) > 3
        stiff = (short & carries) | (own < FEW)
        stiff[0] = False
        return np.where(stiff, self.settings.spine, self.settings.turn)

    def _prior(self) -> Prior:
        """Towards the expected pose; and stiff joints towards the canonical one, which keeps a spine from folding."""
        bend = np.where(self.stiffness < self.settings.turn, self.settings.bend**-2, 0.0)
        held = Pose.canonical(len(self.body)).rotations
        return Prior(self.stiffness**-2.0, bend, held, limits=self.limits, beyond=self.settings.beyond**-2)

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
        """The pose of one frame of points (n, 3), metres. A frame that does not show the body leaves the pose as it
        was: one of fewer than 10 points, or of points most of which are elsewhere. Points that are not finite do not
        count.
        """
        finite = np.isfinite(points).all(axis=1)
        if not finite.all():
            points, colours = points[finite], None if colours is None else colours[finite]
        if len(points) < 10:
            self.before = self.pose
            return Fit.nothing(self.pose)
        data = self.look_at(points, colours, seed)
        found = self.solve(data, self.predict())
        if found.cost > min(self.doubt, ASTRAY) * self.usual:  # it may have turned back: start from where it was
            starts = [self.pose] if self.sure is self.pose else [self.pose, self.sure]
            found = min([found, *(self.solve(data, start) for start in starts)], key=lambda fit: fit.cost)
        better = found
        if self.settings.search:
            if found.cost > max(ASTRAY, self.doubt) * self.usual:
                found = better = self._anew(data, found)
            better = self._search(data, found, seed)
        if np.mean(better.residuals > ABSENT) > 0.5 and np.mean(better.gaps > ABSENT) > 0.5:
            self.before = self.pose
            return self.assess(data, self.pose)
        self.before, self.pose = self.pose if better is found else better.pose, better.pose
        if better.cost < ASTRAY * self.usual:
            self.sure = better.pose
        slowly = better.cost if np.isinf(self.usual) else 0.97 * self.usual + 0.03 * better.cost
        self.usual = min(better.cost, slowly)
        if self.is_sparse:
            self._grow(better)
        return better

    def expect(self, points: Floats, colours: NDArray[np.uint8] | None) -> None:
        """Points of the first frame that the template was not made from: frames to come will fit about as well."""
        self.usual = self.see(points, colours).cost

    def see(
        self, points: Floats, colours: NDArray[np.uint8] | None = None, seed: int = 0, most: int | None = None
    ) -> Fit:
        """How the pose that the tracker has fits a frame, of which at most `most` points are looked at."""
        return self.assess(self.look_at(points, colours, seed, most), self.pose)

    def look_at(self, points: Floats, colours: NDArray[np.uint8] | None, seed: int, most: int | None = None) -> Data:
        """The points of a frame that the tracker looks at, drawn at random where there are more than it wants."""
        some = np.random.default_rng(seed).permutation(len(points))[: most or self.settings.points]
        points, colours = points[some], None if colours is None else colours[some]
        shades = None if colours is None or self.shades is None else self._shades(colours)
        return Data.build(points, shades, colours)

    def solve(self, data: Data, start: Pose, widths: tuple[float, ...] | None = None) -> Fit:
        """Gauss–Newton from a pose, with the start as prior."""
        everything = len(data.points), len(self.matcher.some)
        steps = list[Step]()
        for width in widths or self.settings.widths:
            share = 1.0 if width < FINE else 0.5 if width < COARSE else 0.16
            points, template = (max(ROUGH, round(share * count)) for count in everything)
            steps.append(Step(width, points, template))
        return self.matcher.fit(data, start, steps, self.prior)

    def assess(self, data: Data, pose: Pose) -> Fit:
        """How well a pose fits."""
        return self.matcher.assess(data, pose)

    def nearest(self, data: Data, pose: Pose) -> Labels:
        """(n,): the template point that each data point is matched to."""
        return self.matcher.assess(data, pose).rows

    def _anew(self, data: Data, found: Fit) -> Fit:
        """A body that has lost its points altogether: it may have turned, or come back at another place.

        It is turned to every side, as a whole and at the hips alone, put where the points are, and the best of these
        poses after some steps is kept, if it is better than the one there was.
        """
        some = self._few(data)
        middle = np.median(data.points, axis=0)
        starts = list[Pose]()
        for pose in (found.pose, self.pose):
            a, b = transforms(self.body, pose)
            away = middle - np.median(self.skin.posed(a, b, self.matcher.some), axis=0)
            shift = away if np.linalg.norm(away) > ELSEWHERE else np.zeros(3)
            for turn in self._turns(a[0] @ self.upright):
                starts += [self._turned(pose, turn, shift, whole) for whole in (True, False)]
        rough = sorted((self._roughly(some, start) for start in starts), key=lambda fit: fit.cost)
        return min([found, *(self.solve(data, fit.pose) for fit in rough[:2])], key=lambda fit: fit.cost)

    def _few(self, data: Data) -> Data:
        """As many of the points as a first look takes."""
        return data.some(np.arange(min(len(data.points), ROUGH)))

    def _roughly(self, some: Data, start: Pose) -> Fit:
        """How well a pose fits some of the data after a few steps of a few points."""
        steps = [Step(width, ROUGH, 200) for width in self.settings.widths[2:8]]
        return self.matcher.assess(some, self.matcher.solve(some, start, steps, self.prior))

    def _turns(self, axis: Floats) -> Floats:
        """World rotations (sides, 3, 3) about an axis."""
        return exp(np.arange(SIDES)[:, None] * (2 * np.pi / SIDES) * axis)

    def _turned(self, pose: Pose, turn: Floats, shift: Floats, whole: bool) -> Pose:
        """The pose with its root turned where it stands; if not as a whole, the trunk above it is not."""
        rotations = pose.rotations.copy()
        rotations[0] = turn @ rotations[0]
        if not whole:
            for link in self.above_hips:
                rotations[link] = rotations[0].T @ pose.rotations[0] @ rotations[link]
        return Pose(rotations, pose.root + shift)

    def _search(self, data: Data, found: Fit, seed: int) -> Fit:
        """A limb that has left its points, while other points are left without a limb, is looked for all around.

        Poses of it are drawn at random and judged by how near they bring the limb to points that no other link
        explains, and those points to the limb; the best are refined, and the best of all poses is kept.
        """
        if np.mean(found.residuals > LOST) < LOST_POINTS:
            return found
        best = found
        is_odd = found.cost > self.doubt * self.usual  # though every limb has data near it: it may lie on another's
        for number, limb in enumerate(self.limbs):
            share = self._lost(limb, best)
            self.patience[number] = max(FORGET * self.patience[number], LOST_LIMB)
            if share < self.patience[number] and not (is_odd and (seed + number) % 2):  # every other limb, by turns
                continue
            before = best
            for pose in self._draw(limb, data, best, seed):
                if self.assess(data, pose).cost < HOPE * best.cost:
                    best = _better(best, self.solve(data, pose, self.settings.widths[-5:]))
            if best is before:  # it is where it is best: what is missing is hidden, or not in the template
                self.patience[number] = max(self.patience[number], PUT_UP * share)
        for pair in self.twins:
            share = min(self._lost(self.limbs[number], best) for number in pair)
            if share >= LOST_TWINS or is_odd:
                pose = limbs.exchanged(self.body, best.pose, *(self.limbs[i] for i in pair))
                if self._roughly(self._few(data), pose).cost < ROUGHLY * best.cost:
                    best = _better(best, self.solve(data, pose, self.settings.widths[-6:]))
        is_vain = is_odd and best is found
        put_up = AGAIN * found.cost / self.usual
        self.doubt = put_up if is_vain else max(min(TRUST * self.doubt, put_up), DOUBT)
        return best

    def _lost(self, limb: Limb, fit: Fit) -> float:
        """The share of a limb's template that has no data near it, of all of it or of what is beyond its first bone."""
        parts = (fit.gaps[rows] > LOST for rows in limb.looked_at)
        return max((float(part.mean()) for part in parts if len(part)), default=0.0)

    def _draw(self, limb: Limb, data: Data, found: Fit, seed: int, draws: int = 300, kept: int = 3) -> list[Pose]:
        """The best of random poses of a limb, each moved to where it fits best with all other links held still."""
        free = np.flatnonzero((found.residuals > 0.5 * LOST) | np.isin(found.links, limb.links))
        if len(free) < 10:
            return []
        wanted = data.points[found.residuals > LOST]
        wanted = wanted[:: max(1, len(wanted) // 50)]
        rng = np.random.default_rng([seed, int(limb.links[0])])
        rotations = np.concatenate([
            limbs.shaken(limb, found.pose, rng, draws // 3, 0.15, 2.0),
            limbs.shaken(limb, self.pose, rng, draws // 3, 0.9, 0.7),
            limbs.reaching(self.body, limb, found.pose, rng, wanted[rng.integers(len(wanted), size=draws // 3)])
            if len(wanted) and len(limb.links) > 1
            else limbs.shaken(limb, found.pose, rng, draws // 3, 0.9, 0.7),
        ])  # fmt: skip
        rotations = limbs.within(self.limits, limb, rotations)
        places = Data.build(data.points[free], None, None)
        score = self.matcher.distances(places, wanted, found.pose, limb.links, rotations, limb.rows[::3])
        free = free[:: max(1, len(free) // 300)]
        still = np.full(len(self.body), 1e8)
        still[limb.links] = self.stiffness[limb.links] ** -2.0
        prior = self.prior._replace(turn=still, root=1e8)
        mask = np.zeros(len(self.body), bool)
        mask[limb.links] = True
        some = data.some(free)
        steps = [Step(width, len(free), len(limb.rows)) for width in (0.12, 0.08, 0.05, 0.035)]
        poses = list[Pose]()
        for i in np.argsort(score)[:kept]:
            whole = found.pose.rotations.copy()
            whole[limb.links] = rotations[i]
            poses.append(self.matcher.solve(some, Pose(whole, found.pose.root), steps, prior, limb.rows, mask))
        moved = np.stack([pose.rotations[limb.links] for pose in poses])
        score = self.matcher.distances(places, wanted, found.pose, limb.links, moved, limb.rows)
        return [poses[i] for i in np.argsort(score)[:2]]
