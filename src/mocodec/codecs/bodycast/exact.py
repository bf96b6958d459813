"""Points exactly as they are, as 32-bit floats or to a stated precision: in order of an octree, colours beside them.

coordinates ─► whole steps of a grid, or cells and the bits within them ─► octree ─► adaptive bits
colours ─► against the point before, brightness and two differences ─► entropy coder
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import CannotEncode, Corrupt
from ...geometry.articulation import Floats
from . import bits, octree

Integers = NDArray[np.int64]
Cloud = tuple[Floats, NDArray[np.uint8] | None]
FLOATS = 0  # instead of a step: every bit of a 32-bit float
FINEST = 1e-9  # metres, of steps as they are stored
GRIDS = (*(2.0**-k for k in range(4, 17)), *(m * 10.0**-k for k in (2, 3, 4) for m in (1.0, 2.0, 2.5, 5.0)))
CELL = -10  # exponent of the smallest cell that floats are sorted into, about a millimetre
SMALLEST = 31  # bits of a float below one cell


def grid_of(frames: Sequence[Cloud]) -> float:
    """The coarsest of usual steps on which all points lie, metres; 0 where there is none."""
    points = [p for p, _ in frames if len(p)]
    for step in sorted(GRIDS, reverse=True):
        if all(np.array_equal((np.round(p / step) * step).astype(np.float32), p.astype(np.float32)) for p in points):
            return step
    return 0.0


def pack(frames: Sequence[Cloud], precision: float, coloured: bool) -> bytes:
    """Frames of points; precision in metres, 0 for every bit of float32. Raises CannotEncode beyond a kilometre."""
    step = precision or grid_of(frames)
    nanometres = step / FINEST
    exponent = CELL
    if not precision and step:  # stored as a power of two, or in nanometres
        power = float(np.log2(step))
        nanometres = round(nanometres) if power != round(power) else 0
        exponent = round(power) if not nanometres else CELL
    filled = [(p, c) for p, c in frames if len(p)]
    places = [_cells(p, step, exponent) for p, _ in filled]
    low = np.min([cells.min(axis=0) for cells, _ in places], axis=0) if places else np.zeros(3, np.int64)
    coarser = (
        int(np.gcd.reduce([np.gcd.reduce((cells - low).reshape(-1)) for cells, _ in places])) if step and places else 1
    )
    coarser = max(coarser, 1)  # all coordinates are so many steps apart
    high = max((int((cells.max(axis=0) - low).max()) for cells, _ in places), default=0) // coarser
    depth = high.bit_length()
    if depth > octree.DEEPEST:
        raise CannotEncode(f"exact points that lie more than {2**octree.DEEPEST * (step or 2.0**CELL):,.0f} m apart")
    writer, state = bits.Writer(), octree.State.new()
    left, widths, rests, rest_widths = list[Integers](), list[Integers](), list[Integers](), list[Integers]()
    stops, colours = list[int](), list[Integers]()
    for (points, shades), (cells, magnitudes) in zip(filled, places, strict=True):
        code = octree.codes((cells - low) // coarser)
        order = np.argsort(code, kind="stable")
        stops.append(octree.stop_level(code[order], depth))
        left.append(octree.write(writer, state, code[order], depth, stops[-1]))
        widths.append(np.full(len(points), 3 * (depth - stops[-1])))
        if not step:
            rest, width = _rest(magnitudes[order], cells[order])
            rests.append(rest.reshape(-1))
            rest_widths.append(width.reshape(-1))
        if coloured and shades is not None:
            colours.append(np.diff(_bright(shades[order].astype(np.int64)), axis=0, prepend=0))
    octrees = writer.finish(*(np.concatenate(v) for v in (left, widths))) if filled else b""
    bare = bits.Writer().finish(*(np.concatenate(v) for v in (rests, rest_widths))) if rests else b""
    shade = coder.pack(np.concatenate(colours)) if colours else b""
    counts = [len(p) for p, _ in frames]
    head = varint.write([0 if not step else 1 if not nanometres else 2, round(nanometres), varint.signed(exponent)])
    head += varint.write(
        [coarser, depth, *(varint.signed(v) for v in low.tolist()), *counts, *stops, len(octrees), len(bare)]
    )
    return head + octrees + bare + shade


def unpack(data: bytes, frames: int, coloured: bool) -> list[Cloud]:
    """The inverse of `pack`; the points of a frame in the order of the octree. Raises Corrupt."""
    (kind, nanometres, exponent, coarser, depth, *low), at = varint.read(data, 8)
    counts, at = varint.read(data, frames, at)
    filled = [n for n in counts if n]
    stops, at = varint.read(data, len(filled), at)
    (octrees, bare), at = varint.read(data, 2, at)
    exponent = varint.unsigned(exponent)
    corner = np.array([varint.unsigned(v) for v in low])
    if (
        kind > 2
        or not 0 < coarser < 1 << 40
        or depth > octree.DEEPEST
        or sum(counts) > octree.MOST
        or any(s > depth for s in stops)
    ):
        raise Corrupt("bodycast: exact points are damaged")
    if abs(exponent) > 40 or np.abs(corner).max() > 1 << 40 or at + octrees + bare > len(data):
        raise Corrupt("bodycast: exact points are damaged")
    if sum(counts) > 8 * 16384 * (len(data) + 1):
        raise Corrupt("bodycast: more exact points than can be")
    nodes = _nodes(data[at : at + octrees], filled, stops, depth)
    at += octrees
    cells = [octree.cells_of(code) * coarser + corner for code in nodes]
    if kind == 0:
        points = _floats(data[at : at + bare], cells, exponent)
    else:
        step = 2.0**exponent if kind == 1 else nanometres * FINEST
        points = [_round_step(c, step) for c in cells]
    shades: list[NDArray[np.uint8] | None] = [None] * len(filled)
    if coloured:
        values = coder.unpack(data[at + bare :], (sum(filled), 3))
        ends = np.cumsum([0, *filled])
        shades = [_shaded(np.cumsum(values[i:j], axis=0)) for i, j in pairwise(ends)]
    result, found = list[Cloud](), iter(zip(points, shades, strict=True))
    for count in counts:
        result.append(next(found) if count else (np.zeros((0, 3)), np.zeros((0, 3), np.uint8) if coloured else None))
    return result


def _nodes(data: bytes, filled: Sequence[int], stops: Sequence[int], depth: int) -> list[Integers]:
    """Morton codes of every frame's points."""
    if not filled:
        return []
    reader, state = bits.Reader(data), octree.State.new()
    nodes = [octree.read(reader, state, n, stop) for n, stop in zip(filled, stops, strict=True)]
    widths = np.repeat([3 * (depth - stop) for stop in stops], filled)
    left = reader.finish(widths).astype(np.int64)
    ends = np.cumsum([0, *filled])
    spans = zip(nodes, stops, ends[:-1], ends[1:], strict=True)
    return [node << 3 * (depth - stop) | left[i:j] for node, stop, i, j in spans]


