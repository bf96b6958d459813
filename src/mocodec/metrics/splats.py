"""Images of point clouds: each point is drawn as a small square, nearer points cover farther ones."""

from __future__ import annotations

import numpy as np

from ..pointcloud import PointClouds
from ..typing import Bytes, Floats

AXES = {"x": 0, "y": 1, "z": 2}


def render(
    points: Floats,
    colours: Bytes | None,
    angle: float,
    centre: Floats,
    half: float,
    *,
    size: int = 256,
    splat: int = 3,
    up: str = "y",
) -> Bytes:
    """One orthographic view (size, size, 3) on black.

    angle: degrees about the vertical axis. centre (3,) and half: middle and half width of the visible square, metres.
    splat: width of a point in pixels. Points without colours are shaded by depth.
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
    order = np.argsort(depth, kind="stable")  # nearest last
    image = np.zeros((size, size, 3), np.uint8)
    reach = np.arange(splat) - splat // 2
    dy, dx = np.meshgrid(reach, reach, indexing="ij")
    rows = row[order, None] + dy.ravel()
    columns = column[order, None] + dx.ravel()
    inside = (rows >= 0) & (rows < size) & (columns >= 0) & (columns < size)
    flat = (rows * size + columns)[inside]
    owner = np.broadcast_to(order[:, None], rows.shape)[inside]
    top = np.full(size * size, -1)
    top[flat] = owner  # the last of repeated indices stays: the nearest point
    drawn = top >= 0
    image.reshape(-1, 3)[drawn] = colours[top[drawn]]
    return image


def views(
    clouds: PointClouds, frame: int, like: PointClouds | None = None, *, count: int = 6, size: int = 256
) -> list[Bytes]:
    """`count` images of one frame from evenly spaced directions. like: take the visible square from this cloud's frame,
    so that the images of two clouds can be compared.
    """
    points = finite_points(clouds, frame)
    framing = finite_points(like, frame)[0] if like is not None else points[0]
    low, high = (framing.min(axis=0), framing.max(axis=0)) if len(framing) else (np.zeros(3), np.ones(3))
    centre, half = (low + high) / 2, 0.55 * float((high - low).max() or 1.0)
    return [render(*points, 360 / count * i, centre, half, size=size, up=clouds.up) for i in range(count)]


def finite_points(clouds: PointClouds, frame: int) -> tuple[Floats, Bytes | None]:
    """Points (n, 3) and colours (n, 3) of a frame, without points that are NaN or infinite."""
    points = np.asarray(clouds.positions[frame], np.float64)
    good = np.isfinite(points).all(axis=1)
    return points[good], None if clouds.colours is None else clouds.colours[frame][good]
