"""Iterative closest points (Besl and McKay, as in Lien and Bajcsy 2006, section 2), over an (n, c)-clustered k-d tree.

    model points ──closest with similar normal and colour──► correspondences ──rigid──► transform ──► model points,
    again

Each model point is matched within the same clusters of the data throughout an ICP, so the error never rises:
theorem 3.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..typing import AnyInteger, Booleans, Floats

LONGITUDES = 6
"""Clusters of normals between the poles; each pole is one more."""
POLE = 0.8
"""A normal with a y of more than this, or less than its negative, belongs to a pole."""
HUES, GREY = 6, 6
"""Clusters of hue are 0 to 5; 6 is for colours of low saturation."""
MIN_SATURATION = 0.2
NORMAL_CLUSTERS, COLOUR_CLUSTERS = LONGITUDES + 2, HUES + 1
SEPARATION_M = 1e3
"""Distance between neighbourhoods along the tree's fourth axis, metres: larger than any recording."""
MIN_NEIGHBOURHOOD = 3
"""Data points that a neighbourhood must have; otherwise all points are searched."""

TOLERANCE_M = 2e-4
"""An ICP ends when the root of the error falls by less, metres."""
MAX_COMPILED_CLUSTERS = 64
"""Clusters of points that the compiled module takes: the bits of a number."""


def rigid(p: Floats, q: Floats, pivot: Floats | None = None) -> tuple[Floats, Floats]:
    """R (3, 3), t (3,): the rigid transform that moves points p (n, 3) closest to q (n, 3): equations (1) and (2).

    pivot (3,): a joint that must not move; it replaces both centres of mass (section 3.2).
    """
    centre_p, centre_q = (p.mean(axis=0), q.mean(axis=0)) if pivot is None else (pivot, pivot)
    r = rotations((p - centre_p).T @ (q - centre_q) / max(len(p), 1))
    return r, centre_q - r @ centre_p


def normal_cluster(normals: Floats) -> AnyInteger:
    """(n,): clusters of unit normals (n, 3): 0 to 5 by longitude, 6 and 7 for the poles +y and −y."""
    longitude = np.arctan2(normals[:, 2], normals[:, 0]) % (2 * np.pi)
    sector = np.minimum((longitude / (2 * np.pi) * LONGITUDES).astype(np.int64), LONGITUDES - 1)
    return np.where(normals[:, 1] > POLE, LONGITUDES, np.where(normals[:, 1] < -POLE, LONGITUDES + 1, sector))


def colour_cluster(colours: AnyInteger) -> AnyInteger:
    """(n,): clusters of colours (n, 3) by hue, 0 to 5, and 6 for low saturation."""
    c = np.asarray(colours, np.float64)
    high, low = c.max(axis=1), c.min(axis=1)
    chroma = np.maximum(high - low, 1e-9)
    r, g, b = c.T
    hue = np.where(high == r, ((g - b) / chroma) % 6, np.where(high == g, (b - r) / chroma + 2, (r - g) / chroma + 4))
    return np.where(chroma < MIN_SATURATION * np.maximum(high, 1), GREY, np.minimum(hue.astype(np.int64) % 6, HUES - 1))


def _near_normals() -> Booleans:
    near = np.eye(NORMAL_CLUSTERS, dtype=bool)
    for i in range(LONGITUDES):
        near[i, [(i + 1) % LONGITUDES, (i - 1) % LONGITUDES, LONGITUDES, LONGITUDES + 1]] = True
    return near | near.T


def _near_colours() -> Booleans:
    near = np.eye(COLOUR_CLUSTERS, dtype=bool)
    for i in range(HUES):
        near[i, [(i + 1) % HUES, (i - 1) % HUES, GREY]] = True
    return near | near.T


NEAR_NORMALS, NEAR_COLOURS = _near_normals(), _near_colours()


@cache
def _neighbourhoods(by_normals: bool, by_colours: bool) -> Booleans:
    """(labels, clusters): which clusters are in the neighbourhood of each label."""
    near_normals = NEAR_NORMALS if by_normals else np.ones_like(NEAR_NORMALS)
    near_colours = NEAR_COLOURS if by_colours else np.ones_like(NEAR_COLOURS)
    return np.kron(near_normals, near_colours)


