"""All points of a recording on lattices, coded to a target and decoded again to check it.

target ─► bound of the lattice, colour step ─► chunks ─► decoded ─► the points of the lattice? colours good enough?
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ... import progress
from ...errors import CannotEncode
from ...metrics import point_clouds
from ...typing import Booleans
from ..clouds.raw_frames import Cloud
from . import point_targets
from .point_layer import SurfaceTexture, pack_points, to_lattice, unpack_points
from .pose_stream import PoseSequence


class PointTarget(NamedTuple):
    """What is asked of the points: at most one of the first three. size: bytes of all chunks' points. beside: bytes of
    the file besides them.
    """

    max_error: float | None = None
    mean_error: float | None = None
    size: float | None = None
    psnr: float | None = None
    beside: float = 0.0


class PointEncoder:
    """The points of all frames with what their coding depends on.

    spans: frames of each chunk. poses: of each chunk and body, as they are decoded. is_absent: (frames, bodies) of each
    chunk.
    """

    def __init__(
        self,
        frames: Sequence[Cloud],
        spans: Sequence[slice],
        textures: Sequence[SurfaceTexture],
        poses: Sequence[Sequence[PoseSequence]],
        is_absent: Sequence[Booleans],
        coloured: bool,
    ) -> None:
        self.frames, self.spans, self.textures = frames, spans, textures
        self.poses, self.is_absent, self.coloured = poses, is_absent, coloured

    def encode(self, target: PointTarget) -> list[bytes]:
        """The part of each chunk. Raises CannotEncode if the target cannot be met."""
        bound = self.bound(target)
        step = point_targets.usual_colour_step(bound) if self.coloured else 0
        if target.psnr is None or not self.coloured:
            return self._checked(bound, step, None)
        for step in point_targets.coarser_steps(point_targets.step_of_psnr(target.psnr)):
            if parts := self._checked(bound, step, target.psnr):
                return parts
        raise CannotEncode(
            f"bodycast cannot keep colours to {target.psnr:g} dB with points within {bound * 1000:.3g} mm: "
            "points of one cell become one; ask for a smaller error or a smaller PSNR"
        )

    def bound(self, target: PointTarget) -> float:
        """The bound of the lattice that meets the target, metres."""
        if target.max_error is not None:
            return target.max_error
        if target.mean_error is not None:
            return point_targets.bound_of_mean(self.frames, target.mean_error)
        if target.size is not None:
            return point_targets.finest_that_fits(
                target.size, lambda bound: sum(map(len, self._coded(bound))), target.beside
            )
        return point_targets.DEFAULT_BOUND_M if target.psnr is None else point_targets.COLOUR_BOUND_M

    def _coded(self, bound: float, step: int | None = None) -> list[bytes]:
        """The part of each chunk; step: of colours, by default that of the bound."""
        if step is None:
            step = point_targets.usual_colour_step(bound) if self.coloured else 0
        parts = list[bytes]()
        for span, poses, absent in zip(self.spans, self.poses, self.is_absent, strict=True):
            grid, frames = to_lattice(self.frames[span], bound, self.coloured)
            parts.append(pack_points(grid, frames, self.textures, poses, absent, step))
        return parts

    def _checked(self, bound: float, step: int, psnr: float | None) -> list[bytes]:
        """The part of each chunk, decoded and compared; none if the colours miss `psnr`. Raises CannotEncode."""
        parts, squares = self._coded(bound, step), np.zeros((2, 2))
        for part, span, poses, absent in progress.over(
            list(zip(parts, self.spans, self.poses, self.is_absent, strict=True))
        ):
            source = self.frames[span]
            grid, expected = to_lattice(source, bound, self.coloured)
            decoded = unpack_points(part, len(source), self.textures, poses, absent, self.coloured)
            for frame, cloud, original in zip(expected, decoded, source, strict=True):
                if not np.array_equal(cloud[0], grid.positions(frame.codes)):
                    raise CannotEncode("bodycast: the decoded points are not those that were coded")
                if psnr is not None:
                    squares += point_clouds.luma_squares(original, cloud)
        if len(self.frames) and float(point_targets.own_distances(self.frames, bound).max(initial=0.0)) > bound:
            raise CannotEncode(f"bodycast cannot bound the error of these points by {bound * 1000:g} mm")
        return parts if psnr is None or point_clouds.pooled_psnr(squares) >= psnr else []
