"""All points of a recording on lattices, coded to a target and decoded again to check it.

target ─► bound of the lattice, colour step ─► chunks ─► decoded ─► the points of the lattice? colours good enough?
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ... import parallel, progress
from ...errors import CannotEncode
from ...metrics import point_clouds
from ...typing import Bytes, Floats
from ..clouds.raw_frames import Cloud
from . import point_choice, point_targets
from .colour_lifting import ColourSteps
from .lattice_frames import LatticeFrame, to_lattice
from .point_layer import CodedPlaces, LocatedPoints, join, pack_colours, pack_places, unpack_points
from .point_scene import ChunkBodies


class PointTarget(NamedTuple):
    """The target of the points: at most one of the first three. size: bytes of all chunks' points. beside: bytes of
    the file besides them.
    """

    max_error: float | None = None
    mean_error: float | None = None
    size: float | None = None
    psnr: float | None = None
    beside: float = 0.0

    @property
    def first_bound(self) -> float:
        """The bound with which the points are coded first, metres."""
        if self.max_error is not None:
            return self.max_error
        if self.mean_error is not None:
            return self.mean_error / point_targets.MEAN_PER_BOUND
        if self.size is not None:
            return point_targets.COARSEST_BOUND_M
        return point_targets.DEFAULT_BOUND_M if self.psnr is None else point_targets.COLOUR_BOUND_M


class PointEncoder:
    """The points of all frames with what their coding depends on.

    spans: frames of each chunk. bodies: of each chunk.
    """

    def __init__(
        self,
        frames: Sequence[Cloud],
        spans: Sequence[slice],
        bodies: Sequence[ChunkBodies],
        coloured: bool,
    ) -> None:
        self.frames, self.spans, self.bodies, self.coloured = frames, spans, bodies, coloured
        self._last: tuple[float, list[_CodedChunk]] | None = None

    def encode(self, target: PointTarget) -> list[bytes]:
        """The part of each chunk. Raises CannotEncode if the target cannot be met.

        With threads, the places of a chunk are coded beside the colours and the check of the chunk before it.
        """
        bound = self.bound(target)
        steps = self._usual_steps(bound)
        chunks: Iterable[_CodedChunk] = parallel.ahead(self._coded_chunks(bound))
        if self.coloured and target.psnr is not None:
            chunks = self._places(bound)
            steps = self._steps_of_psnr(chunks, bound, target.psnr)
        elif self._last is not None and self._last[0] == bound:
            chunks = self._last[1]
        parts = list[bytes]()
        for number, chunk in zip(progress.over(range(len(self.spans))), chunks, strict=True):
            part, colours = chunk.with_colours(steps)
            self._check(number, part, colours, chunk.pairs(), bound)
            parts.append(part)
        return parts

    def bound(self, target: PointTarget) -> float:
        """The bound of the lattice that meets the target, metres."""
        if target.mean_error is not None:
            has_bodies = any(bodies.textures for bodies in self.bodies)
            share = point_targets.BODY_MEAN_PER_BOUND if has_bodies else point_targets.MEAN_PER_BOUND
            return point_targets.bound_of_mean(target.mean_error, self._mean_error, target.mean_error / share)
        if target.size is not None:
            return point_targets.finest_that_fits(
                target.size, lambda bound: sum(map(len, self.coded(bound))), target.beside
            )
        return target.first_bound

    def _mean_error(self, bound: float) -> float:
        """The mean error of the points that are decoded with this bound, metres."""
        pairs = [pair for chunk in self._places(bound) for pair in chunk.pairs()]
        return point_targets.mean_error([(frame, located.positions) for frame, located in pairs])

    def coded(self, bound: float) -> list[bytes]:
        """The part of each chunk, with the usual colours of this bound, metres; not checked."""
        return [chunk.with_colours(self._usual_steps(bound))[0] for chunk in self._places(bound)]

    def frame_bytes(self, bound: float) -> list[Floats]:
        """Bytes of each frame with points of each chunk, as `coded`; colours and the rest count in equal shares."""
        octrees = [np.diff(chunk.places.ends, prepend=0) for chunk in self._places(bound)]
        parts = self.coded(bound)
        return [own + (len(part) - own.sum()) / len(own) for part, own in zip(parts, octrees, strict=True)]

    def _usual_steps(self, bound: float) -> ColourSteps | None:
        return ColourSteps.of_luma(point_targets.usual_colour_step(bound)) if self.coloured else None

    def _places(self, bound: float) -> list[_CodedChunk]:
        """The chunks without their colours. The last ones are kept: a search ends with a bound that it has coded."""
        if self._last is not None and self._last[0] == bound:
            return self._last[1]
        chunks = list(self._coded_chunks(bound))
        self._last = bound, chunks
        return chunks

    def _coded_chunks(self, bound: float) -> Iterator[_CodedChunk]:
        """The chunks without their colours, one after the other."""
        for span, bodies in zip(self.spans, self.bodies, strict=True):
            reach = bound / point_choice.FREEDOM if bodies.textures else bound
            grid, frames = to_lattice(self.frames[span], reach, self.coloured)
            yield _CodedChunk(pack_places(grid, frames, bodies, bound))

    def _steps_of_psnr(self, chunks: Sequence[_CodedChunk], bound: float, psnr: float) -> ColourSteps:
        """The coarsest steps whose colours have this PSNR: bisection. Raises CannotEncode if none have."""

        def meets(step: int) -> bool:
            squares = np.zeros((2, 2))
            for chunk, span in zip(chunks, self.spans, strict=True):
                colours = iter(chunk.with_colours(ColourSteps.of_luma(step))[1])
                originals = [original for original in self.frames[span] if len(original[0])]
                for (_, located), original in zip(chunk.pairs(), originals, strict=True):
                    squares += point_clouds.luma_squares(original, (located.positions, next(colours)))
            return not squares[:, 1].all() or point_clouds.pooled_psnr(squares) >= psnr

        step = point_targets.coarsest_step(point_targets.step_of_psnr(psnr), meets)
        if step is None:
            raise CannotEncode(
                f"bodycast cannot keep colours to {psnr:g} dB with points within {bound * 1000:.3g} mm: "
                "points of one cell become one; ask for a smaller error or a smaller PSNR"
            )
        return ColourSteps.of_luma(step)

    def _check(
        self,
        number: int,
        part: bytes,
        colours: Sequence[Bytes],
        pairs: Sequence[tuple[LatticeFrame, LocatedPoints]],
        bound: float,
    ) -> None:
        """Decodes a chunk, compares its points and colours with the coded ones, and measures all points. number: of the
        chunk. Raises CannotEncode.
        """
        span = self.spans[number]
        decoded = unpack_points(part, span.stop - span.start, self.bodies[number], self.coloured)
        filled = (cloud for cloud in decoded if len(cloud[0]))
        wanted = zip(pairs, colours if self.coloured else [None] * len(pairs), strict=True)
        for ((_, located), colour), (points, own) in zip(wanted, filled, strict=True):
            same = np.array_equal(points, located.positions)
            if not same or (colour is not None and not np.array_equal(colour, np.asarray(own))):
                raise CannotEncode("bodycast: the decoded points are not those that were coded")
        if any(frame.own_distances(located.positions).max() > bound for frame, located in pairs):
            raise CannotEncode(f"bodycast cannot bound the error of these points by {bound * 1000:g} mm")


class _CodedChunk(NamedTuple):
    """A chunk on its lattice. places: coded, without colours."""

    places: CodedPlaces

    def pairs(self) -> list[tuple[LatticeFrame, LocatedPoints]]:
        """The frames with points, and their decoded points."""
        return list(zip((f for f in self.places.sources if len(f.codes)), self.places.frames, strict=True))

    def with_colours(self, steps: ColourSteps | None) -> tuple[bytes, list[Bytes]]:
        """The part of the chunk, and the decoded colours of each frame with points; steps: None without colours."""
        if steps is None:
            return join(self.places, None, b""), []
        wanted = [frame.colours for frame in self.places.sources if len(frame.codes) and frame.colours is not None]
        data, decoded = pack_colours(self.places, wanted, steps)
        return join(self.places, steps, data), decoded
