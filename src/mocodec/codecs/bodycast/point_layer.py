"""All points of a chunk's frames within a bound: on a lattice, coded from the bodies' surface.

points ─lattice_frames─► distinct Morton codes ─point_octree─► bytes      colours ─colour_lifting─► bytes
bodies, poses ─point_scene─► where the surface lies ─┤                       │
points of earlier frames ─reference_points───────────┘ │                     │
                                      ├─ point_smoothing: lattice points ─► decoded points
                                      └─ what earlier frames showed there ───┘
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ... import parallel
from ...entropy import varint
from ...entropy.bit_arrays import BitCoder, BitDecoder, BitEncoder, CodedPart
from ...errors import Corrupt
from ...typing import Bytes, Floats, Integers, YCoCg
from ..clouds.raw_frames import Cloud, no_points
from . import (
    cube_octree,
    integer_surface,
    lattice,
    octree,
    point_choice,
    point_colours,
    point_octree,
    point_smoothing,
    reference_points,
)
from .colour_lifting import ColourLifting, ColourSteps
from .integer_surface import rounding_shift
from .lattice_frames import MAX_CORNER, MAX_STEP_M, MIN_STEP_M, LatticeFrame, LatticeGrid
from .point_scene import ChunkBodies, Scene
from .reference_choice import ReferenceChoice
from .reference_points import NO_REFERENCE, EarlierFrames, Reference, ReferencePoints
from .surface_hints import SurfaceHints
from .surface_memory import ColourMemory, SampleTable

UNLEARNED, LEARNED, SMOOTHED, REFERRED, CUBED = 3, 4, 5, 6, 8
KINDS = (UNLEARNED, LEARNED, SMOOTHED, REFERRED, CUBED)
"""Kinds of the part that holds all points; 0 to 2 are those of `exact_points`.

UNLEARNED  decoded only: its surface and colours do not depend on earlier frames
LEARNED    the decoded points are those of the lattice
SMOOTHED   the points of the lattice are smoothed
CUBED      as SMOOTHED, with the octrees of `cube_octree`
REFERRED   stands before a part of kind LEARNED, SMOOTHED or CUBED, whose frames refer to earlier ones
"""
POINTS_PER_BYTE = 8 * 16384  # most points that a byte of coded data can stand for
FRAMES_AHEAD = 2  # whose places another thread has decoded before their colours


class LocatedPoints(NamedTuple):
    """The points of a frame beside the surface.

    cells (n, 3): lattice coordinates. samples (n,): the sample near each among all bodies', −1 without one. places
    (n, 3): in the canonical pose, 2^-16 m; 0 without a sample. references: points of earlier frames, if the frame
    refers to any; nearest (n,): the one near each point without a sample, otherwise −1. positions (n, 3): as decoded,
    metres.
    """

    cells: Integers
    samples: Integers
    places: Integers
    references: ReferencePoints | None
    nearest: Integers
    positions: Floats


class CodedFrame(NamedTuple):
    """A frame whose places are coded. source: its lattice points, as they were chosen. located: None without points.
    octrees_size: whole bytes of the octrees up to this frame. part: of the octrees, if the encoder keeps its bits.
    """

    source: LatticeFrame
    located: LocatedPoints | None
    octrees_size: int
    part: CodedPart | None

    def colours(self) -> YCoCg:
        """The colours (n, 3) of a coloured frame, YCoCg."""
        assert self.source.colours is not None
        return point_colours.ycocg_from_rgb(self.source.colours)


class PlacesPart(NamedTuple):
    """What is stored of the places of a chunk's points. The fields are those of `PointsHeader`; references: of each
    frame. octrees: their bytes.
    """

    kind: int
    grid: LatticeGrid
    counts: list[int]
    shifts: list[int]
    pose_shifts: list[int]
    references: list[Reference]
    octrees: bytes


class CodedPlaces(NamedTuple):
    """The places of a chunk's points, and what their colours are coded from. table: samples of the bodies."""

    part: PlacesPart
    table: SampleTable
    frames: list[CodedFrame]

    def filled(self) -> list[tuple[CodedFrame, LocatedPoints]]:
        """The frames with points."""
        return [(frame, frame.located) for frame in self.frames if frame.located is not None]


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


