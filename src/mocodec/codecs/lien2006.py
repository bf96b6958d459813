"""Model driven compression of 3-D tele-immersion data (Lien and Bajcsy, 2006).

    first frame ──segment──► model P of cylinder links          stored once
    each frame Q ──ARTICP──► pose T of the links ──────────────► pose stream
                    └─ Q and T(P) as maps on the links' cylinders ──difference──► depth as PNG, colour as JPEG

The decoder poses P; with residuals it moves P's points by the differences of their cells, and adds a point for every
cell that holds one of Q's and none of P's.
"""

from __future__ import annotations

import io
import itertools
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import progress
from ..encoded import Chunk, Encoded
from ..entropy import coder, varint
from ..errors import BadInput, CannotEncode, Corrupt
from ..geometry import articulated_icp, articulation, body_fit, cylinder_map
from ..geometry.articulation import Body, Floats, Pose
from ..geometry.cylinder_map import Cylinder, CylinderMap
from ..motion import Motion
from ..pointcloud import PointClouds
from . import base, body_stream
from .body_stream import Steps

Integers = NDArray[np.int64]
STEPS = Steps(reach=0.002, place=0.002)
POINT_STEP, COLOUR_STEP = 0.002, 4  # of the model: metres, and levels of 256
DEPTH_STEP, OLD_DEPTH_STEP = 0.016, 0.008  # of residual maps: metres; eight bits reach two metres either way
DEAD = 0.75  # steps: smaller differences of depth are none
COLOURED, BY_CELL = 1, 2  # what a model's bytes say of its points, and of the stills of depth
BEYOND = 0.25  # metres off a link's cylinder, where points are no longer the body's: props, other people
FEWEST = 50  # points that a frame must have to be a body


class Model(NamedTuple):
    """What the decoder knows: the body, its points in the canonical pose (n, 3), their colours and links (n,)."""

    body: Body
    points: Floats
    colours: NDArray[np.uint8] | None
    links: Integers


class Residual(NamedTuple):
    """A frame's maps of all links, as differences from the model: depth (height, width), colour (height, width, 3)."""

    depth: NDArray[np.uint8]
    colour: NDArray[np.uint8]


class Maps(NamedTuple):
    """How residual maps are stored: their share of the full ones, and whether a still of depth holds the frames of each
    cell side by side, in steps of DEPTH_STEP. In older files it holds lines of them one below the other.
    """

    share: float
    by_cell: bool = True

    @property
    def depth_step(self) -> float:
        return DEPTH_STEP if self.by_cell else OLD_DEPTH_STEP


class Tile(NamedTuple):
    """Where a link's map lies in the atlas, its cylinder, and the model's own map there."""

    top: int
    left: int
    cylinder: Cylinder
    expected: CylinderMap


