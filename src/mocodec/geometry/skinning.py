"""Points of a body that follow its links, each two of them near a joint: linear blend skinning with weights from the
body alone.

The weights follow from where a point lies between two links' axes, so that they cost no bytes: encoder and decoder
derive the same ones from the same body and points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .articulation import Body, Floats

Labels = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Skin:
    """points (n, 3) in the canonical pose; links (n, 2) that each follows, weights (n,) of the first of the two."""

    points: Floats
    links: Labels
    weights: Floats

    def blend(self, a: Floats, b: Floats, rows: Labels | slice = slice(None)) -> Floats:
        """(n, 3, 4): the transform of each point, or of those of `rows`."""
        links, weight = self.links[rows], self.weights[rows, None]
        packed = np.concatenate([a, b[:, :, None]], axis=2)
        blend = packed[links[:, 0]] * weight[..., None]
        blend += packed[links[:, 1]] * (1 - weight)[..., None]
        return blend

    def posed(self, a: Floats, b: Floats, rows: Labels | slice = slice(None)) -> Floats:
        """(n, 3): where transforms a (links, 3, 3), b (links, 3) put the points, or those of `rows`."""
        blend = self.blend(a, b, rows)
        return np.einsum("nij,nj->ni", blend[:, :, :3], self.points[rows]) + blend[:, :, 3]

    def unposed(self, a: Floats, b: Floats, rows: Labels, places: Floats) -> Floats:
        """(n, 3): places in the world brought back into the canonical pose, as if they moved with the points of
        `rows`.
        """
        blend = self.blend(a, b, rows)
        return np.asarray(np.linalg.solve(blend[:, :, :3], (places - blend[:, :, 3])[..., None])[..., 0], np.float64)

    def shares(self, links: int) -> Floats:
        """(n, links): the weight of every link at every point."""
        shares = np.zeros((len(self.points), links))
        rows = np.arange(len(self.points))
        np.add.at(shares, (rows, self.links[:, 0]), self.weights)
        np.add.at(shares, (rows, self.links[:, 1]), 1 - self.weights)
        return shares


def skin(body: Body, points: Floats, links: Labels, softness: float = 0.9) -> Skin:
    """Weights of points (n, 3), canonical, that belong to links (n,).

    Across each joint the weight passes from one link to the other over `softness` of the thinner link's radius to
    either side of the plane that halves the angle between their axes. A point near two joints follows the nearer of
    them.
    """
    partner, weight = links.copy(), np.ones(len(points))
    axes, radii = body.axes, body.radii
    for child, parent in enumerate(body.parents):
        if parent < 0:
            continue
        across = axes[child] + axes[parent]
        if np.linalg.norm(across) < 0.3:  # folded back on itself: the child's own direction
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


@dataclass(frozen=True, eq=False)
class Rig:
    """A skin as one sparse matrix (n, 4 links) of weighted points, so that posing it is a product with the links'
    transforms: for many points that are posed often.
    """

    skin: Skin
    matrix: Any

    @staticmethod
    def of(skin: Skin, links: int) -> Rig:
        from scipy.sparse import csr_array

        count = len(skin.points)
        columns = (4 * skin.links[:, :, None] + np.arange(4)).reshape(-1)
        matrix = csr_array((Rig._values(skin), columns, np.arange(0, 8 * count + 1, 8)), shape=(count, 4 * links))
        return Rig(skin, matrix)

    @staticmethod
    def _values(skin: Skin) -> Floats:
        weights = np.stack([skin.weights, 1 - skin.weights], axis=1)
        ones = np.ones((len(skin.points), 1))
        return (weights[:, :, None] * np.concatenate([skin.points, ones], axis=1)[:, None]).reshape(-1)

    def carrying(self, points: Floats) -> Rig:
        """The same weights on other points (n, 3)."""
        matrix = self.matrix.copy()
        skin = Skin(points, self.skin.links, self.skin.weights)
        matrix.data = Rig._values(skin)
        return Rig(skin, matrix)

    def posed(self, a: Floats, b: Floats) -> Floats:
        """(…, n, 3): where transforms a (…, links, 3, 3), b (…, links, 3) put the points."""
        lead = a.shape[:-3]
        both = np.concatenate([np.swapaxes(a, -1, -2), b[..., None, :]], axis=-2)  # (…, links, 4, 3)
        flat = both.reshape(-1, 4 * a.shape[-3], 3)
        wide = flat.transpose(1, 0, 2).reshape(4 * a.shape[-3], -1)
        points = np.asarray(self.matrix @ wide)
        return points.reshape(len(points), -1, 3).transpose(1, 0, 2).reshape(*lead, len(points), 3)
