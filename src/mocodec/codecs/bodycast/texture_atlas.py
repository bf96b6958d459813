"""A body's surface as one image: a map on every link's cylinder, side by side.

    points on links ──CellSums.add──► means in cells ──atlas_planes──► planes ──video──► planes
    planes ──surface_sampling──► points

The upper half of the image is a texture atlas, the lower half a displacement map: distances from the links' axes. Cells
refer to the canonical pose, so points of many frames fall into the same cells and are averaged there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry import cylinder_map
from ...geometry.articulation import Body
from ...geometry.cylinder_map import Cylinder, CylinderMap
from ...typing import AnyInteger, Bytes, Floats

MAX_SIDE, MAX_TILE_SIDE = 4096, 1024  # cells
MAX_END_MM, MAX_DISPLACEMENT_MM = 10_000, 5000  # of stored tiles
MIN_HEIGHT, MIN_WIDTH, ALIGNMENT = 32, 64, 8  # cells, as x265 needs them
MIN_TILE_POINTS, MIN_TILE_SHARE = 6, 0.002  # points of a link that has a tile


class AtlasTile(NamedTuple):
    """The map of one link.

    link. height, width: cells. low_mm, high_mm: the part of the link's axis that the rows span, from the link's origin.
    max_displacement_mm: the distance from the axis that level 255 stands for. top, left: place in the atlas.
    """

    link: int
    height: int
    width: int
    low_mm: int
    high_mm: int
    max_displacement_mm: int
    top: int = 0
    left: int = 0

    @property
    def region(self) -> tuple[slice, slice]:
        """Rows and columns of the atlas."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)

    def cylinder(self, body: Body) -> Cylinder:
        origin, tip = body.origins[self.link], body.tips[self.link]
        return cylinder_map.cylinder(origin, tip, self.low_mm / 1000, self.high_mm / 1000)


