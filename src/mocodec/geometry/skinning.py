"""Linear blend skinning of a body's surface points, with weights that follow from the body and the points alone.

Near a joint a point follows two links, otherwise one. The weights cost no bytes: encoder and decoder derive the same
ones from the same body and points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import native
from ..typing import AnyInteger, Floats
from .articulation import Body

RADIUS = 0.0375
"""Radius of the neighbourhood over which `blended` averages, as a share of the body's size."""


@dataclass(frozen=True, eq=False)
class Skin:
    """points (n, 3) in the canonical pose, metres; the two links of each (n, 2); the weight (n,) of the first of
    them.
    """

    points: Floats
    links: AnyInteger
    weights: Floats

    def blend(self, a: Floats, b: Floats, rows: AnyInteger | slice = slice(None)) -> Floats:
        """(n, 3, 4): the blended transform of each point, or of those of `rows`."""
        links, weight = self.links[rows], self.weights[rows, None]
        packed = np.concatenate([a, b[:, :, None]], axis=2)
        blend = packed[links[:, 0]] * weight[..., None]
        blend += packed[links[:, 1]] * (1 - weight)[..., None]
        return blend

    def posed(self, a: Floats, b: Floats, rows: AnyInteger | slice = slice(None)) -> Floats:
        """(n, 3): the points, or those of `rows`, under transforms a (links, 3, 3), b (links, 3)."""
        blend = self.blend(a, b, rows)
        return np.einsum("nij,nj->ni", blend[:, :, :3], self.points[rows]) + blend[:, :, 3]

    def unposed(self, a: Floats, b: Floats, rows: AnyInteger, places: Floats) -> Floats:
        """(n, 3): places (n, 3) of the world in the canonical pose, by the inverse transforms of the points `rows`."""
        if (kernel := native.kernel("unposed_places")) is not None:
            return np.asarray(kernel(a, b, self.links[rows], self.weights[rows], places))
        blend = self.blend(a, b, rows)
        return np.asarray(np.linalg.solve(blend[:, :, :3], (places - blend[:, :, 3])[..., None])[..., 0], np.float64)

    def shares(self, links: int) -> Floats:
        """(n, links): the weight of each link at each point."""
        shares = np.zeros((len(self.points), links))
        rows = np.arange(len(self.points))
        np.add.at(shares, (rows, self.links[:, 0]), self.weights)
        np.add.at(shares, (rows, self.links[:, 1]), 1 - self.weights)
        return shares


def skin(body: Body, points: Floats, links: AnyInteger, softness: float = 0.9) -> Skin:
    """The skin of canonical points (n, 3) assigned to links (n,).

    Across each joint the weight changes linearly from one link to the other, within `softness` of the thinner link's
    radius on either side of the plane that bisects the angle between their axes. A point near two joints is blended at
    the nearer one.
    """
    partner, weight = links.copy(), np.ones(len(points))
    axes, radii = body.axes, body.radii
    for child, parent in enumerate(body.parents):
        if parent < 0:
            continue
        across = axes[child] + axes[parent]
        if np.linalg.norm(across) < 0.3:  # a folded joint: the child's own direction
            across = axes[child]
        across = across / np.linalg.norm(across)
        width = softness * min(radii[child], radii[parent])
        near = np.linalg.norm(points - body.origins[child], axis=1) < 2.2 * max(radii[child], width)
        beyond = (points - body.origins[child]) @ across / width  # positive on the child's side
        for link, other, sign in ((child, parent, 1.0), (parent, child, -1.0)):
            mine = np.flatnonzero(near & (links == link) & (sign * beyond < 1))
            share = np.clip(0.5 + 0.5 * sign * beyond[mine], 0.5, 1.0)
            better = share < weight[mine]
            partner[mine[better]], weight[mine[better]] = other, share[better]
    return Skin(points, np.stack([links, partner], axis=1), weight)