class PlacesEncoder:
    """Codes the places of a chunk's points, frame by frame; the inverse is `PlacesDecoder`. table: the samples of the
    bodies.
    """

    def __init__(
        self,
        grid: LatticeGrid,
        frames: Sequence[LatticeFrame],
        bodies: ChunkBodies,
        bound_m: float | None,
        keeps_bits: bool = False,
    ) -> None:
        """bound_m: within which points take other cells (`point_choice`) and move to the surface; None: they stay. The
        octrees of bodies are those of `cube_octree`. keeps_bits: whether frames have a part for `BitCheck`.
        """
        self._kind = LEARNED if bound_m is None else CUBED if bodies.textures else SMOOTHED
        self._grid, self._frames, self._bound_m, self._keeps_bits = grid, frames, bound_m, keeps_bits
        self._shifts = [texture.shift for texture in bodies.textures]
        self._values = [bodies.pose_values(k) for k in range(len(frames))]
        self._pose_shifts = [[rounding_shift(v) for v in of_frame] for of_frame in self._values]
        self._coder, self._choice = BitEncoder(keeps_bits), ReferenceChoice()
        self._scene = Scene(bodies, self._shifts, learns=True, smooths=self._kind != LEARNED)
        self._earlier, self._counts, self._references = EarlierFrames(), list[int](), list[Reference]()
        self.table = self._scene.table

    def frames(self) -> Iterator[CodedFrame]:
        """Each frame after it is coded."""
        for k, frame in enumerate(self._frames):
            source, reference, located = self._code(k, frame) if len(frame.codes) else (frame, NO_REFERENCE, None)
            self._counts.append(len(source.codes))
            self._references.append(reference)
            yield CodedFrame(source, located, self._coder.size, self._coder.take() if self._keeps_bits else None)

    def _code(self, k: int, frame: LatticeFrame) -> tuple[LatticeFrame, Reference, LocatedPoints]:
        octree_of_frame = _OctreeOfFrame(
            self._kind, self._scene, self._grid, k, self._values[k], self._pose_shifts[k], self._earlier
        )
        source = octree_of_frame.chosen(frame, self._bound_m)
        self._coder, reference, located = octree_of_frame.encode(self._coder, source, self._bound_m, self._choice)
        return source, reference, located

    def part(self) -> PlacesPart:
        """What is stored, after the last frame."""
        pose_shifts = [shift for of_frame in self._pose_shifts for shift in of_frame]
        octrees = self._coder.finish()
        return PlacesPart(self._kind, self._grid, self._counts, self._shifts, pose_shifts, self._references, octrees)


def pack_places(
    grid: LatticeGrid, frames: Sequence[LatticeFrame], bodies: ChunkBodies, bound_m: float | None
) -> CodedPlaces:
    """The places of all frames of a chunk. bound_m: as in `PlacesEncoder`."""
    encoder = PlacesEncoder(grid, frames, bodies, bound_m)
    coded = list(encoder.frames())
    return CodedPlaces(encoder.part(), encoder.table, coded)


def pack_colours(coded: CodedPlaces, steps: ColourSteps) -> tuple[bytes, list[Bytes]]:
    """The bytes of the colours of all frames, and the decoded colours (n, 3) of each frame with points."""
    coder, memory = BitEncoder(), ColoursOfChunk(coded.table, steps)
    decoded = [memory.code(coder, frame.colours(), located) for frame, located in coded.filled()]
    return coder.finish(), decoded


def join(places: PlacesPart, steps: ColourSteps | None, colours: bytes) -> bytes:
    """The part of a chunk. steps: None without colours."""
    grid, refers = places.grid, any(reference != NO_REFERENCE for reference in places.references)
    before = varint.write([REFERRED]) + reference_points.pack_references(places.references) if refers else b""
    kind = varint.write([places.kind, grid.depth, *((0, 0) if steps is None else steps)])
    lattice_points = varint.write([varint.signed(v) for v in grid.corner.tolist()]) + struct.pack("<d", grid.step_m)
    numbers = varint.write([*places.counts, *places.shifts, *places.pose_shifts, len(places.octrees)])
    return before + kind + lattice_points + numbers + places.octrees + colours


