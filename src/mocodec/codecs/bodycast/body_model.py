"""What a decoder needs of a body before the first chunk, and its bytes: one shared blob for each body.

links · pose steps · atlas · surface mask · key picture. docs/payloads/bodycast.md describes the bytes field by field.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ...entropy import varint
from ...errors import BadInput, Corrupt
from ...typing import Booleans
from ..clouds.body_record import pack_body, unpack_body
from .pose_stream import PoseSteps
from .surface_mask import pack_mask, unpack_mask
from .texture_atlas import Atlas

MAX_POINTS = 1 << 20
MAX_PICTURE_INTERVAL = 1 << 16


class BodyModel(NamedTuple):
    """A body with its surface.

    is_surface (height, width): cells of the atlas that hold surface. key_picture: H.265 packet of the surface. points:
    of a decoded frame. picture_interval: frames that one picture of the changing surface lasts.
    """

    atlas: Atlas
    pose_steps: PoseSteps
    is_surface: Booleans
    key_picture: bytes
    coloured: bool
    points: int
    picture_interval: int


def pack_model(model: BodyModel) -> bytes:
    mask = pack_mask(model.is_surface)
    fields = varint.write([model.coloured, model.points, model.picture_interval, len(mask), len(model.key_picture)])
    head = pack_body(model.atlas.body) + model.pose_steps.pack() + model.atlas.pack()
    return head + fields + mask + model.key_picture


def unpack_model(data: bytes) -> BodyModel:
    """The inverse of `pack_model`. Raises Corrupt."""
    body, at = unpack_body(data)
    pose_steps, at = PoseSteps.unpack(body, data, at)
    atlas, at = Atlas.unpack(body, data, at)
    (coloured, points, interval, mask_bytes, key_bytes), at = varint.read(data, 5, at)
    if coloured > 1 or not 0 < points <= MAX_POINTS or not 0 < interval < MAX_PICTURE_INTERVAL:
        raise Corrupt("bodycast: a body's model is damaged: colours, points or picture interval are out of range")
    if at + mask_bytes + key_bytes != len(data):
        raise Corrupt("bodycast: a body's model is damaged: its parts do not fill it")
    mask = unpack_mask(data[at : at + mask_bytes], (atlas.height, atlas.width))
    is_surface = mask & (atlas.max_displacements() > 0)
    return BodyModel(atlas, pose_steps, is_surface, data[at + mask_bytes :], bool(coloured), points, interval)


def unpack_models(shared: Sequence[bytes]) -> list[BodyModel]:
    """The models of all bodies of a recording, none where no body was found. Raises Corrupt."""
    return [unpack_model(data) for data in shared]


def body_model(models: Sequence[BodyModel], body: int) -> BodyModel:
    """The model of a body, counted from 0. Raises BadInput if the recording does not have it."""
    if not models:
        raise BadInput("this recording was coded as points, without a body: it has no motion; decode it to .ply frames")
    if not 0 <= body < len(models):
        counts = f"{len(models)} {'body' if len(models) == 1 else 'bodies'}"
        raise BadInput(f"this recording has {counts}, counted from 0, and no number {body}")
    return models[body]
