"""All points of a chunk's frames within a bound: on a lattice, coded from the bodies' surface.

    points ─lattice─► integers ─► distinct Morton codes ─point_octree─► bytes      colours ─point_colours─► bytes
    bodies, poses ─integer_surface─► where the surface lies ─┘                        └─ texture there

Points of one cell of the lattice become one, with their mean colour. So every original point has a decoded one within
the bound, and every decoded point an original one.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...entropy import varint
from ...entropy.bit_arrays import BitDecoder, BitEncoder
from ...errors import CannotEncode, Corrupt
from ...typing import Booleans, Bytes, Floats, Integers
from ..clouds.raw_frames import Cloud, no_points
from . import integer_surface, lattice, octree, point_colours, point_octree, video
from .body_model import BodyModel
from .integer_surface import IntegerSurface, hints_of_frame, posed_samples, rounding_shift
from .pose_stream import PoseSequence
from .surface_hints import SurfaceHints
from .surface_sampling import SurfaceSamples, sample_surface

LATTICE = 3  # kind of the part that holds all points; 0 to 2 are those of `exact_points`
MIN_STEP_M, MAX_STEP_M = 1e-7, 10.0
MAX_CORNER = 1 << 40
POINTS_PER_BYTE = 8 * 16384  # most points that a byte of coded data can stand for


class LatticeFrame(NamedTuple):
    """A frame on the lattice. codes (n,): sorted distinct Morton codes. colours (n, 3): mean colours, or None."""

    codes: Integers
    colours: Bytes | None


@dataclass(frozen=True)
class LatticeGrid:
    """Where the points of a chunk lie. step_m: unit of the lattice. corner (3,), even: in that unit. depth: levels."""

    step_m: float
    corner: Integers
    depth: int

    def positions(self, codes: Integers) -> Floats:
        """The places (n, 3) of Morton codes (n,), metres."""
        return lattice.positions(octree.cells_of_codes(codes) + self.corner, self.step_m)


class SurfaceTexture:
    """The surface of a body with its colours, for the octree of every frame: built once for each file."""

    def __init__(self, model: BodyModel) -> None:
        """Decodes the key picture. Raises Corrupt."""
        planes = next(video.decode([model.key_picture], model.atlas.image_shape))
        self.samples = sample_surface(model.atlas, planes, model.is_surface, integer_surface.SAMPLES)
        self.canonical = self.samples.surface(planes)[0]
        self.colours = _texture(self.samples, planes)
        self.body = model.atlas.body
        self._built: tuple[int, IntegerSurface] | None = None

    @property
    def shift(self) -> int:
        """The rounding shift that an encoder stores."""
        return rounding_shift(IntegerSurface.values(self.samples, self.canonical))

    def integers(self, shift: int) -> IntegerSurface:
        """The surface rounded with this shift."""
        if self._built is None or self._built[0] != shift:
            self._built = shift, IntegerSurface.build(self.samples, self.canonical, shift, len(self.body))
        return self._built[1]


def _texture(samples: SurfaceSamples, planes: Bytes) -> Integers:
    """(m, 3): YCoCg of the atlas cell nearest to each sample, in integers."""
    nearest = np.take_along_axis(samples.cells, samples.weights.argmax(axis=0)[None], axis=0)[0]
    y, cb, cr = planes.reshape(3, -1)[:, nearest].astype(np.int64)
    red, blue = y + (103_206 * (cr - 128) >> 16), y + (121_609 * (cb - 128) >> 16)
    green = y - (30_678 * (cr - 128) + 12_277 * (cb - 128) >> 16)
    return point_colours.ycocg_from_rgb(np.clip(np.stack([red, green, blue], axis=1), 0, 255))


# --- frames on the lattice ------------------------------------------------------------------------------------------


def to_lattice(frames: Sequence[Cloud], bound_m: float, coloured: bool) -> tuple[LatticeGrid, list[LatticeFrame]]:
    """The frames of a chunk on the lattice of this bound. Raises CannotEncode for points too far apart."""
    step = lattice.step_of_bound(bound_m)
    if not MIN_STEP_M <= step <= MAX_STEP_M:
        raise CannotEncode(
            f"bodycast cannot bound the error of points by {bound_m * 1000:g} mm; "
            "ask for 0.001 mm to 10 m, or keep every point with residual exact"
        )
    places = [lattice.nearest(points, step) for points, _ in frames]
    filled = [p for p in places if len(p)]
    corner = np.min([p.min(axis=0) for p in filled], axis=0) // 2 * 2 if filled else np.zeros(3, np.int64)
    depth = max((int((p.max(axis=0) - corner).max()).bit_length() for p in filled), default=0)
    if depth > point_octree.MAX_DEPTH or np.abs(corner).max() >= MAX_CORNER:
        limit_m = 2**point_octree.MAX_DEPTH * step
        raise CannotEncode(
            f"points lie more than {limit_m:.3g} m apart, too far for an error of {bound_m * 1000:g} mm; "
            "ask for a larger error, or keep every point with residual exact"
        )
    grid = LatticeGrid(step, corner, depth)
    pairs = zip(places, frames, strict=True)
    return grid, [_lattice_frame(p - corner, colours if coloured else None) for p, (_, colours) in pairs]


def _lattice_frame(coordinates: Integers, colours: Bytes | None) -> LatticeFrame:
    """Points of one cell become one, with their mean colour."""
    codes, cell, count = np.unique(octree.morton_codes(coordinates), return_inverse=True, return_counts=True)
    if colours is None:
        return LatticeFrame(codes, None)
    sums = np.stack([np.bincount(cell.reshape(-1), colours[:, k], len(codes)) for k in range(3)], axis=1)
    return LatticeFrame(codes, np.round(sums / np.maximum(count, 1)[:, None]).astype(np.uint8))


# --- bytes ----------------------------------------------------------------------------------------------------------


def pack_points(
    grid: LatticeGrid,
    frames: Sequence[LatticeFrame],
    textures: Sequence[SurfaceTexture],
    poses: Sequence[PoseSequence],
    is_absent: Booleans,
    colour_step: int,
) -> bytes:
    """A chunk's points. poses: of each body, as they are decoded. is_absent (frames, bodies). colour_step: 0 without
    colours.
    """
    shifts = [texture.shift for texture in textures]
    values = [
        [integer_surface.pose_values(t.body, poses[b][k]) for b, t in enumerate(textures) if not is_absent[k, b]]
        for k in range(len(frames))
    ]
    pose_shifts = [[rounding_shift(v) for v in of_frame] for of_frame in values]
    head = varint.write([LATTICE, grid.depth, colour_step, *(varint.signed(v) for v in grid.corner.tolist())])
    head += struct.pack("<d", grid.step_m)
    head += varint.write([*(len(f.codes) for f in frames), *shifts, *(s for row in pose_shifts for s in row)])
    places, colours = BitEncoder(), BitEncoder()
    scene = _Scene(grid, textures, shifts, is_absent)
    for k, frame in enumerate(frames):
        if not len(frame.codes):
            continue
        hints, texture = scene.frame(k, values[k], pose_shifts[k])
        _, nearest = point_octree.code_octree(places, frame.codes, grid.depth, len(frame.codes), hints)
        if colour_step and frame.colours is not None:
            predicted = _predicted_colours(texture, nearest)
            wanted = point_colours.quantise(frame.colours, predicted, colour_step)
            point_colours.code_colours(colours, wanted, len(wanted))
    octrees = places.finish()
    return head + varint.write([len(octrees)]) + octrees + (colours.finish() if colour_step else b"")


def unpack_points(
    data: bytes,
    frames: int,
    textures: Sequence[SurfaceTexture],
    poses: Sequence[PoseSequence],
    is_absent: Booleans,
    coloured: bool,
) -> Iterator[Cloud]:
    """The inverse of `pack_points`, frame by frame, in the order of the octree. Raises Corrupt."""
    (_, depth, colour_step, *corner), at = varint.read(data, 6)
    if at + 8 > len(data):
        raise Corrupt("bodycast: the points of a chunk are cut off")
    grid = LatticeGrid(struct.unpack_from("<d", data, at)[0], np.array([varint.unsigned(v) for v in corner]), depth)
    counts, at = varint.read(data, frames, at + 8)
    shifts, at = varint.read(data, len(textures), at)
    pose_shifts, at = varint.read(data, int((~is_absent).sum()) if len(textures) else 0, at)
    (size,), at = varint.read(data, 1, at)
    _require_plausible(grid, counts, colour_step, coloured, [*shifts, *pose_shifts], len(data), at + size)
    places, colours = BitDecoder(data[at : at + size]), BitDecoder(data[at + size :])
    scene, waiting = _Scene(grid, textures, shifts, is_absent), iter(pose_shifts)
    for k, count in enumerate(counts):
        present = [b for b in range(len(textures)) if not is_absent[k, b]]
        own = [next(waiting) for _ in present]
        if not count:
            yield no_points(coloured)
            continue
        values = [integer_surface.pose_values(textures[b].body, poses[b][k]) for b in present]
        hints, texture = scene.frame(k, values, own)
        codes, nearest = point_octree.code_octree(places, None, depth, count, hints)
        colour = None
        if coloured:
            steps = point_colours.code_colours(colours, None, count)
            colour = point_colours.dequantise(steps, _predicted_colours(texture, nearest), colour_step)
        yield grid.positions(codes), colour
    places.finish()


def _require_plausible(
    grid: LatticeGrid,
    counts: Sequence[int],
    colour_step: int,
    coloured: bool,
    shifts: Sequence[int],
    size: int,
    end: int,
) -> None:
    """Raises Corrupt for a header that `pack_points` never writes in `size` bytes; end: of the octrees."""
    if not MIN_STEP_M <= grid.step_m <= MAX_STEP_M or np.abs(grid.corner).max() >= MAX_CORNER:
        raise Corrupt("bodycast: the lattice of a chunk's points is out of range")
    if grid.depth > point_octree.MAX_DEPTH or max(shifts, default=0) >= integer_surface.SHIFTS:
        raise Corrupt("bodycast: the octree of a chunk's points is damaged")
    if bool(colour_step) != coloured or colour_step > point_colours.MAX_STEP or end > size:
        raise Corrupt("bodycast: the points of a chunk are cut off, or their colours are damaged")
    if sum(counts) > min(octree.MAX_POINTS, POINTS_PER_BYTE * (size + 1)):
        raise Corrupt(f"bodycast: {sum(counts)} points in {size} bytes")


class _Scene:
    """The surfaces of all bodies while the frames of a chunk are coded."""

    def __init__(
        self, grid: LatticeGrid, textures: Sequence[SurfaceTexture], shifts: Sequence[int], is_absent: Booleans
    ) -> None:
        self.grid, self.is_absent = grid, is_absent
        self.surfaces = [texture.integers(shift) for texture, shift in zip(textures, shifts, strict=True)]
        self.colours = [texture.colours for texture in textures]

    def frame(self, k: int, values: Sequence[Floats], shifts: Sequence[int]) -> tuple[SurfaceHints | None, Integers]:
        """The surface of frame k, and the colours (m, 3) of its samples. values, shifts: of the bodies in the frame."""
        present = [b for b in range(len(self.surfaces)) if not self.is_absent[k, b]]
        surfaces = [self.surfaces[b] for b in present]
        posed = [posed_samples(s, v, shift) for s, v, shift in zip(surfaces, values, shifts, strict=True)]
        hints = hints_of_frame(surfaces, posed, self.grid.step_m, self.grid.corner, self.grid.depth)
        texture = [self.colours[b] for b in present]
        return hints, np.concatenate(texture) if texture else np.zeros((0, 3), np.int64)


def _predicted_colours(texture: Integers, nearest: Integers) -> Integers:
    """(n, 3): YCoCg of the nearest sample (n,) of each point."""
    if not len(texture):
        return np.tile(point_colours.GREY, (len(nearest), 1))
    return np.where(nearest[:, None] < 0, point_colours.GREY, texture[nearest])
