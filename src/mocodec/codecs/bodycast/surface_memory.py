"""What the earlier frames of a chunk show of the bodies' surface: where it lies, and its colours. Integers only.

points of a frame ─► distance from their sample ─► mean of each sample, recent frames first ─► places of the next frame
      │
      └─ turned back into the canonical pose ─► the latest of each sample, with colours ─► expected colours
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ... import native
from ...typing import Integers, YCoCg
from .integer_surface import TURN_BITS
from .surface_hints import NORMAL_BITS

SMOOTHED = 6  # neighbours of a sample whose distances count for half
KEPT_FIFTHS = 4  # of the sums of distances, from frame to frame
COUNT_UNIT = 16  # what a point counts
PRIOR_UNITS = 32  # that a distance of zero counts for
FARTHEST = 983  # distance of points that are learned from, 2^-16 m: 15 mm
KEPT_POINTS = 8  # of each sample, with their colours
SEARCHED_SAMPLES = 7  # whose points are candidates: the sample and its nearest neighbours
AVERAGED = 4  # points whose mean colour is expected
SOFTENING = 2000  # added to squared distances, 2^-32 m²: (0.7 mm)²
WEIGHT_UNIT = 1 << 40
BATCH_POINTS = 8192  # whose candidates are in memory together
NOT_SEEN = 1 << 24  # coordinate of the points that a sample does not have yet: 256 m
LARGEST_PLACE = 1 << 23  # of canonical coordinates: 128 m, so that products of damaged ones fit into 64 bits


class PosedSurface(NamedTuple):
    """The samples of all bodies in a frame.

    rows (m,): their numbers among the samples of all bodies of the file. places (m, 3): 2^-16 m. normals (m, 3): of
    length 2^NORMAL_BITS. links (m,): the first link of each sample, among those of all bodies in the frame. turns
    (links, 3, 3): 2^-TURN_BITS.
    """

    rows: Integers
    places: Integers
    normals: Integers
    links: Integers
    turns: Integers


class SampleTable(NamedTuple):
    """The samples of all bodies of a file, in the canonical pose.

    points (m, 3): 2^-16 m. neighbours (m, SEARCHED_SAMPLES − 1): the nearest samples of each. colours (m, 3): YCoCg of
    the texture.
    """

    points: Integers
    neighbours: Integers
    colours: YCoCg

    def canonical(self, frame: PosedSurface, points: Integers, samples: Integers) -> Integers:
        """(n, 3): points of a frame in the canonical pose, each moved as the first link of its sample (n,) ≥ 0."""
        if (kernel := native.kernel("canonical_places")) is not None:
            surface = frame.rows, frame.places, frame.links, frame.turns
            return np.asarray(kernel(self.points, *surface, points, samples))
        apart = points - frame.places[samples]
        turned = (frame.turns[frame.links[samples]] * apart[:, :, None]).sum(axis=1) >> TURN_BITS
        return np.clip(self.points[frame.rows[samples]] + turned, -LARGEST_PLACE, LARGEST_PLACE)


def offsets_from(frame: PosedSurface, points: Integers, samples: Integers) -> Integers:
    """(n,): the distances of points (n, 3), 2^-16 m, from the tangent planes of their samples (n,)."""
    return ((points - frame.places[samples]) * frame.normals[samples]).sum(axis=1) >> NORMAL_BITS


class PlaceMemory:
    """The mean distance of the points of earlier frames from each sample."""

    def __init__(self, table: SampleTable) -> None:
        self._neighbours, count = table.neighbours, len(table.points)
        self._distances, self._counts = np.zeros(count, np.int64), np.zeros(count, np.int64)

    def corrected(self, frame: PosedSurface) -> Integers:
        """The places (m, 3) of the samples of a frame, moved along their normals by the mean distance of the points."""
        if (kernel := native.kernel("corrected_places")) is not None:
            frame_arrays = frame.rows, frame.places, frame.normals
            return np.asarray(kernel(*frame_arrays, self._neighbours, self._distances, self._counts))
        around = self._neighbours[frame.rows, :SMOOTHED]
        distance = 2 * self._distances[frame.rows] + self._distances[around].sum(axis=1)
        count = 2 * self._counts[frame.rows] + self._counts[around].sum(axis=1) + PRIOR_UNITS
        offset = COUNT_UNIT * distance // count
        return frame.places + (offset[:, None] * frame.normals >> NORMAL_BITS)

    def learn(self, frame: PosedSurface, points: Integers, samples: Integers) -> None:
        """points (n, 3): of a frame, 2^-16 m. samples (n,): the row in `frame` near each, negative without one."""
        if (kernel := native.kernel("learn_places")) is not None:
            kernel(frame.rows, frame.places, frame.normals, points, samples, self._distances, self._counts)
            return
        known = np.flatnonzero(samples >= 0)
        distance = offsets_from(frame, points[known], samples[known])
        near = np.abs(distance) <= FARTHEST
        rows, size = frame.rows[samples[known[near]]], len(self._counts)
        self._distances = self._distances * KEPT_FIFTHS // 5 + np.bincount(rows, distance[near], size).astype(np.int64)
        self._counts = self._counts * KEPT_FIFTHS // 5 + COUNT_UNIT * np.bincount(rows, minlength=size)


def mean_colour(colours: Integers, square: Integers) -> Integers:
    """(n, 3): the mean of colours (n, AVERAGED, 3), weighted by the inverse of squares (n, AVERAGED) > 0."""
    weight = WEIGHT_UNIT // square
    total = np.maximum(weight.sum(axis=1), 1)[:, None]
    return ((colours * weight[..., None]).sum(axis=1) + total // 2) // total


class ColourMemory:
    """The latest points of each sample with their colours; at first the sample itself with that of the texture."""

    def __init__(self, table: SampleTable) -> None:
        self._neighbours, count = table.neighbours, len(table.points)
        self._places = np.full((count, 3, KEPT_POINTS), NOT_SEEN, np.int32)  # coordinates side by side
        self._colours = np.zeros((count, KEPT_POINTS, 3), np.int16)
        self._places[:, :, 0], self._colours[:, 0] = table.points, table.colours
        self._seen = np.ones(count, np.int64)

    def expected(self, rows: Integers, places: Integers) -> YCoCg:
        """(n, 3): the mean colour of the AVERAGED learned points nearest to canonical places (n, 3).

        rows (n,): the sample near each, of all bodies. Of equal distances the first counts.
        """
        if (kernel := native.kernel("expected_colours")) is not None:
            return np.asarray(kernel(rows, places, self._neighbours, self._places, self._colours))
        parts = [slice(start, start + BATCH_POINTS) for start in range(0, len(rows), BATCH_POINTS)]
        found = [self._expected(rows[part], places[part]) for part in parts]
        return np.concatenate([np.zeros((0, 3), np.int64), *found]).astype(np.int16)

    def _expected(self, rows: Integers, places: Integers) -> Integers:
        searched = np.concatenate([rows[:, None], self._neighbours[rows]], axis=1)
        candidates = self._places[searched].swapaxes(2, 3).reshape(len(rows), -1, 3).astype(np.int64)
        square = ((candidates - places[:, None]) ** 2).sum(axis=2)
        slots = square.shape[1]
        chosen = np.argpartition(square * slots + np.arange(slots), AVERAGED, axis=1)[:, :AVERAGED]
        candidates = self._colours[searched].reshape(len(rows), slots, 3)
        colours = np.take_along_axis(candidates, chosen[..., None], axis=1).astype(np.int64)
        return mean_colour(colours, np.take_along_axis(square, chosen, axis=1) + SOFTENING)

    def learn(self, rows: Integers, places: Integers, colours: YCoCg) -> None:
        """Keep points with their colours (n, 3); of each sample the last KEPT_POINTS. rows, places: as above."""
        if (kernel := native.kernel("learn_colours")) is not None:
            kernel(rows, places, colours, self._places, self._colours, self._seen)
            return
        order = np.argsort(rows, kind="stable")
        own = rows[order]
        first = np.flatnonzero(np.diff(own, prepend=-1))
        length = np.diff(np.append(first, len(own)))
        rank = np.arange(len(own)) - np.repeat(first, length)
        last = np.repeat(length, length) - rank <= KEPT_POINTS
        slot = (self._seen[own] + rank) % KEPT_POINTS
        self._places[own[last], :, slot[last]] = places[order[last]]
        self._colours[own[last], slot[last]] = colours[order[last]]
        self._seen += np.bincount(rows, minlength=len(self._seen))
