"""Bodycast: point clouds of a person as a moving, skinned body with its surface in a video.

    first frame ─► body of links ─► tracker: all joints at once ─► poses ─► entropy coder
                                        │
          points of all frames, brought back into the first pose ─► atlas: one picture of the whole surface, stored once
                                        │                              └─ what changes from frame to frame ─► H.265
          points that no part of the body explains ─► cells of a centimetre, sorted, entropy coded

The modern form of Lien and Bajcsy (2006): `docs/papers/lien2006.md` says what is theirs and what is not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...encoded import Chunk, Encoded
from ...entropy import coder, varint
from ...errors import BadInput, CannotEncode, Corrupt
from ...geometry import articulated_icp, articulation, body_fit, body_tracking, skinning
from ...geometry.articulation import Body, Floats, Pose
from ...motion import Motion
from ...pointcloud import PointClouds
from .. import base, body_stream
from ..body_stream import Steps
from . import video
from .atlas import Atlas, Sums, picture, surface
from .strangers import pack_strangers, strangers, unpack_strangers

Integers = NDArray[np.int64]
Labels = NDArray[Any]
Cloud = tuple[Floats, NDArray[np.uint8] | None]
STEPS = Steps(reach=0.010, place=0.004)
FEWEST = 50  # points that a frame must have to be a body
TEMPLATE = 3000  # points of the first frame that the tracker keeps
HIDDEN = 1.35  # cells for each that is surface: the others lie inside joints
DETAIL = 5000  # points of a frame that the moving surface is made from
KEEP = 0.4  # of what a cell held counts on when new points fall into it


class Model(NamedTuple):
    """What the decoder knows before the first chunk."""

    atlas: Atlas
    valid: NDArray[np.bool_]
    key: bytes
    coloured: bool


@dataclass(frozen=True)
class Bodycast:
    """Settings.

    residual: how well the moving surface follows the data, in percent; 0 sends the surface once and then poses alone.
    skeleton: a Motion, or a file of one, whose first frame is the pose of the first frame; fitted where none is given.
    cells: of the surface, and about the number of points of a decoded frame; those of the first frame unless given.
    surface_quality: of the surface that is sent once, x265's rate factor (lower is better). strangers: code what the
    body does not explain. tracked_points: of a frame, at most, that are looked at.
    """

    name: ClassVar[str] = "bodycast"
    residual: float = 0
    skeleton: Any = None
    cells: int | None = None
    surface_quality: int = 26
    strangers: bool = True
    tracked_points: int = 1000
    chunk_frames: int = 150

    def encode(self, clouds: PointClouds) -> Encoded[PointClouds]:
        """Raises CannotEncode where no frame shows a body, BadInput for settings or a skeleton that cannot be used."""
        if isinstance(clouds, Motion):
            raise CannotEncode("bodycast codes point clouds, not motions")
        if not 0 <= self.residual <= 100 or (self.cells is not None and not 100 <= self.cells <= 1_000_000):
            raise BadInput("residual is a percentage from 0 to 100, cells a number from 100 to a million")
        frames = [body_stream.clean(clouds, frame) for frame in range(len(clouds))]
        first = next((i for i, (points, _) in enumerate(frames) if len(points) >= 4 * FEWEST), None)
        if first is None:
            raise CannotEncode(f"no frame has {4 * FEWEST} points or more: there is no body to code")
        body, tracker = begin(*frames[first], self.skeleton, clouds.up, self.tracked_points)
        poses, sightings = self._follow(tracker, frames, first)
        atlas, sums = self._survey(body, sightings, len(frames[first][0]))
        planes = picture(atlas, sums)
        key = video.encode([planes], self.surface_quality, self._moving_quality())[0]
        model = Model(atlas, valid_cells(atlas, sums), key, clouds.colours is not None)
        chunks = list[Chunk]()
        for start in range(0, len(frames), self.chunk_frames):
            rows = slice(start, start + self.chunk_frames)
            chunks.append(Chunk(start, len(poses[rows]), self._chunk(model, planes, frames, poses, sightings, rows)))
        settings = base.settings(self)
        if self.skeleton is not None:
            settings["skeleton"] = "given" if isinstance(self.skeleton, Motion) else str(self.skeleton)
        like = PointClouds(
            [], clouds.rate, None if clouds.colours is None else [], None, clouds.up, clouds.source, clouds.extras
        )
        return Encoded(self.name, like, chunks, (pack_model(model),), settings=settings)

    def _follow(
        self, tracker: body_tracking.Tracker, frames: list[Cloud], first: int
    ) -> tuple[Integers, list[Sighting | None]]:
        """Poses in steps, (frames, 1 + 3 + 3 links) with a flag for frames without a body; and what was seen in
        each.
        """
        previous = np.zeros(3 + 3 * len(tracker.body), np.int64)
        poses, sightings = list[Integers](), list[Sighting | None]()
        for i, (points, colours) in enumerate(frames):
            is_body = len(points) >= FEWEST and i >= first
            if is_body:
                found = tracker.fit(points, colours, i) if i > first else tracker.see(points, colours, i)
                if self.residual:
                    found = tracker.see(points, colours, i, DETAIL)
                previous = body_stream.quantise(tracker.body, found.pose, STEPS, previous)
                sightings.append(sight(tracker, found, body_stream.dequantise(tracker.body, previous, STEPS)))
            else:
                sightings.append(None)
            poses.append(np.concatenate([[not is_body], previous]))
        return np.array(poses), sightings

    def _survey(self, body: Body, sightings: list[Sighting | None], points: int) -> tuple[Atlas, Sums]:
        """The atlas, and in it the means of all that was seen: fusion over time in the canonical pose."""
        seen = [s for s in sightings if s is not None]
        places, links = np.concatenate([s.points for s in seen]), np.concatenate([s.links for s in seen])
        some = np.random.default_rng(0).permutation(len(places))[:60_000]
        atlas = Atlas.plan(body, places[some], links[some], round(HIDDEN * (self.cells or points)))
        sums = Sums.empty(atlas)
        sums.gather(atlas, places, links, np.concatenate([s.colours for s in seen]))
        return atlas, sums

    def _chunk(
        self,
        model: Model,
        planes: NDArray[np.uint8],
        frames: list[Cloud],
        poses: Integers,
        sightings: list[Sighting | None],
        rows: slice,
    ) -> bytes:
        """Poses, stray frames, strangers and the pictures of a run of frames."""
        here = list(range(*rows.indices(len(frames))))
        strays = body_stream.pack_raw([frames[i] for i in here if sightings[i] is None])
        others = list[Cloud]()
        for i in here:
            sighting = sightings[i]
            if sighting is not None:
                others.append(strangers(frames[i], sighting.unexplained, sighting.body) if self.strangers else _none())
        packets = self._pictures(model, planes, [s for i in here if (s := sightings[i]) is not None])
        stream = coder.pack(poses[rows])
        foreign = pack_strangers(others, model.coloured)
        head = varint.write([len(stream), len(strays), len(foreign), *(len(p) for p in packets)])
        return head + stream + strays + foreign + b"".join(packets)

    def _pictures(self, model: Model, planes: NDArray[np.uint8], seen: list[Sighting]) -> list[bytes]:
        """The changing surface as packets that follow the key packet."""
        if not self.residual or not seen:
            return []

        def changing() -> Iterator[NDArray[np.uint8]]:
            yield planes
            sums = Sums.empty(model.atlas)
            self._begin_from(model.atlas, planes, sums)
            for sighting in seen:
                sums.gather(model.atlas, sighting.points, sighting.links, sighting.colours, KEEP)
                yield picture(model.atlas, sums)

        packets = video.encode(changing(), self.surface_quality, self._moving_quality())
        own_key = packets[0] if packets[0] != model.key else b""
        return [own_key, *packets[1:]]

    def _moving_quality(self) -> int:
        """x265's rate factor of the changes of the surface."""
        return self.surface_quality + round(14 * (1 - self.residual / 100))

    def _begin_from(self, atlas: Atlas, planes: NDArray[np.uint8], sums: Sums, weight: float = 3.0) -> None:
        """Fill the running sums with what the first picture shows."""
        _, _, count = sums.means(atlas)
        points, links, colours = surface(atlas, planes, np.ones(count.shape, bool))
        sums.gather(atlas, points, links, colours.astype(float))
        sums.values *= weight

    @staticmethod
    def decode(encoded: Encoded[PointClouds], frames: slice | None = None) -> PointClouds:
        """The point clouds, or a slice of their frames. Raises Corrupt."""
        model = unpack_model(encoded.shared)
        stage = Stage(model)
        positions, colours = list[Floats](), list[NDArray[np.uint8]]()
        start, stop = encoded.range(frames)
        for chunk in encoded.covering(start, stop):
            for i, (points, colour) in enumerate(stage.play(chunk, start - chunk.start, stop - chunk.start)):
                if start <= chunk.start + i < stop:
                    positions.append(points)
                    colours.append(np.zeros((len(points), 3), np.uint8) if colour is None else colour)
        like = encoded.about
        return PointClouds(
            positions, like.rate, colours if model.coloured else None, None, like.up, like.source, like.extras
        )

    @staticmethod
    def track(encoded: Encoded[PointClouds], frames: slice | None = None) -> Motion:
        """The tracked body: markerless motion capture, to be written as BVH. Raises Corrupt."""
        body = unpack_model(encoded.shared).atlas.body
        start, stop = encoded.range(frames)
        poses = list[Pose]()
        for chunk in encoded.covering(start, stop):
            rows = split_chunk(chunk, len(body)).poses
            poses += [
                body_stream.dequantise(body, r[1:], STEPS)
                for i, r in enumerate(rows)
                if start <= chunk.start + i < stop
            ]
        return body_stream.track(encoded, body, poses)


