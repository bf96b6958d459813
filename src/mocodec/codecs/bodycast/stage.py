"""Plays chunks: puts the surfaces that the models' pictures show into their poses, frame by frame.

pictures ──weave──► canonical points ──┐
poses ────────────► transforms ────────┴─► points in the world, with those that no body explains
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ...encoded import Chunk
from ...errors import Corrupt
from ...geometry import articulation, skinning
from ...geometry.articulation import Floats, Pose
from .. import body_stream
from . import chunks, exact, poses, video
from .model import Model
from .strangers import unpack_strangers
from .weave import Weave, weave

Cloud = tuple[Floats, NDArray[np.uint8] | None]
AT_ONCE = 32  # frames that are posed together


class Actor:
    """One body of a scene, with its surface."""

    def __init__(self, model: Model) -> None:
        self.model, self.body = model, model.atlas.body
        planes = next(video.decode([model.key], model.atlas.picture_shape))
        self.weave: Weave = weave(model.atlas, planes, model.valid, model.points)
        points, self.colours = self.weave.surface(planes)
        self.skin = skinning.blended(self.body, points, self.weave.links, self.weave.normals)
        self.rig = skinning.SkinMatrix.build(self.skin, len(self.body))

    def posed(self, pose: Pose) -> Floats:
        """(…, n, 3): the surface as it was first, in the poses of (…) frames."""
        return self.rig.posed(*articulation.transforms(self.body, pose))

    def perform(self, play: chunks.Play, frames: int, start: int, stop: int) -> Iterator[Cloud]:
        """Frames [start, stop) of a chunk. Raises Corrupt."""
        track = poses.unpack(self.body, play.poses, frames, self.model.scale)
        if play.pictures:
            yield from self._moving(track, play, frames, start, stop)
            return
        for first in range(start, stop, AT_ONCE):
            for points in self.posed(track[first : min(stop, first + AT_ONCE)]):
                yield points, self.colours

    def _moving(self, track: poses.Track, play: chunks.Play, frames: int, start: int, stop: int) -> Iterator[Cloud]:
        every = self.model.every
        if len(play.pictures) != 1 + -(-frames // every):
            raise Corrupt("bodycast: pictures are missing")
        if stop <= start:
            return
        packets = [play.pictures[0] or self.model.key, *play.pictures[1:]]
        shown = video.decode(packets, self.model.atlas.picture_shape)
        a, b = track.transforms(self.body)
        for i, planes in enumerate(islice(shown, 1, None)):
            here = range(max(start, i * every), min(stop, frames, (i + 1) * every))
            if here:
                points, colours = self.weave.surface(planes)
                rig = self.rig.with_points(points)
                for frame in here:
                    yield rig.posed(a[frame], b[frame]), colours


class Stage:
    """All bodies of a recording."""

    def __init__(self, models: Sequence[Model]) -> None:
        self.actors = [Actor(model) for model in models]
        self.coloured = models[0].coloured

    def play(self, chunk: Chunk, start: int, stop: int) -> Iterator[Cloud]:
        """Frames [start, stop) of a chunk, counted from its first. Raises Corrupt."""
        parts = chunks.unpack(chunk, len(self.actors))
        if parts.exact:
            yield from exact.unpack(parts.exact, chunk.frames, self.coloured)[start:stop]
            return
        nobody = [bool(row.all()) for row in parts.absent]
        raw = iter(body_stream.unpack_raw(parts.strays, sum(nobody), self.coloured))
        strays = [next(raw) if alone else None for alone in nobody]
        others = unpack_strangers(parts.foreign, chunk.frames, self.coloured)
        shows = [
            actor.perform(play, chunk.frames, start, stop) for actor, play in zip(self.actors, parts.plays, strict=True)
        ]
        for frame in range(start, stop):
            clouds = [next(show) for show in shows]
            there = [cloud for cloud, absent in zip(clouds, parts.absent[frame], strict=True) if not absent]
            stray = strays[frame]
            yield joined([*there, others[frame]], self.coloured) if stray is None else stray


def joined(clouds: Sequence[Cloud], coloured: bool) -> Cloud:
    """Points of several clouds as one."""
    some = [cloud for cloud in clouds if len(cloud[0])] or [clouds[-1]]
    if len(some) == 1:
        points, colours = some[0]
        return points, (np.zeros((len(points), 3), np.uint8) if colours is None else colours) if coloured else None
    points = np.concatenate([points for points, _ in some])
    colours = [c for _, c in some if c is not None]
    return points, np.concatenate(colours) if coloured else None
