"""Points of a surface that is kept as a picture: evenly spread, however the picture's cells lie.

    picture, counts ─► which cells are surface
    picture ─► area of each part of a cell ─► every so many square metres a point ─► its place on the picture
    picture, places ─► distance and colour between the cells' centres ─► points

How many points a frame has and how many cells the picture has are two things. All that decides where a point lies is
done in whole numbers, or element by element, so that every machine takes the same ones.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import Corrupt
from ...geometry.articulation import Floats
from .atlas import Atlas, Sums, from_luma

Labels = NDArray[Any]
PARTS = 3  # of a cell along each side
STRIP = 4  # spacings of points that a strip of rows is high
GOLDEN = 40503  # of 2^16: the step across a strip from one point to the next
UNIT = 1e-12  # square metres
FEW = 8  # points in a cell, below which it is counted with those around it
USUAL = 0.4  # of the points that are usual for its area, which a cell of the surface has at least


class Weave(NamedTuple):
    """n points on an atlas: cells (4, n) of the sheet around each and their weights; in canonical coordinates, where
    the link's axis passes (n, 3) and the direction away from it (n, 3); metres that 255 stands for, links (n,), unit
    normals (n, 3).
    """

    cells: Labels
    weights: Floats
    axis: Floats
    out: Floats
    reach: Floats
    links: Labels
    normals: Floats
    below: int  # cells from a colour to its distance

    def surface(self, planes: NDArray[np.uint8]) -> tuple[Floats, NDArray[np.uint8]]:
        """Canonical points (n, 3) and their colours (n, 3), as the planes (3, 2 height, width) show them."""
        flat = planes.reshape(3, -1)
        distance = np.einsum("kn,kn->n", self.weights, flat[0][self.cells + self.below]) * (self.reach / 255)
        ycc = np.einsum("kn,ckn->nc", self.weights, flat[:, self.cells])
        return self.axis + distance[:, None] * self.out, from_luma(ycc)


def valid_cells(atlas: Atlas, planes: NDArray[np.uint8], sums: Sums) -> NDArray[np.bool_]:
    """Cells that hold, with those around them, half of the points that are usual for their area: those inside joints,
    and those that span two surfaces, do not.
    """
    count, area = sums.values[0].reshape(atlas.height, atlas.width), np.zeros((atlas.height, atlas.width))
    distance = planes[0, atlas.height :].astype(np.float64)
    for number, t in enumerate(atlas.tiles):
        fine, _ = _fine(atlas, number, distance, np.ones(area.shape, bool))
        area[t.here] = fine.reshape(t.height, PARTS, t.width, PARTS).sum(axis=(1, 3))
    some = (count > 0) & (area > 0)
    if not some.any():
        return some
    if count[some].mean() < FEW:
        count, area = (_around(atlas, values) for values in (count, area))
    some = (count > 0) & (area > 0)
    usual = float(np.median(count[some] / area[some]))
    full = (count >= USUAL * usual * area) & some
    valid = _around(atlas, full.astype(np.float64)) > 4  # single cells follow those around, which costs fewer bits
    return valid if valid.any() else full


def _around(atlas: Atlas, values: Floats) -> Floats:
    """Sums over each cell and the eight around it in its tile; columns close a ring."""
    result = np.zeros_like(values)
    for t in atlas.tiles:
        padded = np.pad(np.pad(values[t.here], ((0, 0), (1, 1)), "wrap"), ((1, 1), (0, 0)), "edge")
        for i, j in np.ndindex(3, 3):
            result[t.here] += padded[i : i + t.height, j : j + t.width]
    return result


class _Part(NamedTuple):
    """A tile's fine grid: area of each part of a cell in UNITs, in strips; what stands there."""

    area: NDArray[np.int64]  # (strips, columns, rows of a strip)
    normals: Floats  # (rows, columns, 3)