@dataclass(frozen=True, eq=False)
class ClusteredTree:
    """Data points for queries that are each matched within a neighbourhood: some clusters of the points.

    points (n, 3): metres. clusters (n,): of each. near (labels, clusters): the neighbourhood of each label. filled
    (labels,): whether it has enough points; otherwise queries search all points. keys: labels of queries.
    """

    points: Floats
    clusters: AnyInteger
    near: Booleans
    filled: Booleans
    keys: AnyInteger

    @staticmethod
    def build(points: Floats, normals: Floats | None, colours: AnyInteger | None, wanted: AnyInteger) -> ClusteredTree:
        """The tree of points (n, 3) for queries with the labels `wanted`. Without normals or colours, all points count
        as similar in them.
        """
        n_label = np.zeros(len(points), np.int64) if normals is None else normal_cluster(normals)
        c_label = np.zeros(len(points), np.int64) if colours is None else colour_cluster(colours)
        near = _neighbourhoods(normals is not None, colours is not None)
        clusters = n_label * COLOUR_CLUSTERS + c_label
        filled = near @ np.bincount(clusters, minlength=len(near)) >= MIN_NEIGHBOURHOOD
        return ClusteredTree(points, clusters, near, filled, np.unique(wanted))

    @staticmethod
    def of_groups(points: Floats, groups: AnyInteger, count: int) -> ClusteredTree:
        """The tree of points (n, 3) in disjoint groups (n,), 0 to count − 1. Queries are labelled by group; those of a
        group without points are not allowed.
        """
        filled = np.bincount(groups, minlength=count) > 0
        return ClusteredTree(points, groups, np.eye(count, dtype=bool), filled, np.flatnonzero(filled))

    @cached_property
    def tree(self) -> tuple[Any, AnyInteger]:
        """One k-d tree that separates the neighbourhoods along a fourth axis, and the data point of each entry."""
        enough = self.filled[self.keys]
        keys = self.keys[enough]
        inside = self.near[keys][:, self.clusters]
        if not enough.all():  # neighbourhood −1 is all points
            keys, inside = np.append(keys, -1), np.vstack([inside, np.ones(len(self.points), bool)])
        key, row = np.nonzero(inside)
        return _tree(self.points[row], keys[key]), row

    @cached_property
    def compiled(self) -> Any:
        """The compiled points, None where the kernel is missing or there are more clusters than it takes."""
        kernel = native.kernel("ClusteredPoints")
        if kernel is None or self.near.shape[1] > MAX_COMPILED_CLUSTERS:
            return None
        return kernel(self.points, self.clusters.astype(np.uint8))

    def allowed(self, labels: AnyInteger) -> NDArray[np.uint64]:
        """(n,): the clusters of the neighbourhoods of labels (n,), as bits."""
        bits = np.left_shift(np.uint64(1), np.arange(self.near.shape[1], dtype=np.uint64))
        masks = np.where(self.filled, self.near @ bits, ~np.uint64(0))
        return masks[labels]

    def queries(self, points: Floats, labels: AnyInteger) -> Floats:
        """(n, 4): points (n, 3) with the coordinate of their label's neighbourhood, as `closest` takes them."""
        return np.column_stack([points, np.where(self.filled[labels], labels, -1) * SEPARATION_M])

    def closest(self, queries: Floats) -> tuple[AnyInteger, Floats]:
        """For each of queries (n, 4), the row and the distance of the closest data point in its neighbourhood."""
        tree, rows = self.tree
        distance, index = tree.query(queries)
        return rows[index], distance


def _tree(points: Floats, keys: AnyInteger) -> Any:
    from scipy.spatial import cKDTree  # type: ignore[attr-defined]  # KDTree's checks of each query take long

    return cKDTree(np.column_stack([points, keys * SEPARATION_M]), 16, compact_nodes=False, balanced_tree=False)