def unpack_points(data: bytes, frames: int, bodies: ChunkBodies, coloured: bool) -> Iterator[Cloud]:
    """The inverse of `join`, frame by frame, in the order of the octree. With threads, the places of the next frames
    are decoded beside the colours of a frame. Raises Corrupt.
    """
    places = PlacesDecoder(data, frames, bodies, coloured)
    kind, steps, table = places.head.kind, places.head.steps, places.table
    colours = BitDecoder(places.rest)
    memory = ColoursOfChunk(table, ColourSteps(*steps)) if kind != UNLEARNED and coloured else None
    for k, located in enumerate(parallel.ahead(places.frames(), FRAMES_AHEAD)):
        cloud = no_points(coloured)
        if located is not None:
            colour = None
            if memory is not None:
                colour = memory.code(colours, None, located)
            elif coloured:
                colour = _unlearned_colours(colours, table.colours, located.samples, steps[0])
            cloud = located.positions, colour
        if k == frames - 1:  # before it is handed out: a caller may take no more than the frames there are
            colours.finish()
        yield cloud


class PlacesDecoder:
    """The places of the points of a chunk. head: what stands before them. table: the samples of the bodies. rest: what
    follows.
    """

    def __init__(self, data: bytes, frames: int, bodies: ChunkBodies, coloured: bool) -> None:
        """As `unpack_points`. Raises Corrupt."""
        part, self._references = split_references(data, frames)
        self.head = PointsHeader.read(part, frames, len(bodies.textures), int((~bodies.is_absent).sum()), coloured)
        self._coder, self.rest = BitDecoder(part[self.head.octrees]), part[self.head.octrees.stop :]
        kind = self.head.kind
        self._scene = Scene(bodies, self.head.shifts, learns=kind != UNLEARNED, smooths=kind in (SMOOTHED, CUBED))
        self.table = self._scene.table

    def frames(self) -> Iterator[LocatedPoints | None]:
        """The points of each frame, None for a frame without points. Raises Corrupt."""
        bodies, waiting, earlier = self._scene.bodies, iter(self.head.pose_shifts), EarlierFrames()
        for k, count in enumerate(self.head.counts):
            shifts, located = [next(waiting) for _ in bodies.present(k)], None
            if count:
                located = _OctreeOfFrame(
                    self.head.kind, self._scene, self.head.grid, k, bodies.pose_values(k), shifts, earlier
                ).decode(self._coder, count, self._references[k])
            if k == len(self.head.counts) - 1:
                self._coder.finish()
            yield located


def split_references(data: bytes, frames: int) -> tuple[bytes, list[Reference]]:
    """The part without references, and the reference of each frame. Raises Corrupt."""
    if data[:1] != bytes([REFERRED]):
        return data, [NO_REFERENCE] * frames
    references, at = reference_points.unpack_references(data, frames, 1)
    if data[at : at + 1] not in (bytes([kind]) for kind in (LEARNED, SMOOTHED, CUBED)):
        raise Corrupt("bodycast: references stand before points of another kind")
    return data[at:], references


class _Seen(NamedTuple):
    """A reference, its points, and what the octree sees of them and of the bodies."""

    reference: Reference
    references: ReferencePoints | None
    hints: SurfaceHints | None


