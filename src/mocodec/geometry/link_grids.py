"""Nearest template points by table: for each link a regular grid in the link's canonical coordinates, built once.

A data point is brought into a link's coordinates and looked up in constant time, at the cost of half a cell's accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..typing import AnyInteger, Floats, Integers
from .articulation import Body
from .skinning import Skin

CELL_M = 0.02
"""Edge of a grid's cell, metres."""
MARGIN_M = 0.10
"""How far a grid reaches beyond the bounding box of its link's points, metres."""
MIN_WEIGHT = 0.34
"""Skinning weight with which a template point must follow a link to be in the link's grid."""
NO_COLOURS = np.zeros((0, 3))


@dataclass(frozen=True, eq=False)
class LinkGrids:
    """nearest (cells of all links,): template row nearest to the centre of each cell, −1 for links without points;
    low (links, 3): corner of each link's grid, metres; size (links, 3): its cells; start (links,): its first entry.
    """

    nearest: NDArray[np.int32]
    low: Floats
    size: NDArray[np.int32]
    start: Integers

    @staticmethod
    def build(body: Body, skin: Skin) -> LinkGrids:
        """Grids of the points that follow each link with a weight of `MIN_WEIGHT` or more."""
        weights = skin.shares(len(body))
        nearest, low, size, start = list[NDArray[np.int32]](), list[Floats](), list[AnyInteger](), [0]
        for link in range(len(body)):
            rows = np.flatnonzero(weights[:, link] > MIN_WEIGHT)
            if not len(rows):
                nearest.append(np.full(1, -1, np.int32))
                low.append(np.zeros(3))
                size.append(np.ones(3, np.int32))
            else:
                points = skin.points[rows]
                low.append(points.min(axis=0) - MARGIN_M)
                size.append(np.ceil((np.ptp(points, axis=0) + 2 * MARGIN_M) / CELL_M).astype(np.int32))
                nearest.append(rows[_nearest_in_grid(points, low[-1], size[-1])].astype(np.int32))
            start.append(start[-1] + len(nearest[-1]))
        return LinkGrids(
            np.concatenate(nearest), np.array(low), np.array(size, np.int32), np.array(start[:-1], np.int64)
        )

    def look_up(self, link: AnyInteger, local: Floats) -> AnyInteger:
        """(…,): the template row nearest to `local` (…, 3), in the canonical coordinates of `link`; −1 for a link
        without points. Places outside a grid count as in its outermost cell.
        """
        cell = ((local - self.low[link]) * (1 / CELL_M)).astype(np.int32)
        size = self.size[link]
        np.minimum(cell, size - 1, out=cell)
        np.maximum(cell, 0, out=cell)
        strides = np.stack([size[..., 1] * size[..., 2], size[..., 2], np.ones_like(size[..., 0])], -1)
        return self.nearest[self.start[link] + np.sum(cell * strides, axis=-1)]


def _nearest_in_grid(points: Floats, low: Floats, size: AnyInteger) -> AnyInteger:
    """The row of the point nearest to the centre of each cell of a grid, the last axis fastest."""
    if tree := native.kernel("KdTree"):
        return tree(np.ascontiguousarray(points), NO_COLOURS).grid(low, size, CELL_M)
    from scipy.spatial import KDTree

    axes = [low[i] + CELL_M * (np.arange(size[i]) + 0.5) for i in range(3)]
    return np.asarray(KDTree(points).query(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3))[1])