@dataclass(frozen=True, eq=False)
class Atlas:
    """Tiles on a sheet of (height, width) cells."""

    body: Body
    tiles: tuple[AtlasTile, ...]
    height: int
    width: int

    @property
    def image_shape(self) -> tuple[int, int]:
        """(rows, columns) of the image: texture above, displacement below."""
        return 2 * self.height, self.width

    @staticmethod
    def plan(body: Body, points: Floats, links: AnyInteger, cells: int) -> Atlas:
        """An atlas of about `cells` cells for points (n, 3) of links (n,), divided by the paper's grid-size formula."""
        tiles = list[AtlasTile]()
        for link in range(len(body)):
            own = points[links == link]
            if len(own) < max(MIN_TILE_POINTS, MIN_TILE_SHARE * len(points)):
                continue
            cylinder = cylinder_map.cylinder(body.origins[link], body.tips[link], 0, 1)
            along, _, distance = cylinder_map.coordinates(cylinder, own)
            low, high = np.floor(along.min() * 1000), np.ceil(along.max() * 1000) + 1
            share = cells / (2 * len(points))
            height, width = cylinder_map.grid_size(len(own), float(distance.mean()), (high - low) / 1000, share)
            most = min(int(np.ceil(np.percentile(distance, 99.5) * 1300)) + 5, 2000)
            tiles.append(
                AtlasTile(link, min(height, MAX_TILE_SIDE), min(width, MAX_TILE_SIDE), int(low), int(high), most)
            )
        return Atlas.arrange(body, tiles)

    @staticmethod
    def arrange(body: Body, tiles: list[AtlasTile]) -> Atlas:
        """Tiles placed on shelves, the tallest first."""
        area = sum(t.height * t.width for t in tiles)
        width = max(max((t.width for t in tiles), default=8), int(1.05 * np.sqrt(area)))
        width += -width % ALIGNMENT
        placed, left, top, shelf_height = list[AtlasTile](), 0, 0, 0
        for tile in sorted(tiles, key=lambda t: (-t.height, t.link)):
            if left + tile.width > width:
                left, top, shelf_height = 0, top + shelf_height, 0
            placed.append(tile._replace(top=top, left=left))
            left, shelf_height = left + tile.width, max(shelf_height, tile.height)
        height = top + shelf_height
        height += -height % ALIGNMENT
        return Atlas(body, tuple(sorted(placed)), max(MIN_HEIGHT, height), max(MIN_WIDTH, width))

    def pack(self) -> bytes:
        rows = np.array([tile[:6] for tile in self.tiles], np.int64).reshape(-1, 6)
        data = coder.pack(rows)
        return varint.write([len(rows), len(data)]) + data

    @staticmethod
    def unpack(body: Body, data: bytes, at: int) -> tuple[Atlas, int]:
        """The atlas at position `at` and the position after it. Raises Corrupt."""
        (count, size), at = varint.read(data, 2, at)
        if count > len(body) or at + size > len(data):
            raise Corrupt("bodycast: the atlas is damaged: more tiles than links, or cut off")
        rows = coder.unpack(data[at : at + size], (count, 6))
        tiles = [AtlasTile(*map(int, row)) for row in rows]
        for t in tiles:
            valid = 0 <= t.link < len(body) and 0 < t.height <= MAX_TILE_SIDE and 0 < t.width <= MAX_TILE_SIDE
            valid &= 0 < t.max_displacement_mm <= MAX_DISPLACEMENT_MM
            if not (valid and -MAX_END_MM < t.low_mm < t.high_mm < MAX_END_MM):
                raise Corrupt(f"bodycast: the atlas is damaged: tile {tuple(t[:6])} is out of range")
        if len({t.link for t in tiles}) != count:
            raise Corrupt("bodycast: the atlas is damaged: a link has two tiles")
        atlas = Atlas.arrange(body, tiles)
        if max(atlas.image_shape) > MAX_SIDE:
            raise Corrupt(f"bodycast: the atlas is larger than {MAX_SIDE} cells")
        return atlas, at + size

    def cells(self, points: Floats, links: AnyInteger) -> tuple[AnyInteger, Floats]:
        """(n,) each, for canonical points (n, 3) of links (n,): the flat cell, −1 where the link has no tile; and the
        distance from the link's axis, metres.
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

    def max_displacements(self) -> Floats:
        """(height, width): metres that level 255 stands for in each cell; 0 outside the tiles."""
        sheet = np.zeros((self.height, self.width))
        for t in self.tiles:
            sheet[t.region] = t.max_displacement_mm / 1000
        return sheet


@dataclass(eq=False)
class CellSums:
    """Running sums in every cell: values (5, cells): weight, distance, red, green, blue."""

    values: Floats

    @staticmethod
    def empty(atlas: Atlas) -> CellSums:
        return CellSums(np.zeros((5, atlas.height * atlas.width)))

    @staticmethod
    def from_planes(atlas: Atlas, planes: Bytes, weight: float) -> CellSums:
        """The sums of an image, with `weight` points in every cell."""
        distance = planes[0, atlas.height :] * (atlas.max_displacements() / 255)
        colour = rgb_from_ycbcr(planes[:, : atlas.height].transpose(1, 2, 0).astype(np.float64))
        layers = np.concatenate([np.ones((*distance.shape, 1)), distance[..., None], colour], axis=2)
        return CellSums(np.asarray(weight * layers.reshape(-1, 5).T, np.float64))

    def add(self, atlas: Atlas, points: Floats, links: AnyInteger, colours: Floats, keep: float = 1.0) -> None:
        """Add canonical points (n, 3) with links (n,) and colours (n, 3). keep: factor on their cells' old sums."""
        cell, distance = atlas.cells(points, links)
        mapped = cell >= 0
        cell, size = cell[mapped], self.values.shape[1]
        layers = (None, distance[mapped], *colours[mapped].T)
        if keep < 1:
            self.values[:, np.unique(cell)] *= keep
        for i, layer in enumerate(layers):
            self.values[i] += np.bincount(cell, layer, size)

    def means(self, atlas: Atlas) -> tuple[Floats, Floats, Floats]:
        """distance (height, width), NaN in empty cells; colour (height, width, 3); weight (height, width)."""
        weight = self.values[0].reshape(atlas.height, atlas.width)
        divisor = np.maximum(self.values[0], 1e-9)
        distance = np.where(self.values[0] > 0, self.values[1] / divisor, np.nan).reshape(weight.shape)
        return distance, (self.values[2:] / divisor).T.reshape(*weight.shape, 3), weight


def atlas_planes(atlas: Atlas, sums: CellSums) -> Bytes:
    """(3, 2 height, width): Y above displacement, Cb and Cr. Empty cells are filled from their neighbours."""
    distance, colour, _ = sums.means(atlas)
    planes = np.full((3, 2 * atlas.height, atlas.width), 128, np.uint8)
    for t in atlas.tiles:
        full = cylinder_map.filled(CylinderMap(distance[t.region], colour[t.region]))
        planes[:, *t.region] = np.clip(np.round(ycbcr_from_rgb(full.colour)), 0, 255).transpose(2, 0, 1)
        below = slice(atlas.height + t.top, atlas.height + t.top + t.height)
        displacement = np.round(full.distance * (255_000 / t.max_displacement_mm))
        planes[0, below, t.region[1]] = np.clip(displacement, 0, 255)
    return planes


def ycbcr_from_rgb(rgb: Floats) -> Floats:
    """(…, 3) Y, Cb, Cr of BT.709, full range, of colours (…, 3), 0 to 255."""
    y = rgb @ np.array([0.2126, 0.7152, 0.0722])
    return np.stack([y, (rgb[..., 2] - y) / 1.8556 + 128, (rgb[..., 0] - y) / 1.5748 + 128], -1)


def rgb_from_ycbcr(ycbcr: Floats) -> Bytes:
    """The inverse of `ycbcr_from_rgb`, rounded to bytes."""
    y, cb, cr = np.moveaxis(ycbcr, -1, 0)
    red, blue = y + 1.5748 * (cr - 128), y + 1.8556 * (cb - 128)
    green = (y - 0.2126 * red - 0.0722 * blue) / 0.7152
    return np.clip(np.round(np.stack([red, green, blue], -1)), 0, 255).astype(np.uint8)
