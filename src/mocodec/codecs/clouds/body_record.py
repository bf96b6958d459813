"""The links of a body as bytes: names, parents, and the cylinders of the canonical pose in millimetres."""

from __future__ import annotations

import zlib
from dataclasses import replace

import numpy as np

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry.articulation import Body
from .inflate import inflate

MILLIMETRE = 1e-3
MAX_LINKS, MAX_NAME_BYTES = 255, 1 << 16
MAX_MILLIMETRES = 10**7
MIN_RADIUS_M = 1e-3


def round_body(body: Body) -> Body:
    """The body as `unpack_body` returns it, up to the last bits of floats: lengths in whole millimetres, no joints of a
    skeleton.
    """
    body = replace(body, joints=())
    grid = [np.round(values / MILLIMETRE) * MILLIMETRE for values in (body.origins, body.tips, body.radii)]
    return replace(body, origins=grid[0], tips=grid[1], radii=grid[2])


def pack_body(body: Body) -> bytes:
    """Names, parents and cylinders of the links."""
    names = zlib.compress("\n".join(body.names).encode(), 9)
    values = np.column_stack([body.origins, body.tips - body.origins, body.radii]) / MILLIMETRE
    rows = np.column_stack([np.array(body.parents) + 1, np.round(values)]).astype(np.int64)
    links = coder.pack(rows)
    return varint.write([len(body), len(names), len(links)]) + names + links


def unpack_body(data: bytes) -> tuple[Body, int]:
    """The body at the start of `data` and the position after it. Raises Corrupt."""
    (links, name_bytes, link_bytes), at = varint.read(data, 3)
    if not 0 < links <= MAX_LINKS or at + name_bytes + link_bytes > len(data):
        raise Corrupt(
            f"the stored body is damaged: {links} links, 1 to {MAX_LINKS} expected, in {name_bytes + link_bytes} bytes "
            f"of {len(data) - at}"
        )
    names = inflate(data[at : at + name_bytes], MAX_NAME_BYTES).decode("utf-8", "replace").split("\n")
    at += name_bytes
    rows = coder.unpack(data[at : at + link_bytes], (links, 8))
    parents = rows[:, 0] - 1
    values = np.asarray(np.clip(rows[:, 1:], -MAX_MILLIMETRES, MAX_MILLIMETRES) * MILLIMETRE, np.float64)
    if len(names) != links or (parents >= np.arange(links)).any() or (parents < -1).any() or (parents[1:] < 0).any():
        raise Corrupt("the stored body is damaged: its links do not form a tree")
    origins, radii = values[:, :3], np.maximum(values[:, 6], MIN_RADIUS_M)
    body = Body(tuple(names), tuple(parents.tolist()), origins, origins + values[:, 3:6], radii)
    return body, at + link_bytes
