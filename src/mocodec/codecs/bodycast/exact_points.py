"""All points of a frame, bit by bit as 32-bit floats or to a stated precision, in the order of an octree.

    coordinates ─► steps of a grid, or cells and the float's bits within its cell ─► octree ─► occupancy bits by context
    colours ─► YCoCg-R ─► relative to the point before ─► entropy coder

Three kinds of coordinates: all bits of 32-bit floats; steps of a power of two; steps of whole nanometres.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import CannotEncode, Corrupt
from ...typing import Bytes, Floats, Integers
from ..clouds.raw_frames import Cloud, no_points
from . import octree
from .binary_coder import BinaryDecoder, BinaryEncoder
from .point_colours import rgb_from_ycocg, ycocg_from_rgb

FLOATS, BINARY_STEP, DECIMAL_STEP = range(3)  # kinds
NANOMETRE = 1e-9
GRID_STEPS_M = (*(2.0**-k for k in range(4, 17)), *(m * 10.0**-k for k in (2, 3, 4) for m in (1.0, 2.0, 2.5, 5.0)))
CELL_EXPONENT = -10  # floats are sorted into cells of 2^−10 m
LOWEST_CELL_BITS = 31  # bits of a float whose magnitude is below one cell
MAX_CELL, MAX_EXPONENT, MAX_SPACING = 1 << 40, 40, 1 << 40
MAX_FLOAT_M = 1 << 30
MAX_FLOAT_BITS = 0x7F7FFFFF  # of a finite float32's magnitude
POINTS_PER_BYTE = 8 * 16384  # most points that a byte of coded data can stand for


class Grid(NamedTuple):
    """How coordinates become cells. kind: FLOATS, BINARY_STEP or DECIMAL_STEP. exponent: of cells of 2^exponent metres,
    for the first two. nanometres: of a step, for the last.
    """

    kind: int
    exponent: int
    nanometres: int

    @property
    def step_m(self) -> float:
        """Metres between decoded coordinates, 0 for floats."""
        if self.kind == FLOATS:
            return 0.0
        return 2.0**self.exponent if self.kind == BINARY_STEP else self.nanometres * NANOMETRE


class GridCells(NamedTuple):
    """The cells of all frames. filled: points of each frame that has any. stops: octree level down to which the
    occupancy of each is coded. spacing: gcd of the differences of all coordinates. corner (3,): lowest coordinates.
    """

    filled: list[int]
    stops: list[int]
    spacing: int
    depth: int
    corner: Integers


def common_grid_step(frames: Sequence[Cloud]) -> float:
    """The largest of GRID_STEPS_M on which all points lie, metres; 0 if there is none."""
    points = [p for p, _ in frames if len(p)]
    for step in sorted(GRID_STEPS_M, reverse=True):
        if all(np.array_equal((np.round(p / step) * step).astype(np.float32), p.astype(np.float32)) for p in points):
            return step
    return 0.0


# --- frames ---------------------------------------------------------------------------------------------------------


def require_range(frames: Sequence[Cloud], precision_m: float) -> None:
    """Raises CannotEncode for a chunk that `pack_exact` cannot hold; takes little time for the points of a person."""
    filled = [(points, colours) for points, colours in frames if len(points)]
    far = max((float(np.abs(points).max()) for points, _ in filled), default=0.0)
    if 2 * far < 2**octree.MAX_DEPTH * (precision_m or min(GRID_STEPS_M)):
        return
    step = precision_m or common_grid_step(filled)
    grid = grid_of_step(step, searched=not precision_m)
    extent([cells_and_bits(points, step, grid.exponent)[0] for points, _ in filled], step)


def pack_exact(frames: Sequence[Cloud], precision_m: float, coloured: bool) -> bytes:
    """Frames of points. precision_m: step in metres; 0 keeps every bit of float32. Raises CannotEncode."""
    step = precision_m or common_grid_step(frames)
    grid = grid_of_step(step, searched=not precision_m)
    filled = [(points, colours) for points, colours in frames if len(points)]
    places = [cells_and_bits(points, step, grid.exponent) for points, _ in filled]
    spacing, depth, corner = extent([cells for cells, _ in places], step)
    encoder, contexts = BinaryEncoder(), octree.OctreeContexts.new()
    rests, rest_widths = list[Integers](), list[Integers]()
    within = list[tuple[Integers, Integers]]()
    stops, colour_differences = list[int](), list[Integers]()
    for (points, colours), (cells, magnitudes) in zip(filled, places, strict=True):
        code = octree.morton_codes((cells - corner) // spacing)
        order = np.argsort(code, kind="stable")
        stops.append(octree.last_coded_level(code[order], depth))
        rests.append(octree.encode_octree(encoder, contexts, code[order], depth, stops[-1]))
        rest_widths.append(np.full(len(points), 3 * (depth - stops[-1])))
        if not step:
            within.append((cells[order], magnitudes[order].astype(np.int64)))
        if coloured and colours is not None:
            ycocg = ycocg_from_rgb(colours[order])
            colour_differences.append(np.diff(ycocg.astype(np.int64), axis=0, prepend=0))
    octrees = encoder.finish(np.concatenate(rests), np.concatenate(rest_widths)) if filled else b""
    bits = float_bits(within)
    colour = coder.pack(np.concatenate(colour_differences)) if colour_differences else b""
    counts = [len(points) for points, _ in frames]
    head = varint.write([grid.kind, grid.nanometres, varint.signed(grid.exponent)])
    head += varint.write([spacing, depth, *(varint.signed(v) for v in corner.tolist()), *counts, *stops])
    return head + varint.write([len(octrees), len(bits)]) + octrees + bits + colour


def unpack_exact(data: bytes, frames: int, coloured: bool) -> list[Cloud]:
    """The inverse of `pack_exact`; the points of a frame in the order of the octree. Raises Corrupt."""
    grid, layout, counts, at = _read_header(data, frames)
    (octree_bytes, float_bytes), at = varint.read(data, 2, at)
    _require_plausible(grid, layout, len(data))
    if at + octree_bytes + float_bytes > len(data):
        raise Corrupt("bodycast: exact points are cut off")
    codes = _decode_codes(data[at : at + octree_bytes], layout)
    at += octree_bytes
    cells = [octree.cells_of_codes(code) * layout.spacing + layout.corner for code in codes]
    points = coordinates(grid, cells, data[at : at + float_bytes])
    colours: list[Bytes | None] = [None] * len(cells)
    if coloured:
        differences = coder.unpack(data[at + float_bytes :], (sum(counts), 3))
        ends = np.cumsum([0, *layout.filled])
        colours = [rgb_from_ycocg(np.cumsum(differences[i:j], axis=0)) for i, j in pairwise(ends)]
    filled = iter(zip(points, colours, strict=True))
    return [next(filled) if count else no_points(coloured) for count in counts]


def _read_header(data: bytes, frames: int) -> tuple[Grid, GridCells, list[int], int]:
    """The grid, the layout of its cells, the points of each frame, and the position after them. Raises Corrupt."""
    (kind, nanometres, exponent, spacing, depth, *corner), at = varint.read(data, 8)
    counts, at = varint.read(data, frames, at)
    filled = [n for n in counts if n]
    stops, at = varint.read(data, len(filled), at)
    grid = Grid(kind, varint.unsigned(exponent), nanometres)
    return grid, GridCells(filled, stops, spacing, depth, np.array([varint.unsigned(v) for v in corner])), counts, at


def _require_plausible(grid: Grid, layout: GridCells, size: int) -> None:
    """Raises Corrupt for a header that `pack_exact` never writes in `size` bytes."""
    require_grid(grid)
    if not 0 < layout.spacing < MAX_SPACING or np.abs(layout.corner).max() > MAX_CELL:
        raise Corrupt("bodycast: the cells of exact points are out of range")
    if layout.depth > octree.MAX_DEPTH or any(stop > layout.depth for stop in layout.stops):
        raise Corrupt("bodycast: the octrees of exact points are too deep")
    points = sum(layout.filled)
    if points > octree.MAX_POINTS or points > POINTS_PER_BYTE * (size + 1):
        raise Corrupt(f"bodycast: {points} exact points in {size} bytes")


def require_grid(grid: Grid) -> None:
    """Raises Corrupt for a grid that no encoder writes."""
    if grid.kind > DECIMAL_STEP or abs(grid.exponent) > MAX_EXPONENT:
        raise Corrupt("bodycast: exact points on an unknown grid")


def _decode_codes(data: bytes, layout: GridCells) -> list[Integers]:
    """Morton codes of the points of each frame that has any."""
    if not layout.filled:
        return []
    decoder, contexts = BinaryDecoder(data), octree.OctreeContexts.new()
    cubes = [
        octree.decode_octree(decoder, contexts, n, stop) for n, stop in zip(layout.filled, layout.stops, strict=True)
    ]
    shifts = [3 * (layout.depth - stop) for stop in layout.stops]
    rest = decoder.finish(np.repeat(shifts, layout.filled)).astype(np.int64)
    ends = np.cumsum([0, *layout.filled])
    spans = zip(cubes, shifts, ends[:-1], ends[1:], strict=True)
    return [cube << shift | rest[i:j] for cube, shift, i, j in spans]


# --- coordinates ----------------------------------------------------------------------------------------------------


def grid_of_step(step_m: float, searched: bool) -> Grid:
    """The grid as it is stored. searched: the step is one of GRID_STEPS_M, not the user's."""
    if not step_m:
        return Grid(FLOATS, CELL_EXPONENT, 0)
    power = float(np.log2(step_m))
    if searched and power == round(power):
        return Grid(BINARY_STEP, round(power), 0)
    return Grid(DECIMAL_STEP, CELL_EXPONENT, round(step_m / NANOMETRE))