@dataclass(frozen=True)
class Lien2006:
    """Settings. `residual` is the share of the full residual maps in percent: 0 sends poses alone.

    skeleton: a Motion, or a file of one (.bvh, .amc), whose first frame is the pose of the first frame; fitted where
    none is given. model_share: of the first frame's points that become the model, 50 % as for the paper's own data.
    tracked_points: of the model and of a frame, at most, that ARTICP looks at.
    """

    name: ClassVar[str] = "lien2006"
    residual: float = 0
    skeleton: Any = None
    model_share: float = 0.5
    tracked_points: int = 2500
    jpeg_quality: int = 50
    chunk_frames: int = 60
    global_fitting: bool = True
    articulation: bool = True

    def encode(self, clouds: PointClouds) -> Encoded[PointClouds]:
        """Raises CannotEncode where no frame shows a body, BadInput for settings or a skeleton that cannot be used."""
        if isinstance(clouds, Motion):
            raise CannotEncode("lien2006 codes point clouds, not motions")
        if not 0 <= self.residual <= 100 or not 0 < self.model_share <= 1:
            raise BadInput("residual is a percentage from 0 to 100, model_share a share up to 1")
        frames = [body_stream.clean(clouds, frame) for frame in range(len(clouds))]
        first = next((i for i, (points, _) in enumerate(frames) if len(points) >= 4 * FEWEST), None)
        if first is None:
            raise CannotEncode(f"no frame has {4 * FEWEST} points or more: there is no body to code")
        model, tracker = self._begin(*frames[first], _normals(clouds, first), clouds.up)
        atlas = _atlas(model, self.residual / 100) if self.residual else []
        chunks, poses, held = list[Chunk](), list[Integers](), list[Residual]()
        strays = list[tuple[Floats, NDArray[np.uint8] | None]]()
        previous = np.zeros(3 + 3 * len(model.body), np.int64)
        for i, (points, colours) in progress.over(list(enumerate(frames))):
            is_body = len(points) >= FEWEST and i >= first
            if is_body:
                given = _normals(clouds, i)
                pose = self._fit(tracker, points, colours, given, i) if i > first else tracker.pose
                previous = body_stream.quantise(model.body, pose, STEPS, previous)
                if atlas:
                    maps = _maps(model, atlas, body_stream.dequantise(model.body, previous, STEPS), points, colours)
                    held.append(_differences(atlas, maps))
            else:
                strays.append((points, colours))
            poses.append(np.concatenate([[not is_body], previous]))
            if len(poses) == self.chunk_frames or i == len(frames) - 1:
                stills = _stills(held, clouds.colours is not None, self.jpeg_quality)
                payload = _pack_chunk(np.array(poses), body_stream.pack_raw(strays), stills)
                chunks.append(Chunk(i + 1 - len(poses), len(poses), payload))
                poses, held, strays = [], [], []
        settings = base.settings(self)
        if self.skeleton is not None:
            settings["skeleton"] = str(self.skeleton) if not isinstance(self.skeleton, Motion) else "given"
        about = _about(clouds)
        return Encoded(self.name, about, chunks, (_pack_model(model, self.residual),), settings=settings)

    def _begin(
        self, points: Floats, colours: NDArray[np.uint8] | None, normals: Floats | None, up: str
    ) -> tuple[Model, articulated_icp.ArticpTracker]:
        """The model of the first frame and the tracker that follows it."""
        if self.skeleton is None:
            body = body_fit.first_pose(points, up).body(one_trunk=True, shortest=0.1)
        else:
            motion = body_stream.skeleton_motion(self.skeleton)
            assert motion.skeleton is not None
            names, parents = motion.skeleton.names, motion.skeleton.parents
            body = articulation.from_skeleton(names, parents, motion.positions[0], one_trunk=True, shortest=0.1)
            body_fit.require_near(body, points)
        rng = np.random.default_rng(0)
        share = rng.permutation(len(points))[: max(2 * FEWEST, round(self.model_share * len(points)))]
        near = articulated_icp.is_near(body, points[share])
        share = share[near] if near.sum() >= FEWEST else share  # a second person, or a floor, is no part of the body
        colours = None if colours is None else colours[share]
        normals = None if normals is None else normals[share]
        body, model = articulated_icp.make_model(body, points[share], colours, normals, among=points)
        body = body_stream.rounded(body)
        few = slice(0, self.tracked_points)
        small = articulated_icp.CylinderModel(
            model.points[few], model.normals[few], None if colours is None else colours[few], model.links[few]
        )
        settings = articulated_icp.ArticpSettings(articulation=self.articulation, global_fitting=self.global_fitting)
        return _rounded(Model(body, model.points, colours, model.links)), articulated_icp.ArticpTracker(
            body, small, settings
        )

    def _fit(
        self,
        tracker: articulated_icp.ArticpTracker,
        points: Floats,
        colours: NDArray[np.uint8] | None,
        normals: Floats | None,
        frame: int,
    ) -> Pose:
        some = np.random.default_rng(frame).permutation(len(points))[: self.tracked_points]
        colours = None if colours is None else colours[some]
        return tracker.fit(points[some], colours, None if normals is None else normals[some], points)

    @staticmethod
    def decode(encoded: Encoded[PointClouds], frames: slice | None = None) -> PointClouds:
        """The point clouds, or a slice of their frames. Raises Corrupt."""
        model, stored = _unpack_model(encoded.shared)
        atlas = _atlas(model, stored.share) if stored.share else []
        positions, colours = list[Floats](), list[NDArray[np.uint8]]()
        start, stop = encoded.range(frames)
        for chunk in progress.over(encoded.covering(start, stop)):
            for i, (points, colour) in enumerate(_decode_chunk(model, stored, atlas, chunk)):
                if start <= chunk.start + i < stop:
                    positions.append(points)
                    colours.append(colour if colour is not None else np.zeros((len(points), 3), np.uint8))
        return _restore(encoded, positions, None if model.colours is None else colours)

    @staticmethod
    def track(encoded: Encoded[PointClouds], frames: slice | None = None) -> Motion:
        """The tracked body: joints and rotations of the links, frame by frame. Raises Corrupt."""
        model, _ = _unpack_model(encoded.shared)
        start, stop = encoded.range(frames)
        poses = list[Pose]()
        for chunk in encoded.covering(start, stop):
            rows = _unpack_poses(chunk, len(model.body))[0]
            poses += [
                body_stream.dequantise(model.body, r[1:], STEPS)
                for i, r in enumerate(rows)
                if start <= chunk.start + i < stop
            ]
        return body_stream.track(encoded, model.body, poses)


