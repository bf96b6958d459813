"""Depth and colour maps of a person from six views: what image and video codecs can be given in place of points.

    points ──forward──► depth, colour of six orthographic views ──inverse──► a point of every pixel that shows one

The views stand 60 degrees apart about the vertical axis and do not move. Pixels are as large as makes as many of them
show something as a frame has points: finer ones would be full of holes, coarser ones would lose what was there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocodec.errors import CannotEncode
from mocodec.metrics import splats
from mocodec.motion import Floats
from mocodec.pointcloud import PointClouds

VIEWS = 6
BLOCK = 16  # pixels: widths and heights are multiples of it, as video codecs like them
MOST = 1024  # pixels on a side of a view
BEHIND = 0.08  # metres: a pixel that lies this far behind most of its neighbours shows the other side of the body

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Cameras:
    """Six views: where they look, metres that a pixel is wide, half of what they see across and up, and what is up."""

    centre: tuple[float, float, float]
    pixel: float
    across: float
    height: float
    up: str

    @property
    def columns(self) -> int:
        return _whole_blocks(2 * self.across / self.pixel)

    @property
    def rows(self) -> int:
        return _whole_blocks(2 * self.height / self.pixel)

    def numbers(self) -> tuple[float, ...]:
        """Everything but `up`, for a header."""
        return *self.centre, self.pixel, self.across, self.height

    @staticmethod
    def of(numbers: Sequence[float], up: str) -> Cameras:
        """The inverse of `numbers`, as float32 keeps them."""
        x, y, z, pixel, across, height = np.asarray(numbers, np.float32).tolist()
        return Cameras((x, y, z), pixel, across, height, up)


def _whole_blocks(pixels: float) -> int:
    return min(MOST, BLOCK * int(np.ceil((pixels + 2) / BLOCK)))


def cameras(clouds: PointClouds) -> Cameras:
    """Cameras that hold the whole sequence, with as many pixels on the body as a frame has points.

    Raises CannotEncode where no frame has a point.
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
    chosen = Cameras.of((*centre, 0.02, max(away, 0.01), max((high - low)[up] / 2, 0.01)), clouds.up)
    points, colours = frames[len(frames) // 2]
    for _ in range(3):
        shown = int(np.isfinite(forward(points, colours, chosen)[0]).sum())
        pixel = chosen.pixel * (max(shown, 1) / len(points)) ** 0.5
        least = 2 * max(chosen.across, chosen.height) / (MOST - 2 * BLOCK)
        chosen = Cameras.of((*chosen.centre, max(pixel, least), chosen.across, chosen.height), clouds.up)
    return chosen


def forward(points: Floats, colours: Image | None, seen_by: Cameras) -> tuple[Floats, Image]:
    """depth (6, rows, columns), metres towards the camera, NaN where nothing is; colour (6, rows, columns, 3).

    The nearest point of a pixel shows. Pixels through which the far side shows are emptied, and holes closed where at
    least five of the eight neighbours show something.
    """
    rows, columns = seen_by.rows, seen_by.columns
    depth = np.full((VIEWS, rows * columns), np.nan)
    colour = np.zeros((VIEWS, rows * columns, 3))
    for view, (u, towards, v) in enumerate(_turned(points, seen_by)):
        column = np.clip(np.floor(u / seen_by.pixel + columns / 2).astype(np.int64), 0, columns - 1)
        row = np.clip(np.floor(rows / 2 - v / seen_by.pixel).astype(np.int64), 0, rows - 1)
        order = np.argsort(towards, kind="stable")  # of repeated indices, the last assignment stands: the nearest
        flat = (row * columns + column)[order]
        depth[view, flat] = towards[order]
        colour[view, flat] = 128 if colours is None else colours[order]
    depth = depth.reshape(VIEWS, rows, columns)
    colour = colour.reshape(VIEWS, rows, columns, 3)
    in_front = sum((near > depth + BEHIND).astype(np.int8) for near, _ in _neighbours(depth, colour))
    depth[in_front >= 5] = np.nan
    for _ in range(2):
        depth, colour = _close(depth, colour)
    return depth, np.clip(np.rint(colour), 0, 255).astype(np.uint8)


def inverse(depth: Floats, colour: Image, seen_by: Cameras) -> tuple[Floats, Image]:
    """Points (n, 3) and colours (n, 3): one of every pixel whose depth is not NaN, at its middle."""
    points = list[Floats]()
    up, across, away = _axes(seen_by)
    for view in range(VIEWS):
        row, column = np.nonzero(np.isfinite(depth[view]))
        u = (column + 0.5 - seen_by.columns / 2) * seen_by.pixel
        v = (seen_by.rows / 2 - row - 0.5) * seen_by.pixel
        towards = depth[view][row, column]
        c, s = _angle(view)
        p = np.empty((len(row), 3))
        p[:, across], p[:, away], p[:, up] = c * u - s * towards, s * u + c * towards, v
        points.append(p + seen_by.centre)
    return np.concatenate(points), colour[np.isfinite(depth)]


def atlas(maps: NDArray) -> NDArray:
    """(6, rows, columns, …) as one image (2 rows, 3 columns, …)."""
    return np.concatenate([np.concatenate(list(half), axis=1) for half in (maps[:3], maps[3:])], axis=0)


def cut(image: NDArray) -> NDArray:
    """The inverse of `atlas`."""
    return np.concatenate([np.stack(np.split(half, 3, axis=1)) for half in np.split(image, 2, axis=0)])


def padded(values: Floats, there: NDArray[np.bool_]) -> Floats:
    """values (rows, columns, channels) with what is not there filled smoothly from around, by a pyramid of means.

    Video codecs spend bits on edges; with this there are none at silhouettes, and the mask travels by itself.
    """
    if not there.any():
        return np.zeros_like(values)
    weight = there[..., None].astype(float)
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
    """Sums of 2 × 2."""
    a = np.pad(a, ((0, a.shape[0] % 2), (0, a.shape[1] % 2), (0, 0)))
    return a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2]