class _OctreeOfFrame:
    """The octree of frame k. values, shifts: as in `Scene.posed`. The frame joins the `earlier` ones."""

    def __init__(
        self,
        kind: int,
        scene: Scene,
        grid: LatticeGrid,
        k: int,
        values: Sequence[Floats],
        shifts: Sequence[int],
        earlier: EarlierFrames,
    ) -> None:
        self.scene, self.grid, self.earlier = scene, grid, earlier
        self.code_octree = cube_octree.code_octree if kind == CUBED else point_octree.code_octree
        self.surface = scene.posed(k, values, shifts)
        self.hints = scene.hints(k, self.surface, grid.step_m, grid.corner, grid.depth)

    def chosen(self, frame: LatticeFrame, bound_m: float | None) -> LatticeFrame:
        """The frame with cells that take fewer bits within the bound, if a body shows the surface."""
        if self.hints is None or bound_m is None:
            return frame
        return point_choice.chosen_cells(frame, self.grid, self.hints, bound_m)

    def encode(
        self, coder: BitEncoder, frame: LatticeFrame, bound_m: float | None, choice: ReferenceChoice
    ) -> tuple[BitEncoder, Reference, LocatedPoints]:
        """Code the points with the best choice of references. The coder to go on with."""
        cells, has_bodies, depth = octree.cells_of_codes(frame.codes), self.hints is not None, self.grid.depth
        before = coder.size
        candidates = choice.candidates(self.earlier, cells, depth, has_bodies)
        tried = list[tuple[BitEncoder, _Seen, Integers]]()
        for reference in candidates:
            trial, seen = coder.copy() if len(candidates) > 1 else coder, self._seen(reference)
            _, nearest = self.code_octree(trial, frame.codes, depth, len(frame.codes), seen.hints)
            tried.append((trial, seen, nearest))
        best = choice.keep_best(candidates, [trial.size - before for trial, *_ in tried], has_bodies)
        coder, seen, nearest = tried[best]
        return coder, seen.reference, self._keep(coder, frame, bound_m, cells, nearest, seen)

    def decode(self, coder: BitDecoder, count: int, reference: Reference) -> LocatedPoints:
        """The points (count,). Raises Corrupt."""
        seen = self._seen(reference)
        codes, nearest = self.code_octree(coder, None, self.grid.depth, count, seen.hints)
        return self._keep(coder, None, None, octree.cells_of_codes(codes), nearest, seen)

    def _seen(self, reference: Reference) -> _Seen:
        """The points of a reference, and what the octree sees of them and of the bodies."""
        bodies, references = None if reference.hides_bodies else self.hints, None
        if reference.frames:
            earlier = self.earlier.moved(reference.motion)
            references = earlier.references(reference.frames, self.grid.depth, bodies is not None)
        hints = reference_points.joined_hints(bodies, references, self.grid.depth, self.scene.smooths)
        return _Seen(reference, references, hints)

    def _keep(
        self,
        coder: BitEncoder | BitDecoder,
        frame: LatticeFrame | None,
        bound_m: float | None,
        cells: Integers,
        nearest: Integers,
        seen: _Seen,
    ) -> LocatedPoints:
        """What the next frames and the colours need. frame, bound_m: None in the decoder. nearest (n,): the sample near
        each point. Raises Corrupt.
        """
        bodies = 0 if seen.reference.hides_bodies else len(self.surface.rows)
        samples, places = self._learn(cells, np.where(nearest < bodies, nearest, -1), seen.reference)
        if self.scene.smooths:
            positions = self._moved(coder, frame, bound_m, cells, nearest, seen.hints)
        else:
            positions = self.grid.positions(cells)
        others = np.where(nearest < bodies, -1, nearest - bodies)
        return LocatedPoints(cells, samples, places, seen.references, others, positions)

    def _learn(self, cells: Integers, of_bodies: Integers, reference: Reference) -> tuple[Integers, Integers]:
        """Keep the points for later frames. of_bodies (n,): the sample of a body near each, −1 without one. Returns
        `samples` and `places` of `LocatedPoints`.
        """
        points, table = self.grid.places(cells), self.scene.table
        if len(cells) and of_bodies.min() >= 0:
            samples, places = self.surface.rows[of_bodies], table.canonical(self.surface, points, of_bodies)
        else:
            samples, places = np.full(len(cells), -1), np.zeros((len(cells), 3), np.int64)
            known = np.flatnonzero(of_bodies >= 0)
            samples[known] = self.surface.rows[of_bodies[known]]
            places[known] = table.canonical(self.surface, points[known], of_bodies[known])
        self.scene.learn(self.surface, points, of_bodies)
        self.earlier.move(reference.motion)
        self.earlier.add(cells, reference_points.explained_points(self.surface, points, of_bodies))
        return samples, places

    def _moved(
        self,
        coder: BitEncoder | BitDecoder,
        frame: LatticeFrame | None,
        bound_m: float | None,
        cells: Integers,
        nearest: Integers,
        hints: SurfaceHints | None,
    ) -> Floats:
        """The decoded points (n, 3), metres: those of the lattice, moved to the surface where that keeps the bound."""
        if hints is None:
            return self.grid.positions(cells)
        smoothed, stays = point_smoothing.smooth(cells, nearest, hints), None
        if frame is not None and bound_m is not None:
            moved = self.grid.shifted_positions(cells, smoothed.shifts, point_smoothing.FINE_BITS)
            stays = np.zeros(len(cells), bool)
            stays[frame.rows[frame.own_distances(moved) > bound_m * (1 - lattice.ROUNDING)]] = True
        stays = point_smoothing.code_stays(coder, smoothed, stays)
        shifts = np.where(stays[:, None], 0, smoothed.shifts)
        return self.grid.shifted_positions(cells, shifts, point_smoothing.FINE_BITS)


