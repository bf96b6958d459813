"""Chunks to point clouds: the surface of each body's picture, in the body's poses.

picture ──surface_sampling──► canonical points ──┐
poses ──────────────────────► transforms ────────┴──skinning──► points in the world, joined with the outliers
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import islice

import numpy as np

from ...encoded import Chunk
from ...errors import Corrupt
from ...geometry import articulation, skinning
from ...geometry.articulation import Pose
from ...typing import Floats
from ..clouds.raw_frames import Cloud, unpack_raw_frames
from . import exact_octree, video
from .body_model import BodyModel
from .chunk_payload import BodyStreams, ChunkStreams, unpack_chunk
from .exact_points import unpack_exact
from .outliers import unpack_outliers
from .point_layer import KINDS, unpack_points
from .point_scene import ChunkBodies, SurfaceTexture
from .pose_stream import PoseSequence, unpack_poses
from .surface_sampling import sample_surface

BATCH_FRAMES = 32  # frames that are posed together


class BodyDecoder:
    """One body with its surface.

    samples: places of the decoded points on the atlas. colours, skin, skin_matrix: the surface of the key picture.
    """

    def __init__(self, model: BodyModel) -> None:
        """Decodes the key picture. Raises Corrupt."""
        self.model, self.body = model, model.atlas.body
        planes = next(video.decode([model.key_picture], model.atlas.image_shape))
        self.samples = sample_surface(model.atlas, planes, model.is_surface, model.points)
        points, self.colours = self.samples.surface(planes)
        self.skin = skinning.blended(self.body, points, self.samples.links, self.samples.normals)
        self.skin_matrix = skinning.SkinMatrix.build(self.skin, len(self.body))

    def posed(self, pose: Pose) -> Floats:
        """(…, n, 3): the surface of the key picture in the poses of (…) frames."""
        return self.skin_matrix.posed(*articulation.transforms(self.body, pose))

    def decode_frames(self, streams: BodyStreams, frames: int, start: int, stop: int) -> Iterator[Cloud]:
        """Frames [start, stop) of a chunk of `frames` frames. Raises Corrupt."""
        sequence = unpack_poses(self.body, streams.poses, frames, self.model.pose_steps)
        if streams.pictures:
            yield from self._changing_surface(sequence, streams.pictures, frames, start, stop)
            return
        for first in range(start, stop, BATCH_FRAMES):
            for points in self.posed(sequence[first : min(stop, first + BATCH_FRAMES)]):
                yield points, self.colours

    def _changing_surface(
        self, sequence: PoseSequence, pictures: Sequence[bytes], frames: int, start: int, stop: int
    ) -> Iterator[Cloud]:
        interval = self.model.picture_interval
        if len(pictures) != 1 + -(-frames // interval):
            raise Corrupt(f"bodycast: {len(pictures)} pictures for {frames} frames, one every {interval}")
        if stop <= start:
            return
        packets = [pictures[0] or self.model.key_picture, *pictures[1:]]
        decoded = video.decode(packets, self.model.atlas.image_shape)
        a, b = sequence.transforms(self.body)
        for i, planes in enumerate(islice(decoded, 1, None)):
            shown = range(max(start, i * interval), min(stop, frames, (i + 1) * interval))
            if shown:
                points, colours = self.samples.surface(planes)
                skin_matrix = self.skin_matrix.with_points(points)
                for frame in shown:
                    yield skin_matrix.posed(a[frame], b[frame]), colours


class SceneDecoder:
    """All bodies of a recording."""

    def __init__(self, models: Sequence[BodyModel], coloured: bool) -> None:
        self.models, self.coloured = models, coloured

    @cached_property
    def bodies(self) -> list[BodyDecoder]:
        """The decoded surfaces."""
        return [BodyDecoder(model) for model in self.models]

    @cached_property
    def textures(self) -> list[SurfaceTexture]:
        """The surfaces that the points of lattices are coded from."""
        return [SurfaceTexture(model) for model in self.models]

    def decode_chunk(self, chunk: Chunk, start: int, stop: int) -> Iterator[Cloud]:
        """Frames [start, stop) of a chunk, counted from its first. Raises Corrupt."""
        streams = unpack_chunk(chunk, len(self.models))
        kind = streams.exact_points[0] if streams.exact_points else None
        if kind in (*KINDS, exact_octree.KIND):
            unpack = exact_octree.unpack if kind == exact_octree.KIND else unpack_points
            bodies = ChunkBodies(self.textures, self._poses(streams, chunk.frames), streams.is_absent)
            yield from islice(unpack(streams.exact_points, chunk.frames, bodies, self.coloured), start, stop)
            return
        if streams.exact_points:
            yield from unpack_exact(streams.exact_points, chunk.frames, self.coloured)[start:stop]
            return
        is_raw = [bool(row.all()) for row in streams.is_absent]
        stored = iter(unpack_raw_frames(streams.raw_frames, sum(is_raw), self.coloured))
        raw_frames = [next(stored) if raw else None for raw in is_raw]
        outliers = unpack_outliers(streams.outliers, chunk.frames, self.coloured)
        bodies = [
            body.decode_frames(own, chunk.frames, start, stop)
            for body, own in zip(self.bodies, streams.bodies, strict=True)
        ]
        for frame in range(start, stop):
            clouds = [next(body) for body in bodies]
            present = [cloud for cloud, absent in zip(clouds, streams.is_absent[frame], strict=True) if not absent]
            raw = raw_frames[frame]
            yield joined([*present, outliers[frame]], self.coloured) if raw is None else raw

    def _poses(self, streams: ChunkStreams, frames: int) -> list[PoseSequence]:
        return [
            unpack_poses(model.atlas.body, own.poses, frames, model.pose_steps)
            for model, own in zip(self.models, streams.bodies, strict=True)
        ]


def joined(clouds: Sequence[Cloud], coloured: bool) -> Cloud:
    """The points of several clouds as one."""
    filled = [cloud for cloud in clouds if len(cloud[0])] or [clouds[-1]]
    if len(filled) == 1:
        points, colours = filled[0]
        return points, (np.zeros((len(points), 3), np.uint8) if colours is None else colours) if coloured else None
    points = np.concatenate([points for points, _ in filled])
    colours = [c for _, c in filled if c is not None]
    return points, np.concatenate(colours) if coloured else None
