"""All points of a chunk's frames within a bound: on a lattice, coded from the bodies' surface.

points ─lattice_frames─► distinct Morton codes ─point_octree─► bytes      colours ─colour_lifting─► bytes
bodies, poses ─point_scene─► where the surface lies ─┘ │                     │
                                      ├─ point_smoothing: lattice points ─► decoded points
                                      └─ what earlier frames showed there ───┘
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ...entropy import varint
from ...entropy.bit_arrays import BitDecoder, BitEncoder
from ...errors import Corrupt
from ...typing import Booleans, Bytes, Floats, Integers
from ..clouds.raw_frames import Cloud, no_points
from . import integer_surface, lattice, octree, point_colours, point_octree, point_smoothing
from .colour_lifting import ColourLifting, ColourSteps
from .integer_surface import rounding_shift
from .lattice_frames import MAX_CORNER, MAX_STEP_M, MIN_STEP_M, LatticeFrame, LatticeGrid
from .point_scene import Scene, SurfaceTexture
from .pose_stream import PoseSequence
from .surface_memory import ColourMemory, SampleTable

UNLEARNED, LEARNED, SMOOTHED = 3, 4, 5  # kinds of the part that holds all points; 0 to 2 are those of `exact_points`
KINDS = (UNLEARNED, LEARNED, SMOOTHED)
"""UNLEARNED and LEARNED are decoded only: their points are those of the lattice. The surface and colours of UNLEARNED
do not depend on earlier frames.
"""
POINTS_PER_BYTE = 8 * 16384  # most points that a byte of coded data can stand for


class LocatedPoints(NamedTuple):
    """The points of a frame beside the surface.

    cells (n, 3): lattice coordinates. samples (n,): the sample near each among all bodies', −1 without one. places
    (n, 3): in the canonical pose, 2^-16 m; 0 without a sample. positions (n, 3): as decoded, metres.
    """

    cells: Integers
    samples: Integers
    places: Integers
    positions: Floats


class CodedPlaces(NamedTuple):
    """The places of a chunk's points as bytes, and what their colours are coded from. head: what follows the steps of
    colours.
    """

    depth: int
    head: bytes
    octrees: bytes
    frames: list[LocatedPoints]
    table: SampleTable


class PointsHeader(NamedTuple):
    """What stands before the octrees of a chunk's points. steps: of colours. counts: points of each frame. shifts: of
    each body; pose_shifts: of each body in each frame that it is in. octrees: their bytes; the rest is colours.
    """

    kind: int
    grid: LatticeGrid
    steps: list[int]
    counts: list[int]
    shifts: list[int]
    pose_shifts: list[int]
    octrees: slice

    @staticmethod
    def read(data: bytes, frames: int, bodies: int, poses: int, coloured: bool) -> PointsHeader:
        """poses: of all bodies in all frames. Raises Corrupt for what `join` never writes."""
        (kind, depth, *steps), at = varint.read(data, 3 if data[:1] == bytes([UNLEARNED]) else 4)
        corner, at = varint.read(data, 3, at)
        if at + 8 > len(data):
            raise Corrupt("bodycast: the points of a chunk are cut off")
        step = struct.unpack_from("<d", data, at)[0]
        grid = LatticeGrid(step, np.array([varint.unsigned(v) for v in corner]), depth)
        counts, at = varint.read(data, frames, at + 8)
        shifts, at = varint.read(data, bodies, at)
        pose_shifts, at = varint.read(data, poses if bodies else 0, at)
        (size,), at = varint.read(data, 1, at)
        header = PointsHeader(kind, grid, steps, counts, shifts, pose_shifts, slice(at, at + size))
        header._require_plausible(len(data), coloured)
        return header

    def _require_plausible(self, size: int, coloured: bool) -> None:
        grid, shifts = self.grid, [*self.shifts, *self.pose_shifts]
        if not MIN_STEP_M <= grid.step_m <= MAX_STEP_M or np.abs(grid.corner).max() >= MAX_CORNER:
            raise Corrupt("bodycast: the lattice of a chunk's points is out of range")
        if grid.depth > point_octree.MAX_DEPTH or max(shifts, default=0) >= integer_surface.SHIFTS:
            raise Corrupt("bodycast: the octree of a chunk's points is damaged")
        are_wrong = any(bool(step) != coloured or step > 2 * point_colours.MAX_STEP for step in self.steps)
        if are_wrong or self.octrees.stop > size:
            raise Corrupt("bodycast: the points of a chunk are cut off, or their colours are damaged")
        if sum(self.counts) > min(octree.MAX_POINTS, POINTS_PER_BYTE * (size + 1)):
            raise Corrupt(f"bodycast: {sum(self.counts)} points in {size} bytes")


def pack_places(
    grid: LatticeGrid,
    frames: Sequence[LatticeFrame],
    textures: Sequence[SurfaceTexture],
    poses: Sequence[PoseSequence],
    is_absent: Booleans,
) -> CodedPlaces:
    """poses: of each body, as they are decoded. is_absent (frames, bodies)."""
    shifts = [texture.shift for texture in textures]
    values = [
        [integer_surface.pose_values(t.body, poses[b][k]) for b, t in enumerate(textures) if not is_absent[k, b]]
        for k in range(len(frames))
    ]
    pose_shifts = [[rounding_shift(v) for v in of_frame] for of_frame in values]
    head = varint.write([varint.signed(v) for v in grid.corner.tolist()]) + struct.pack("<d", grid.step_m)
    head += varint.write([*(len(f.codes) for f in frames), *shifts, *(s for row in pose_shifts for s in row)])
    coder, scene = BitEncoder(), Scene(textures, shifts, is_absent, learns=True, smooths=True)
    located = [
        _OctreeOfFrame(scene, grid, k, values[k], pose_shifts[k]).code(coder, frame, len(frame.codes))
        for k, frame in enumerate(frames)
        if len(frame.codes)
    ]
    return CodedPlaces(grid.depth, head, coder.finish(), located, scene.table)


def pack_colours(coded: CodedPlaces, colours: Sequence[Bytes], steps: ColourSteps) -> tuple[bytes, list[Bytes]]:
    """The bytes of the colours (n, 3) of each frame with points, and the decoded colours."""
    coder, memory = BitEncoder(), _ColoursOfChunk(coded.table, steps)
    decoded = [
        memory.code(coder, point_colours.ycocg_from_rgb(own.astype(np.int64)), located)
        for own, located in zip(colours, coded.frames, strict=True)
    ]
    return coder.finish(), decoded


def join(coded: CodedPlaces, steps: ColourSteps | None, colours: bytes) -> bytes:
    """The part of a chunk. steps: None without colours."""
    kind = varint.write([SMOOTHED, coded.depth, *((0, 0) if steps is None else steps)])
    return kind + coded.head + varint.write([len(coded.octrees)]) + coded.octrees + colours


def unpack_points(
    data: bytes,
    frames: int,
    textures: Sequence[SurfaceTexture],
    poses: Sequence[PoseSequence],
    is_absent: Booleans,
    coloured: bool,
) -> Iterator[Cloud]:
    """The inverse of `join`, frame by frame, in the order of the octree. Raises Corrupt."""
    head = PointsHeader.read(data, frames, len(textures), int((~is_absent).sum()), coloured)
    grid, kind, steps, shifts = head.grid, head.kind, head.steps, head.shifts
    places, colours = BitDecoder(data[head.octrees]), BitDecoder(data[head.octrees.stop :])
    scene = Scene(textures, shifts, is_absent, learns=kind != UNLEARNED, smooths=kind == SMOOTHED)
    waiting = iter(head.pose_shifts)
    memory = _ColoursOfChunk(scene.table, ColourSteps(*steps)) if kind != UNLEARNED and coloured else None
    for k, count in enumerate(head.counts):
        present = [b for b in range(len(textures)) if not is_absent[k, b]]
        own = [next(waiting) for _ in present]
        if not count:
            yield no_points(coloured)
            continue
        values = [integer_surface.pose_values(textures[b].body, poses[b][k]) for b in present]
        located = _OctreeOfFrame(scene, grid, k, values, own).code(places, None, count)
        colour = None
        if memory is not None:
            colour = memory.code(colours, None, located)
        elif coloured:
            colour = _unlearned_colours(colours, scene.table.colours, located.samples, steps[0])
        yield located.positions, colour
    places.finish()


class _OctreeOfFrame:
    """The octree of frame k. values, shifts: as in `Scene.posed`."""

    def __init__(
        self, scene: Scene, grid: LatticeGrid, k: int, values: Sequence[Floats], shifts: Sequence[int]
    ) -> None:
        self.scene, self.grid = scene, grid
        self.surface = scene.posed(k, values, shifts)
        self.hints = scene.hints(k, self.surface, grid.step_m, grid.corner, grid.depth)

    def code(self, coder: BitEncoder | BitDecoder, frame: LatticeFrame | None, count: int) -> LocatedPoints:
        """Code the points (count,), None in the decoder; the next frames learn from them. Raises Corrupt."""
        codes = None if frame is None else frame.codes
        codes, nearest = point_octree.code_octree(coder, codes, self.grid.depth, count, self.hints)
        cells = octree.cells_of_codes(codes)
        points, table = self.grid.places(cells), self.scene.table
        samples, places = np.full(count, -1), np.zeros((count, 3), np.int64)
        known = np.flatnonzero(nearest >= 0)
        samples[known] = self.surface.rows[nearest[known]]
        places[known] = table.canonical(self.surface, points[known], nearest[known])
        self.scene.learn(self.surface, points, nearest)
        positions = self._positions(coder, frame, cells, nearest) if self.scene.smooths else self.grid.positions(cells)
        return LocatedPoints(cells, samples, places, positions)

    def _positions(
        self, coder: BitEncoder | BitDecoder, frame: LatticeFrame | None, cells: Integers, nearest: Integers
    ) -> Floats:
        """The decoded points (n, 3), metres: those of the lattice, moved to the surface where that keeps the bound."""
        smoothed, stays = point_smoothing.smooth(cells, nearest, self.hints), None
        if frame is not None:
            moved = self.grid.shifted_positions(cells, smoothed.shifts, point_smoothing.FINE_BITS)
            away = np.linalg.norm(frame.originals - moved[frame.rows], axis=1)
            stays = np.zeros(len(cells), bool)
            stays[frame.rows[away > lattice.bound_of_step(self.grid.step_m) * (1 - lattice.ROUNDING)]] = True
        stays = point_smoothing.code_stays(coder, smoothed, stays)
        shifts = np.where(stays[:, None], 0, smoothed.shifts)
        return self.grid.shifted_positions(cells, shifts, point_smoothing.FINE_BITS)


class _ColoursOfChunk:
    """Codes the colours of a chunk's frames, each from what those before it showed of the surface."""

    def __init__(self, table: SampleTable, steps: ColourSteps) -> None:
        self.memory, self.lifting = ColourMemory(table), ColourLifting(steps)

    def code(self, coder: BitEncoder | BitDecoder, wanted: Integers | None, points: LocatedPoints) -> Bytes:
        """The decoded colours (n, 3) of a frame; wanted: YCoCg (n, 3), None in the decoder. Raises Corrupt."""
        known = points.samples >= 0
        expected = np.zeros((len(known), 3), np.int64)
        expected[known] = self.memory.expected(points.samples[known], points.places[known])
        colours = self.lifting.code_frame(coder, wanted, points.cells, expected, known)
        self.memory.learn(points.samples[known], points.places[known], colours[known])
        return point_colours.rgb_from_ycocg(colours)


def _unlearned_colours(coder: BitDecoder, texture: Integers, samples: Integers, step: int) -> Bytes:
    """The colours (n, 3) of points relative to the texture (m, 3) at their samples (n,). Raises Corrupt."""
    values = point_colours.code_colours(coder, None, len(samples))
    predicted = np.tile(point_colours.GREY, (len(samples), 1))
    predicted[samples >= 0] = texture[samples[samples >= 0]]
    return point_colours.dequantise(values, predicted, step)
