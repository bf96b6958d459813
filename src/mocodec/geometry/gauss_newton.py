"""One Gauss–Newton step of a body's pose: residuals of correspondences and priors, as normal equations h x = g.

    correspondences ──linearise──► sums by pairs of links ──joint hierarchy──► h, g ──priors, limits──► solve ──► pose

The unknowns x are a translation of the root and a rotation vector of every joint, all in the world's axes. A template
point y that follows link l moves by v_l + ω_l × y; its distance across the surface changes by f · (v, ω) with
f = (n, y × n). Sums of f fᵀ by links give the normal equations of the links' motions, and the joint hierarchy turns
those into the joints'. src/native/normal_equations.h does the same where it is compiled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..typing import AnyInteger, Booleans, Floats
from . import joint_limits
from .articulation import Body, Pose, exp, joint_positions, log
from .joint_limits import NO_LIMITS, LinkLimits
from .skinning import Skin

MAX_TURN = 0.7
"""Radians that a joint turns in one step, at most: the linearisation holds for little more."""
UPPER = np.triu_indices(6)
CROSS = np.zeros((3, 3, 3))
"""CROSS @ v is the matrix of v ×."""
CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = -1.0
CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0


class PosePrior(NamedTuple):
    """Quadratic penalties on a pose; strengths are one over radians squared, or one over square metres.

    start_strength (links,): towards the pose at the start. rest_strength (links,): towards the rotations `rest`
    (links, 3, 3). root_strength: towards the root's place at the start. limit_strength: towards the nearest allowed
    rotation, for links beyond their limits.
    """

    start_strength: Floats
    rest_strength: Floats
    rest: Floats
    root_strength: float = 0.3**-2
    limits: LinkLimits = NO_LIMITS
    limit_strength: float = 0.0


class NormalEquations:
    """Gauss–Newton steps of one template. normals (n, 3): of its points, canonical. tangential: weight of squared
    distances along the surface against those across it. noise: of the data, metres.
    """

    def __init__(self, body: Body, skin: Skin, normals: Floats, tangential: float, noise: float) -> None:
        self.body, self.skin, self.normals = body, skin, normals
        self.tangential, self.noise = tangential, noise
        self.is_ancestor = body.ancestors
        self.parents = np.maximum(np.array(body.parents), 0)
        self.is_root = np.array(body.parents) < 0
        self.link_pairs, self.pair_of_row = np.unique(skin.links, axis=0, return_inverse=True)
        self.pair_of_row = self.pair_of_row.reshape(-1)

    def step(
        self,
        targets: Floats,
        rows: AnyInteger,
        pose: Pose,
        start: Pose,
        a: Floats,
        b: Floats,
        width: float,
        prior: PosePrior,
        limited_axes: Floats,
    ) -> tuple[Pose, float]:
        """The pose after one step, and how far the step moves the root, or the far end of a link by its own rotation,
        at most, metres.

        targets (n, 3): where the template points `rows` (n,) should move to. a, b: transforms of `pose`. width: of the
        robust weight (Geman–McClure), metres. limited_axes (limited links, 3): see `_add_limits`, which updates them.
        """
        y = self.skin.posed(a, b, rows)
        normals = np.einsum("nij,nj->ni", a[self.skin.links[rows, 0]], self.normals[rows])
        gap = targets - y
        weight = (width**2 / (width**2 + np.einsum("ni,ni->n", gap, gap))) ** 2 / self.noise**2
        matrix, vector = self._equations_of_links(y, normals, gap, weight, rows)
        links = len(self.body)
        jacobian = link_motions(self.is_ancestor, joint_positions(self.body, a, b)).reshape(6 * links, 3 + 3 * links)
        h = jacobian.T @ matrix @ jacobian
        g = jacobian.T @ vector
        self.add_priors(h, g, pose, start, a, prior, limited_axes)
        step = np.linalg.solve(h, g)
        turns = step[3:].reshape(-1, 3)
        angle = np.linalg.norm(turns, axis=1, keepdims=True)
        turns = turns * np.minimum(1.0, MAX_TURN / np.maximum(angle, 1e-9))
        rotations = exp(np.einsum("lji,lj->li", self._parent_rotations(a), turns)) @ pose.rotations
        moved = max(float(np.linalg.norm(step[:3])), float((angle[:, 0] * self.body.lengths).max()))
        return Pose(rotations, pose.root + step[:3]), moved

    def _equations_of_links(
        self, y: Floats, normals: Floats, gap: Floats, weight: Floats, rows: AnyInteger
    ) -> tuple[Floats, Floats]:
        """Normal equations of the links' motions (v, ω): (6 links, 6 links) and (6 links,)."""
        outer, right = self._point_terms(y, normals, gap)
        first = self.skin.weights[rows]
        second = 1 - first
        terms = np.concatenate([outer, right], axis=1) * weight[:, None]
        pair = self.pair_of_row[rows]
        order = np.argsort(pair, kind="stable")
        terms, first, second = terms[order], first[order, None], second[order, None]
        present, starts = np.unique(pair[order], return_index=True)
        sums = [
            np.add.reduceat(terms[:, :21] * share, starts) for share in (first * first, first * second, second * second)
        ]
        right_sums = [np.add.reduceat(terms[:, 21:] * share, starts) for share in (first, second)]
        links = len(self.body)
        l0, l1 = self.link_pairs[present].T
        matrix, vector = np.zeros((links, links, 6, 6)), np.zeros((links, 6))
        for i, j, block in ((l0, l0, sums[0]), (l0, l1, sums[1]), (l1, l0, sums[1]), (l1, l1, sums[2])):
            full = np.empty((len(block), 6, 6))
            full[:, UPPER[0], UPPER[1]] = block
            full[:, UPPER[1], UPPER[0]] = block
            np.add.at(matrix, (i, j), full)
        np.add.at(vector, l0, right_sums[0])
        np.add.at(vector, l1, right_sums[1])
        return matrix.transpose(0, 2, 1, 3).reshape(6 * links, 6 * links), vector.ravel()

    def _point_terms(self, y: Floats, normals: Floats, gap: Floats) -> tuple[Floats, Floats]:
        """For each correspondence the upper triangle (n, 21) of f fᵀ, and f times the residual (n, 6); with
        point-to-point distances added at the weight `tangential`: (I, −[y]×)ᵀ (I, −[y]×).
        """
        t = self.tangential
        f = np.concatenate([normals, cross(y, normals)], axis=1)
        outer = f[:, UPPER[0]] * f[:, UPPER[1]]
        square = np.einsum("ni,ni->n", y, y)
        y0, y1, y2 = y.T
        outer[:, [0, 6, 11]] += t
        outer[:, [4, 5, 8, 10, 12, 13]] += t * np.stack([y2, -y1, -y2, y0, y1, -y0], 1)
        outer[:, [15, 18, 20]] += t * (square[:, None] - y**2)
        outer[:, [16, 17, 19]] -= t * np.stack([y0 * y1, y0 * y2, y1 * y2], 1)
        right = f * np.einsum("ni,ni->n", normals, gap)[:, None]
        right += t * np.concatenate([gap, cross(y, gap)], axis=1)
        return outer, right

    def _parent_rotations(self, a: Floats) -> Floats:
        """(links, 3, 3): world rotations of the links' parents."""
        rotations = a[self.parents]
        rotations[self.is_root] = np.eye(3)
        return rotations

    def add_priors(
        self, h: Floats, g: Floats, pose: Pose, start: Pose, a: Floats, prior: PosePrior, limited_axes: Floats
    ) -> None:
        """Add the penalties of `prior` at `pose` to h and g, in place. start: the pose before the first step."""
        towards = np.stack([start.rotations, prior.rest])
        off = log(pose.rotations @ towards.transpose(0, 1, 3, 2))
        strength = np.stack([prior.start_strength, prior.rest_strength])
        world = np.einsum("lij,klj,kl->li", self._parent_rotations(a), off, strength)
        diagonal = np.concatenate([np.full(3, prior.root_strength), np.repeat(strength.sum(axis=0), 3)])
        g[:3] -= (pose.root - start.root) * prior.root_strength
        g[3:] -= world.ravel()
        h[np.diag_indices_from(h)] += diagonal
        if len(prior.limits.links):
            self._add_limits(h, g, pose, self._parent_rotations(a), prior, limited_axes)

    def _add_limits(
        self, h: Floats, g: Floats, pose: Pose, parents: Floats, prior: PosePrior, limited_axes: Floats
    ) -> None:
        """Towards the nearest allowed rotation, for links beyond their limits.

        The distance to the limit changes with rotation about one axis only. limited_axes (limited links, 3) keeps that
        axis: later steps resist rotation about it too, or the link would leave its limits again.
        """
        links = prior.limits.links
        allowed, outside = joint_limits.nearest_allowed(prior.limits, pose.rotations[links])
        off = log(pose.rotations[links] @ allowed.transpose(0, 2, 1))
        for k, link in enumerate(links):
            at = slice(3 + 3 * link, 6 + 3 * link)
            if outside[k]:
                g[at] -= prior.limit_strength * (parents[link] @ off[k])
                limited_axes[k] = off[k] / max(float(np.linalg.norm(off[k])), 1e-12)
            if limited_axes[k].any():
                axis = parents[link] @ limited_axes[k]
                h[at, at] += prior.limit_strength * np.outer(axis, axis)


def link_motions(is_ancestor: Booleans, joints: Floats) -> Floats:
    """(links, 6, 3 + 3 links): motions (v, ω) of the links by the root's translation and the joints' rotations.
    is_ancestor (links, links): as `Body.ancestors`; joints (links, 3): the links' origins, metres.
    """
    links = len(joints)
    motion = np.zeros((links, 6, 1 + links, 3))
    motion[:, :3, 0] = np.eye(3)
    motion[:, :3, 1:] = is_ancestor.T[:, None, :, None] * (CROSS @ joints.T).transpose(0, 2, 1)[None]
    motion[:, 3:, 1:] = is_ancestor.T[:, None, :, None] * np.eye(3)[:, None, :]
    return motion.reshape(links, 6, 3 + 3 * links)


def cross(u: Floats, v: Floats) -> Floats:
    """u × v of (n, 3) and (n, 3): faster than np.cross."""
    out = np.empty_like(u)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, i] = u[:, j] * v[:, k] - u[:, k] * v[:, j]
    return out
