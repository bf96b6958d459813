"""All points of one frame within a bound, in bytes that decode alone: for `streaming`.

pose, in steps ─┬─► bytes
points ─────────┴─coded from the body in that pose─► bytes
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...entropy import coder, varint
from ...errors import Corrupt
from ...typing import Integers
from ..clouds.raw_frames import Cloud
from .body_model import BodyModel
from .point_encoder import PointEncoder, PointTarget
from .point_layer import unpack_points
from .point_scene import ChunkBodies, SurfaceTexture
from .pose_stream import PoseSequence, dequantise_pose


class PointBody(NamedTuple):
    """The body that points are coded from."""

    model: BodyModel
    texture: SurfaceTexture

    @staticmethod
    def of(model: BodyModel) -> PointBody:
        """Raises Corrupt."""
        return PointBody(model, SurfaceTexture(model))

    def unpack_pose(self, data: bytes) -> Integers:
        """(3 + 3 links,): a pose in steps. Raises Corrupt."""
        return coder.unpack(data, (1 + len(self.model.atlas.body), 3)).reshape(-1)

    def posed(self, pose: Integers) -> ChunkBodies:
        """The body in one frame; pose (3 + 3 links,) in steps."""
        decoded = dequantise_pose(self.model.atlas.body, pose, self.model.pose_steps)
        return ChunkBodies([self.texture], [PoseSequence.from_poses([decoded])], np.zeros((1, 1), bool))


class PointPart(NamedTuple):
    """The parts of a frame as bytes. has_body: whether its points are coded from a body in this pose."""

    coloured: bool
    has_body: bool
    pose: bytes
    points: bytes


def pack_points(cloud: Cloud, max_error: float, body: PointBody | None, pose: Integers | None) -> bytes:
    """The points (n, 3) of a frame within max_error, metres: decoded and measured. pose: of the body, in steps; None
    where the frame does not show it. Raises CannotEncode.
    """
    coloured, bodies = cloud[1] is not None, _bodies(body, pose)
    [points] = PointEncoder([cloud], [slice(0, 1)], [bodies], coloured).encode(PointTarget(max_error))
    packed_pose = b"" if pose is None else coder.pack(pose.reshape(-1, 3))
    return varint.write([int(coloured), int(pose is not None), len(packed_pose)]) + packed_pose + points


def split_parts(data: bytes) -> PointPart:
    """The parts of `pack_points`. Raises Corrupt."""
    (coloured, has_body, size), at = varint.read(data, 3)
    if coloured > 1 or has_body > 1 or at + size > len(data):
        raise Corrupt("bodycast: a packet of points is damaged")
    return PointPart(bool(coloured), bool(has_body), data[at : at + size], data[at + size :])


def decode_points(part: PointPart, body: PointBody | None, pose: Integers | None) -> Cloud:
    """The points of a frame. pose: as in `pack_points`. Raises Corrupt."""
    [cloud] = unpack_points(part.points, 1, _bodies(body, pose), part.coloured)
    return cloud


def _bodies(body: PointBody | None, pose: Integers | None) -> ChunkBodies:
    return ChunkBodies.nobody(1) if body is None or pose is None else body.posed(pose)
