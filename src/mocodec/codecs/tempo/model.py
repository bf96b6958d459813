"""All that encoder and decoder share about one recording: the rows its motion becomes, and how large they should be.

body frame ──► heading · place (3) · pose ──DCT over the chunk──► ─bases of the pose─► coefficients (frames, rows)

prior, names ─of_names─► Model                     a set of points that the prior knows
motion ─learn─► Model ─pack─► bytes ─unpack─►      any other
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...geometry.body_frame import normalised_label as plain_label
from ...motion import Floats
from . import body, contexts, cosine
from .prior import PointSet, Prior

Integers = NDArray[np.int64]

SLOPES = slice(0, 6)
HEADING = 6
PLACE = slice(7, 10)
POSE = 10
"""Rows: the place's slope where the chunk starts (3) and ends (3), heading, place (3), components of the pose."""
HEADING_STEP = -213
"""log₂ of the step of the heading's mean, radians, in 1/32 octave: about 0.01. Steps of its DCT grow with √frames."""
EDGES_MHZ = (700, 2000, 5000)
"""Each band of frequencies between these has a basis of its own."""


@dataclass(frozen=True, eq=False)
class Model:
    """One set of points at one frame rate."""

    points: PointSet
    prior: Prior
    rate: float
    weights: Floats | None = None
    """How much closer than the bound each point is kept, (points,), for corrections and the direct engine."""
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
            heading[HEADING] = heading_step(frames)
            self._cache[key] = contexts.expect(self.points.spreads, self.points.means, frames, self.rate, heading)
        logs = self._cache[key] - step
        logs[:, HEADING] += step
        return logs

    def bands(self, frames: int) -> list[slice]:
        """The frequencies of a chunk that each basis serves. Integers only."""
        edges = [0, *(min(frames, -(-2 * frames * e // round(self.rate * 1000))) for e in EDGES_MHZ), frames]
        return [slice(a, b) for a, b in pairwise(edges)]

    def analyse(self, positions: Floats) -> Floats:
        """Positions (frames, points, 3), y up, as coefficients (frames, rows) in metres; no slopes taken out yet.

        The heading comes as it will be decoded, rounded to its steps: what its rounding leaves is in the pose.
        """
        frames, points = positions.shape[:2]
        positions = np.asfortranarray(positions)
        place = positions.mean(axis=1)
        centred = positions - place[:, None]
        out = np.zeros((frames, self.rows))
        h = body.heading(centred, self.points.pose)
        h -= 2 * np.pi * np.round(h[0] / (2 * np.pi))
        out[:, HEADING] = smooth_heading(h, self.rate)
        angle = cosine.inverse(out[:, HEADING], frames)
        out[:, PLACE] = cosine.forward(place * np.sqrt(points))
        spectrum = self.points.weighed(cosine.forward(self.points.coordinates(body.turn(centred, -angle))))
        for band, basis in zip(self.bands(frames), self.points.bases, strict=True):
            out[band, POSE:] = spectrum[band] @ basis.T
        return out

    def synthesise(self, coefficients: Floats, frames: int) -> Floats:
        """The positions (frames, points, 3) of a chunk from its first coefficients (frequencies, rows), in metres."""
        points, bases = len(self.points.pose), self.points.unweighed_bases
        known = int(np.flatnonzero(coefficients[:, HEADING:].any(axis=1)).max(initial=-1)) + 1
        spectrum = np.empty((known, POSE - HEADING + bases[0].shape[1]))
        spectrum[:, : POSE - HEADING] = coefficients[:known, HEADING:POSE]
        for band, basis in zip(self.bands(frames), bases, strict=True):
            part = slice(band.start, min(band.stop, known))
            spectrum[part, POSE - HEADING :] = coefficients[part, POSE:] @ basis
        curves = cosine.inverse(spectrum, frames)
        place = curves[:, 1 : POSE - HEADING]
        if len(coefficients):
            place += slope_curves(frames).T @ coefficients[0, SLOPES].reshape(2, 3)
        moved = body.turn(self.points.posed(curves[:, POSE - HEADING :]), curves[:, 0])
        moved += place[:, None] / np.sqrt(points)
        return moved


def without_slopes(coefficients: Floats, step: int) -> Floats:
    """Coefficients with the slopes of the place taken out of it and rounded, as they will be decoded, to the step."""
    out = coefficients.copy()
    bends, size = slope_spectra(len(out)), step_size(step)
    slopes = np.round(_fit_slopes(out[:, PLACE], bends) / size) * size
    out[0, SLOPES] = slopes.ravel()
    out[:, PLACE] -= bends.T @ slopes
    return out


@lru_cache(maxsize=16)
def slope_curves(frames: int) -> Floats:
    """Two curves (2, frames), one bent at the start of a chunk and one at its end.

    A DCT continues a curve by its mirror image: a slope at an end makes a kink there, and coefficients that fall only
    as 1/k². Walking is such a slope. These curves take it out: parabolas that are level at one end.
    """
    t = (np.arange(frames) + 0.5) / frames
    return SLOPE_GAIN / np.sqrt(frames) * np.stack([t - t * t / 2, t * t / 2])


@lru_cache(maxsize=16)
def slope_spectra(frames: int) -> Floats:
    """The DCT of `slope_curves`, (2, frames)."""
    return cosine.forward(slope_curves(frames).T).T


SLOPE_GAIN = 4.0
"""Makes one step of a slope about as much error as one step of a coefficient."""


def _fit_slopes(curves: Floats, bends: Floats) -> Floats:
    """How much of each bend (2, frames) takes most of the slow fall out of the spectra (frames, 3): (2, 3)."""
    first, last = SLOPE_FIT
    if len(curves) < 2 * first:
        return np.zeros((2, curves.shape[1]))
    weight = np.arange(first, min(last, len(curves)))[:, None]
    slopes = np.linalg.lstsq(weight * bends.T[first:last], weight * curves[first:last], rcond=None)[0]
    return np.asarray(slopes, np.float64)


SLOPE_FIT = (12, 120)
"""Between these frequencies of a chunk."""


def heading_step(frames: int) -> int:
    """log₂ of the step of the heading's coefficients, radians, in 1/32 octave."""
    return HEADING_STEP + int(contexts.log2(np.array([frames]))[0]) // 2


def step_size(log: int | Integers) -> Floats:
    return 2.0 ** (np.asarray(log) / contexts.OCTAVE)


def smooth_heading(heading: Floats, rate: float) -> Floats:
    """The heading's DCT, rounded to its steps, below about 1.2 Hz only."""
    frames = len(heading)
    size = step_size(heading_step(frames))
    coefficients = np.round(cosine.forward(heading) / size) * size
    coefficients[3 + int(2.4 * frames / rate) :] = 0
    return coefficients


@lru_cache(maxsize=8)
def of_names(names: tuple[str, ...], prior: Prior, rate: float) -> Model | None:
    """The model of a set of points that the prior knows by these names, in any order; None where it has no such set."""
    labels = [plain_label(n) for n in names]
    for points in prior.sets:
        known = [plain_label(n) for n in points.names]
        if sorted(labels) == sorted(known) and len(set(labels)) == len(labels):
            order = [known.index(label) for label in labels]
            columns = (np.array(order)[:, None] * 3 + np.arange(3)).ravel()
            bases = tuple(b[:, columns] for b in points.bases)
            return Model(PointSet(names, points.pose[order], bases, points.spreads, points.means), prior, rate)
    return None


def plain(names: tuple[str, ...], prior: Prior, rate: float) -> Model:
    """A model without rows, for points that are only ever coded directly."""
    nothing = np.zeros((0, 0), np.int64)
    return Model(PointSet(names, np.zeros((len(names), 3)), (), nothing, nothing), prior, rate)
