"""Random search for the pose of one limb whose points are not where the template expects them.

    random rotations ──score──► best ──resample near them, twice──► best ──► a few distinct ones
    (near the pose, near the previous pose, reaching for unexplained points)

src/native/limb_search.h does the same where it is compiled. It draws no random numbers: it is given them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .. import native
from ..typing import AnyInteger, Booleans, Floats
from . import limb_chains
from .articulation import Body, Pose, exp, log, transforms
from .body_matching import TRUNCATION_M, FramePoints, Matcher
from .joint_limits import LinkLimits
from .limb_chains import LimbChain

HYPOTHESES = 300
"""Random poses of a limb that are drawn at first, for each pose of its base."""
FIRST_STRIDE = 2
"""The first draws are scored on every FIRST_STRIDE-th template point and unexplained point."""
SPREADS_RAD, KEPT, DRAWN = (0.4, 0.2), 20, 8
"""Standard deviations of later draws, how many poses each of them starts from, and how many it draws near each."""
CONSIDERED, REFINED = 60, 4
"""How many of the best random poses are compared with one another, and how many of these are returned at most."""
DISTINCT_M = 0.08
"""Two poses are distinct if bend and end of the limb are farther apart than this, metres, both together."""
PROMISING = 1.2
"""Multiple of the limb's own score below which another pose is returned."""
BASE_TURNED_RAD = 0.3
"""A limb's base that has turned farther than this since the first pose may have been pulled away."""
TWISTED, NEARBY = (0.15, 2.0), (0.9, 0.7)
"""Standard deviations of a limb's first and second rotation, radians: bent anew, or turned as a whole."""
REACH_SHARES = 0.5, 1.3
"""Where on its second bone a limb reaches a target, as a range of shares of that bone's length."""


class LimbDraws(NamedTuple):
    """Random numbers of a search, for each of some bases and a third of the hypotheses.

    base_rotations (bases, links of the base, 3, 3). turns (bases, 3, third, 2, 3): standard normal, for the first two
    links. targets, sides (bases, third, 3): unexplained points, and directions to which the limb bends; shares (bases,
    third) of the second bone. near (rounds, KEPT · DRAWN, 2, 3): standard normal.
    """

    base_rotations: Floats
    turns: Floats
    targets: Floats
    sides: Floats
    shares: Floats
    near: Floats

    @staticmethod
    def of(limb: LimbChain, pose: Pose, unexplained: Floats, rng: np.random.Generator) -> LimbDraws:
        """Draws for a limb. Its base is as it is, and if that is turned far, also back in the first pose: a limb on
        wrong points pulls its base.
        """
        bases = [pose.rotations[limb.base]]
        if len(limb.base) and np.linalg.norm(log(bases[0])) > BASE_TURNED_RAD:
            bases.append(np.tile(np.eye(3), (len(limb.base), 1, 1)))
        shape = len(bases), HYPOTHESES // 3
        some = unexplained if len(unexplained) else np.zeros((1, 3))
        return LimbDraws(
            np.stack(bases), rng.normal(size=(shape[0], 3, shape[1], 2, 3)), some[rng.integers(len(some), size=shape)],
            rng.normal(size=(*shape, 3)), rng.uniform(*REACH_SHARES, size=shape),
            rng.normal(size=(len(SPREADS_RAD), KEPT * DRAWN, 2, 3)),
        )  # fmt: skip


