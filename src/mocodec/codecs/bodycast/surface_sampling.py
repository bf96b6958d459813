"""Points on the surface that the atlas shows: evenly spread by area, whatever the size of the cells.

    displacement map ─► areas of subcells ─► points at equal steps of area ─► its place in the atlas
    image, places ─► distance and colour, interpolated between cell centres ─► points

So the number of decoded points does not depend on the number of cells. Everything that decides where a point lies is
computed in integers, or element by element, so that every machine gets the same points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...errors import Corrupt
from ...geometry.cylinder_map import Cylinder
from ...typing import AnyInteger, Booleans, Bytes, Floats, Integers
from .texture_atlas import Atlas, AtlasTile, rgb_from_ycbcr

SUBCELLS = 3  # of a cell along each side
STRIP_SPACINGS = 4  # height of a strip of rows, in spacings of points
GOLDEN = 40503  # of 2^16: golden-ratio step across a strip from one point to the next
AREA_UNIT_M2 = 1e-12


class SurfaceSamples(NamedTuple):
    """Places of n points on an atlas.

    cells (4, n), weights (4, n): flat cells of the image around each point, and their bilinear weights. axis_points
    (n, 3), directions (n, 3): the foot of the point on the link's axis and the unit vector away from it, canonical.
    max_displacements (n,): metres that level 255 stands for. links (n,). normals (n, 3): unit vectors.
    displacement_offset: cells from a texture cell to its displacement.
    """

    cells: AnyInteger
    weights: Floats
    axis_points: Floats
    directions: Floats
    max_displacements: Floats
    links: AnyInteger
    normals: Floats
    displacement_offset: int

    def surface(self, planes: Bytes) -> tuple[Floats, Bytes]:
        """Canonical points (n, 3) and their colours (n, 3) in an image (3, 2 height, width)."""
        flat = planes.reshape(3, -1)
        displacement = flat[0][self.cells + self.displacement_offset]
        distance = np.einsum("kn,kn->n", self.weights, displacement) * (self.max_displacements / 255)
        ycbcr = np.einsum("kn,ckn->nc", self.weights, flat[:, self.cells])
        return self.axis_points + distance[:, None] * self.directions, rgb_from_ycbcr(ycbcr)


def sample_surface(atlas: Atlas, planes: Bytes, is_surface: Booleans, points: int) -> SurfaceSamples:
    """`points` places evenly spread over the cells (height, width) that are surface. Raises Corrupt without any."""
    displacement = planes[0, atlas.height :].astype(np.float64)
    fine = [subcell_areas(atlas, tile, displacement, is_surface) for tile in atlas.tiles]
    total = sum(int(area.sum()) for area, _ in fine)
    if not total:
        raise Corrupt("bodycast: the atlas shows no surface")
    spacing_m = np.sqrt(total * AREA_UNIT_M2 / points)
    strips = [_cut_into_strips(area, tile, spacing_m) for (area, _), tile in zip(fine, atlas.tiles, strict=True)]
    start = np.cumsum([0, *(int(area.sum()) for area in strips)])
    number = np.arange(points, dtype=np.int64)
    target = (2 * number + 1) * (total // (2 * points)) + total % (2 * points) // 2
    across_strip = (number * GOLDEN) & 0xFFFF
    tiles = [
        _samples_of_tile(atlas, tile, strips[i], fine[i][1], target[inside] - start[i], across_strip[inside])
        for i, tile in enumerate(atlas.tiles)
        if (inside := (target >= start[i]) & (target < start[i + 1])).any()
    ]
    return SurfaceSamples(
        np.concatenate([s.cells for s in tiles], axis=1), np.concatenate([s.weights for s in tiles], axis=1),
        np.concatenate([s.axis_points for s in tiles]), np.concatenate([s.directions for s in tiles]),
        np.concatenate([s.max_displacements for s in tiles]), np.concatenate([s.links for s in tiles]),
        np.concatenate([s.normals for s in tiles]), atlas.height * atlas.width,
    )  # fmt: skip


def subcell_areas(atlas: Atlas, tile: AtlasTile, displacement: Floats, is_surface: Booleans) -> tuple[Integers, Floats]:
    """Areas (rows, columns) in AREA_UNIT_M2 and unit normals (rows, columns, 3) of a tile's subcells.

    displacement, is_surface (height, width): of the whole atlas. Subcells of cells that are no surface have area 0.
    """
    t = tile
    rows, columns = (np.arange(SUBCELLS * n) + 0.5 for n in (t.height, t.width))
    cells, weights = _bilinear_taps(
        t.height, t.width, np.repeat(rows / SUBCELLS, len(columns)), np.tile(columns / SUBCELLS, len(rows))
    )
    flat = displacement[t.region].reshape(-1)
    distance = weights[0] * flat[cells[0]]
    for weight, cell in zip(weights[1:], cells[1:], strict=True):
        distance = distance + weight * flat[cell]
    distance = distance.reshape(len(rows), len(columns)) * (t.max_displacement_mm / 255_000)
    row_length = (t.high_mm - t.low_mm) / (1000 * len(rows))
    column_angle = 2 * np.pi / len(columns)
    slope_along = np.zeros_like(distance)
    if len(rows) > 2:
        slope_along[1:-1] = (distance[2:] - distance[:-2]) / 2
    slope_around = (np.roll(distance, -1, axis=1) - np.roll(distance, 1, axis=1)) / 2
    arc = distance * column_angle
    area = np.sqrt(
        arc * arc * (row_length * row_length + slope_along * slope_along)
        + row_length * row_length * slope_around * slope_around
    )
    kept = np.repeat(np.repeat(is_surface[t.region], SUBCELLS, axis=0), SUBCELLS, axis=1)
    cylinder, angle = t.cylinder(atlas.body), np.asarray(columns * column_angle, np.float64)
    outward, tangent = _outward(cylinder, angle), _tangent(cylinder, angle)
    normals = outward[None] - (slope_along / row_length)[..., None] * cylinder.axis
    normals = normals - (slope_around / np.maximum(arc, 1e-6))[..., None] * tangent[None]
    normals = normals / np.sqrt((normals**2).sum(axis=2, keepdims=True))
    return np.floor(np.minimum(area, 1.0) / AREA_UNIT_M2).astype(np.int64) * kept, normals


def _outward(cylinder: Cylinder, angle: Floats) -> Floats:
    """(n, 3): unit vectors away from the axis at angles (n,)."""
    return np.cos(angle)[:, None] * cylinder.side + np.sin(angle)[:, None] * cylinder.across


def _tangent(cylinder: Cylinder, angle: Floats) -> Floats:
    """(n, 3): unit vectors around the axis at angles (n,)."""
    return np.cos(angle)[:, None] * cylinder.across - np.sin(angle)[:, None] * cylinder.side


def _cut_into_strips(area: Integers, tile: AtlasTile, spacing_m: float) -> Integers:
    """(strips, columns, rows of a strip): the areas of `subcell_areas`; the last strip is padded with zeros."""
    row_length = (tile.high_mm - tile.low_mm) / (1000 * len(area))
    rows = int(np.clip(np.round(STRIP_SPACINGS * spacing_m / row_length), 1, len(area)))
    strips = -(-len(area) // rows)
    padded = np.zeros((strips * rows, area.shape[1]), np.int64)
    padded[: len(area)] = area
    return padded.reshape(strips, rows, -1).transpose(0, 2, 1)


def _samples_of_tile(
    atlas: Atlas, tile: AtlasTile, strips: Integers, normals: Floats, target: Integers, across_strip: Integers
) -> SurfaceSamples:
    """The places at which the area, summed column by column along the strips, reaches the targets (n,).

    across_strip (n,): where in its column each point lies, as a share of the column's area, of 2^16.
    """
    t = tile
    _, columns, rows = strips.shape
    sums = strips.sum(axis=2).reshape(-1)
    before = np.cumsum(sums) - sums
    column = np.searchsorted(before + sums, target, side="right")
    along_column = (target - before[column]) / sums[column]
    up_to = np.cumsum(strips.reshape(-1))
    wanted = before[column] + (across_strip * (sums[column] >> 16) + (across_strip * (sums[column] & 0xFFFF) >> 16))
    subcell = np.searchsorted(up_to, wanted, side="right")
    size = strips.reshape(-1)[subcell]
    within_subcell = (wanted - (up_to[subcell] - size)) / size
    strip, tile_column = np.divmod(column, columns)
    row = strip * rows + subcell % rows
    at_row, at_column = (row + within_subcell) / SUBCELLS, (tile_column + along_column) / SUBCELLS
    cells, weights = _bilinear_taps(t.height, t.width, at_row, at_column)
    inner_row, inner_column = np.divmod(cells, t.width)
    cylinder = t.cylinder(atlas.body)
    along = cylinder.low + at_row / t.height * (cylinder.high - cylinder.low)
    angle = at_column / t.width * 2 * np.pi
    return SurfaceSamples(
        (t.top + inner_row) * atlas.width + t.left + inner_column, weights,
        cylinder.origin + along[:, None] * cylinder.axis, _outward(cylinder, angle),
        np.full(len(row), t.max_displacement_mm / 1000), np.full(len(row), t.link), normals[row, tile_column],
        atlas.height * atlas.width,
    )  # fmt: skip


def _bilinear_taps(height: int, width: int, row: Floats, column: Floats) -> tuple[AnyInteger, Floats]:
    """(4, n) each: the flat cells whose centres surround places in a tile, and their bilinear weights.

    row, column (n,): in cells from the tile's corner. Rows end at the tile's edge; columns close a ring.
    """
    row = np.clip(row - 0.5, 0, height - 1)
    column = column - 0.5 + width
    top, left = np.floor(row).astype(np.int64), np.floor(column).astype(np.int64)
    down, right = row - top, column - left
    bottom = np.minimum(top + 1, height - 1)
    cells = [r * width + c % width for r in (top, bottom) for c in (left, left + 1)]
    weights = [v * h for v in (1 - down, down) for h in (1 - right, right)]
    return np.stack(cells), np.stack(weights)
