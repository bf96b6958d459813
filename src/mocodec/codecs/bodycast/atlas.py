"""A body's surface as one picture: a map on every link's cylinder, side by side; luma above, distance below.

    points, matched to links ──gather──► means in cells ──picture──► planes ──video──► planes ──weave──► points

What each cell holds is in the canonical pose, so points of many frames fall into the same cells and are averaged there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry import cylinder_map
from ...geometry.articulation import Body, Floats
from ...geometry.cylinder_map import Cylinder, CylinderMap

Labels = NDArray[Any]
MAX_SIDE = 4096


class Tile(NamedTuple):
    """A link's map: where it lies in the atlas, millimetres along the link that its rows span, and what 255 stands
    for.
    """

    link: int
    height: int
    width: int
    low: int
    high: int
    reach: int
    top: int = 0
    left: int = 0

    @property
    def here(self) -> tuple[slice, slice]:
        """Its place on the sheet."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)

    def cylinder(self, body: Body) -> Cylinder:
        return cylinder_map.cylinder(body.origins[self.link], body.tips[self.link], self.low / 1000, self.high / 1000)


@dataclass(frozen=True, eq=False)
class Atlas:
    """Tiles on a sheet of (height, width) cells."""

    body: Body
    tiles: tuple[Tile, ...]
    height: int
    width: int

    @property
    def picture_shape(self) -> tuple[int, int]:
        return 2 * self.height, self.width

    @staticmethod
    def plan(body: Body, points: Floats, links: Labels, cells: int) -> Atlas:
        """Room for about `cells` cells in all, shared out by the paper's grid-size formula (section 4)."""
        tiles = list[Tile]()
        for link in range(len(body)):
            own = points[links == link]
            if len(own) < max(6, 0.002 * len(points)):
                continue
            along, _, away = cylinder_map.coordinates(
                cylinder_map.cylinder(body.origins[link], body.tips[link], 0, 1), own
            )
            low, high = np.floor(along.min() * 1000), np.ceil(along.max() * 1000) + 1
            share = cells / (2 * len(points))
            height, width = cylinder_map.grid_size(len(own), float(away.mean()), (high - low) / 1000, share)
            reach = min(int(np.ceil(np.percentile(away, 99.5) * 1300)) + 5, 2000)
            tiles.append(Tile(link, min(height, 1024), min(width, 1024), int(low), int(high), reach))
        return Atlas.laid_out(body, tiles)

    @staticmethod
    def laid_out(body: Body, tiles: list[Tile]) -> Atlas:
        """Tiles on shelves, the tallest first."""
        area = sum(t.height * t.width for t in tiles)
        width = max(max((t.width for t in tiles), default=8), int(1.05 * np.sqrt(area)))
        width += -width % 8
        placed, left, top, shelf = list[Tile](), 0, 0, 0
        for tile in sorted(tiles, key=lambda t: (-t.height, t.link)):
            if left + tile.width > width:
                left, top, shelf = 0, top + shelf, 0
            placed.append(tile._replace(top=top, left=left))
            left, shelf = left + tile.width, max(shelf, tile.height)
        height = top + shelf
        return Atlas(body, tuple(sorted(placed)), max(32, height + -height % 8), max(64, width))  # as x265 needs it

    def pack(self) -> bytes:
        rows = np.array([tile[:6] for tile in self.tiles], np.int64).reshape(-1, 6)
        data = coder.pack(rows)
        return varint.write([len(rows), len(data)]) + data

    @staticmethod
    def unpack(body: Body, data: bytes, at: int) -> tuple[Atlas, int]:
        """The atlas and where its bytes end. Raises Corrupt."""
        (count, size), at = varint.read(data, 2, at)
        if count > len(body) or at + size > len(data):
            raise Corrupt("bodycast: the atlas is damaged")
        rows = coder.unpack(data[at : at + size], (count, 6))
        tiles = [Tile(*map(int, row)) for row in rows]
        for t in tiles:
            good = 0 <= t.link < len(body) and 0 < t.height <= 1024 and 0 < t.width <= 1024 and 0 < t.reach <= 5000
            if not (good and -10000 < t.low < t.high < 10000):
                raise Corrupt("bodycast: the atlas is damaged")
        if len({t.link for t in tiles}) != count:
            raise Corrupt("bodycast: the atlas is damaged")
        atlas = Atlas.laid_out(body, tiles)
        if max(atlas.picture_shape) > MAX_SIDE:
            raise Corrupt("bodycast: the atlas is too large")
        return atlas, at + size

    def cells(self, points: Floats, links: Labels) -> tuple[Labels, Floats]:
        """For canonical points (n, 3) of links (n,): the cell of the sheet, −1 where there is none, and the
        distance.
        """
        cell, distance = np.full(len(points), -1), np.zeros(len(points))
        for tile in self.tiles:
            rows = np.flatnonzero(links == tile.link)
            if len(rows):
                shape = tile.height, tile.width
                inner, distance[rows] = cylinder_map.cells(tile.cylinder(self.body), points[rows], shape)
                row, column = np.divmod(inner, tile.width)
                cell[rows] = (tile.top + row) * self.width + tile.left + column
        return cell, distance

    def reach(self) -> Floats:
        """(height, width): the distance in metres that 255 stands for in each cell; 0 outside the tiles."""
        sheet = np.zeros((self.height, self.width))
        for t in self.tiles:
            sheet[t.top : t.top + t.height, t.left : t.left + t.width] = t.reach / 1000
        return sheet


