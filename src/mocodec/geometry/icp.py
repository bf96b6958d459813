"""Iterative closest points (Besl and McKay, as in Lien and Bajcsy 2006, section 2), over an (n, c)-clustered k-d tree.

    model points ──closest, among like normals and colours──► pairs ──rigid──► transform ──► moved model points, again

Each model point looks in one fixed set of clusters of the data for as long as an ICP runs, so every step can only
lower the error: theorem 3.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Labels = NDArray[Any]

LATITUDES, LONGITUDES = 3, 6  # the poles are one cluster each
HUES, GREY = 6, 6  # hue clusters 0 to 5; 6 is what has too little saturation to have a hue
NORMAL_CLUSTERS, COLOUR_CLUSTERS = LONGITUDES + 2, HUES + 1
APART = 1e3  # metres between neighbourhoods along the tree's fourth axis


def rigid(p: Floats, q: Floats, pivot: Floats | None = None) -> tuple[Floats, Floats]:
    """R (3, 3), t (3,) that carry points p (n, 3) closest to their pairs q (n, 3): equations (1) and (2).

    pivot (3,): a joint that must stay where it is; it stands in place of both centres (section 3.2).
    """
    centre_p, centre_q = (p.mean(axis=0), q.mean(axis=0)) if pivot is None else (pivot, pivot)
    r = rotations((p - centre_p).T @ (q - centre_q) / max(len(p), 1))
    return r, centre_q - r @ centre_p


def normal_cluster(normals: Floats) -> Labels:
    """Clusters in geographic coordinates: the poles and LONGITUDES sectors between them."""
    longitude = np.arctan2(normals[:, 2], normals[:, 0]) % (2 * np.pi)
    sector = np.minimum((longitude / (2 * np.pi) * LONGITUDES).astype(np.int64), LONGITUDES - 1)
    return np.where(normals[:, 1] > 0.8, LONGITUDES, np.where(normals[:, 1] < -0.8, LONGITUDES + 1, sector))


def colour_cluster(colours: NDArray[Any]) -> Labels:
    """Clusters of hue, and one of what has little saturation."""
    c = np.asarray(colours, np.float64)
    high, low = c.max(axis=1), c.min(axis=1)
    chroma = np.maximum(high - low, 1e-9)
    r, g, b = c.T
    hue = np.where(high == r, ((g - b) / chroma) % 6, np.where(high == g, (b - r) / chroma + 2, (r - g) / chroma + 4))
    return np.where(chroma < 0.2 * np.maximum(high, 1), GREY, np.minimum(hue.astype(np.int64) % 6, HUES - 1))


def _near_normals() -> NDArray[np.bool_]:
    near = np.eye(NORMAL_CLUSTERS, dtype=bool)
    for i in range(LONGITUDES):
        near[i, [(i + 1) % LONGITUDES, (i - 1) % LONGITUDES, LONGITUDES, LONGITUDES + 1]] = True
    return near | near.T


def _near_colours() -> NDArray[np.bool_]:
    near = np.eye(COLOUR_CLUSTERS, dtype=bool)
    for i in range(HUES):
        near[i, [(i + 1) % HUES, (i - 1) % HUES, GREY]] = True
    return near | near.T


NEAR_NORMALS, NEAR_COLOURS = _near_normals(), _near_colours()


@dataclass(frozen=True, eq=False)
class ClusteredTree:
    """Data points by neighbourhoods of like normal and colour; one k-d tree holds them all, APART along a fourth
    axis.
    """

    points: Floats
    tree: Any
    rows: Labels
    filled: NDArray[np.bool_]

    @staticmethod
    def build(points: Floats, normals: Floats | None, colours: NDArray[Any] | None, wanted: Labels) -> ClusteredTree:
        """The tree of points (n, 3) for queries with the labels in `wanted`; without normals or colours, all are
        alike.
        """
        n_label = np.zeros(len(points), np.int64) if normals is None else normal_cluster(normals)
        c_label = np.zeros(len(points), np.int64) if colours is None else colour_cluster(colours)
        keys = np.unique(wanted)
        n, c = np.divmod(keys, COLOUR_CLUSTERS)
        near_normals = NEAR_NORMALS if normals is not None else np.ones_like(NEAR_NORMALS)
        near_colours = NEAR_COLOURS if colours is not None else np.ones_like(NEAR_COLOURS)
        inside = near_normals[n][:, n_label] & near_colours[c][:, c_label]
        enough = inside.sum(axis=1) >= 3
        filled = np.zeros(NORMAL_CLUSTERS * COLOUR_CLUSTERS, bool)
        filled[keys] = enough
        keys, inside = keys[enough], inside[enough]
        if not enough.all():  # neighbourhood −1 is all points
            keys, inside = np.append(keys, -1), np.vstack([inside, np.ones(len(points), bool)])
        key, row = np.nonzero(inside)
        return ClusteredTree(points, _tree(points[row], keys[key]), row, filled)

    @staticmethod
    def of_groups(points: Floats, groups: Labels, count: int) -> ClusteredTree:
        """The tree of points (n, 3) of which each is in one group (n,), 0 to count − 1: for queries labelled by group,
        of groups that have points."""
        filled = np.bincount(groups, minlength=count) > 0
        return ClusteredTree(points, _tree(points, groups), np.arange(len(points)), filled)

    def placed(self, points: Floats, labels: Labels) -> Floats:
        """(n, 4): points in the neighbourhoods of their labels, as `closest` takes them."""
        return np.column_stack([points, np.where(self.filled[labels], labels, -1) * APART])

    def closest(self, placed: Floats) -> tuple[Labels, Floats]:
        """For each of `placed` (n, 4), the row and the distance of the closest data point in its neighbourhood."""
        distance, index = self.tree.query(placed)
        return self.rows[index], distance


def _tree(points: Floats, keys: Labels) -> Any:
    from scipy.spatial import cKDTree  # type: ignore[attr-defined]  # KDTree checks every query at length

    return cKDTree(np.column_stack([points, keys * APART]), 16, compact_nodes=False, balanced_tree=False)


def labels(normals: Floats | None, colours: NDArray[Any] | None, count: int) -> Labels:
    """The neighbourhood that each model point looks in."""
    n = np.zeros(count, np.int64) if normals is None else normal_cluster(normals)
    c = np.full(count, GREY) if colours is None else colour_cluster(colours)
    return n * COLOUR_CLUSTERS + c


def icp(
    points: Floats,
    label: Labels,
    data: ClusteredTree,
    *,
    pivot: Floats | None = None,
    iterations: int = 12,
    tolerance: float = 2e-4,
) -> tuple[Floats, Floats, list[float]]:
    """Algorithm 2.1: R (3, 3), t (3,) that carry model points (n, 3) onto the data, and the error of equation (1) a
    step.

    The errors, mean squared distances in square metres, never rise. Stops when the root of the error falls by less
    than `tolerance` metres.
    """
    pivots = np.full((1, 3), np.nan) if pivot is None else pivot[None]
    r, t, errors = icp_many(points, label, [len(points)], data, pivots, iterations=iterations, tolerance=tolerance)
    return r[0], t[0], errors[0]


def icp_many(
    points: Floats,
    label: Labels,
    sizes: Sequence[int],
    data: ClusteredTree,
    pivots: Floats,
    *,
    iterations: int = 12,
    tolerance: float = 2e-4,
) -> tuple[Floats, Floats, list[list[float]]]:
    """`icp` of several rigid parts that do not move one another, step by step side by side.

    points (n, 3): of one part after another, `sizes` of each, none of them empty. pivots (parts, 3): joints that stay
    where they are; NaN for a part that is free. Returns R (parts, 3, 3), t (parts, 3), the errors of each part.
    """
    count = len(sizes)
    many = np.array(sizes)
    r, t = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    errors = [list[float]() for _ in range(count)]
    placed, free = data.placed(points, label), np.isnan(pivots[:, :1])
    active, part_of = np.arange(count), np.repeat(np.arange(count), many)
    last = np.full(count, np.inf)
    for _ in range(iterations):
        starts = np.cumsum(many) - many
        row, distance = data.closest(placed)
        error = np.add.reduceat(distance**2, starts) / many
        for part, value in zip(active, error.tolist(), strict=True):
            errors[part].append(value)
        root = np.sqrt(error)
        going = last - root >= tolerance
        if not going.all():
            if not going.any():
                break
            stay = going[part_of]
            placed, row = placed[stay], row[stay]
            active, many, root = active[going], many[going], root[going]
            starts, part_of = np.cumsum(many) - many, np.repeat(np.arange(len(active)), many)
        last = root
        p, q, each = placed[:, :3], data.points[row], many[:, None]
        centre_p, centre_q = (np.where(free[active], np.add.reduceat(x, starts) / each, pivots[active]) for x in (p, q))
        off_p, off_q = p - centre_p[part_of], q - centre_q[part_of]
        products = (off_p[:, :, None] * off_q[:, None, :]).reshape(-1, 9)
        step = rotations((np.add.reduceat(products, starts) / each).reshape(-1, 3, 3))
        move = centre_q - np.einsum("pij,pj->pi", step, centre_p)
        placed[:, :3] = np.einsum("nij,nj->ni", step[part_of], p) + move[part_of]
        r[active], t[active] = step @ r[active], np.einsum("pij,pj->pi", step, t[active]) + move
    return r, t, errors


def rotations(covariance: Floats) -> Floats:
    """(…, 3, 3): the rotations that carry p closest to q, from their cross-covariances Σ p qᵀ (…, 3, 3)."""
    u, _, vt = np.linalg.svd(covariance)
    u[..., :, 2] *= np.where(np.linalg.det(u @ vt) < 0, -1.0, 1.0)[..., None]
    return np.asarray((u @ vt).swapaxes(-1, -2), np.float64)
