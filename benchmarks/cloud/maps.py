"""Depth and colour maps of a person from six views: input for image and video codecs instead of points.

    points ──forward──► depth and colour of six orthographic views ──inverse──► one point per non-empty pixel

The fixed views are 60 degrees apart around the vertical axis. The pixel size gives about as many non-empty pixels as a
frame has points: smaller pixels would leave holes, larger ones would lose detail.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocodec.errors import CannotEncode
from mocodec.metrics import splats
from mocodec.pointcloud import PointClouds
from mocodec.typing import Booleans, Bytes, Floats

VIEWS = 6
BLOCK = 16
"""Widths and heights in pixels are multiples of this, the block size of video codecs."""
MOST_PIXELS = 1024
"""Largest width and height of a view."""
BEHIND_M = 0.08
"""A pixel at least this far behind most of its neighbours shows the far side of the body."""


@dataclass(frozen=True)
class Cameras:
    """Six views: common centre, pixel size, half width and half height of the visible area (metres), vertical axis."""

    centre: tuple[float, float, float]
    pixel: float
    across: float
    height: float
    up: str

    @property
    def columns(self) -> int:
        """Width of a view in pixels."""
        return _whole_blocks(2 * self.across / self.pixel)

    @property
    def rows(self) -> int:
        """Height of a view in pixels."""
        return _whole_blocks(2 * self.height / self.pixel)

    def numbers(self) -> tuple[float, ...]:
        """All fields except the vertical axis, for a header."""
        return *self.centre, self.pixel, self.across, self.height

    @staticmethod
    def of(numbers: Sequence[float], up: str) -> Cameras:
        """Cameras from `numbers`, rounded to float32."""
        x, y, z, pixel, across, height = np.asarray(numbers, np.float32).tolist()
        return Cameras((x, y, z), pixel, across, height, up)


def _whole_blocks(pixels: float) -> int:
    """A number of pixels, rounded up to whole blocks, at most MOST_PIXELS."""
    return min(MOST_PIXELS, BLOCK * int(np.ceil((pixels + 2) / BLOCK)))


def cameras(clouds: PointClouds) -> Cameras:
    """Cameras that show the whole sequence, with about as many pixels on the body as a frame has points.

    Raises CannotEncode if no frame has a point.
    """
    frames = [splats.finite_points(clouds, frame) for frame in range(len(clouds))]
    frames = sorted((f for f in frames if len(f[0])), key=lambda f: len(f[0]))
    if not frames:
        raise CannotEncode("no frame has a point to make a map of")
    low = np.min([points.min(axis=0) for points, _ in frames], axis=0)
    high = np.max([points.max(axis=0) for points, _ in frames], axis=0)
    up = splats.AXES[clouds.up]
    level = [axis for axis in range(3) if axis != up]
    centre = (low + high) / 2
    away = max(float(np.linalg.norm((points - centre)[:, level], axis=1).max()) for points, _ in frames)
    result = Cameras.of((*centre, 0.02, max(away, 0.01), max((high - low)[up] / 2, 0.01)), clouds.up)
    points, colours = frames[len(frames) // 2]
    for _ in range(3):
        shown = int(np.isfinite(forward(points, colours, result)[0]).sum())
        pixel = result.pixel * (max(shown, 1) / len(points)) ** 0.5
        least = 2 * max(result.across, result.height) / (MOST_PIXELS - 2 * BLOCK)
        result = Cameras.of((*result.centre, max(pixel, least), result.across, result.height), clouds.up)
    return result


def forward(points: Floats, colours: Bytes | None, views: Cameras) -> tuple[Floats, Bytes]:
    """Depth (6, rows, columns), metres towards the camera, NaN without a point; colour (6, rows, columns, 3).

    A pixel shows its nearest point. Pixels that show the far side of the body are cleared; holes are filled if at least
    five of the eight neighbours show a point.
    """
    rows, columns = views.rows, views.columns
    depth = np.full((VIEWS, rows * columns), np.nan)
    colour = np.zeros((VIEWS, rows * columns, 3))
    for view, (u, towards, v) in enumerate(_view_coordinates(points, views)):
        column = np.clip(np.floor(u / views.pixel + columns / 2).astype(np.int64), 0, columns - 1)
        row = np.clip(np.floor(rows / 2 - v / views.pixel).astype(np.int64), 0, rows - 1)
        order = np.argsort(towards, kind="stable")  # the last of repeated indices stays: the nearest point
        flat = (row * columns + column)[order]
        depth[view, flat] = towards[order]
        colour[view, flat] = 128 if colours is None else colours[order]
    depth = depth.reshape(VIEWS, rows, columns)
    colour = colour.reshape(VIEWS, rows, columns, 3)
    in_front = sum((near > depth + BEHIND_M).astype(np.int8) for near, _ in _neighbours(depth, colour))
    depth[in_front >= 5] = np.nan
    for _ in range(2):
        depth, colour = _close(depth, colour)
    return depth, np.clip(np.rint(colour), 0, 255).astype(np.uint8)


def inverse(depth: Floats, colour: Bytes, views: Cameras) -> tuple[Floats, Bytes]:
    """Points (n, 3) and colours (n, 3): one at the centre of every pixel with a depth."""
    points = list[Floats]()
    up, across, away = _axes(views)
    for view in range(VIEWS):
        row, column = np.nonzero(np.isfinite(depth[view]))
        u = (column + 0.5 - views.columns / 2) * views.pixel
        v = (views.rows / 2 - row - 0.5) * views.pixel
        towards = depth[view][row, column]
        c, s = _angle(view)
        p = np.empty((len(row), 3))
        p[:, across], p[:, away], p[:, up] = c * u - s * towards, s * u + c * towards, v
        points.append(p + views.centre)
    return np.concatenate(points), colour[np.isfinite(depth)]


def atlas(maps: NDArray) -> NDArray:
    """Arranges six maps (6, rows, columns, …) in one image (2 rows, 3 columns, …)."""
    return np.concatenate([np.concatenate(list(half), axis=1) for half in (maps[:3], maps[3:])], axis=0)


def cut(image: NDArray) -> NDArray:
    """The inverse of `atlas`."""
    return np.concatenate([np.stack(np.split(half, 3, axis=1)) for half in np.split(image, 2, axis=0)])


def padded(values: Floats, present: Booleans) -> Floats:
    """Values (rows, columns, channels), with missing pixels filled smoothly by an image pyramid.

    This removes the edge at the silhouette, on which a video codec would spend bits; the mask is coded separately.
    """
    if not present.any():
        return np.zeros_like(values)
    weight = present[..., None].astype(float)
    levels = [(np.where(weight > 0, values, 0.0), weight)]
    while max(levels[-1][1].shape[:2]) > 1:
        total, count = (_halved(a) for a in (levels[-1][0] * levels[-1][1], levels[-1][1]))
        levels.append((total / np.maximum(count, 1e-9), np.minimum(count, 1.0)))
    filled = levels[-1][0]
    for own, weight in reversed(levels[:-1]):
        finer = filled.repeat(2, axis=0).repeat(2, axis=1)[: own.shape[0], : own.shape[1]]
        filled = np.where(weight > 0, own, finer)
    return filled


def _halved(a: Floats) -> Floats:
    """Sums of blocks of 2 × 2 pixels."""
    a = np.pad(a, ((0, a.shape[0] % 2), (0, a.shape[1] % 2), (0, 0)))
    return a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2]


def _close(depth: Floats, colour: Floats) -> tuple[Floats, Floats]:
    """Fills holes with at least five neighbours with the mean of the front neighbours."""
    around = list(_neighbours(depth, colour))
    depths = np.stack([d for d, _ in around])
    front = np.max(np.where(np.isfinite(depths), depths, -np.inf), axis=0)
    good = np.isfinite(depths) & (depths > front - BEHIND_M)
    hole = np.isnan(depth) & (np.isfinite(depths).sum(axis=0) >= 5)
    count = np.maximum(good.sum(axis=0), 1)
    fill_depth = np.where(good, depths, 0).sum(axis=0) / count
    fill_colour = sum(np.where(g[..., None], c, 0) for g, (_, c) in zip(good, around, strict=True)) / count[..., None]
    return np.where(hole, fill_depth, depth), np.where(hole[..., None], fill_colour, colour)


def _neighbours(depth: Floats, colour: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Depth and colour of each pixel's eight neighbours. Borders wrap around; border pixels are always empty."""
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            if down or right:
                yield np.roll(depth, (down, right), (1, 2)), np.roll(colour, (down, right), (1, 2))


def _view_coordinates(points: Floats, views: Cameras) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Coordinates of the points in each view: across, towards the camera, up."""
    up, across, away = _axes(views)
    p = points - np.array(views.centre)
    for view in range(VIEWS):
        c, s = _angle(view)
        yield c * p[:, across] + s * p[:, away], -s * p[:, across] + c * p[:, away], p[:, up]


def _axes(views: Cameras) -> tuple[int, int, int]:
    """Indices of the axes up, across and away in the first view."""
    up = splats.AXES[views.up]
    return up, (up + 1) % 3, (up + 2) % 3


def _angle(view: int) -> tuple[float, float]:
    """Cosine and sine of the direction of a view."""
    angle = 2 * np.pi * view / VIEWS
    return float(np.cos(angle)), float(np.sin(angle))