def _close(depth: Floats, colour: Floats) -> tuple[Floats, Floats]:
    """Holes that at least five neighbours surround, filled with the mean of those that lie in front."""
    around = list(_neighbours(depth, colour))
    depths = np.stack([d for d, _ in around])
    front = np.max(np.where(np.isfinite(depths), depths, -np.inf), axis=0)
    good = np.isfinite(depths) & (depths > front - BEHIND)
    hole = np.isnan(depth) & (np.isfinite(depths).sum(axis=0) >= 5)
    count = np.maximum(good.sum(axis=0), 1)
    fill_depth = np.where(good, depths, 0).sum(axis=0) / count
    fill_colour = sum(np.where(g[..., None], c, 0) for g, (_, c) in zip(good, around, strict=True)) / count[..., None]
    return np.where(hole, fill_depth, depth), np.where(hole[..., None], fill_colour, colour)


def _neighbours(depth: Floats, colour: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Depth and colour of each pixel's eight neighbours; the border repeats the other side, which is always empty."""
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            if down or right:
                yield np.roll(depth, (down, right), (1, 2)), np.roll(colour, (down, right), (1, 2))


def _turned(points: Floats, seen_by: Cameras) -> Iterator[tuple[Floats, Floats, Floats]]:
    """(across, towards the camera, up) of the points as each view sees them."""
    up, across, away = _axes(seen_by)
    p = points - np.array(seen_by.centre)
    for view in range(VIEWS):
        c, s = _angle(view)
        yield c * p[:, across] + s * p[:, away], -s * p[:, across] + c * p[:, away], p[:, up]


def _axes(seen_by: Cameras) -> tuple[int, int, int]:
    up = splats.AXES[seen_by.up]
    return up, (up + 1) % 3, (up + 2) % 3


def _angle(view: int) -> tuple[float, float]:
    """Cosine and sine of where a view stands."""
    angle = 2 * np.pi * view / VIEWS
    return float(np.cos(angle)), float(np.sin(angle))
