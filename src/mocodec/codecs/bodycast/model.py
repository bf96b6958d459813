"""What a decoder knows of a body before the first chunk, and its bytes.

body · scale of its poses · atlas · cells that are surface · key packet of the surface's picture
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...entropy import varint
from ...errors import Corrupt
from .. import body_stream
from . import bits
from .atlas import Atlas
from .poses import Scale

MOST_POINTS = 1 << 20


class Model(NamedTuple):
    """points: of a decoded frame. every: frames that one picture of the moving surface stands for."""

    atlas: Atlas
    scale: Scale
    valid: NDArray[np.bool_]
    key: bytes
    coloured: bool
    points: int
    every: int


def pack(model: Model) -> bytes:
    cells = bits.pack_mask(model.valid)
    sizes = varint.write([model.coloured, model.points, model.every, len(cells), len(model.key)])
    head = body_stream.pack_body(model.atlas.body) + model.scale.pack() + model.atlas.pack()
    return head + sizes + cells + model.key


def unpack(data: bytes) -> Model:
    """Raises Corrupt."""
    body, at = body_stream.unpack_body(data)
    scale, at = Scale.unpack(body, data, at)
    atlas, at = Atlas.unpack(body, data, at)
    (coloured, points, every, cells, key), at = varint.read(data, 5, at)
    sound = coloured <= 1 and 0 < points <= MOST_POINTS and 0 < every < 1 << 16
    if not sound or at + cells + key != len(data):
        raise Corrupt("bodycast: the model is damaged")
    valid = bits.unpack_mask(data[at : at + cells], (atlas.height, atlas.width))
    return Model(atlas, scale, valid & (atlas.reach() > 0), data[at + cells :], bool(coloured), points, every)
