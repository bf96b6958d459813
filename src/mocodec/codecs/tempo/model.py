"""All that encoder and decoder share about one recording: the rows its motion becomes, and how large they should be.

    body frame ──► rows: heading · place (3) · components of the pose ──DCT over the chunk──► coefficients

    prior, names ─of_names─► Model                     a set of points that the prior knows
    motion ─learn─► Model ─pack─► bytes ─unpack─►      any other
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...motion import Floats
from . import body, contexts
from .prior import PointSet, Prior

Integers = NDArray[np.int64]

HEADING_STEP = -213
"""log₂ of the step of the heading's mean, radians, in 1/32 octave: about 0.01. Steps of its DCT grow with √frames."""
PLACE = slice(1, 4)
POSE = 4
EDGES_MHZ = (700, 2000, 5000)
"""Each band of frequencies between these has a basis of its own."""


@dataclass(frozen=True, eq=False)
class Model:
    """One set of points at one frame rate."""

    points: PointSet
    prior: Prior
    rate: float
    _cache: dict[tuple[int, ...], Integers] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        return len(self.points.spreads)

    def expected(self, frames: int, step: int) -> Integers:
        """log₂ of the expected magnitudes, in steps: (frames, rows). Integers only."""
        key = (frames,)
        if key not in self._cache:
            if len(self._cache) > 16:
                self._cache.clear()
            heading = np.zeros(self.rows, np.int64)
            heading[0] = heading_step(frames)
            self._cache[key] = contexts.expect(self.points.spreads, self.points.means, frames, self.rate, heading)
        logs = self._cache[key] - step
        logs[:, 0] += step
        return logs

    def bands(self, frames: int) -> list[slice]:
        """The frequencies of a chunk that each basis serves. Integers only."""
        edges = [0, *(min(frames, -(-2 * frames * e // round(self.rate * 1000))) for e in EDGES_MHZ), frames]
        return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]

    def analyse(self, positions: Floats) -> Floats:
        """Positions (frames, points, 3), y up, as coefficients (frames, rows); the heading's are whole numbers of steps already."""
        from scipy.fft import dct, idct

        frames, points = positions.shape[:2]
        place = positions.mean(axis=1)
        centred = positions - place[:, None]
        out = np.zeros((frames, self.rows))
        h = body.heading(centred, self.points.pose)
        h -= 2 * np.pi * np.round(h[0] / (2 * np.pi))
        out[:, 0] = smooth_heading(h, self.rate)
        angle = idct(out[:, 0] * step_size(heading_step(frames)), norm="ortho")
        out[:, PLACE] = dct(place * np.sqrt(points), axis=0, norm="ortho")
        pose = (body.turn(centred, -angle) - self.points.pose).reshape(frames, -1)
        spectrum = dct(pose, axis=0, norm="ortho")
        for band, basis in zip(self.bands(frames), self.points.bases, strict=True):
            out[band, POSE:] = spectrum[band] @ basis.T
        return out

    def synthesise(self, coefficients: Floats, frames: int, start: int = 0, stop: int | None = None) -> Floats:
        """Positions of frames [start, stop) of a chunk of `frames` from its first coefficients (frequencies, rows)."""
        from scipy.fft import idct

        points = len(self.points.pose)
        known = len(coefficients)
        spectrum = np.zeros((frames, 4 + 3 * points))
        spectrum[:known, :4] = coefficients[:, :4]
        spectrum[:, 0] *= step_size(heading_step(frames))
        for band, basis in zip(self.bands(frames), self.points.bases, strict=True):
            part = coefficients[band, POSE:]
            spectrum[band.start : band.start + len(part), 4:] = part @ basis
        signals = idct(spectrum, axis=0, norm="ortho", overwrite_x=True)[start:stop]
        pose = signals[:, 4:].reshape(-1, points, 3) + self.points.pose
        return body.turn(pose, signals[:, 0]) + signals[:, None, PLACE] / np.sqrt(points)


def heading_step(frames: int) -> int:
    """log₂ of the step of the heading's coefficients, radians, in 1/32 octave."""
    return HEADING_STEP + int(contexts.log2(np.array([frames]))[0]) // 2


def step_size(log: int | Integers) -> Floats:
    return 2.0 ** (np.asarray(log) / contexts.OCTAVE)


def smooth_heading(heading: Floats, rate: float) -> Floats:
    """The heading's DCT in whole steps, below about 1.2 Hz only."""
    from scipy.fft import dct

    frames = len(heading)
    coefficients = np.round(dct(heading, norm="ortho") / step_size(heading_step(frames)))
    coefficients[3 + int(2.4 * frames / rate) :] = 0
    return coefficients


@lru_cache(maxsize=8)
def of_names(names: tuple[str, ...], prior: Prior, rate: float) -> Model | None:
    """The model of a set of points that the prior knows by these names, in any order; None where it knows no such set."""
    for points in prior.sets:
        if len(names) == len(points.names) and set(names) == set(points.names):
            order = [points.names.index(n) for n in names]
            columns = (np.array(order)[:, None] * 3 + np.arange(3)).ravel()
            bases = tuple(b[:, columns] for b in points.bases)
            return Model(PointSet(names, points.pose[order], bases, points.spreads, points.means), prior, rate)
    return None


def plain(names: tuple[str, ...], prior: Prior, rate: float) -> Model:
    """A model without rows, for points that are only ever coded directly."""
    nothing = np.zeros((0, 0), np.int64)
    return Model(PointSet(names, np.zeros((len(names), 3)), (), nothing, nothing), prior, rate)
