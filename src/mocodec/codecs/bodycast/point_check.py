"""The check of coded points: every bit is decoded from the bytes, and the distances of all points are measured.

    frames as they are coded ─`BitCheck`─► all bits equal ─┐
    part of the chunk ─► header equal, streams equal ──────┴─► decoded points equal the coded ones
    coded points ─► distances ≤ bound

`ChunkCheck` follows the encoder. Besides bits, a decoder computes only what follows from the header, the bodies and
earlier bits. The encoder has computed it from the same, so the check shares it, as long as all bits are equal. The
bodies are those that a decoder reads from the file (`BodyEncoder.model`). The first frames are decoded by the decoder
alone, which would show an encoder that computes otherwise. `check_decoded` decodes all frames so, for encoders that
keep no bits.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, zip_longest

import numpy as np

from ... import parallel
from ...entropy.bit_arrays import BitCheck, CodedPart
from ...errors import CannotEncode, Corrupt
from ...typing import Bytes
from ..clouds.raw_frames import Cloud
from .colour_lifting import ColourSteps
from .point_layer import CodedFrame, CodedPlaces, PlacesPart, PointsHeader, split_references, unpack_points
from .point_scene import ChunkBodies

DIFFERENT = "bodycast: the decoded points are not those that were coded"
FIRST_FRAMES = 2  # with points, which are decoded whole: the second depends on what was learned from the first


class ChunkCheck:
    """Checks a chunk while its frames are coded. Its methods raise CannotEncode."""

    def __init__(self, bound_m: float) -> None:
        self._bound_m = bound_m
        self._places, self._colours = BitCheck(), BitCheck()
        self._first = list[Cloud]()  # the coded points and colours of the first frames

    def follow_places(self, frame: CodedFrame) -> None:
        """Check the next frame: its places, and the distances of its points."""
        assert frame.part is not None
        _follow(self._places, frame.part)
        _require_bound(frame, self._bound_m)
        if frame.located is not None and len(self._first) < FIRST_FRAMES:
            self._first.append((frame.located.positions, None))

    def follow_colours(self, part: CodedPart, colours: Bytes) -> None:
        """Check the colours of the same frame, if it has points. colours (n, 3): as they decode."""
        _follow(self._colours, part)
        if self._first[-1][1] is None:
            self._first[-1] = self._first[-1][0], colours

    def finish(self, part: bytes, places: PlacesPart, steps: ColourSteps | None, bodies: ChunkBodies) -> None:
        """Check the part of the chunk after its last frame. steps: None without colours."""
        try:
            header, octrees, colours = _split(part, places, bodies, steps is not None)
            if not _is_header_of(header, places, steps):
                raise CannotEncode(DIFFERENT)
            self._places.finish(octrees)
            self._colours.finish(colours)
            with parallel.threads(1):  # which decode no further frames ahead
                decoded = unpack_points(part, len(header.counts), bodies, steps is not None)
                _require_same(islice(_filled(decoded), len(self._first)), self._first)
        except Corrupt as error:
            raise CannotEncode(DIFFERENT) from error


def _follow(check: BitCheck, part: CodedPart) -> None:
    try:
        check.follow(part)
    except Corrupt as error:
        raise CannotEncode(DIFFERENT) from error


def _split(part: bytes, places: PlacesPart, bodies: ChunkBodies, coloured: bool) -> tuple[PointsHeader, bytes, bytes]:
    """What a decoder reads from the part: the header, the bytes of the octrees, and those of the colours."""
    data, references = split_references(part, len(bodies.is_absent))
    if references != places.references:
        raise CannotEncode(DIFFERENT)
    poses = int((~bodies.is_absent).sum())
    header = PointsHeader.read(data, len(bodies.is_absent), len(bodies.textures), poses, coloured)
    return header, data[header.octrees], data[header.octrees.stop :]


def _is_header_of(header: PointsHeader, places: PlacesPart, steps: ColourSteps | None) -> bool:
    grid, coded = header.grid, places.grid
    return (
        (grid.step_m, grid.corner.tolist(), grid.depth) == (coded.step_m, coded.corner.tolist(), coded.depth)
        and (header.kind, header.steps) == (places.kind, [0, 0] if steps is None else [*steps])
        and (header.counts, header.shifts, header.pose_shifts) == (places.counts, places.shifts, places.pose_shifts)
    )


def _require_bound(frame: CodedFrame, bound_m: float) -> None:
    """Raises CannotEncode for a frame with points farther from their decoded points."""
    located = frame.located
    if located is not None and frame.source.own_distances(located.positions).max() > bound_m:
        raise CannotEncode(f"bodycast cannot bound the error of these points by {bound_m * 1000:g} mm")


def check_decoded(
    part: bytes, coded: CodedPlaces, colours: Sequence[Bytes] | None, bodies: ChunkBodies, bound_m: float
) -> None:
    """Decodes a chunk, compares its points and colours with the coded ones, and measures all points. Raises
    CannotEncode. colours (n, 3): as they decode, of each frame with points; None without colours.
    """
    located = [located for _, located in coded.filled()]
    decoded = unpack_points(part, len(bodies.is_absent), bodies, colours is not None)
    own_colours = [None] * len(located) if colours is None else colours
    _require_same(_filled(decoded), [(own.positions, colour) for own, colour in zip(located, own_colours, strict=True)])
    for frame in coded.frames:
        _require_bound(frame, bound_m)


def _filled(decoded: Iterable[Cloud]) -> Iterator[Cloud]:
    """The frames with points."""
    return (cloud for cloud in decoded if len(cloud[0]))


def _require_same(decoded: Iterable[Cloud], coded: Iterable[Cloud]) -> None:
    """Raises CannotEncode if frames with points differ from the coded ones."""
    for own, expected in zip_longest(decoded, coded):
        if own is None or expected is None or not _is_same(own, expected):
            raise CannotEncode(DIFFERENT)


def _is_same(decoded: Cloud, coded: Cloud) -> bool:
    (points, colours), (coded_points, coded_colours) = decoded, coded
    return np.array_equal(points, coded_points) and (
        coded_colours is None or np.array_equal(np.asarray(colours), coded_colours)
    )
