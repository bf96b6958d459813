"""The model P of the paper: points of the first frame, each on a cylinder link; and its bytes.

A decoder needs nothing else besides the chunks. docs/payloads/lien2006.md describes the bytes field by field.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry.articulation import Body
from ...typing import AnyInteger, Bytes, Floats, Integers
from ..clouds.body_record import pack_body, unpack_body

POINT_STEP_M, COLOUR_STEP = 0.002, 4  # of stored points; of stored colours, levels of 256
COLOURED, DEPTH_BY_CELL = 1, 2  # flags
MAX_POINTS = 1 << 19
RESIDUAL_SCALE = 100  # stored share of the residual: hundredths of a percent
MAX_STEPS = 10**7  # of a stored coordinate
MORTON_BITS = 14  # of each coordinate
DEPTH_STEP_M, OLD_DEPTH_STEP_M = 0.016, 0.008  # of residual maps; eight bits of DEPTH_STEP_M reach 2 m either way


class CylinderTemplate(NamedTuple):
    """The body, and its points in the canonical pose: points (n, 3) metres, colours (n, 3), links (n,) ascending."""

    body: Body
    points: Floats
    colours: Bytes | None
    links: AnyInteger


class ResidualFormat(NamedTuple):
    """How a file stores residual maps.

    share: cells of its maps, as a share of the full ones; 0: no maps. depth_by_cell: an image of depth holds the frames
    of each cell side by side, in steps of DEPTH_STEP_M; older files have whole rows of frames one below the other, in
    steps of OLD_DEPTH_STEP_M.
    """

    share: float
    depth_by_cell: bool = True

    @property
    def depth_step_m(self) -> float:
        return DEPTH_STEP_M if self.depth_by_cell else OLD_DEPTH_STEP_M


def round_model(model: CylinderTemplate) -> CylinderTemplate:
    """The model as `unpack_model` returns it: points on the grid, ordered by link, then along a Morton curve."""
    grid = _grid(model.points)
    order = np.lexsort((_morton_codes(grid), model.links))
    colours = None
    if model.colours is not None:
        colours = np.minimum(np.round(model.colours[order] / COLOUR_STEP) * COLOUR_STEP, 255).astype(np.uint8)
    return CylinderTemplate(model.body, grid[order].astype(np.float64) * POINT_STEP_M, colours, model.links[order])


def _grid(points: Floats) -> Integers:
    return np.round(points / POINT_STEP_M).astype(np.int64)


def _morton_codes(grid: Integers) -> Integers:
    """(n,): the bits of three coordinates interleaved, so that neighbours in space are close in order."""
    low = grid - grid.min(axis=0)
    code = np.zeros(len(grid), np.int64)
    for bit in range(MORTON_BITS):
        for axis in range(3):
            code |= ((low[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def stored_share(residual_percent: float) -> float:
    """The share of the full residual maps that a decoder reads: the percentage rounded to two decimals."""
    return round(residual_percent * RESIDUAL_SCALE) / (100 * RESIDUAL_SCALE)


def pack_model(model: CylinderTemplate, residual_percent: float) -> bytes:
    """A rounded model, and the share of the full residual maps that the chunks hold."""
    grid = _grid(model.points)
    columns = [grid]
    if model.colours is not None:
        columns.append(np.round(model.colours / COLOUR_STEP).astype(np.int64))
    counts = np.bincount(model.links, minlength=len(model.body))
    points = coder.pack(np.diff(np.concatenate(columns, axis=1), axis=0, prepend=0))
    flags = DEPTH_BY_CELL + COLOURED * (model.colours is not None)
    head = varint.write([round(residual_percent * RESIDUAL_SCALE), flags, len(grid), *counts.tolist()])
    return pack_body(model.body) + head + points


def unpack_model(shared: Sequence[bytes]) -> tuple[CylinderTemplate, ResidualFormat]:
    """The model, and how the chunks store residual maps. Raises Corrupt."""
    if len(shared) != 1:
        raise Corrupt(f"lien2006: a file has one model, this one has {len(shared)}")
    data = shared[0]
    body, at = unpack_body(data)
    (residual, flags, count, *counts), at = varint.read(data, 3 + len(body), at)
    if residual > 100 * RESIDUAL_SCALE or flags > COLOURED + DEPTH_BY_CELL:
        raise Corrupt("lien2006: the model is damaged: wrong share of residuals or unknown flags")
    if not 0 < count <= MAX_POINTS or sum(counts) != count:
        raise Corrupt(
            f"lien2006: the model is damaged: its cylinders have {sum(counts)} points, {count} expected of at most "
            f"{MAX_POINTS}"
        )
    coloured = bool(flags & COLOURED)
    differences = coder.unpack(data[at:], (count, 6 if coloured else 3))
    values = np.cumsum(np.clip(differences, -MAX_STEPS, MAX_STEPS), axis=0)
    colours = np.clip(values[:, 3:] * COLOUR_STEP, 0, 255).astype(np.uint8) if coloured else None
    points = np.clip(values[:, :3], -MAX_STEPS, MAX_STEPS).astype(np.float64) * POINT_STEP_M
    model = CylinderTemplate(body, points, colours, np.repeat(np.arange(len(body)), counts))
    return model, ResidualFormat(residual / (100 * RESIDUAL_SCALE), bool(flags & DEPTH_BY_CELL))
