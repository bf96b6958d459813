"""Points of earlier frames of a chunk as samples of the surface, where no body shows it: props, animals, robes.

frames before, each moved on ─► distinct points ─`reference_surface`─► samples beside those of the bodies
decoded points ─► those that no body explains are kept ─► the next frames
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ... import native
from ...entropy import varint
from ...errors import Corrupt
from ...typing import Booleans, Integers, YCoCg
from . import octree
from .integer_surface import hints_of_samples
from .reference_surface import Samples, surface_of_points
from .surface_hints import NEIGHBOURS, SUBUNIT_BITS, SurfaceHints
from .surface_memory import AVERAGED, FARTHEST, PosedSurface, mean_colour, offsets_from

MAX_FRAMES = 4  # before a frame, whose points it may refer to
LEAST_POINTS = 4 * NEIGHBOURS  # fewer points are no surface
MAX_MOTION = 1 << 16  # lattice units from frame to frame
MAX_ASIDE = 2621  # 2^-16 m: 40 mm, that a point of a body lies from its sample
CANDIDATES = 7  # reference points whose colours may be expected: the nearest and its first neighbours
SOFTENING = 128  # added to squared distances, subunits: (0.7 lattice units)²


class Reference(NamedTuple):
    """What a frame refers to. frames: how many before it, 0 for none. motion: of their points since the frame before,
    lattice units. hides_bodies: whether the frame is coded as if no body were in it.
    """

    frames: int = 0
    motion: tuple[int, int, int] = (0, 0, 0)
    hides_bodies: bool = False


NO_REFERENCE = Reference()


class ReferencePoints(NamedTuple):
    """Points of earlier frames as samples of a frame's surface. ages (m,): how many frames with points before. rows
    (m,): the point's number in its frame.
    """

    samples: Samples
    ages: Integers
    rows: Integers

    def expected(self, colours: Sequence[YCoCg], cells: Integers, nearest: Integers) -> Integers:
        """(n, 3): the mean colour of the AVERAGED points nearest to lattice points (n, 3), among the sample (n,) near
        each and its neighbours. colours: of the frames before, the latest last.
        """
        around = self.samples.neighbours[nearest, : CANDIDATES - 1]
        candidates = np.concatenate([nearest[:, None], around], axis=1)
        square = ((self.samples.places[candidates] - (cells << SUBUNIT_BITS)[:, None]) ** 2).sum(axis=2)
        order = np.argsort(square, axis=1, kind="stable")[:, :AVERAGED]
        chosen = np.take_along_axis(candidates, order, axis=1)
        return mean_colour(self._colours(colours)[chosen], np.take_along_axis(square, order, axis=1) + SOFTENING)

    def _colours(self, colours: Sequence[YCoCg]) -> Integers:
        result = np.zeros((len(self.rows), 3), np.int64)
        for age in np.unique(self.ages).tolist():
            own = self.ages == age
            result[own] = colours[-age][self.rows[own]]
        return result


@dataclass
class _KeptFrame:
    """The points of a frame, as they stand now. cells (n, 3): lattice coordinates. is_explained (n,): by a body."""

    cells: Integers
    is_explained: Booleans


class EarlierFrames:
    """The points of the last frames that have any."""

    def __init__(self) -> None:
        self._frames = list[_KeptFrame]()  # the latest first
        self._found = dict[tuple[int, int, bool], ReferencePoints | None]()

    def __len__(self) -> int:
        return len(self._frames)

    def move(self, motion: Sequence[int]) -> None:
        """Move all points on by a step, lattice units."""
        if not any(motion):
            return
        self._found.clear()
        for frame in self._frames:
            frame.cells = frame.cells + np.asarray(motion, np.int64)

    def moved(self, motion: Sequence[int]) -> EarlierFrames:
        """A copy whose points moved; itself without motion."""
        if not any(motion):
            return self
        result = EarlierFrames()
        result._frames = [_KeptFrame(f.cells, f.is_explained) for f in self._frames]
        result.move(motion)
        return result

    def references(self, frames: int, depth: int, has_bodies: bool) -> ReferencePoints | None:
        """Samples of the distinct points of the last `frames` frames, within the octree; None below LEAST_POINTS.

        Of equal points that of the latest frame counts. has_bodies: whether those that a body explains are left out.
        """
        key = frames, depth, has_bodies
        if key not in self._found:
            self._found[key] = self._references(*key)
        return self._found[key]

    def _references(self, frames: int, depth: int, has_bodies: bool) -> ReferencePoints | None:
        """As `references`."""
        parts = [self._usable(frame, depth, has_bodies) for frame in self._frames[:frames]]
        if sum(map(len, parts)) < LEAST_POINTS:
            return None
        cells = np.concatenate([f.cells[rows] for f, rows in zip(self._frames, parts, strict=False)])
        ages = np.repeat(np.arange(1, len(parts) + 1), [len(rows) for rows in parts])
        _, first = np.unique(octree.morton_codes(cells), return_index=True)
        if len(first) < LEAST_POINTS:
            return None
        return ReferencePoints(surface_of_points(cells[first]), ages[first], np.concatenate(parts)[first])

    @staticmethod
    def _usable(frame: _KeptFrame, depth: int, has_bodies: bool) -> Integers:
        is_inside = ((frame.cells >= 0) & (frame.cells < 1 << depth)).all(axis=1)
        return np.flatnonzero(is_inside & ~frame.is_explained if has_bodies else is_inside)

    def unexplained_share(self) -> float:
        """The share of the points of the last frame that no body explains; 0 without a frame."""
        return float(np.mean(~self._frames[0].is_explained)) if self._frames else 0.0

    def add(self, cells: Integers, is_explained: Booleans) -> None:
        """Keep the points of a frame."""
        self._found.clear()
        self._frames = [_KeptFrame(cells, is_explained), *self._frames[: MAX_FRAMES - 1]]


def explained_points(surface: PosedSurface, points: Integers, nearest: Integers) -> Booleans:
    """(n,): whether a body explains the points (n, 3), 2^-16 m. nearest (n,): a body's sample near each,
    negative without one.
    """
    if (kernel := native.kernel("explained_points")) is not None:
        return np.asarray(kernel(surface.places, surface.normals, points, nearest)).view(bool)
    result = nearest >= 0
    rows = nearest[result]
    aside = ((points[result] - surface.places[rows]) ** 2).sum(axis=1)
    distance = offsets_from(surface, points[result], rows)
    result[result] = (np.abs(distance) <= FARTHEST) & (aside <= MAX_ASIDE**2)
    return result


def joined_hints(
    bodies: SurfaceHints | None, references: ReferencePoints | None, depth: int, smooths: bool
) -> SurfaceHints | None:
    """The samples of the bodies, then those of the references, as the octree sees them. smooths: as in `Scene`."""
    if references is None:
        return bodies
    own = references.samples
    if bodies is None:
        places, normals, neighbours = own
    else:
        places = np.concatenate([bodies.points, own.places])
        normals = np.concatenate([bodies.normals, own.normals])
        neighbours = np.concatenate([bodies.neighbours, own.neighbours + len(bodies.points)])
    return hints_of_samples(places, normals, neighbours, depth, smooths)


def pack_references(references: Sequence[Reference]) -> bytes:
    """The references of all frames of a chunk."""
    numbers = list[int]()
    for reference in references:
        numbers.append(2 * reference.frames + reference.hides_bodies)
        if reference.frames:
            numbers += [varint.signed(v) for v in reference.motion]
    return varint.write(numbers)


def unpack_references(data: bytes, frames: int, at: int) -> tuple[list[Reference], int]:
    """The inverse of `pack_references`, and the position after them. Raises Corrupt."""
    result = list[Reference]()
    for _ in range(frames):
        (number,), at = varint.read(data, 1, at)
        count, motion = number // 2, [0, 0, 0]
        if count:
            numbers, at = varint.read(data, 3, at)
            motion = [varint.unsigned(v) for v in numbers]
        if count > MAX_FRAMES or max(map(abs, motion)) > MAX_MOTION:
            raise Corrupt("bodycast: a reference to earlier frames is out of range")
        result.append(Reference(count, (motion[0], motion[1], motion[2]), number % 2 == 1))
    return result, at
