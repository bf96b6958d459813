"""All points of a frame, exactly, in the octree of lattice points: predicted from the bodies and earlier frames.

    coordinates ─► cells, as in `exact_points` ─► distinct ones ─point_layer─► bytes
                       └─► points of each cell, the bits of floats within them
    colours ─colour_lifting, steps of 1─► bytes

A cell is a lattice point with even coordinates (steps of a grid), or odd ones (the middle of a cell of floats).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ...entropy import varint
from ...entropy.bit_arrays import BitCoder, BitDecoder, BitEncoder
from ...errors import Corrupt
from ...typing import AnyInteger, Bytes, Integers
from ..clouds.raw_frames import Cloud, no_points
from . import exact_points, octree, point_colours, point_layer
from .colour_lifting import ColourSteps
from .exact_points import CELL_EXPONENT, FLOATS, MAX_CELL, MAX_SPACING, Grid
from .lattice_frames import MAX_CORNER, MAX_STEP_M, MIN_STEP_M, LatticeFrame, LatticeGrid
from .point_layer import ColoursOfChunk, LocatedPoints
from .point_scene import ChunkBodies

KIND = 7  # of the part that holds all points
MAX_REPEATS = 2000  # points of a cell besides the first
LOSSLESS = ColourSteps(1, 1)


class ExactHeader(NamedTuple):
    """What stands before the streams. grid, spacing, corner (3,): as in `exact_points`. sizes: bytes of the places, the
    repeats and the bits of floats.
    """

    grid: Grid
    spacing: int
    corner: Integers
    sizes: tuple[int, int, int]

    def pack(self) -> bytes:
        """The inverse of `read`."""
        grid = self.grid
        head = varint.write([KIND, grid.kind, grid.nanometres, varint.signed(grid.exponent), self.spacing])
        return head + varint.write([*(varint.signed(v) for v in self.corner.tolist()), *self.sizes])

    @staticmethod
    def read(data: bytes) -> tuple[ExactHeader, int]:
        """The header and the position after it. Raises Corrupt."""
        (_, kind, nanometres, exponent, spacing, *corner), at = varint.read(data, 8)
        sizes, at = varint.read(data, 3, at)
        grid = Grid(kind, varint.unsigned(exponent), nanometres)
        exact_points.require_grid(grid)
        cells = np.array([varint.unsigned(v) for v in corner])
        if not 0 < spacing < MAX_SPACING or np.abs(cells).max() > MAX_CELL or at + sum(sizes) > len(data):
            raise Corrupt("bodycast: the cells of exact points are out of range, or cut off")
        if kind != FLOATS and sizes[2]:
            raise Corrupt("bodycast: exact points on a grid have bits of floats")
        return ExactHeader(grid, spacing, cells, (sizes[0], sizes[1], sizes[2])), at


class _FrameCells(NamedTuple):
    """A frame in the order of its cells. order (n,): rows of the frame. codes (m,): of the distinct cells, as lattice
    points. repeats (m,): points of each besides the first. magnitudes (n, 3): bits of floats.
    """

    order: Integers
    codes: Integers
    repeats: Integers
    cells: Integers
    magnitudes: Integers


def pack_smallest(
    frames: Sequence[Cloud],
    precision_m: float,
    coloured: bool,
    bodies: ChunkBodies,
) -> bytes:
    """The smaller of this form, if it can hold the points, and that of `exact_points`. Raises CannotEncode."""
    plain = exact_points.pack_exact(frames, precision_m, coloured)
    packed = _pack(frames, precision_m, coloured, bodies)
    return plain if packed is None or len(packed) >= len(plain) else packed


def _pack(
    frames: Sequence[Cloud],
    precision_m: float,
    coloured: bool,
    bodies: ChunkBodies,
) -> bytes | None:
    """None for points that this form cannot hold, or that do not come back from it."""
    step = precision_m or exact_points.common_grid_step(frames)
    grid = exact_points.grid_of_step(step, searched=not precision_m)
    places = [exact_points.cells_and_bits(p, step, grid.exponent) if len(p) else None for p, _ in frames]
    spacing, depth, corner = exact_points.extent([found[0] for found in places if found is not None], step)
    lattice = _lattice_of(grid, spacing, corner, depth + 1)
    if lattice is None:
        return None
    cells = [None if found is None else _frame_cells(*found, corner, spacing, not step) for found in places]
    if max((int(own.repeats.max()) for own in cells if own is not None), default=0) > MAX_REPEATS:
        return None
    distinct = [_lattice_frame(own) for own in cells]
    coded = point_layer.pack_places(lattice, distinct, bodies, bound_m=None)
    filled = [own for own in cells if own is not None]
    encoder = BitEncoder()
    for own in filled:
        _code_repeats(encoder, own.repeats, len(own.repeats))
    streams = (
        point_layer.join(coded.part, None, b""),
        encoder.finish(),
        b"" if step else exact_points.float_bits([(own.cells, own.magnitudes) for own in filled]),
    )
    packed = ExactHeader(grid, spacing, corner, (len(streams[0]), len(streams[1]), len(streams[2]))).pack()
    packed += b"".join(streams)
    if coloured:
        memory, colour_coder = ColoursOfChunk(coded.table, LOSSLESS), BitEncoder()
        colours = [own for points, own in frames if len(points) and own is not None]
        for own, (_, located), colour in zip(filled, coded.filled(), colours, strict=True):
            wanted = point_colours.ycocg_from_rgb(colour[own.order])
            memory.code_repeated(colour_coder, wanted, located, own.repeats)
        packed += colour_coder.finish()
    back = unpack(packed, len(frames), bodies, coloured)
    expected = [_in_order(frame, own, grid) for frame, own in zip(frames, cells, strict=True)]
    same = all(_is_same(a, b) for a, b in zip(back, expected, strict=True))
    return packed if same else None


def _frame_cells(
    cells: Integers, magnitudes: AnyInteger, corner: Integers, spacing: int, is_float: bool
) -> _FrameCells:
    code = octree.morton_codes(2 * ((cells - corner) // spacing) + is_float)
    order = np.argsort(code, kind="stable")
    codes, count = np.unique(code, return_counts=True)
    bits = magnitudes[order] if is_float else magnitudes
    return _FrameCells(order, codes, count - 1, cells[order], bits.astype(np.int64))


def _lattice_frame(own: _FrameCells | None) -> LatticeFrame:
    none = np.zeros(0, np.int64)
    return LatticeFrame(none if own is None else own.codes, None, np.zeros((0, 3)), none)


def _lattice_of(grid: Grid, spacing: int, corner: Integers, depth: int) -> LatticeGrid | None:
    """The lattice on which the cells lie; None if it is out of range. Its corner is rounded: it only serves to find the
    surface near a cell.
    """
    step = (grid.step_m or 2.0**CELL_EXPONENT) * spacing / 2
    lattice = LatticeGrid(step, corner // spacing * 2, depth)
    fits = MIN_STEP_M <= step <= MAX_STEP_M and depth <= octree.MAX_DEPTH
    return lattice if fits and np.abs(lattice.corner).max() < MAX_CORNER else None


def _code_repeats(coder: BitCoder, wanted: Integers | None, count: int) -> Integers:
    """Code how many more points each of the cells (count,) holds; wanted: None in the decoder. Raises Corrupt."""

    def contexts(kind: int, rows: Integers) -> tuple[Integers, Integers]:
        return np.full((len(rows), 5), kind), np.full(len(rows), kind)

    found = point_colours.code_integers(coder, wanted, count, contexts)
    if (found < 0).any():
        raise Corrupt("bodycast: a cell of exact points holds less than one point")
    return found


def _in_order(frame: Cloud, own: _FrameCells | None, grid: Grid) -> Cloud:
    """The frame as it is decoded, −0 as 0."""
    if own is None:
        return frame
    points, colours = frame
    is_float = grid.kind == FLOATS
    decoded = (
        points[own.order].astype(np.float32).astype(np.float64)
        if is_float
        else np.asarray(own.cells * grid.step_m, np.float64)
    )
    return decoded, None if colours is None else colours[own.order]


def _is_same(a: Cloud, b: Cloud) -> bool:
    if not np.array_equal(a[0], b[0]):
        return False
    return a[1] is None or b[1] is None or np.array_equal(a[1], b[1])


def unpack(data: bytes, frames: int, bodies: ChunkBodies, coloured: bool) -> Iterator[Cloud]:
    """The inverse of `pack_smallest` for a part of this kind, frame by frame, in the order of the octree. Raises
    Corrupt.
    """
    header, at = ExactHeader.read(data)
    parts = list[bytes]()
    for size in header.sizes:
        parts.append(data[at : at + size])
        at += size
    places = point_layer.PlacesDecoder(parts[0], frames, bodies, coloured=False)
    found, total = list[tuple[LocatedPoints, Integers] | None](), 0
    repeats = BitDecoder(parts[1])
    for located in places.frames():
        own = None if located is None else _code_repeats(repeats, None, len(located.cells))
        total += 0 if own is None else len(own) + int(own.sum())
        if total > min(octree.MAX_POINTS, point_layer.POINTS_PER_BYTE * (len(data) + 1)):
            raise Corrupt(f"bodycast: more than {total} exact points in {len(data)} bytes")
        found.append(None if located is None or own is None else (located, own))
    repeats.finish()
    BitDecoder(places.rest).finish()  # colours of the places: none
    cells = [_cells_of(header, *own) for own in found if own is not None]
    points = iter(exact_points.coordinates(header.grid, cells, parts[2]))
    memory, colour_bits = ColoursOfChunk(places.table, LOSSLESS), BitDecoder(data[at:])
    for k, own in enumerate(found):
        cloud = no_points(coloured)
        if own is not None:
            colours: Bytes | None = memory.code_repeated(colour_bits, None, *own) if coloured else None
            cloud = next(points), colours
        if k == frames - 1:  # before it is handed out: a caller may take no more than the frames there are
            colour_bits.finish()
        yield cloud


def _cells_of(header: ExactHeader, located: LocatedPoints, repeats: Integers) -> Integers:
    """(n, 3): the cell of each point."""
    return np.repeat((located.cells >> 1) * header.spacing + header.corner, repeats + 1, axis=0)