def _normals(clouds: PointClouds, frame: int) -> Floats | None:
    """Unit normals of the points that `body_stream.clean` keeps; None where the clouds have none that can be used."""
    if clouds.normals is None:
        return None
    normals = np.asarray(clouds.normals[frame], np.float64)[body_stream.is_here(clouds.positions[frame])]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / length if np.isfinite(length).all() and (length > 1e-6).all() else None


def _about(clouds: PointClouds) -> PointClouds:
    return PointClouds(
        [], clouds.rate, None if clouds.colours is None else [], None, clouds.up, clouds.source, clouds.extras
    )


def _restore(
    encoded: Encoded[PointClouds], positions: list[Floats], colours: list[NDArray[np.uint8]] | None
) -> PointClouds:
    like = encoded.about
    return PointClouds(positions, like.rate, colours, None, like.up, like.source, like.extras)


# --- the model ------------------------------------------------------------------------------------------------------


def _rounded(model: Model) -> Model:
    """The model as its bytes give it back: on the grid of its steps, points of a link beside each other."""
    grid = np.round(model.points / POINT_STEP).astype(np.int64)
    order = np.lexsort((_morton(grid), model.links))
    colours = None
    if model.colours is not None:
        colours = np.minimum(np.round(model.colours[order] / COLOUR_STEP) * COLOUR_STEP, 255).astype(np.uint8)
    return Model(model.body, grid[order].astype(np.float64) * POINT_STEP, colours, model.links[order])


