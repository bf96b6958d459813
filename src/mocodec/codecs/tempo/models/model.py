"""What encoder and decoder share about one recording: its coordinates, and how large their coefficients should be.

positions ─► heading · place (3) · pose ─coordinates─► ─DCT over the chunk─► ─bases─► coefficients (frames, rows)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from ....entropy.lanes import StaticTables
from ....stages import basis, dct
from ....stages.lattice import Neighbours
from ....typing import Floats, Integers
from ..coding import contexts
from ..coding.rows import HEADING, PLACE, POSE, heading_step, step_size
from ..pose import heading
from .coordinates import Coordinates, PointCoordinates

MANY_ROWS, SPARSE_ROWS = 256, 0.5
"""With more than MANY_ROWS rows, of which less than this share have coefficients, only these are multiplied."""
BAND_EDGES_MHZ = (700, 2000, 5000)
"""Each band of frequencies between these has a basis of its own."""
BANDS = len(BAND_EDGES_MHZ) + 1
SLOWEST_HEADING = 3
"""Number of coefficients of the heading that every chunk keeps, at least."""
HEADING_HZ = 1.2
"""Coefficients of the heading up to this frequency are kept."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """How the coordinates of a pose move.

    bases: for each band (components, dimensions), orthonormal rows, strongest first, of scaled coordinates.
    spreads (rows, frequencies of `contexts.BANDS_MHZ`) and means (rows,): log₂ in 1/32 octave of the mean magnitude of
    the coefficients of heading, place and components, at 120 Hz, metres. completion: of the stored columns to the one
    basis of all bands, None where there are several.
    """

    bases: tuple[Floats, ...]
    spreads: Integers
    means: Integers
    completion: basis.Completion | None = None


@dataclass(frozen=True, eq=False)
class Model:
    """Coordinates and statistics of a set of points at one frame rate, and the tables that code their coefficients.

    weights (points,): how many times closer than the bound each point is kept. neighbours: of the lattice engine.
    """

    names: tuple[str, ...]
    coordinates: Coordinates
    statistics: Statistics
    tables: StaticTables
    rate: float
    weights: Floats | None = None
    neighbours: Neighbours | None = None
    _expected: dict[int, Integers] = field(default_factory=dict)
    compiled: dict[int, Any] = field(default_factory=dict, init=False)
    """State of `compiled_chunks`, by length of chunk."""

    @classmethod
    def without_rows(cls, names: tuple[str, ...], rate: float) -> Model:
        """For points that are coded directly only."""
        nothing = np.zeros((0, 0), np.int64)
        coordinates = PointCoordinates(np.zeros((len(names), 3)))
        return cls(
            names, coordinates, Statistics((), nothing, nothing), StaticTables.of(np.zeros((0, 1), np.int64)), rate
        )

    @property
    def points(self) -> int:
        return len(self.names)

    @property
    def rows(self) -> int:
        return len(self.statistics.spreads)

    def expected(self, frames: int, step: int) -> Integers:
        """log₂ of the expected magnitudes, in steps, 1/32 octave: (frames, rows). Integer arithmetic only."""
        if frames not in self._expected:
            if len(self._expected) > 16:
                self._expected.clear()
            steps = np.zeros(self.rows, np.int64)
            steps[HEADING] = heading_step(frames)
            known = self.statistics
            self._expected[frames] = contexts.expect(known.spreads, known.means, frames, self.rate, steps)
        logs = self._expected[frames] - step
        logs[:, HEADING] += step
        return logs

    def bands(self, frames: int) -> list[slice]:
        """The frequencies of a chunk that each basis serves. Integer arithmetic only."""
        edges = [
            0,
            *(min(frames, -(-2 * frames * e // max(1, round(self.rate * 1000)))) for e in BAND_EDGES_MHZ),
            frames,
        ]
        return [slice(a, b) for a, b in pairwise(edges)]

    def analyse(self, positions: Floats) -> Floats:
        """Coefficients (frames, rows), metres, of positions (frames, points, 3), y up.

        The heading is rounded to its steps, as it will be decoded: the pose absorbs its rounding error.
        """
        frames = len(positions)
        out = np.zeros((frames, self.rows))
        spectrum = coordinate_spectrum(positions, self.coordinates, self.rate, out)
        if self.statistics.completion is not None:
            self.statistics.completion.components(spectrum, out[:, POSE:])
            return out
        for band, of_band in zip(self.bands(frames), self.statistics.bases, strict=True):
            out[band, POSE:] = spectrum[band] @ of_band.T
        return out

    def synthesise(self, coefficients: Floats, frames: int) -> Floats:
        """Positions (frames, points, 3) of a chunk from its first coefficients (frequencies, rows), metres."""
        bases = self.synthesis_bases
        if self.rows > MANY_ROWS:
            used = np.append(np.ones(POSE, bool), coefficients[:, POSE:].any(axis=0))
            if np.count_nonzero(used) < SPARSE_ROWS * self.rows:
                bases, coefficients = tuple(b[used[POSE:]] for b in bases), coefficients[:, used]
        known = int(np.flatnonzero(coefficients.any(axis=1)).max(initial=-1)) + 1
        spectrum = np.empty((known, POSE + bases[0].shape[1]))
        spectrum[:, :POSE] = coefficients[:known, :POSE]
        for band, of_band in zip(self.bands(frames), bases, strict=True):
            part = slice(band.start, min(band.stop, known))
            spectrum[part, POSE:] = coefficients[part, POSE:] @ of_band
        curves = dct.inverse(spectrum, frames)
        moved = heading.rotate(self.coordinates.inverse(curves[:, POSE:]), curves[:, HEADING])
        moved += curves[:, None, PLACE] / np.sqrt(self.points)
        return moved

    @cached_property
    def synthesis_bases(self) -> tuple[Floats, ...]:
        """For each band (components, dimensions), of coordinates before `scale`."""
        return self.coordinates.unscaled(self.statistics.bases)


def coordinate_spectrum(positions: Floats, coordinates: Coordinates, rate: float, moves: Floats) -> Floats:
    """DCT (frames, dimensions) of the coordinates of positions (frames, points, 3), y up.

    moves (frames, rows): its columns of heading and place are filled.
    """
    frames, points = positions.shape[:2]
    positions = np.asfortranarray(positions)
    place = positions.mean(axis=1)
    centred = positions - place[:, None]
    h = heading.heading(centred, coordinates.pose)
    h -= 2 * np.pi * np.round(h[0] / (2 * np.pi))
    moves[:, HEADING] = smooth_heading(h, rate)
    moves[:, PLACE] = dct.forward(place * np.sqrt(points))
    angle = dct.inverse(moves[:, HEADING], frames)
    return coordinates.scale(dct.forward(coordinates.forward(heading.rotate(centred, -angle))))


def smooth_heading(angles: Floats, rate: float) -> Floats:
    """DCT of the heading, rounded to its steps, without the frequencies above `HEADING_HZ`."""
    frames = len(angles)
    size = step_size(heading_step(frames))
    coefficients = np.round(dct.forward(angles) / size) * size
    coefficients[heading_frequencies(frames, rate) :] = 0
    return coefficients


def heading_frequencies(frames: int, rate: float) -> int:
    """How many coefficients of the heading are kept."""
    return SLOWEST_HEADING + int(2 * HEADING_HZ * frames / rate)