class Sighting(NamedTuple):
    """What was seen of the body in a frame: canonical points (n, 3), links, colours; and whether there was more."""

    points: Floats
    links: Labels
    colours: Floats
    unexplained: float
    body: Floats


def begin(
    points: Floats, colours: NDArray[np.uint8] | None, skeleton: Any, up: str, looked_at: int
) -> tuple[Body, body_tracking.Tracker]:
    """The body of the first frame, as its bytes will give it back, and a tracker that follows it."""
    if skeleton is None:
        body = body_fit.first_pose(points, up).body()
    else:
        motion = body_stream.skeleton_motion(skeleton)
        assert motion.skeleton is not None
        body = articulation.from_skeleton(motion.skeleton.names, motion.skeleton.parents, motion.positions[0])
        body_fit.require_near(body, points)
    some = np.random.default_rng(0).permutation(len(points))[:8000]
    some = some[articulated_icp.is_near(body, points[some])][:6000]
    if len(some) < 2 * FEWEST:
        raise BadInput("the skeleton does not stand in the first frame's points: it must have its place, pose and unit")
    shades = None if colours is None else colours[some]
    body, model = articulated_icp.make_model(body, points[some], shades, by_surface=True)
    body = body_stream.rounded(body)
    few = slice(0, TEMPLATE)
    skin = skinning.skin(body, model.points[few], model.links[few])
    shades = None if model.colours is None else model.colours[few]
    settings = body_tracking.Settings(points=looked_at)
    return body, body_tracking.Tracker(body, skin, model.normals[few], shades, settings)


