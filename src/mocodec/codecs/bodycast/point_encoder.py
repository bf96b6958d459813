"""All points of a recording on lattices, coded to a target and decoded again to check it.

target ─► bound of the lattice, colour step ─► chunks ─► decoded ─► the points of the lattice? colours good enough?

Where the bound is known at once, the check follows the encoder frame by frame; after a search for the bound, and for
chunks of few frames, the chunks are decoded.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from ... import parallel, progress
from ...entropy.bit_arrays import BitCheck, BitEncoder
from ...errors import CannotEncode
from ...metrics import point_clouds
from ...typing import Bytes, Floats
from ..clouds.raw_frames import Cloud
from . import point_choice, point_targets
from .colour_lifting import ColourSteps
from .lattice_frames import LatticeFrame, LatticeGrid, to_lattice
from .point_check import FIRST_FRAMES, ChunkCheck, check_decoded
from .point_layer import (
    FRAMES_AHEAD,
    CodedFrame,
    CodedPlaces,
    ColoursOfChunk,
    PlacesEncoder,
    join,
    pack_colours,
    pack_places,
)
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

        With threads, the places of the next frames or chunks are coded beside the colours and the check.
        """
        bound = self.bound(target)
        steps = self._usual_steps(bound)
        if self.coloured and target.psnr is not None:
            chunks = self._places(bound)
            return self._decoded_parts(chunks, bound, self._steps_of_psnr(chunks, bound, target.psnr))
        if self._last is not None and self._last[0] == bound:
            return self._decoded_parts(self._last[1], bound, steps)
        if not BitCheck.is_available() or all(span.stop - span.start <= FIRST_FRAMES for span in self.spans):
            return self._decoded_parts(parallel.ahead(self._coded_chunks(bound)), bound, steps)
        frames = parallel.ahead(self._coded_frames(bound), FRAMES_AHEAD)
        numbers = progress.over(range(len(self.spans)))
        return [self._followed_part(number, frames, bound, steps) for number in numbers]

    def _decoded_parts(self, chunks: Iterable[_CodedChunk], bound: float, steps: ColourSteps | None) -> list[bytes]:
        """The part of each chunk, decoded to check it."""
        parts = list[bytes]()
        for number, chunk in zip(progress.over(range(len(self.spans))), chunks, strict=True):
            part, colours = chunk.with_colours(steps)
            check_decoded(part, chunk.places, colours if self.coloured else None, self.bodies[number], bound)
            parts.append(part)
        return parts

    def _followed_part(
        self,
        number: int,
        frames: Iterator[tuple[PlacesEncoder, CodedFrame]],
        bound: float,
        steps: ColourSteps | None,
    ) -> bytes:
        """The part of a chunk, checked while its frames are coded. frames: of this chunk, then of the next ones."""
        span, check, coder = self.spans[number], ChunkCheck(bound), BitEncoder(keeps_bits=True)
        places: PlacesEncoder | None = None
        colours: ColoursOfChunk | None = None
        for places, frame in islice(frames, span.stop - span.start):
            check.follow_places(frame)
            if steps is None or frame.located is None:
                continue
            colours = colours or ColoursOfChunk(places.table, steps)
            decoded = colours.code(coder, frame.colours(), frame.located)
            check.follow_colours(coder.take(), decoded)
        assert places is not None
        stored = places.part()
        part = join(stored, steps, coder.finish())
        check.finish(part, stored, steps, self.bodies[number])
        return part

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
        pairs = [pair for chunk in self._places(bound) for pair in chunk.places.filled()]
        return point_targets.mean_error([(frame.source, located.positions) for frame, located in pairs])

    def coded(self, bound: float) -> list[bytes]:
        """The part of each chunk, with the usual colours of this bound, metres; not checked."""
        return [chunk.with_colours(self._usual_steps(bound))[0] for chunk in self._places(bound)]

    def frame_bytes(self, bound: float) -> list[Floats]:
        """Bytes of each frame with points of each chunk, as `coded`; colours and the rest count in equal shares."""
        ends = [[frame.octrees_size for frame, _ in chunk.places.filled()] for chunk in self._places(bound)]
        octrees = [np.diff(of_chunk, prepend=0) for of_chunk in ends]
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
        for number in range(len(self.spans)):
            yield _CodedChunk(pack_places(*self._on_lattice(number, bound), self.bodies[number], bound))

    def _coded_frames(self, bound: float) -> Iterator[tuple[PlacesEncoder, CodedFrame]]:
        """The frames of all chunks without their colours, each with the encoder of its chunk."""
        for number in range(len(self.spans)):
            grid, frames = self._on_lattice(number, bound)
            encoder = PlacesEncoder(grid, frames, self.bodies[number], bound, keeps_bits=True)
            for frame in encoder.frames():
                yield encoder, frame

    def _on_lattice(self, number: int, bound: float) -> tuple[LatticeGrid, list[LatticeFrame]]:
        """The frames of a chunk, so that `pack_places` can keep the bound."""
        reach = bound / point_choice.FREEDOM if self.bodies[number].textures else bound
        return to_lattice(self.frames[self.spans[number]], reach, self.coloured)

    def _steps_of_psnr(self, chunks: Sequence[_CodedChunk], bound: float, psnr: float) -> ColourSteps:
        """The coarsest steps whose colours have this PSNR: bisection. Raises CannotEncode if none have."""

        def meets(step: int) -> bool:
            squares = np.zeros((2, 2))
            for chunk, span in zip(chunks, self.spans, strict=True):
                colours = iter(chunk.with_colours(ColourSteps.of_luma(step))[1])
                originals = [original for original in self.frames[span] if len(original[0])]
                for (_, located), original in zip(chunk.places.filled(), originals, strict=True):
                    squares += point_clouds.luma_squares(original, (located.positions, next(colours)))
            return not squares[:, 1].all() or point_clouds.pooled_psnr(squares) >= psnr

        step = point_targets.coarsest_step(point_targets.step_of_psnr(psnr), meets)
        if step is None:
            raise CannotEncode(
                f"bodycast cannot keep colours to {psnr:g} dB with points within {bound * 1000:.3g} mm: "
                "points of one cell become one; ask for a smaller error or a smaller PSNR"
            )
        return ColourSteps.of_luma(step)


class _CodedChunk(NamedTuple):
    """A chunk on its lattice. places: coded, without colours."""

    places: CodedPlaces

    def with_colours(self, steps: ColourSteps | None) -> tuple[bytes, list[Bytes]]:
        """The part of the chunk, and the decoded colours of each frame with points; steps: None without colours."""
        if steps is None:
            return join(self.places.part, None, b""), []
        data, decoded = pack_colours(self.places, steps)
        return join(self.places.part, steps, data), decoded