@dataclass(eq=False)
class Sums:
    """Running sums in every cell: count, distance, red, green, blue; (5, cells)."""

    values: Floats

    @staticmethod
    def empty(atlas: Atlas) -> Sums:
        return Sums(np.zeros((5, atlas.height * atlas.width)))

    @staticmethod
    def showing(atlas: Atlas, planes: NDArray[np.uint8], weight: float) -> Sums:
        """As if so many points in every cell had made this picture."""
        distance = planes[0, atlas.height :] * (atlas.reach() / 255)
        colour = from_luma(planes[:, : atlas.height].transpose(1, 2, 0).astype(np.float64))
        layers = np.concatenate([np.ones((*distance.shape, 1)), distance[..., None], colour], axis=2)
        return Sums(np.asarray(weight * layers.reshape(-1, 5).T, np.float64))

    def gather(self, atlas: Atlas, points: Floats, links: Labels, colours: Floats, keep: float = 1.0) -> None:
        """Add points; what was there before counts `keep` of what it did, in the cells that these fall into."""
        cell, distance = atlas.cells(points, links)
        good = cell >= 0
        cell, size = cell[good], self.values.shape[1]
        layers = (None, distance[good], *colours[good].T)
        if keep < 1:
            self.values[:, np.unique(cell)] *= keep
        for i, layer in enumerate(layers):
            self.values[i] += np.bincount(cell, layer, size)

    def means(self, atlas: Atlas) -> tuple[Floats, Floats, Floats]:
        """(height, width) distance, NaN where nothing fell; (height, width, 3) colour; (height, width) counts."""
        count = self.values[0].reshape(atlas.height, atlas.width)
        some = np.maximum(self.values[0], 1e-9)
        distance = np.where(self.values[0] > 0, self.values[1] / some, np.nan).reshape(count.shape)
        return distance, (self.values[2:] / some).T.reshape(*count.shape, 3), count


def picture(atlas: Atlas, sums: Sums) -> NDArray[np.uint8]:
    """(3, 2 height, width): luma over distance, and the chromas; cells without points like their neighbours."""
    distance, colour, _ = sums.means(atlas)
    planes = np.full((3, 2 * atlas.height, atlas.width), 128, np.uint8)
    for t in atlas.tiles:
        full = cylinder_map.filled(CylinderMap(distance[t.here], colour[t.here]))
        luma = to_luma(full.colour)
        planes[:, *t.here] = np.clip(np.round(luma), 0, 255).transpose(2, 0, 1)
        below = slice(atlas.height + t.top, atlas.height + t.top + t.height)
        planes[0, below, t.here[1]] = np.clip(np.round(full.distance * (255_000 / t.reach)), 0, 255)
    return planes


def to_luma(rgb: Floats) -> Floats:
    """(…, 3) Y, Cb, Cr of BT.709, full range, of colours 0 to 255."""
    y = rgb @ np.array([0.2126, 0.7152, 0.0722])
    return np.stack([y, (rgb[..., 2] - y) / 1.8556 + 128, (rgb[..., 0] - y) / 1.5748 + 128], -1)


def from_luma(ycc: Floats) -> NDArray[np.uint8]:
    """The inverse of `to_luma`, as bytes."""
    y, cb, cr = np.moveaxis(ycc, -1, 0)
    red, blue = y + 1.5748 * (cr - 128), y + 1.8556 * (cb - 128)
    green = (y - 0.2126 * red - 0.0722 * blue) / 0.7152
    return np.clip(np.round(np.stack([red, green, blue], -1)), 0, 255).astype(np.uint8)
