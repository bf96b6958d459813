"""Bodycast: point clouds of people as moving, skinned bodies with their surfaces in a video.

    first frame ─► bodies of links ─► trackers: all joints at once ─► poses ─► spectra ─► entropy coder
                                          │
            points of all frames, brought back into the first pose ─► atlas: one picture of the surface, stored once
                                          │                              └─ what changes from frame to frame ─► H.265
            points that no body explains ─► cells of a centimetre, as an octree; or all points, exactly

The modern form of Lien and Bajcsy (2006): `docs/papers/lien2006.md` says what is theirs and what is not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ... import progress
from ...encoded import Chunk, Encoded
from ...errors import BadInput, CannotEncode, Corrupt
from ...formats.gltf import Surface
from ...geometry.body_matching import FramePoints
from ...motion import Motion
from ...pointcloud import PointClouds
from .. import base, body_stream
from . import chunks, exact, model, poses, video
from .atlas import Atlas, Labels, Sums, picture
from .follow import FEWEST, Cloud, Follower, Sighting, begin, enter, shared_out
from .model import Model
from .poses import Scale, Track
from .stage import Actor, Stage
from .strangers import pack_strangers, unexplained
from .weave import valid_cells

HIDDEN = 1.35  # cells for each that is surface: the others lie inside joints
SURVEYED = 48  # frames that the surface which is stored once is made from
LEARNT = 14  # frames from which it is learned what a point moves with
KEEP = 0.7  # of what a cell held counts on when new points fall into it
FIRST_WEIGHT = 3.0  # points that the first picture counts for in each cell
STILL = 25  # percent of the residual up to which nothing moves but the poses
EXACT = "exact"

__all__ = ["Bodycast", "Role", "begin", "models"]


@dataclass(frozen=True)
class Bodycast:
    """Settings.

    residual: how well surface and poses follow the data, in percent. From 0 to 25 the poses and the one picture of the
    surface become finer; above that, pictures of what changes are sent too, the better and the more often the higher;
    "exact" sends every point as it is. precision: of exact points, metres; 0 keeps all bits of 32-bit
    floats. skeleton: a Motion, or a file of one, whose first frame is the pose of the first frame, or a list of them
    for several people; fitted where none is given. people: so many are followed, at most; what others there are is
    coded as points. pose_step: metres that the surface moves for one step of a joint. points: of a decoded frame; as
    many as a frame has unless given. cells: of the picture of the surface. surface_quality: of that picture, as x265's
    rate factor (lower is better); these three are those of residual 0. strangers: code what no body explains.
    tracked_points: of a frame, at most, that are looked at.
    """

    name: ClassVar[str] = "bodycast"
    residual: float | str = 0
    skeleton: Any = None
    people: int = 4
    precision: float = 0.0
    pose_step: float = 0.003
    points: int | None = None
    cells: int = 10_000
    surface_quality: int = 30
    strangers: bool = True
    tracked_points: int = 2500
    chunk_frames: int = 150

    def encode(self, clouds: PointClouds) -> Encoded[PointClouds]:
        """Raises CannotEncode where no frame shows a body, BadInput for settings or a skeleton that cannot be used."""
        if isinstance(clouds, Motion):
            raise CannotEncode("bodycast codes point clouds, not motions")
        self._require_settings()
        frames = [body_stream.clean(clouds, frame) for frame in range(len(clouds))]
        first = next((i for i, (points, _) in enumerate(frames) if len(points) >= 4 * FEWEST), None)
        if first is None:
            raise CannotEncode(f"no frame has {4 * FEWEST} points or more: there is no body to code")
        skeletons = (
            [] if self.skeleton is None else self.skeleton if isinstance(self.skeleton, list) else [self.skeleton]
        )
        followers = enter(frames[first], skeletons, clouds.up, self.tracked_points, self.people)
        with progress.phase(0.0, 0.6):
            cast = self._follow(followers, frames, first)
        coloured = clouds.colours is not None
        usual = int(np.mean([len(points) for points, _ in frames[first:] if len(points) >= FEWEST]))
        for role in cast:
            role.prepare(self, usual, coloured, len(cast))
        here = range(0, len(frames), self.chunk_frames)
        spans = [slice(start, min(start + self.chunk_frames, len(frames))) for start in here]
        told = frames
        if self.residual == EXACT:
            told = [body_stream.clean(clouds, i, float(np.finfo(np.float32).max)) for i in range(len(clouds))]
        with progress.phase(0.7, 1.0):
            written = [
                Chunk(s.start, s.stop - s.start, self._chunk(cast, told, s, coloured)) for s in progress.over(spans)
            ]
        settings = base.settings(self)
        if self.skeleton is not None:
            settings["skeleton"] = [s if isinstance(s, str) else "given" for s in skeletons]
        colours = [] if coloured else None
        like = PointClouds([], clouds.rate, colours, None, clouds.up, clouds.source, clouds.extras)
        return Encoded(self.name, like, written, tuple(model.pack(role.model) for role in cast), settings=settings)

    def _require_settings(self) -> None:
        percent = self.residual if isinstance(self.residual, int | float) else 0.0
        if (isinstance(self.residual, str) and self.residual != EXACT) or not 0 <= percent <= 100:
            raise BadInput(f'residual is a percentage from 0 to 100, or "{EXACT}"')
        if not 100 <= self.cells <= 1_000_000 or not (self.points is None or 1 <= self.points <= model.MOST_POINTS):
            raise BadInput("cells is a number from 100 to a million, points one from 1 to a million")
        if not 1e-4 <= self.pose_step <= 1 or not 0 <= self.precision <= 1 or self.chunk_frames < 1 or self.people < 1:
            raise BadInput(
                "pose_step is 0.1 mm to a metre, precision at most a metre; people, chunk_frames at least one"
            )

    @property
    def fineness(self) -> Fineness:
        """What the residual asks for; exact points need neither fine poses nor pictures."""
        percent = 0.0 if isinstance(self.residual, str) else self.residual
        still, moving = min(percent / STILL, 1.0), max(percent - STILL, 0.0) / (100 - STILL)
        quality = max(self.surface_quality - round(8 * still), 0)
        every = max(1, round(1 / moving)) if moving else 0
        step = self.pose_step * 4.0**-still
        return Fineness(
            step, round(self.cells * 2.0**still), quality, min(quality + round(14 * (1 - moving)), 51), every
        )

    def _follow(self, followers: list[Follower], frames: list[Cloud], first: int) -> list[Role]:
        """Every body through all frames."""
        cast = [Role(follower) for follower in followers]
        for i, (points, colours) in progress.over(list(enumerate(frames))):
            whose = shared_out(points, followers) if i >= first else np.full(len(points), -1)
            for number, role in enumerate(cast):
                rows = slice(None) if len(cast) == 1 else np.flatnonzero(whose == number)
                own = points[rows], None if colours is None else colours[rows]
                role.watch(i, own if i >= first else (points[:0], colours), started=i > first)
        return cast

    def _chunk(self, cast: list[Role], frames: list[Cloud], span: slice, coloured: bool) -> bytes:
        """Poses, stray frames, strangers and the pictures of a run of frames."""
        here = range(span.start, span.stop)
        absent = np.array([[not role.there[i] for role in cast] for i in here], bool)
        plays = list[chunks.Play]()
        for role in cast:
            stream = poses.pack(role.follower.body, Track.of(role.poses[span]), role.model.scale)
            role.stored = poses.unpack(role.follower.body, stream, len(here), role.model.scale)
            moving = self._pictures(role, span) if self.fineness.every and any(role.there[i] for i in here) else []
            plays.append(chunks.Play(stream, tuple(moving)))
        if self.residual == EXACT:
            points = exact.pack([frames[i] for i in here], self.precision, coloured)
            return chunks.pack(chunks.Parts(absent, b"", b"", points, tuple(plays)))
        nobody = [not any(role.there[i] for role in cast) for i in here]
        others = list[Cloud]()
        for k, i in enumerate(here):
            share = max((r.unexplained[i] for r in cast if r.there[i]), default=0.0)
            if self.strangers and not nobody[k] and (share >= 0.01 or len(cast) > 1):
                bodies = [r.follower.surface(r.stored[k]) for r in cast if r.there[i]]
                others.append(unexplained(frames[i], np.concatenate(bodies)))
            else:
                points, colours = frames[i]
                others.append((points[:0], None if colours is None else colours[:0]))
        strays = body_stream.pack_raw([frames[i] for k, i in enumerate(here) if nobody[k]])
        return chunks.pack(chunks.Parts(absent, strays, pack_strangers(others, coloured), b"", tuple(plays)))

    def _pictures(self, role: Role, span: slice) -> list[bytes]:
        """The changing surface as packets that follow the key packet."""
        atlas, planes, fine = role.model.atlas, role.planes, self.fineness

        def changing() -> Iterator[NDArray[np.uint8]]:
            yield planes
            sums = Sums.showing(atlas, planes, FIRST_WEIGHT)
            for first in range(span.start, span.stop, fine.every):
                for i in range(first, min(span.stop, first + fine.every)):
                    if role.there[i]:
                        seen = role.sight(i, role.stored[i - span.start])
                        sums.gather(atlas, seen.points, seen.links, seen.colours, KEEP)
                yield picture(atlas, sums)

        packets = video.encode(changing(), fine.quality, fine.moving)
        return [packets[0] if packets[0] != role.model.key else b"", *packets[1:]]

    @staticmethod
    def decode(encoded: Encoded[PointClouds], frames: slice | None = None) -> PointClouds:
        """The point clouds, or a slice of their frames. Raises Corrupt."""
        stage = Stage(models(encoded))
        positions, colours = list[NDArray[np.float64]](), list[NDArray[np.uint8]]()
        start, stop = encoded.range(frames)
        for chunk in progress.over(encoded.covering(start, stop)):
            here = max(0, start - chunk.start), min(chunk.frames, stop - chunk.start)
            for points, colour in stage.play(chunk, *here):
                positions.append(points)
                colours.append(np.zeros((len(points), 3), np.uint8) if colour is None else colour)
        like, coloured = encoded.about, stage.coloured
        return PointClouds(positions, like.rate, colours if coloured else None, None, like.up, like.source, like.extras)

    @staticmethod
    def track(encoded: Encoded[PointClouds], frames: slice | None = None, body: int = 0) -> Motion:
        """A tracked body, the first unless told: markerless motion capture, to be written as BVH. Raises Corrupt."""
        known = models(encoded)
        if not 0 <= body < len(known):
            raise BadInput(f"there are {len(known)} bodies, counted from 0, and no number {body}")
        chosen = known[body]
        start, stop = encoded.range(frames)
        found = list[Any]()
        for chunk in encoded.covering(start, stop):
            play = chunks.unpack(chunk, len(known)).plays[body]
            track = poses.unpack(chosen.atlas.body, play.poses, chunk.frames, chosen.scale)
            found += [track[i] for i in range(chunk.frames) if start <= chunk.start + i < stop]
        return body_stream.track(encoded, chosen.atlas.body, found)

    @staticmethod
    def surface(encoded: Encoded[PointClouds], body: int = 0) -> Surface:
        """The surface of a body for the joints of `track`: what a GLB shows. Raises Corrupt."""
        chosen = models(encoded)[body]
        actor = Actor(chosen)
        joints, rest = body_stream.joints_of_track(actor.body)
        weights = np.stack([actor.skin.weights, 1 - actor.skin.weights], axis=1)
        colours = actor.colours if chosen.coloured else None
        return Surface(actor.skin.points, colours, joints[actor.skin.links], weights, rest)


def models(encoded: Encoded[PointClouds]) -> list[Model]:
    """Every body of a recording. Raises Corrupt."""
    known = [model.unpack(data) for data in encoded.shared]
    if not known:
        raise Corrupt("bodycast: the model is missing")
    return known


class Fineness(NamedTuple):
    """step: of poses. cells, quality: of the picture of the surface. moving: x265's rate factor of its changes. every:
    frames from one of those to the next, 0 where there are none.
    """

    step: float
    cells: int
    quality: int
    moving: int
    every: int


class Role:
    """A body while it is encoded: its poses in all frames, and the model that is made of it."""

    def __init__(self, follower: Follower) -> None:
        self.follower = follower
        self.clouds, self.poses = list[Cloud](), list[Any]()
        self.there, self.unexplained = list[bool](), list[float]()
        self.model: Model
        self.planes: NDArray[np.uint8]
        self.stored: Track

    def watch(self, frame: int, cloud: Cloud, started: bool) -> None:
        """One frame of the points that are this body's, or of none before it has come."""
        points, colours = cloud
        there = len(points) >= FEWEST
        if there:
            found = (
                self.follower.fit(points, colours, frame) if started else self.follower.begin(points, colours, frame)
            )
            self.unexplained.append(float(np.mean(found.residuals > 0.08)) if len(found.residuals) else 0.0)
        else:
            self.unexplained.append(0.0)
        self.clouds.append(cloud)
        self.poses.append(self.follower.tracker.pose)
        self.there.append(there)

    def sight(self, frame: int, pose: Any) -> Sighting:
        return self.follower.sight(self.look_closely(frame), pose)

    def _surveyed(self, there: Labels, closely: bool) -> list[Sighting]:
        """What was seen of the surface in some of the frames in which the body is there. closely: the poses of all of
        them are first brought closer to their points.
        """
        some = set(there[np.linspace(0, len(there) - 1, min(SURVEYED, len(there))).round().astype(int)].tolist())
        seen = list[Sighting]()
        for i in there.tolist() if closely else sorted(some):
            data = self.look_closely(i)
            if closely:
                self.poses[i] = self.follower.refined(data, self.poses[i])
            if i in some:
                seen.append(self.follower.sight(data, self.poses[i]))
        return seen

    def look_closely(self, frame: int) -> FramePoints:
        return self.follower.look_closely(*self.clouds[frame], frame)

    def prepare(self, codec: Bodycast, usual: int, coloured: bool, roles: int) -> None:
        """Make the model: the means of all that was seen, fused over time in the canonical pose."""
        body, there, fine = self.follower.body, np.flatnonzero(self.there), codec.fineness
        if len(there) >= 8:
            some = there[np.linspace(0, len(there) - 1, min(LEARNT, len(there))).round().astype(int)].tolist()
            self.follower.learn([self.clouds[i] for i in some], [self.poses[i] for i in some])
        scale = Scale.of(body, self.follower.tracker.skin, fine.step)
        seen = self._surveyed(there, closely=len(there) >= 8 and fine.step < codec.pose_step)
        places, links = np.concatenate([s.points for s in seen]), np.concatenate([s.links for s in seen])
        few = np.random.default_rng(0).permutation(len(places))[:60_000]
        atlas = Atlas.plan(body, places[few], links[few], round(HIDDEN * min(fine.cells, len(places))))
        if not atlas.tiles:
            raise CannotEncode("nothing was seen of the body's surface: does the skeleton fit the person?")
        sums = Sums.empty(atlas)
        sums.gather(atlas, places, links, np.concatenate([s.colours for s in seen]))
        self.planes = picture(atlas, sums)
        key = video.encode([self.planes], fine.quality, fine.moving)[0]
        own = usual if roles == 1 else int(np.mean([len(self.clouds[i][0]) for i in there]))
        shown = codec.points or max(own, 1)
        valid = valid_cells(atlas, self.planes, sums)
        self.model = Model(atlas, scale, valid, key, coloured, min(shown, model.MOST_POINTS), fine.every or 1)