def weave(atlas: Atlas, planes: NDArray[np.uint8], valid: NDArray[np.bool_], points: int) -> Weave:
    """About evenly spread points on the valid cells of the picture. Raises Corrupt where there are none."""
    distance = planes[0, atlas.height :].astype(np.float64)
    fine = [_fine(atlas, number, distance, valid) for number in range(len(atlas.tiles))]
    total = sum(int(area.sum()) for area, _ in fine)
    if not total:
        raise Corrupt("bodycast: the atlas is empty")
    spacing = np.sqrt(total * UNIT / points)
    parts = [_Part(_strips(area, atlas.tiles[i], spacing), normals) for i, (area, normals) in enumerate(fine)]
    begin = np.cumsum([0, *(int(p.area.sum()) for p in parts)])
    target = (2 * np.arange(points, dtype=np.int64) + 1) * (total // (2 * points)) + total % (2 * points) // 2
    golden = (np.arange(points, dtype=np.int64) * GOLDEN) & 0xFFFF
    found = [
        _pick(atlas, i, part, target[inside] - begin[i], golden[inside])
        for i, part in enumerate(parts)
        if (inside := (target >= begin[i]) & (target < begin[i + 1])).any()
    ]
    cells, weights, axis, out, reach, links, normals = (list(column) for column in zip(*found, strict=True))
    return Weave(
        np.concatenate(cells, axis=1), np.concatenate(weights, axis=1), np.concatenate(axis), np.concatenate(out),
        np.concatenate(reach), np.concatenate(links), np.concatenate(normals), atlas.height * atlas.width,
    )  # fmt: skip


def _fine(atlas: Atlas, number: int, sheet: Floats, valid: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Floats]:
    """Areas (rows, columns) and normals (rows, columns, 3) of a tile's cells in PARTS each way."""
    t = atlas.tiles[number]
    rows, columns = (np.arange(PARTS * n) + 0.5 for n in (t.height, t.width))
    cells, weights = _taps(
        t.height, t.width, np.repeat(rows / PARTS, len(columns)), np.tile(columns / PARTS, len(rows))
    )
    flat = sheet[t.here].reshape(-1)
    away = weights[0] * flat[cells[0]]
    for weight, cell in zip(weights[1:], cells[1:], strict=True):
        away = away + weight * flat[cell]
    away = away.reshape(len(rows), len(columns)) * (t.reach / 255_000)
    along = (t.high - t.low) / (1000 * len(rows))
    turn = 2 * np.pi / len(columns)
    down = np.zeros_like(away)
    if len(rows) > 2:
        down[1:-1] = (away[2:] - away[:-2]) / 2
    round_ = (np.roll(away, -1, axis=1) - np.roll(away, 1, axis=1)) / 2
    arc = away * turn
    area = np.sqrt(arc * arc * (along * along + down * down) + along * along * round_ * round_)
    kept = np.repeat(np.repeat(valid[t.here], PARTS, axis=0), PARTS, axis=1)
    frame = t.cylinder(atlas.body)
    angle = columns * turn
    out = np.cos(angle)[:, None] * frame.side + np.sin(angle)[:, None] * frame.across
    tangent = np.cos(angle)[:, None] * frame.across - np.sin(angle)[:, None] * frame.side
    normals = out[None] - (down / along)[..., None] * frame.axis
    normals = normals - (round_ / np.maximum(arc, 1e-6))[..., None] * tangent[None]
    normals = normals / np.sqrt((normals**2).sum(axis=2, keepdims=True))
    return np.floor(np.minimum(area, 1.0) / UNIT).astype(np.int64) * kept, normals


def _strips(area: NDArray[np.int64], tile: Any, spacing: float) -> NDArray[np.int64]:
    """(strips, columns, rows of a strip), the last filled up with nothing."""
    along = (tile.high - tile.low) / (1000 * len(area))
    rows = int(np.clip(np.round(STRIP * spacing / along), 1, len(area)))
    strips = -(-len(area) // rows)
    padded = np.zeros((strips * rows, area.shape[1]), np.int64)
    padded[: len(area)] = area
    return padded.reshape(strips, rows, -1).transpose(0, 2, 1)


def _pick(
    atlas: Atlas, number: int, part: _Part, target: NDArray[np.int64], golden: NDArray[np.int64]
) -> tuple[Any, ...]:
    """The points of a tile at which its area, summed along strips, passes the targets."""
    t = atlas.tiles[number]
    _, columns, rows = part.area.shape
    sums = part.area.sum(axis=2).reshape(-1)
    before = np.cumsum(sums) - sums
    column = np.searchsorted(before + sums, target, side="right")
    across = (target - before[column]) / sums[column]
    each = np.cumsum(part.area.reshape(-1))
    wanted = before[column] + (golden * (sums[column] >> 16) + (golden * (sums[column] & 0xFFFF) >> 16))
    cell = np.searchsorted(each, wanted, side="right")
    size = part.area.reshape(-1)[cell]
    inside = (wanted - (each[cell] - size)) / size
    strip, place = np.divmod(column, columns)
    row = strip * rows + cell % rows
    at_row, at_column = (row + inside) / PARTS, (place + across) / PARTS
    cells, weights = _taps(t.height, t.width, at_row, at_column)
    inner_row, inner_column = np.divmod(cells, t.width)
    frame = t.cylinder(atlas.body)
    along = frame.low + at_row / t.height * (frame.high - frame.low)
    angle = at_column / t.width * 2 * np.pi
    return (
        (t.top + inner_row) * atlas.width + t.left + inner_column, weights,
        frame.origin + along[:, None] * frame.axis,
        np.cos(angle)[:, None] * frame.side + np.sin(angle)[:, None] * frame.across,
        np.full(len(row), t.reach / 1000), np.full(len(row), t.link), part.normals[row, place],
    )  # fmt: skip


def _taps(height: int, width: int, row: Floats, column: Floats) -> tuple[Labels, Floats]:
    """(4, n): the flat cells whose centres lie around places given in cells, and their bilinear weights."""
    row = np.clip(row - 0.5, 0, height - 1)
    column = column - 0.5 + width
    top, left = np.floor(row).astype(np.int64), np.floor(column).astype(np.int64)
    down, right = row - top, column - left
    bottom = np.minimum(top + 1, height - 1)
    cells = [r * width + c % width for r in (top, bottom) for c in (left, left + 1)]
    weights = [v * h for v in (1 - down, down) for h in (1 - right, right)]
    return np.stack(cells), np.stack(weights)