def _morton(grid: Integers) -> Integers:
    """Bits of the three coordinates in turn, so that neighbours in space are near each other in order."""
    low = grid - grid.min(axis=0)
    code = np.zeros(len(grid), np.int64)
    for bit in range(14):
        for axis in range(3):
            code |= ((low[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def _pack_model(model: Model, residual: float) -> bytes:
    grid = np.round(model.points / POINT_STEP).astype(np.int64)
    lanes = [grid]
    if model.colours is not None:
        lanes.append(np.round(model.colours / COLOUR_STEP).astype(np.int64))
    counts = np.bincount(model.links, minlength=len(model.body))
    points = coder.pack(np.diff(np.concatenate(lanes, axis=1), axis=0, prepend=0))
    kind = BY_CELL + COLOURED * (model.colours is not None)
    head = varint.write([round(residual * 100), kind, len(grid), *counts.tolist()])
    return body_stream.pack_body(model.body) + head + points


def _unpack_model(shared: Sequence[bytes]) -> tuple[Model, Maps]:
    if len(shared) != 1:
        raise Corrupt("lien2006: the model is missing")
    data = shared[0]
    body, at = body_stream.unpack_body(data)
    (residual, kind, count, *counts), at = varint.read(data, 3 + len(body), at)
    coloured = bool(kind & COLOURED)
    if (
        residual > 10000
        or kind > COLOURED + BY_CELL
        or count > body_stream.MAX_POINTS
        or sum(counts) != count
        or not count
    ):
        raise Corrupt("lien2006: the model is damaged")
    values = np.cumsum(np.clip(coder.unpack(data[at:], (count, 6 if coloured else 3)), -(10**7), 10**7), axis=0)
    colours = np.clip(values[:, 3:] * COLOUR_STEP, 0, 255).astype(np.uint8) if coloured else None
    points = np.clip(values[:, :3], -(10**7), 10**7).astype(np.float64) * POINT_STEP
    model = Model(body, points, colours, np.repeat(np.arange(len(body)), counts))
    return model, Maps(residual / 10000, bool(kind & BY_CELL))


# --- residual maps (section 4) ---------------------------------------------------------------------------------------


def _atlas(model: Model, share: float) -> list[Tile | None]:
    """A place for every link's map, in shelves; None for links without points."""
    tiles = list[Tile | None]()
    shapes = list[tuple[int, int]]()
    for link in range(len(model.body)):
        own = model.links == link
        if own.sum() < 6:
            tiles.append(None)
            shapes.append((0, 0))
            continue
        points = model.points[own]
        body = model.body
        along = (points - body.origins[link]) @ body.axes[link]
        low, high = float(along.min()), max(float(along.max()), float(along.min()) + 0.02)
        cylinder = cylinder_map.cylinder(body.origins[link], body.tips[link], low, high)
        shape = cylinder_map.grid_size(int(own.sum()), float(body.radii[link]), high - low, share)
        colours = np.full((len(points), 3), 128.0) if model.colours is None else model.colours[own].astype(float)
        expected = cylinder_map.filled(cylinder_map.forward(cylinder, points, colours, shape))
        tiles.append(Tile(0, 0, cylinder, expected))
        shapes.append(shape)
    width = max(max(w for _, w in shapes), int(1.1 * np.sqrt(sum(h * w for h, w in shapes))))
    left = top = shelf = 0
    for link in sorted(range(len(tiles)), key=lambda i: -shapes[i][0]):
        tile, (h, w) = tiles[link], shapes[link]
        if tile is None:
            continue
        if left + w > width:
            left, top, shelf = 0, top + shelf, 0
        tiles[link] = tile._replace(top=top, left=left)
        left, shelf = left + w, max(shelf, h)
    return tiles


def _extent(atlas: Sequence[Tile | None]) -> tuple[int, int]:
    """(height, width) of the whole atlas."""
    some = [(t.top + t.expected.distance.shape[0], t.left + t.expected.distance.shape[1]) for t in atlas if t]
    return max(h for h, _ in some), max(w for _, w in some)


def _maps(
    model: Model, atlas: Sequence[Tile | None], pose: Pose, points: Floats, colours: NDArray[np.uint8] | None
) -> list[CylinderMap | None]:
    """The frame's points as maps on the links, which are where the stored pose puts them."""
    a, b = articulation.transforms(model.body, pose)
    links = articulated_icp.segment(model.body, a, b, points, None)
    shades = np.full((len(points), 3), 128.0) if colours is None else colours.astype(float)
    maps = list[CylinderMap | None]()
    for link, tile in enumerate(atlas):
        if tile is None:
            maps.append(None)
            continue
        own = links == link
        local, own_shades = (points[own] - b[link]) @ a[link], shades[own]
        along, _, away = cylinder_map.coordinates(tile.cylinder, local)
        near = (away < model.body.radii[link] + BEYOND) & (np.abs(along - np.clip(along, *tile.cylinder[4:])) < BEYOND)
        maps.append(cylinder_map.forward(tile.cylinder, local[near], own_shades[near], tile.expected.distance.shape))
    return maps


def _differences(atlas: Sequence[Tile | None], maps: Sequence[CylinderMap | None]) -> Residual:
    """Depth (0: no point; 128: as the model) and colour (128: as the model; half scale) of the whole atlas."""
    depth = np.zeros(_extent(atlas), np.uint8)
    colour = np.full((*depth.shape, 3), 128, np.uint8)
    for tile, found in zip(atlas, maps, strict=True):
        if tile is None or found is None:
            continue
        there = np.isfinite(found.distance)
        steps = np.where(there, found.distance - tile.expected.distance, 0) / DEPTH_STEP
        here = _window(tile)
        steps = np.where(np.abs(steps) < DEAD, 0, np.round(steps))
        depth[here] = np.where(there, np.clip(steps + 128, 1, 255), 0)
        shades = np.where(there[..., None], found.colour - tile.expected.colour, 0)
        colour[here] = np.clip(np.round(shades / 2) + 128, 0, 255)
    return Residual(depth, colour)


def _window(tile: Tile) -> tuple[slice, slice]:
    height, width = tile.expected.distance.shape
    return slice(tile.top, tile.top + height), slice(tile.left, tile.left + width)


def _frames_a_still(extent: tuple[int, int]) -> int:
    """How many frames' maps one still holds at most: what JPEG and its readers can hold."""
    height, width = extent
    return max(1, min(60_000 // height, 40_000_000 // (height * width)))


def _stills(residuals: Sequence[Residual], coloured: bool, quality: int) -> list[bytes]:
    """The frames' maps of depth as PNGs, then those of colour as JPEGs (section 5.2, table 2).

    A still holds the maps of many frames: all frames of a cell side by side (depth), or the same line of all of them
    together (colour). So they share one header and one set of tables, and what stays from frame to frame is next to
    itself, for PNG's runs and JPEG's transform. A palette of greys keeps PNG from predicting, which is worse.
    """
    image = body_stream.imaging()
    stills = list[bytes]()
    groups = _groups(len(residuals), residuals[0].depth.shape) if residuals else []
    for group in groups:
        cells = np.stack([residual.depth for residual in residuals[group]], axis=2)
        still = image.fromarray(cells.reshape(len(cells), -1))
        still.putpalette(np.repeat(np.arange(cells.max() + 1, dtype=np.uint8), 3).tobytes())
        stills.append(_saved(still, "PNG", compress_level=9, compress_type=zlib.Z_RLE))
    for group in groups if coloured else ():
        lines = np.stack([residual.colour for residual in residuals[group]], axis=1)
        still = image.fromarray(lines.reshape(-1, *lines.shape[2:]))
        stills.append(_saved(still, "JPEG", quality=quality, subsampling=2, optimize=True))
    return stills


def _saved(still: Any, kind: str, **options: Any) -> bytes:
    out = io.BytesIO()
    still.save(out, kind, **options)
    return out.getvalue()


def _groups(frames: int, extent: tuple[int, int]) -> list[slice]:
    """The frames whose maps stand in one still."""
    most = _frames_a_still(extent)
    return [slice(start, min(start + most, frames)) for start in range(0, frames, most)]


def _open_stills(
    stills: Sequence[bytes], frames: int, extent: tuple[int, int], coloured: bool, by_cell: bool
) -> list[Residual]:
    """The frames' maps back. Raises Corrupt."""
    groups = _groups(frames, extent)
    if len(stills) != len(groups) * (1 + coloured):
        raise Corrupt("lien2006: residual maps are missing")
    depth, colour = list[NDArray[np.uint8]](), list[NDArray[np.uint8]]()
    for still, group in zip(stills, groups, strict=False):
        count = group.stop - group.start
        shape = (extent[0], extent[1], count) if by_cell else (extent[0], count, extent[1])
        pixels = _open_still(still, shape[0] * (1 if by_cell else count), "P" if by_cell else "L", shape)
        depth += list(np.moveaxis(pixels, 2 if by_cell else 1, 0))
    for still, group in zip(stills[len(groups) :], groups, strict=False):
        count = group.stop - group.start
        pixels = _open_still(still, extent[0] * count, "RGB", (extent[0], count, extent[1], 3))
        colour += list(pixels.swapaxes(0, 1))
    grey = np.broadcast_to(np.uint8(128), (*extent, 3))
    return [Residual(d, c) for d, c in zip(depth, colour or [grey] * frames, strict=True)]


def _open_still(data: bytes, height: int, mode: str, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """The pixels of a still, which must be so many lines of this mode. Raises Corrupt."""
    image = body_stream.imaging()
    try:
        still = image.open(io.BytesIO(data), formats=("PNG", "JPEG"))
        if (
            still.height != height
            or still.mode != mode
            or still.width * height * len(still.getbands()) != np.prod(shape)
        ):
            raise Corrupt("lien2006: a residual map has the wrong size")
        return np.asarray(still).reshape(shape)
    except Corrupt:
        raise
    except Exception as error:
        raise Corrupt(f"lien2006: a residual map is damaged ({error})") from None


# --- chunks -----------------------------------------------------------------------------------------------------------


def _pack_chunk(poses: Integers, raw: bytes, stills: list[bytes]) -> bytes:
    """Poses, stray frames, then the stills."""
    stream = coder.pack(poses)
    sizes = varint.write([len(stream), len(raw), len(stills), *map(len, stills)])
    return b"".join([sizes, stream, raw, *stills])


def _unpack_poses(chunk: Chunk, links: int) -> tuple[Integers, bytes, list[bytes]]:
    """The poses of a chunk, its stray frames, and its stills. Raises Corrupt."""
    (size, raw, count), at = varint.read(chunk.payload, 3)
    if count > 2 * chunk.frames:
        raise Corrupt("lien2006: a chunk is damaged")
    sizes, at = varint.read(chunk.payload, count, at)
    bounds = [at, *(at + int(end) for end in itertools.accumulate([size, raw, *sizes]))]
    if bounds[-1] > len(chunk.payload):
        raise Corrupt("lien2006: a chunk is cut off")
    stream, strays, *stills = (chunk.payload[i:j] for i, j in itertools.pairwise(bounds))
    return coder.unpack(stream, (chunk.frames, 4 + 3 * links)), strays, stills


def _decode_chunk(
    model: Model, stored: Maps, atlas: Sequence[Tile | None], chunk: Chunk
) -> Iterator[tuple[Floats, NDArray[np.uint8] | None]]:
    coloured = model.colours is not None
    poses, raw, stills = _unpack_poses(chunk, len(model.body))
    is_stray = poses[:, 0] != 0
    strays = iter(body_stream.unpack_raw(raw, int(is_stray.sum()), coloured))
    bodies = int((~is_stray).sum())
    if stills and not atlas:
        raise Corrupt("lien2006: residual maps without a grid")
    maps = iter(_open_stills(stills, bodies, _extent(atlas), coloured, stored.by_cell) if stills else [None] * bodies)
    for row, stray in zip(poses, is_stray, strict=True):
        if stray:
            yield next(strays)
        else:
            pose = body_stream.dequantise(model.body, row[1:], STEPS)
            yield _posed(model, atlas, pose, next(maps), stored.depth_step)


def _corrected(
    model: Model, link: int, tile: Tile, there: NDArray[np.bool_], farther: Floats, brighter: Floats
) -> tuple[Floats, Floats]:
    """A link's points with the differences of their cells added; and a point in every cell that has one but no model's.

    A cell of a small grid holds several of the model's points, each of which it moves: so a quarter of the full maps
    still makes as many points as the model has.
    """
    own = model.links == link
    points = model.points[own]
    cell, distance = cylinder_map.cells(tile.cylinder, points, (there.shape[0], there.shape[1]))
    seen = there.ravel()[cell]
    along, _, _ = cylinder_map.coordinates(tile.cylinder, points)
    out = points - tile.cylinder.origin - along[:, None] * tile.cylinder.axis
    out /= np.maximum(distance, 1e-6)[:, None]
    moved = points[seen] + (out * farther.ravel()[cell][:, None])[seen]
    shades = np.full((len(points), 3), 128.0) if model.colours is None else model.colours[own].astype(np.float64)
    shades = (shades + brighter.reshape(-1, 3)[cell])[seen]
    empty = there.copy()
    empty.reshape(-1)[cell] = False
    fresh = CylinderMap(np.where(empty, tile.expected.distance + farther, np.nan), tile.expected.colour + brighter)
    more, more_shades = cylinder_map.inverse(tile.cylinder, fresh)
    return np.concatenate([moved, more]), np.concatenate([shades, more_shades])


def _posed(
    model: Model, atlas: Sequence[Tile | None], pose: Pose, residual: Residual | None, depth_step: float
) -> tuple[Floats, NDArray[np.uint8] | None]:
    """A frame's points: the model's, or those of the residual maps."""
    a, b = articulation.transforms(model.body, pose)
    if residual is None:
        return np.einsum("nij,nj->ni", a[model.links], model.points) + b[model.links], model.colours
    points, shades = list[Floats](), list[Floats]()
    for link, tile in enumerate(atlas):
        if tile is None:
            continue
        here = _window(tile)
        there = residual.depth[here] > 0
        farther = (residual.depth[here].astype(np.float64) - 128) * depth_step
        brighter = 2 * (residual.colour[here].astype(np.float64) - 128)
        local, c = _corrected(model, link, tile, there, farther, brighter)
        points.append(local @ a[link].T + b[link])
        shades.append(c)
    colours = np.clip(np.round(np.concatenate(shades)), 0, 255).astype(np.uint8) if model.colours is not None else None
    return np.concatenate(points), colours