def blended(body: Body, points: Floats, links: AnyInteger, normals: Floats) -> Skin:
    """The skin of canonical points (n, 3) assigned to links (n,), with weights averaged over neighbours whose unit
    normals (n, 3) point the same way.

    Weights change gradually across every boundary between links, wherever it lies, but not from an arm to the trunk
    that it touches.
    """
    own = np.zeros((len(points), len(body)))
    own[np.arange(len(points)), links] = 1.0
    shares = averaged(body, points, normals, own)
    order = np.argsort(-shares, axis=1, kind="stable")[:, :2]
    first, second = np.take_along_axis(shares, order, axis=1).T
    order[second <= 0, 1] = order[second <= 0, 0]
    return Skin(points, order, first / (first + second))


def averaged(body: Body, points: Floats, normals: Floats, values: Floats) -> Floats:
    """(n, k): values (n, k) of points (n, 3), averaged over the neighbourhood of each. Weights fall to zero at its
    radius, and for unit normals (n, 3) at a right angle or more.
    """
    radius = RADIUS * float(np.ptp(np.concatenate([body.origins, body.tips]), axis=0).max())
    if (kernel := native.kernel("neighbourhood_means")) is not None:
        return np.asarray(kernel(points, normals, values, radius))
    from scipy.sparse import coo_array
    from scipy.spatial import KDTree

    pairs = KDTree(points).query_pairs(radius, output_type="ndarray")
    own = np.arange(len(points))
    i, j = (np.concatenate([pairs[:, k], pairs[:, 1 - k], own]) for k in (0, 1))
    gap = np.sum((points[i] - points[j]) ** 2, axis=1) / radius**2
    weight = np.maximum(1 - gap, 0.0) ** 2 * np.maximum(np.sum(normals[i] * normals[j], axis=1), 0.0)
    weight[len(i) - len(own) :] = 1.0
    total = np.bincount(i, weight, len(points))
    means = coo_array((weight / total[i], (i, j)), shape=(len(points),) * 2).tocsr()
    return np.asarray(means @ values)


@dataclass(frozen=True, eq=False)
class SkinMatrix:
    """A skin as one sparse matrix (n, 4 links) of weighted points: posing is a product with the links' transforms.
    Faster than `Skin.posed` for many points in many poses.
    """

    skin: Skin
    matrix: Any

    @staticmethod
    def build(skin: Skin, links: int) -> SkinMatrix:
        from scipy.sparse import csr_array

        count = len(skin.points)
        columns = (4 * skin.links[:, :, None] + np.arange(4)).reshape(-1)
        matrix = csr_array(
            (SkinMatrix._values(skin), columns, np.arange(0, 8 * count + 1, 8)), shape=(count, 4 * links)
        )
        return SkinMatrix(skin, matrix)

    @staticmethod
    def _values(skin: Skin) -> Floats:
        weights = np.stack([skin.weights, 1 - skin.weights], axis=1)
        ones = np.ones((len(skin.points), 1))
        return (weights[:, :, None] * np.concatenate([skin.points, ones], axis=1)[:, None]).reshape(-1)

    def with_points(self, points: Floats) -> SkinMatrix:
        """The matrix of other canonical points (n, 3) with the same weights."""
        matrix = self.matrix.copy()
        skin = Skin(points, self.skin.links, self.skin.weights)
        matrix.data = SkinMatrix._values(skin)
        return SkinMatrix(skin, matrix)

    def posed(self, a: Floats, b: Floats) -> Floats:
        """(…, n, 3): the points under transforms a (…, links, 3, 3), b (…, links, 3)."""
        lead = a.shape[:-3]
        both = np.concatenate([np.swapaxes(a, -1, -2), b[..., None, :]], axis=-2)  # (…, links, 4, 3)
        flat = both.reshape(-1, 4 * a.shape[-3], 3)
        wide = flat.transpose(1, 0, 2).reshape(4 * a.shape[-3], -1)
        points = np.asarray(self.matrix @ wide)
        return points.reshape(len(points), -1, 3).transpose(1, 0, 2).reshape(*lead, len(points), 3)