class LimbSearch(NamedTuple):
    """What a search is about. places: data points, without colours, that the limb could belong to; unexplained (m, 3):
    those that no link explains. pose, previous: of this frame and of the one before. rows (k,): template points that
    score a pose.
    """

    matcher: Matcher
    limb: LimbChain
    limits: LinkLimits
    places: FramePoints
    unexplained: Floats
    pose: Pose
    previous: Pose
    rows: AnyInteger

    def best(self, draws: LimbDraws) -> Floats:
        """(n, links of base and limb, 3, 3): rotations of the best distinct hypotheses, best first, at most REFINED.

        None if none is as good as PROMISING times the score of the limb as it is.
        """
        if self.matcher.compiled and native.available():
            return self._compiled(draws)
        own = self._scores(self.pose.rotations[self.limb.with_base][None])[0]
        hypotheses = self._first(draws)
        hypotheses = hypotheses[np.argsort(self._scores(hypotheses, FIRST_STRIDE), kind="stable")[:KEPT]]
        score = self._scores(hypotheses)
        for spread, near in zip(SPREADS_RAD, draws.near, strict=True):
            kept = np.argsort(score, kind="stable")[:KEPT]
            more = np.repeat(hypotheses[kept], DRAWN, axis=0)
            self._turn(more, near, (spread, spread))
            hypotheses = np.concatenate([hypotheses[kept], more])
            score = np.concatenate([score[kept], self._scores(more)])
        order = np.argsort(score, kind="stable")[:CONSIDERED]
        order = order[score[order] < PROMISING * own]
        return hypotheses[self._distinct(hypotheses, order)]

    def _compiled(self, draws: LimbDraws) -> Any:
        """`best` by the kernel."""
        limb, body, limits = self.limb, self.matcher.body, self.limits
        return self.matcher.compiled.search_limb(
            self.places.tree, self.unexplained, self.pose.rotations, self.pose.root, limb.with_base, len(limb.base),
            self.rows, body.axes[limb.links[[0, min(1, len(limb.links) - 1)]]], _end(body, limb),
            draws.base_rotations, self.previous.rotations[limb.with_base], draws.turns, draws.targets, draws.sides,
            draws.shares, draws.near, np.array(SPREADS_RAD), np.array([TWISTED, NEARBY]), limits.links, limits.table,
            np.array([KEPT, DRAWN, CONSIDERED, REFINED]), np.array([PROMISING, DISTINCT_M, TRUNCATION_M]),
        )  # fmt: skip

    def _turn(self, rotations: Floats, vectors: Floats, scales: tuple[float, float]) -> None:
        """Turn the limb's first two links in rotations (n, links, 3, 3), in place, by rotation vectors (n, 2, 3) times
        a scale for either, and clamp the links to their limits.
        """
        first = len(self.limb.base)
        for k, scale in enumerate(scales[: len(self.limb.links)]):
            rotations[:, first + k] = exp(scale * vectors[:, k]) @ rotations[:, first + k]
        limb_chains.clamp_to_limits(self.limits, self.limb, rotations[:, first:])

    def _first(self, draws: LimbDraws) -> Floats:
        """(hypotheses, links, 3, 3): of the first round."""
        limb, first, result = self.limb, len(self.limb.base), list[Floats]()
        reaches = len(self.unexplained) > 0 and len(limb.links) > 1
        for b, carrier in enumerate(draws.base_rotations):
            base = Pose(self.pose.rotations.copy(), self.pose.root)
            base.rotations[limb.base] = carrier
            for way, (pose, scales) in enumerate(((base, TWISTED), (self.previous, NEARBY), (base, NEARBY))):
                rotations = np.tile(pose.rotations[limb.with_base], (draws.turns.shape[2], 1, 1, 1))
                rotations[:, :first] = carrier
                if way == 2 and reaches:
                    rotations[:, first:] = limb_chains.reaching(
                        self.matcher.body, limb, base, draws.targets[b], draws.shares[b], draws.sides[b]
                    )
                    limb_chains.clamp_to_limits(self.limits, limb, rotations[:, first:])
                else:
                    self._turn(rotations, draws.turns[b, way], scales)
                result.append(rotations)
        return np.concatenate(result)

    def _scores(self, hypotheses: Floats, stride: int = 1) -> Floats:
        """(hypotheses,): square metres, the lower the better: the mean squared distance of every `stride`th template
        point from the places, plus that of such unexplained points from the template points, both truncated.

        hypotheses (hypotheses, links, 3, 3): rotations of the base and limb; all other links keep those of the pose.
        """
        body, skin = self.matcher.body, self.matcher.skin
        a, b = transforms(body, self.pose)
        a, b = np.tile(a, (len(hypotheses), 1, 1, 1)), np.tile(b, (len(hypotheses), 1, 1))
        for i, link in enumerate(self.limb.with_base):
            parent, origin = body.parents[link], body.origins[link]
            a[:, link] = a[:, parent] @ hypotheses[:, i]
            b[:, link] = np.einsum("nij,nj->ni", a[:, parent], origin - hypotheses[:, i] @ origin) + b[:, parent]
        rows, unexplained = self.rows[::stride], self.unexplained[::stride]
        owner = skin.links[rows, 0]
        posed = np.einsum("nkij,kj->nki", a[:, owner], skin.points[rows]) + b[:, owner]
        distance, _ = self.places.nearest(posed.reshape(-1, 3), None, TRUNCATION_M)
        score = (np.minimum(distance, TRUNCATION_M) ** 2).reshape(len(hypotheses), -1).mean(axis=1)
        if len(unexplained):
            squares = (posed**2).sum(axis=2)[:, :, None] + (unexplained**2).sum(axis=1)
            back = (squares - 2 * posed @ unexplained.T).min(axis=1)
            score += np.minimum(np.maximum(back, 0), TRUNCATION_M**2).mean(axis=1)
        return score

    def _distinct(self, hypotheses: Floats, order: AnyInteger) -> AnyInteger:
        """The hypotheses, in this order, in which bend and end of the limb differ by DISTINCT_M or more from the
        pose and from all chosen before.
        """
        body, limb, pose = self.matcher.body, self.limb, self.pose
        rotations = np.tile(pose.rotations, (1 + len(order), 1, 1, 1))
        rotations[1:, limb.with_base] = hypotheses[order]
        a, b = transforms(body, Pose(rotations, np.tile(pose.root, (len(rotations), 1))))
        places = (
            limb_chains.bend_and_end(body, limb) if len(limb.links) > 1 else [(limb.links[0], _end(body, limb))] * 2
        )
        ends = np.concatenate([a[:, link] @ place + b[:, link] for link, place in places], axis=1)
        chosen = [0]  # the pose
        for i in range(1, len(ends)):
            is_new: Booleans = np.linalg.norm(ends[chosen] - ends[i], axis=1) >= DISTINCT_M
            if len(chosen) <= REFINED and is_new.all():
                chosen.append(i)
        return order[np.array(chosen[1:], np.int64) - 1]


def _end(body: Body, limb: LimbChain) -> Floats:
    """(3,): the canonical place of the end of a limb's second bone, or of its only one."""
    return limb_chains.bend_and_end(body, limb)[1][1] if len(limb.links) > 1 else body.tips[limb.links[0]]