def labels(normals: Floats | None, clusters: AnyInteger | None, count: int) -> AnyInteger:
    """(n,): the label of each model point: the neighbourhood in which it is matched. clusters (n,): of its colour."""
    n = np.zeros(count, np.int64) if normals is None else normal_cluster(normals)
    c = np.full(count, GREY) if clusters is None else clusters
    return n * COLOUR_CLUSTERS + c


def icp(
    points: Floats,
    label: AnyInteger,
    data: ClusteredTree,
    *,
    pivot: Floats | None = None,
    iterations: int = 12,
    tolerance: float = TOLERANCE_M,
) -> tuple[Floats, Floats, list[float]]:
    """Algorithm 2.1: R (3, 3), t (3,) that move model points (n, 3) onto the data, and the error of equation (1) before
    each step.

    The errors are mean squared distances in square metres, and never rise. Stops when the root of the error falls by
    less than `tolerance` metres. pivot (3,): a joint that must not move.
    """
    pivots = np.full((1, 3), np.nan) if pivot is None else pivot[None]
    r, t, errors = icp_many(points, label, [len(points)], data, pivots, iterations=iterations, tolerance=tolerance)
    return r[0], t[0], errors[0]


def icp_many(
    points: Floats,
    label: AnyInteger,
    sizes: Sequence[int],
    data: ClusteredTree,
    pivots: Floats,
    *,
    iterations: int = 12,
    tolerance: float = TOLERANCE_M,
) -> tuple[Floats, Floats, list[list[float]]]:
    """`icp` of several independent rigid parts at once, vectorised over the parts.

    points (n, 3): of one part after another; `sizes` of them each, at least one. pivots (parts, 3): joints that must
    not move; NaN for a free part. Returns R (parts, 3, 3), t (parts, 3), the errors of each part.
    """
    if (compiled := data.compiled) is not None:
        allowed, lengths = data.allowed(label), np.array(sizes, np.int64)
        r, t, errors = compiled.icp(points, allowed, lengths, pivots, iterations, tolerance)
        return np.asarray(r), np.asarray(t), errors
    count = len(sizes)
    lengths = np.array(sizes)
    r, t = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    errors = [list[float]() for _ in range(count)]
    queries, free = data.queries(points, label), np.isnan(pivots[:, :1])
    active, part_of = np.arange(count), np.repeat(np.arange(count), lengths)
    last = np.full(count, np.inf)
    for _ in range(iterations):
        starts = np.cumsum(lengths) - lengths
        row, distance = data.closest(queries)
        error = np.add.reduceat(distance**2, starts) / lengths
        for part, value in zip(active, error.tolist(), strict=True):
            errors[part].append(value)
        root = np.sqrt(error)
        improves = last - root >= tolerance
        if not improves.all():
            if not improves.any():
                break
            kept = improves[part_of]
            queries, row = queries[kept], row[kept]
            active, lengths, root = active[improves], lengths[improves], root[improves]
            starts, part_of = np.cumsum(lengths) - lengths, np.repeat(np.arange(len(active)), lengths)
        last = root
        p, q, each = queries[:, :3], data.points[row], lengths[:, None]
        centre_p, centre_q = (np.where(free[active], np.add.reduceat(x, starts) / each, pivots[active]) for x in (p, q))
        off_p, off_q = p - centre_p[part_of], q - centre_q[part_of]
        products = (off_p[:, :, None] * off_q[:, None, :]).reshape(-1, 9)
        step = rotations((np.add.reduceat(products, starts) / each).reshape(-1, 3, 3))
        move = centre_q - np.einsum("pij,pj->pi", step, centre_p)
        queries[:, :3] = np.einsum("nij,nj->ni", step[part_of], p) + move[part_of]
        r[active], t[active] = step @ r[active], np.einsum("pij,pj->pi", step, t[active]) + move
    return r, t, errors


def rotations(covariance: Floats) -> Floats:
    """(…, 3, 3): the rotations that turn p closest to q, from their cross-covariances Σ p qᵀ (…, 3, 3)."""
    u, _, vt = np.linalg.svd(covariance)
    u[..., :, 2] *= np.where(np.linalg.det(u @ vt) < 0, -1.0, 1.0)[..., None]
    return np.asarray((u @ vt).swapaxes(-1, -2), np.float64)
