"""How a long array is laid out for coding many symbols per NumPy operation.

    (steps, lanes) ─► segments ─► diagonals: the rows of one flat array in which a neighbour is the array, shifted

A segment is some lanes over some steps. Step t of lane l lies on diagonal t + l. The neighbours that a symbol's law
depends on (earlier in its lane, or in earlier lanes at the same step) all lie on the two diagonals before, so a whole
diagonal of all segments is coded at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..typing import AnyInteger

LANES = 64  # of a segment, at most
STEPS = 128  # of a segment, at least, unless the array has fewer
WIDE = 4096  # symbols that one NumPy operation should take


class Layout:
    """(steps, lanes) as diagonals of segments.

    The longer axis is cut into pieces, the last padded with zeros; the shorter one into groups of lanes, the first of
    which may have one lane more than the others. A segment is one piece of one group.

    steps, lanes, segments: of the layout. row: places of a diagonal in the flat array. width: symbols of the widest
    diagonal.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._transposed = shape[1] > shape[0]
        self._long, self._short = shape[::-1] if self._transposed else shape
        groups = -(-self._short // LANES)
        self.lanes = -(-self._short // groups)
        pieces = max(1, min(WIDE // self._short, self._long // STEPS))
        self.steps = -(-self._long // pieces)
        self.pieces = -(-self._long // self.steps)
        self.segments = groups * self.pieces
        self._full_segments = (self._short - groups * (self.lanes - 1)) * self.pieces  # segments with all lanes
        self.row = (self.lanes + 2) * self.segments  # two lanes and two diagonals of padding
        self.width = min(self.steps, self.lanes) * self.segments

    def diagonals(self) -> Iterator[tuple[int, int, int]]:
        """(diagonal, begin, end): the range of each diagonal in the flat array of `skewed`."""
        for i in range(self.steps + self.lanes - 1):
            low, high = max(0, i - self.steps + 1), min(self.lanes, i + 1)
            begin = (i + 2) * self.row + (low + 2) * self.segments
            missing = self.segments - self._full_segments if high == self.lanes else 0
            if (count := (high - low) * self.segments - missing) > 0:
                yield i, begin, begin + count

    def empty(self, dtype: Any) -> AnyInteger:
        """Zeros for all diagonals and their padding."""
        return np.zeros((self.steps + self.lanes + 1) * self.row, dtype)

    def _cube(self, flat: AnyInteger) -> AnyInteger:
        """The places of (steps, lanes, segments) in a flat array, as a view."""
        item = flat.itemsize
        strides = (self.row * item, (self.row + self.segments) * item, item)
        inside = flat[2 * self.row + 2 * self.segments :]
        return np.lib.stride_tricks.as_strided(inside, (self.steps, self.lanes, self.segments), strides)

    def _parts(self, cube: AnyInteger) -> Iterator[tuple[AnyInteger, slice]]:
        """Parts of a cube as (steps, lanes, groups, pieces), and the lanes of the plain array that each holds."""
        first = self._full_segments // self.pieces * self.lanes
        for segments, lanes, plain in (
            (slice(0, self._full_segments), self.lanes, slice(0, first)),
            (slice(self._full_segments, None), self.lanes - 1, slice(first, None)),
        ):
            part = cube[:, :lanes, segments]
            if part.size:
                yield part.reshape(self.steps, lanes, -1, self.pieces), plain

    def skewed(self, plain: AnyInteger, dtype: Any) -> AnyInteger:
        """The flat array of diagonals from an array (steps, lanes)."""
        long = plain.T if self._transposed else plain
        if (more := self.pieces * self.steps - self._long) > 0:
            long = np.concatenate([long, np.zeros((more, self._short), long.dtype)])
        flat = self.empty(dtype)
        for part, lanes in self._parts(self._cube(flat)):
            block = long[:, lanes].reshape(self.pieces, self.steps, part.shape[2], part.shape[1])
            part[...] = block.transpose(1, 3, 2, 0)
        return flat

    def unskewed(self, flat: AnyInteger, dtype: Any) -> AnyInteger:
        """The array (steps, lanes) from the flat array of diagonals."""
        long = np.empty((self.pieces * self.steps, self._short), dtype)
        for part, lanes in self._parts(self._cube(flat)):
            block = long[:, lanes].reshape(self.pieces, self.steps, part.shape[2], part.shape[1])
            block[...] = part.transpose(3, 0, 2, 1)
            long[:, lanes] = block.reshape(len(long), -1)
        return long[: self._long].T if self._transposed else long[: self._long]