def sight(tracker: body_tracking.Tracker, found: body_tracking.Fit, pose: Pose, near: float = 0.04) -> Sighting:
    """The points of a frame brought back into the canonical pose, from the pose as it is stored."""
    a, b = articulation.transforms(tracker.body, pose)
    data, rows = found.data, found.rows
    away = np.linalg.norm(data.points - tracker.skin.posed(a, b, rows), axis=1)
    good = away < near
    canonical = tracker.skin.unposed(a, b, rows[good], data.points[good])
    # where a joint folds the blend of two turns, almost nothing comes back near to where it came from
    held = np.linalg.norm(canonical - tracker.skin.points[rows[good]], axis=1) < 1.5 * near
    good[good] = held
    canonical = canonical[held]
    colours = np.full((int(good.sum()), 3), 128.0) if data.colours is None else data.colours[good].astype(float)
    lost = float(np.mean(away > 2 * near)) if len(good) else 0.0
    body = tracker.skin.posed(a, b)
    return Sighting(canonical, tracker.skin.links[rows[good], 0], colours, lost, body)


def _none() -> Cloud:
    return np.zeros((0, 3)), np.zeros((0, 3), np.uint8)


def valid_cells(atlas: Atlas, sums: Sums) -> NDArray[np.bool_]:
    """Cells that hold a fifth or more of the usual number of points: those hidden in joints do not."""
    count = sums.values[0].reshape(atlas.height, atlas.width)
    some = count[count > 0]
    return count >= max(1.0, 0.2 * float(np.median(some)) if some.size else 1.0)


# --- bytes ----------------------------------------------------------------------------------------------------------