def extent(cells: Sequence[Integers], step_m: float) -> tuple[int, int, Integers]:
    """spacing, depth and corner of `GridCells`. Raises CannotEncode for points too far apart."""
    if not cells:
        return 1, 0, np.zeros(3, np.int64)
    corner = np.min([c.min(axis=0) for c in cells], axis=0)
    spacing = 1
    if step_m:
        spacing = max(int(np.gcd.reduce([np.gcd.reduce((c - corner).reshape(-1)) for c in cells])), 1)
    depth = (max(int((c.max(axis=0) - corner).max()) for c in cells) // spacing).bit_length()
    if depth > octree.MAX_DEPTH:
        limit_m = 2**octree.MAX_DEPTH * (step_m or 2.0**CELL_EXPONENT)
        raise CannotEncode(f"exact points that lie more than {limit_m:,.0f} m apart")
    return spacing, depth, corner


def cells_and_bits(points: Floats, step_m: float, exponent: int) -> tuple[Integers, NDArray[np.uint32]]:
    """Cells (n, 3) of points on a grid; without a step, the cells of floats and the bits (n, 3) of their magnitudes.

    A negative float of cell magnitude c has cell −c − 1. Raises CannotEncode for coordinates that are too large.
    """
    if step_m:
        if np.abs(points).max() / step_m >= MAX_CELL:
            raise CannotEncode("exact points that lie too far from the origin for their precision")
        return np.round(points / step_m).astype(np.int64), np.zeros((0, 3), np.uint32)
    single = points.astype(np.float32)
    magnitude = np.abs(single).astype(np.float64)
    if not (magnitude < MAX_FLOAT_M).all():
        raise CannotEncode(f"exact points with coordinates of {MAX_FLOAT_M:,} m or more")
    cell = np.floor(magnitude * 2.0**-exponent).astype(np.int64)
    return np.where(single < 0, -cell - 1, cell), np.abs(single).view(np.uint32)


def _float_range(cells: Integers, exponent: int) -> tuple[Integers, Integers]:
    """(n, 3) each, for cells of floats: bits that select a float in its cell, and the pattern of the cell's lowest."""
    size = np.where(cells < 0, -cells - 1, cells)
    start = (size * 2.0**exponent).astype(np.float32).view(np.uint32).astype(np.int64)
    beyond = ((size + 1) * 2.0**exponent).astype(np.float32).view(np.uint32).astype(np.int64)
    width = np.ceil(np.log2(np.maximum(beyond - start, 1))).astype(np.int64)
    return np.where(size == 0, LOWEST_CELL_BITS, width), start


def float_bits(frames: Sequence[tuple[Integers, Integers]]) -> bytes:
    """The bits that select floats in their cells. frames: cells (n, 3), and the bits (n, 3) of the magnitudes."""
    if not frames:
        return b""
    ranges = [_float_range(cells, CELL_EXPONENT) for cells, _ in frames]
    bits = [(magnitudes - start).reshape(-1) for (_, magnitudes), (_, start) in zip(frames, ranges, strict=True)]
    return BinaryEncoder().finish(np.concatenate(bits), np.concatenate([width.reshape(-1) for width, _ in ranges]))


def coordinates(grid: Grid, cells: Sequence[Integers], bits: bytes) -> list[Floats]:
    """The points (n, 3) of cells (n, 3) on a grid. bits: of floats, as `float_bits` makes them. Raises Corrupt."""
    if grid.kind == FLOATS:
        return _floats(bits, cells, grid.exponent)
    return [np.asarray(own * grid.step_m, np.float64) for own in cells]


def _floats(data: bytes, cells: Sequence[Integers], exponent: int) -> list[Floats]:
    """Coordinates from cells and the bits within them. Raises Corrupt."""
    if not cells:
        return []
    every = np.concatenate(cells)
    if exponent != CELL_EXPONENT or np.abs(every).max() > MAX_CELL:
        raise Corrupt("bodycast: the cells of exact points are out of range")
    width, start = _float_range(every, exponent)
    within = BinaryDecoder(data).finish(width.reshape(-1)).astype(np.int64).reshape(every.shape)
    values = (start + within).clip(0, MAX_FLOAT_BITS).astype(np.uint32).view(np.float32).astype(np.float64)
    values = np.where(every < 0, -values, values)
    return np.split(values, np.cumsum([len(c) for c in cells])[:-1])
