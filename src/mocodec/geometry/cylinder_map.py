"""Points of a link as an image: a regular grid on the link's cylinder (Lien and Bajcsy 2006, section 4).

    points of a link ──forward──► (height, width) grids of distance from the axis and of colour ──inverse──► points

Rows are heights along the link, columns are angles around it. The map moves with the link: only the points of the
current frame have to be resampled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..typing import Floats, Integers


class Cylinder(NamedTuple):
    """A cylinder's coordinate frame: origin (3,), and the orthogonal unit vectors axis, side and across (3,); the map
    covers heights from `low` to `high` along the axis, metres.
    """

    origin: Floats
    axis: Floats
    side: Floats
    across: Floats
    low: float
    high: float


class CylinderMap(NamedTuple):
    """distance (height, width): metres from the axis, NaN in empty cells; colour (height, width, 3), 0 to 255."""

    distance: Floats
    colour: Floats


def cylinder(origin: Floats, tip: Floats, low: float, high: float) -> Cylinder:
    """The cylinder from `origin` (3,) towards `tip` (3,) whose map covers heights from `low` to `high`, metres."""
    side, across, axis = (rows[0] for rows in directions(origin[None], tip[None]))
    return Cylinder(origin, axis, side, across, low, high)


def directions(origins: Floats, tips: Floats) -> tuple[Floats, Floats, Floats]:
    """Unit vectors (n, 3) of cylinders from origins to tips (n, 3): side, across (axis × side), and axis."""
    axis = tips - origins
    axis = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
    side = np.cross(axis, np.where(np.abs(axis[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return side, np.cross(axis, side), axis


def grid_size(points: int, radius: float, length: float, share: float = 1.0) -> tuple[int, int]:
    """(height, width) of a link's grid: L S by 2πR S with S = √(|P| / πRL), 2|P| cells in total (section 4).

    radius R, length L: metres. share: of the full residual; the grid has that share of the cells.
    """
    s = np.sqrt(max(points, 1) * share / (np.pi * radius * length))
    return max(1, round(length * s)), max(3, round(2 * np.pi * radius * s))


def coordinates(cylinder: Cylinder, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Height along the axis, angle in [0, 2π) about it and distance from it, (n,) each, of points (n, 3)."""
    offset = points - cylinder.origin
    u, v = offset @ cylinder.side, offset @ cylinder.across
    return offset @ cylinder.axis, np.arctan2(v, u) % (2 * np.pi), np.hypot(u, v)


def cells(cylinder: Cylinder, points: Floats, shape: tuple[int, int]) -> tuple[Integers, Floats]:
    """(n,) each: the flat index of the cell that each point (n, 3) falls into, and its distance from the axis,
    metres.
    """
    along, angle, distance = coordinates(cylinder, points)
    height, width = shape
    span = max(cylinder.high - cylinder.low, 1e-9)
    row = np.clip((along - cylinder.low) / span * height, 0, height - 1).astype(np.int64)
    column = np.minimum((angle / (2 * np.pi) * width).astype(np.int64), width - 1)
    return row * width + column, distance


def forward(cylinder: Cylinder, points: Floats, colours: Floats, shape: tuple[int, int]) -> CylinderMap:
    """The mean distance and colour of the points (n, 3), with colours (n, 3), that fall into each cell."""
    cell, distance = cells(cylinder, points, shape)
    size = shape[0] * shape[1]
    count = np.bincount(cell, minlength=size)
    divisor = np.maximum(count, 1)
    mean = np.where(count > 0, np.bincount(cell, distance, size) / divisor, np.nan)
    colour = np.stack([np.bincount(cell, colours[:, i], size) / divisor for i in range(3)], -1)
    return CylinderMap(mean.reshape(shape), colour.reshape(*shape, 3))


def inverse(cylinder: Cylinder, sampled: CylinderMap) -> tuple[Floats, Floats]:
    """Points (n, 3), metres, and colours (n, 3) at the centres of the cells that are not empty."""
    height, width = sampled.distance.shape
    row, column = np.nonzero(np.isfinite(sampled.distance))
    return positions(cylinder, row, column, sampled.distance[row, column], (height, width)), sampled.colour[row, column]


def positions(cylinder: Cylinder, row: Integers, column: Integers, distance: Floats, shape: tuple[int, int]) -> Floats:
    """(n, 3): positions of cells (rows and columns (n,)) at distances (n,) from the axis, metres."""
    along = cylinder.low + (row + 0.5) / shape[0] * (cylinder.high - cylinder.low)
    angle = (column + 0.5) / shape[1] * 2 * np.pi
    out = np.cos(angle)[:, None] * cylinder.side + np.sin(angle)[:, None] * cylinder.across
    return cylinder.origin + along[:, None] * cylinder.axis + distance[:, None] * out


def filled(sampled: CylinderMap, rounds: int = 200) -> CylinderMap:
    """The map with its holes filled, from their edges inwards, by the mean of each cell's known neighbours."""
    distance, colour = sampled.distance.copy(), sampled.colour.copy()
    known = np.isfinite(distance)
    if not known.any():
        return CylinderMap(np.zeros_like(distance), np.full_like(colour, 128.0))
    distance[~known] = 0
    values = np.concatenate([distance[..., None], colour], -1)
    values[~known] = 0
    for _ in range(rounds):
        if known.all():
            break
        total, weight = np.zeros_like(values), np.zeros_like(distance)
        for shift, axis in ((1, 1), (-1, 1), (1, 0), (-1, 0)):
            neighbour, is_known = np.roll(values, shift, axis), np.roll(known, shift, axis).astype(float)
            if axis == 0:  # rows do not wrap around
                is_known[0 if shift == 1 else -1] = 0
            total += neighbour * is_known[..., None]
            weight += is_known
        new = ~known & (weight > 0)
        values[new] = total[new] / weight[new, None]
        known = known | new
    return CylinderMap(values[..., 0], values[..., 1:])