def pack_model(model: Model) -> bytes:
    """Body, atlas, the cells that are surface, and the key packet."""
    cells = coder.pack(model.valid.astype(np.int64))
    sizes = varint.write([model.coloured, len(cells), len(model.key)])
    return body_stream.pack_body(model.atlas.body) + model.atlas.pack() + sizes + cells + model.key


def unpack_model(shared: Sequence[bytes]) -> Model:
    """Raises Corrupt."""
    if len(shared) != 1:
        raise Corrupt("bodycast: the model is missing")
    body, at = body_stream.unpack_body(shared[0])
    atlas, at = Atlas.unpack(body, shared[0], at)
    (coloured, cells, key), at = varint.read(shared[0], 3, at)
    if coloured > 1 or at + cells + key != len(shared[0]):
        raise Corrupt("bodycast: the model is damaged")
    valid = coder.unpack(shared[0][at : at + cells], (atlas.height, atlas.width)) != 0
    return Model(atlas, valid & (atlas.reach() > 0), shared[0][at + cells :], bool(coloured))


class Parts(NamedTuple):
    poses: Integers
    strays: bytes
    foreign: bytes
    packets: list[bytes]


def split_chunk(chunk: Chunk, links: int) -> Parts:
    """A chunk's streams. Raises Corrupt."""
    data = chunk.payload
    (stream, strays, foreign), at = varint.read(data, 3)
    # the sizes of packets follow the three streams' sizes until the sizes add up to what is left
    sizes, room = list[int](), 0
    while at + stream + strays + foreign + room < len(data):
        (size,), at = varint.read(data, 1, at)
        sizes.append(size)
        room += size
        if len(sizes) > chunk.frames + 1:
            break
    if at + stream + strays + foreign + room != len(data) or len(sizes) > chunk.frames + 1:
        raise Corrupt("bodycast: a chunk is damaged")
    poses = coder.unpack(data[at : at + stream], (chunk.frames, 4 + 3 * links))
    at += stream
    ends = at + strays + foreign + np.cumsum([0, *sizes])
    packets = [data[i:j] for i, j in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)]
    return Parts(poses, data[at : at + strays], data[at + strays : at + strays + foreign], packets)


class Stage:
    """Plays chunks: poses the surface that a model's key packet shows, frame by frame."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.body = model.atlas.body
        self.planes = next(video.decode([model.key], model.atlas.picture_shape))
        self.points, self.links, self.colours = surface(model.atlas, self.planes, model.valid)
        self.skin = skinning.skin(self.body, self.points, self.links)

    def play(self, chunk: Chunk, start: int, stop: int) -> Iterator[Cloud]:
        """The frames of a chunk; those outside [start, stop) may come without points."""
        parts = split_chunk(chunk, len(self.body))
        strays = parts.poses[:, 0] != 0
        bodies = int((~strays).sum())
        raw = iter(body_stream.unpack_raw(parts.strays, int(strays.sum()), self.model.coloured))
        others = iter(unpack_strangers(parts.foreign, bodies, self.model.coloured))
        if parts.packets and len(parts.packets) != bodies + 1:
            raise Corrupt("bodycast: pictures are missing")
        key = parts.packets[0] or self.model.key if parts.packets else b""
        pictures = video.decode([key, *parts.packets[1:]], self.model.atlas.picture_shape) if parts.packets else None
        if pictures is not None:
            next(pictures)
        for i, (row, stray) in enumerate(zip(parts.poses, strays, strict=True)):
            if stray:
                yield next(raw)
                continue
            planes = None if pictures is None else next(pictures)
            more = next(others)
            if not start <= i < stop:
                yield _none()
                continue
            cloud = self.posed(body_stream.dequantise(self.body, row[1:], STEPS), planes)
            yield _joined(cloud, more) if len(more[0]) else cloud

    def posed(self, pose: Pose, planes: NDArray[np.uint8] | None = None) -> Cloud:
        """The surface in a pose, as the picture shows it, or as it was first."""
        skin, colours = self.skin, self.colours
        if planes is not None:
            points, _, colours = surface(self.model.atlas, planes, self.model.valid)
            skin = skinning.Skin(points, skin.links, skin.weights)
        a, b = articulation.transforms(self.body, pose)
        return skin.posed(a, b), colours if self.model.coloured else None


def _joined(cloud: Cloud, more: Cloud) -> Cloud:
    colours = None if cloud[1] is None or more[1] is None else np.concatenate([cloud[1], more[1]])
    return np.concatenate([cloud[0], more[0]]), colours
