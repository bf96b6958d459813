"""The surfaces of all bodies while the frames of a chunk are coded: posed, corrected, and as the octree sees them.

key picture ─► samples, colours (`SurfaceTexture`, once a file)
poses ───────► samples of a frame ─`PlaceMemory`─► corrected ─► `SurfaceHints` for the octree
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...typing import Booleans, Bytes, Floats, Integers, YCoCg
from . import integer_surface, point_colours, video
from .body_model import BodyModel
from .integer_surface import IntegerSurface, pose_values, posed_samples, rounding_shift
from .pose_stream import PoseSequence
from .surface_hints import NEIGHBOURS, SurfaceHints
from .surface_memory import SEARCHED_SAMPLES, PlaceMemory, PosedSurface, SampleTable
from .surface_sampling import SurfaceSamples, sample_surface


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


def _texture(samples: SurfaceSamples, planes: Bytes) -> YCoCg:
    """(m, 3): YCoCg of the atlas cell nearest to each sample, in integers."""
    nearest = np.take_along_axis(samples.cells, samples.weights.argmax(axis=0)[None], axis=0)[0]
    y, cb, cr = planes.reshape(3, -1)[:, nearest].astype(np.int64)
    red, blue = y + (103_206 * (cr - 128) >> 16), y + (121_609 * (cb - 128) >> 16)
    green = y - (30_678 * (cr - 128) + 12_277 * (cb - 128) >> 16)
    return point_colours.ycocg_from_rgb(np.clip(np.stack([red, green, blue], axis=1), 0, 255).astype(np.uint8))


class ChunkBodies(NamedTuple):
    """The bodies of a chunk, from which its points are coded. poses: of each body, as they are decoded. is_absent
    (frames, bodies): True where a body is not in a frame.
    """

    textures: Sequence[SurfaceTexture]
    poses: Sequence[PoseSequence]
    is_absent: Booleans

    @staticmethod
    def nobody(frames: int) -> ChunkBodies:
        """For a chunk of `frames` frames without bodies."""
        return ChunkBodies([], [], np.zeros((frames, 0), bool))

    def present(self, k: int) -> list[int]:
        """The numbers of the bodies in frame k."""
        return np.flatnonzero(~self.is_absent[k]).tolist()

    def pose_values(self, k: int) -> list[Floats]:
        """`integer_surface.pose_values` of each body in frame k."""
        return [pose_values(self.textures[b].body, self.poses[b][k]) for b in self.present(k)]


class Scene:
    """The surfaces of all bodies of a file, frame after frame of a chunk. table: their samples.

    learns: whether the points of earlier frames move the samples of later ones. smooths: whether decoded points move to
    the surface that the points around them show.
    """

    def __init__(self, bodies: ChunkBodies, shifts: Sequence[int], learns: bool, smooths: bool) -> None:
        """shifts: the rounding shift of each body's surface."""
        self.bodies, self.learns, self.smooths = bodies, learns, smooths
        self.surfaces = [texture.integers(shift) for texture, shift in zip(bodies.textures, shifts, strict=True)]
        self._starts = np.cumsum([0, *(len(s.points) for s in self.surfaces)])
        neighbours = _joined(self.surfaces, self._starts.tolist())
        self.table = SampleTable(
            np.concatenate([np.zeros((0, 3), np.int64), *(s.points for s in self.surfaces)]),
            np.ascontiguousarray(neighbours[:, : SEARCHED_SAMPLES - 1]),
            np.concatenate([np.zeros((0, 3), np.int16), *(texture.colours for texture in bodies.textures)]),
        )
        self._memory = PlaceMemory(self.table)
        self._neighbours = dict[tuple[int, ...], Integers]()  # of the samples of these bodies

    def posed(self, k: int, values: Sequence[Floats], shifts: Sequence[int]) -> PosedSurface:
        """The samples in frame k. values, shifts: `pose_values` and rounding shift of each body in the frame."""
        parts, links = list[tuple[Integers, ...]](), 0
        for b, value, shift in zip(self.bodies.present(k), values, shifts, strict=True):
            surface = self.surfaces[b]
            places, normals, turns = posed_samples(surface, value, shift)
            rows = np.arange(self._starts[b], self._starts[b + 1])
            parts.append((rows, places, normals, surface.links[:, 0] + links, turns))
            links += len(turns)
        if len(parts) == 1:
            return PosedSurface(*parts[0])
        nothing = (np.zeros(shape, np.int64) for shape in (0, (0, 3), (0, 3), 0, (0, 3, 3)))
        return PosedSurface(*map(np.concatenate, zip(nothing, *parts, strict=True)))

    def hints(self, k: int, frame: PosedSurface, step_m: float, corner: Integers, depth: int) -> SurfaceHints | None:
        """What the octree of frame k sees of the samples; None without bodies. Raises Corrupt."""
        present = tuple(self.bodies.present(k))
        if present not in self._neighbours:
            surfaces = [self.surfaces[b] for b in present]
            self._neighbours[present] = _joined(surfaces, np.cumsum([0, *(len(s.points) for s in surfaces)]).tolist())
        places, neighbours = self._memory.corrected(frame) if self.learns else frame.places, self._neighbours[present]
        return integer_surface.hints_of_frame(places, frame.normals, neighbours, step_m, corner, depth, self.smooths)

    def learn(self, frame: PosedSurface, points: Integers, samples: Integers) -> None:
        """As `PlaceMemory.learn`."""
        if self.learns:
            self._memory.learn(frame, points, samples)


def _joined(surfaces: Sequence[IntegerSurface], starts: Sequence[int]) -> Integers:
    """(m, NEIGHBOURS): the neighbours of the samples of several surfaces, of which the first starts at starts[0]."""
    parts = [s.neighbours + start for s, start in zip(surfaces, starts, strict=False)]
    return np.concatenate([np.zeros((0, NEIGHBOURS), np.int64), *parts])
