"""Images of point clouds: each point a small square, the nearest wins. Six views stand 60 degrees apart, as in the
paper.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...motion import Floats
from ...pointcloud import PointClouds

Image = NDArray[np.uint8]
AXES = {"x": 0, "y": 1, "z": 2}


def render(
    points: Floats,
    colours: NDArray[np.uint8] | None,
    angle: float,
    centre: Floats,
    half: float,
    *,
    size: int = 256,
    splat: int = 3,
    up: str = "y",
) -> Image:
    """One orthographic view, (size, size, 3), on black.

    angle: degrees about the vertical axis. centre (3,), half: metres, the square that fills the image. splat: pixels a
    point's side is wide. Points without colours are drawn by their depth.
    """
    vertical = AXES[up]
    across, away = (vertical + 1) % 3, (vertical + 2) % 3
    p = points - centre
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    u, depth, v = c * p[:, across] + s * p[:, away], -s * p[:, across] + c * p[:, away], p[:, vertical]
    if colours is None:
        shade = np.clip(255 * (0.5 + 0.5 * depth / half), 40, 255).astype(np.uint8)
        colours = np.repeat(shade[:, None], 3, axis=1)
    column = np.floor((u / half + 1) * size / 2).astype(np.int64)
    row = np.floor((1 - v / half) * size / 2).astype(np.int64)
    order = np.argsort(depth, kind="stable")  # the nearest is drawn last
    image = np.zeros((size, size, 3), np.uint8)
    reach = np.arange(splat) - splat // 2
    dy, dx = np.meshgrid(reach, reach, indexing="ij")
    rows = row[order, None] + dy.ravel()
    columns = column[order, None] + dx.ravel()
    inside = (rows >= 0) & (rows < size) & (columns >= 0) & (columns < size)
    flat = (rows * size + columns)[inside]
    owner = np.broadcast_to(order[:, None], rows.shape)[inside]
    top = np.full(size * size, -1)
    top[flat] = owner  # of repeated indices, the last assignment stands
    drawn = top >= 0
    image.reshape(-1, 3)[drawn] = colours[top[drawn]]
    return image


def views(
    clouds: PointClouds, frame: int, like: PointClouds | None = None, *, count: int = 6, size: int = 256
) -> list[Image]:
    """`count` images around one frame, framed as the same frame of `like`, so that two clouds can be compared."""
    points = finite(clouds, frame)
    framing = finite(like, frame)[0] if like is not None else points[0]
    low, high = (framing.min(axis=0), framing.max(axis=0)) if len(framing) else (np.zeros(3), np.ones(3))
    centre, half = (low + high) / 2, 0.55 * float((high - low).max() or 1.0)
    return [render(*points, 360 / count * i, centre, half, size=size, up=clouds.up) for i in range(count)]


def finite(clouds: PointClouds, frame: int) -> tuple[Floats, NDArray[np.uint8] | None]:
    """Points and colours of a frame without those that are NaN or infinite."""
    points = np.asarray(clouds.positions[frame], np.float64)
    good = np.isfinite(points).all(axis=1)
    return points[good], None if clouds.colours is None else clouds.colours[frame][good]