def _round_step(cells: Integers, step: float) -> Floats:
    return np.asarray(cells * step, np.float64)


def _cells(points: Floats, step: float, exponent: int) -> tuple[Integers, NDArray[np.uint32]]:
    """Cells (n, 3) on the grid; of floats, the cells that they fall into and the bits of their magnitudes."""
    if step:
        if np.abs(points).max() / step >= 1 << 40:
            raise CannotEncode("exact points that lie too far from the origin for their precision")
        return np.round(points / step).astype(np.int64), np.zeros((0, 3), np.uint32)
    single = points.astype(np.float32)
    magnitude = np.abs(single).astype(np.float64)
    if not (magnitude < 1 << 30).all():
        raise CannotEncode("exact points that lie beyond 32-bit floats of any scene")
    cell = np.floor(magnitude * 2.0**-exponent).astype(np.int64)
    return np.where(single < 0, -cell - 1, cell), np.abs(single).view(np.uint32)


def _widths(cells: Integers, exponent: int) -> tuple[Integers, Integers]:
    """How many bits of each float are not said by its cell, and the bits of the cell's beginning."""
    size = np.where(cells < 0, -cells - 1, cells)
    start = (size * 2.0**exponent).astype(np.float32).view(np.uint32).astype(np.int64)
    beyond = ((size + 1) * 2.0**exponent).astype(np.float32).view(np.uint32).astype(np.int64)
    width = np.ceil(np.log2(np.maximum(beyond - start, 1))).astype(np.int64)
    return np.where(size == 0, SMALLEST, width), start


def _rest(magnitudes: NDArray[np.uint32], cells: Integers) -> tuple[Integers, Integers]:
    width, start = _widths(cells, CELL)
    return magnitudes.astype(np.int64) - start, width


def _floats(data: bytes, cells: Sequence[Integers], exponent: int) -> list[Floats]:
    """Coordinates of cells and the bits within them."""
    if not cells:
        return []
    every = np.concatenate(cells)
    if exponent != CELL or np.abs(every).max() > 1 << 40:
        raise Corrupt("bodycast: exact points are damaged")
    width, start = _widths(every, exponent)
    rest = bits.Reader(data).finish(width.reshape(-1)).astype(np.int64).reshape(every.shape)
    values = (start + rest).clip(0, 0x7F7FFFFF).astype(np.uint32).view(np.float32).astype(np.float64)
    values = np.where(every < 0, -values, values)
    return np.split(values, np.cumsum([len(c) for c in cells])[:-1])


def _bright(colours: Integers) -> Integers:
    """Brightness and two differences, in whole numbers that turn back (YCoCg-R)."""
    red, green, blue = colours.T
    orange = red - blue
    half = blue + (orange >> 1)
    greenish = green - half
    return np.stack([half + (greenish >> 1), orange, greenish], axis=1)


def _shaded(values: Integers) -> NDArray[np.uint8]:
    bright, orange, greenish = values.T
    half = bright - (greenish >> 1)
    blue = half - (orange >> 1)
    return np.clip(np.stack([blue + orange, greenish + half, blue], axis=1), 0, 255).astype(np.uint8)