class ColoursOfChunk:
    """Codes the colours of a chunk's frames, each from what those before it showed of the surface."""

    def __init__(self, table: SampleTable, steps: ColourSteps) -> None:
        self.memory, self.lifting = ColourMemory(table), ColourLifting(steps)
        self.decoded = list[YCoCg]()  # colours of the last frames

    def code(self, coder: BitCoder, wanted: YCoCg | None, points: LocatedPoints) -> Bytes:
        """The decoded colours (n, 3) of a frame; wanted: YCoCg (n, 3), None in the decoder. Raises Corrupt."""
        colours = self._code(coder, wanted, points)
        self._keep(colours)
        return point_colours.rgb_from_ycocg(colours)

    def code_repeated(self, coder: BitCoder, wanted: YCoCg | None, points: LocatedPoints, repeats: Integers) -> Bytes:
        """As `code`, of points that stand for `repeats` (m,) more each. Later frames refer to the first of them."""
        samples, places, cells, nearest = (
            np.repeat(values, repeats + 1, axis=0)
            for values in (points.samples, points.places, points.cells, points.nearest)
        )
        every = points._replace(samples=samples, places=places, cells=cells, nearest=nearest)
        colours = self._code(coder, wanted, every)
        self._keep(colours[np.cumsum(repeats + 1) - repeats - 1])
        return point_colours.rgb_from_ycocg(colours)

    def _code(self, coder: BitCoder, wanted: YCoCg | None, points: LocatedPoints) -> YCoCg:
        samples, nearest = points.samples, points.nearest
        known, referring = np.flatnonzero(samples >= 0), nearest >= 0
        has_all = len(known) == len(samples)
        rows, places = (samples, points.places) if has_all else (samples[known], points.places[known])
        expected = self.memory.expected(rows, places)
        if not has_all:
            every = np.zeros((len(samples), 3), np.int16)
            every[known] = expected
            expected = every
        if points.references is not None:
            cells = points.cells[referring]
            expected[referring] = points.references.expected(self.decoded, cells, nearest[referring])
        colours = self.lifting.code_frame(coder, wanted, points.cells, expected, (samples >= 0) | referring)
        self.memory.learn(rows, places, colours if has_all else colours[known])
        return colours

    def _keep(self, colours: YCoCg) -> None:
        """For later frames that refer to this one."""
        self.decoded = [*self.decoded[1 - reference_points.MAX_FRAMES :], colours]


def _unlearned_colours(coder: BitDecoder, texture: YCoCg, samples: Integers, step: int) -> Bytes:
    """The colours (n, 3) of points relative to the texture (m, 3) at their samples (n,). Raises Corrupt."""
    values = point_colours.code_colours(coder, None, len(samples))
    predicted = np.tile(point_colours.GREY, (len(samples), 1))
    predicted[samples >= 0] = texture[samples[samples >= 0]]
    return point_colours.dequantise(values, predicted, step)
