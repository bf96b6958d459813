"""Frozen samples: points that stand still at one exact value while others move, and come back at that value.

    positions ──split──► positions with NaN at frozen samples, as in gaps    to the codec, which fills them
    missing and frozen samples ──pack──► bytes                               one part of each chunk
    decoded positions, bytes ──restore──► positions with gaps and frozen samples

Files park missing markers at the origin, at a clamp value or at their last position. Taken for motion, these jumps cost
far more than the motion. A frozen run is stored as its start, its length and its value; the value is either in a table
or that of the sample before the run, whose error the run then has.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .. import native, parallel
from ..entropy import coder, varint
from ..errors import Corrupt
from ..typing import Booleans, Floats, Integers
from . import gaps

SHORTEST_RUN = 5
"""Frames of the shortest run that is found by itself. Shorter runs are found by their value: that of a longer run, or
one to which points jump again and again."""
SHORTEST_EDGE_RUN = 32
"""Frames of the shortest run without a jump, at either end of the recording."""
JUMP = 3.0
"""A step is a jump if it is longer than this many times the median step of its point."""
RELATIVE_TOLERANCE = 2.0**-14
"""Rounding of a stored position, relative to its largest coordinate, if the codec gives no tolerance."""
WITH_FROZEN = 0
"""First number of a part that has frozen runs; a gap mask never begins with it. Never change it."""
HELD = 0
"""Number of a run's value that stands for the sample before the run; the others count from 1 in the table."""
VALUE_BYTES = 24


@dataclass(frozen=True, eq=False)
class Split:
    """Samples set apart from a transform, for frames of a recording.

    positions (frames, points, 3): the original ones, NaN where missing. missing, frozen, constant (frames, points):
    masks; constant: the frozen samples whose exact value is stored. The other frozen samples repeat a position of the
    point, which may be rounded by `tolerance` metres. holds: whether such a run may take the decoded sample before it
    instead: no bytes for the value, but all of the run has the error of that sample.
    """

    positions: Floats
    missing: Booleans
    frozen: Booleans
    constant: Booleans
    tolerance: float | None = None
    holds: bool = True

    def __getitem__(self, frames: slice) -> Split:
        masks = self.missing[frames], self.frozen[frames], self.constant[frames]
        return Split(self.positions[frames], *masks, self.tolerance, self.holds)

    @property
    def apart(self) -> Booleans:
        """(frames, points): missing or frozen."""
        return self.missing | self.frozen

    @cached_property
    def moving(self) -> Floats:
        """The positions (frames, points, 3) with NaN at missing and frozen samples; not to be written to."""
        return gaps.apply(self.positions, self.frozen)

    def mean_error(self, decoded: Floats) -> float:
        """Mean distance of all samples, metres, from positions (frames, points, 3) before `restore`, if none holds."""
        if (kernel := native.kernel("compare_positions")) is not None:
            _, samples, total, _ = kernel(self.moving, decoded)
            return (total + self.rounding_error) / (samples + int((self.frozen & ~self.missing).sum()))
        off = self.positions - decoded
        off *= off
        error = np.where(self.apart, 0.0, np.sqrt(off[..., 0] + off[..., 1] + off[..., 2]))
        return (float(error.sum()) + self.rounding_error) / int((~self.missing).sum())

    @cached_property
    def rounding_error(self) -> float:
        """Sum of the distances of frozen samples from their stored values, metres, if none holds."""
        runs = _runs_of(self.frozen, self.positions)
        error = self._stored_values(runs) - self.positions[runs.first, runs.point]
        return float((np.sqrt((error**2).sum(axis=1)) * runs.length).sum())

    def pack(self) -> bytes:
        """The bytes of gaps and frozen runs; those of `gaps.pack` if nothing is frozen."""
        mask = gaps.pack(self.missing)
        if not self.frozen.any():
            return mask
        runs = _runs_of(self.frozen, self.positions)
        before = np.maximum(runs.first - 1, 0)
        held = (runs.first > 0) & ~self.constant[runs.first, runs.point] & self.holds
        held &= _equal(self.positions[before, runs.point], self.positions[runs.first, runs.point])
        values = self._stored_values(runs)[~held]
        table, order = np.unique(values.view(np.uint64).reshape(-1, 3), axis=0, return_inverse=True)
        which = np.full(len(held), HELD)
        which[~held] = 1 + order.ravel()
        frames = len(self.frozen)
        starts = runs.point * frames + runs.first
        waits = starts - np.append(0, starts + runs.length)[:-1]
        numbers = coder.pack(np.stack([waits, runs.length - 1, which], axis=1))
        octets = coder.pack(table.astype("<u8").view(np.uint8).reshape(-1, VALUE_BYTES))
        sizes = varint.write([WITH_FROZEN, len(mask), len(waits), len(numbers)])
        return sizes + mask + numbers + octets

    def _stored_values(self, runs: _Runs) -> Floats:
        """Values (runs, 3): exact for constants, otherwise with as few bits as the tolerance allows."""
        values = self.positions[runs.first, runs.point]
        tolerance = self.tolerance
        if tolerance is None:
            tolerance = RELATIVE_TOLERANCE * np.abs(values).max(axis=1, keepdims=True, initial=0.0)
        with np.errstate(all="ignore"):
            step = np.exp2(np.floor(np.log2(tolerance)))
            rounded = np.rint(values / step) * step
        exact = self.constant[runs.first, runs.point][:, None] | ~(np.abs(rounded - values) <= tolerance / 2)
        return np.ascontiguousarray(np.where(exact, values, rounded))


class _Runs(NamedTuple):
    """Runs of equal samples, point after point. first, length: frames; point: column. Each (runs,)."""

    first: Integers
    length: Integers
    point: Integers


def split(positions: Floats, tolerance: float | None = None, bones: bool = False, holds: bool = True) -> Split:
    """Find the frozen samples of positions (frames, points, 3), NaN in gaps.

    tolerance: metres by which a position that a point repeats may be rounded; 0: exact; None: relative to its size.
    bones: the points are joints of a skeleton: joints that stand still without a jump are motion, since their bones
    keep their lengths. holds: see `Split`.
    """
    missing = np.isnan(positions[..., 0])
    nothing = np.zeros(missing.shape, bool)
    same = _equal_to_before(positions) & ~missing[1:]
    moves = (~same & ~(missing[1:] | missing[:-1])).any(axis=1)
    if not (same.any(axis=1) & moves).any():  # whole frames that repeat are no frozen samples
        return Split(positions, missing, nothing, nothing, tolerance, holds)
    changes = np.append(0, np.cumsum(moves))
    frozen, constant = _find(positions, missing, same, changes, bones)
    if (frozen | missing).all():
        frozen = constant = nothing
    return Split(positions, missing, frozen, constant, tolerance, holds)


def _find(
    positions: Floats, missing: Booleans, same: Booleans, changes: Integers, bones: bool
) -> tuple[Booleans, Booleans]:
    """Masks (frames, points) of frozen samples and of those with a constant.

    same (frames − 1, points): equal to the frame before. changes (frames,): frames so far where any point moves. Points
    that never repeat a sample have frozen samples only at values where others are parked, and are left out at first.
    """
    repeating = np.flatnonzero(same.any(axis=0))
    found, parked = _find_among(positions[:, repeating], missing[:, repeating], same[:, repeating], changes, bones)
    if parked:
        found, _ = _find_among(positions, missing, same, changes, bones)
        return found[0], found[1]
    frozen, constant = np.zeros(missing.shape, bool), np.zeros(missing.shape, bool)
    frozen[:, repeating], constant[:, repeating] = found
    return frozen, constant


def _find_among(
    positions: Floats, missing: Booleans, same: Booleans, changes: Integers, bones: bool
) -> tuple[Booleans, bool]:
    """The masks of `_find`, (2, frames, points), and whether points are parked at any value."""
    runs = _runs_of(~missing, positions, same)
    values = positions[runs.first, runs.point]
    into, out = _steps(runs, values)
    typical = _typical_steps(runs, into, same)[runs.point]
    jump_in, jump_out = into > JUMP * typical, out > JUMP * typical
    others_move = changes[runs.first + runs.length - 1] - changes[runs.first] >= SHORTEST_RUN - 1
    is_jump = (jump_in & np.isfinite(typical)) | (jump_out & ~np.isnan(out))
    is_jump &= ~(np.isnan(into) & np.isnan(out))
    at_edge = (np.isnan(into) | np.isnan(out)) & (runs.length >= SHORTEST_EDGE_RUN) & (not bones)
    found = others_move & (runs.length >= SHORTEST_RUN) & (is_jump | at_edge)
    constant = np.isnan(into) | jump_in
    parking = _parking_values(runs, values, found & constant, jump_in & jump_out)
    of_constant = _with_values(values, parking)
    found |= of_constant
    constant |= of_constant
    masks = np.zeros((2, *missing.shape), bool)
    first = np.where(constant, runs.first, runs.first + 1)
    length = runs.length - (first - runs.first)
    for mask, chosen in zip(masks, (found, found & constant), strict=True):
        frame = np.repeat(first[chosen], length[chosen]) + _within(length[chosen])
        mask[frame, np.repeat(runs.point[chosen], length[chosen])] = True
    return masks, bool(len(parking))


def _parking_values(runs: _Runs, values: Floats, constant: Booleans, between_jumps: Booleans) -> Integers:
    """Bit patterns (n, 3) of values where points are parked: those of constant runs, and those to which points jump
    in at least two runs of `SHORTEST_RUN` samples together, mostly from different places. A motion that repeats as a
    loop comes to its values from the same places each time.
    """
    patterns = _bits(values)
    repeated, which, counts = np.unique(patterns[between_jumps], axis=0, return_inverse=True, return_counts=True)
    which = which.ravel()
    samples = np.bincount(which, runs.length[between_jumps], minlength=len(counts))
    before = np.roll(patterns, 1, axis=0)[between_jumps]
    arrivals = np.unique(np.column_stack([which.astype(before.dtype), before]), axis=0)[:, 0]
    places = np.bincount(arrivals.astype(np.int64), minlength=len(counts))
    again = repeated[(counts >= 2) & (samples >= SHORTEST_RUN) & (places >= np.maximum(2, counts / 2))]
    return np.unique(np.concatenate([patterns[constant], again]), axis=0)


def _with_values(values: Floats, patterns: Integers) -> Booleans:
    """Which of the values (n, 3) have one of the bit patterns (m, 3)."""
    if not len(patterns):
        return np.zeros(len(values), bool)
    rows = np.concatenate([patterns, _bits(values)])
    _, which = np.unique(rows, axis=0, return_inverse=True)
    return np.isin(which.ravel()[len(patterns) :], which.ravel()[: len(patterns)])


def _steps(runs: _Runs, values: Floats) -> tuple[Floats, Floats]:
    """Distances (runs,) to the runs before and after of the same point; NaN where there is none."""
    into = np.full(len(values), np.nan)
    with np.errstate(over="ignore"):
        length = np.sqrt((np.diff(values, axis=0) ** 2).sum(axis=1))
    into[1:] = np.where(np.diff(runs.point) == 0, length, np.nan)
    return into, np.append(into[1:], np.nan)


def _typical_steps(runs: _Runs, into: Floats, same: Booleans) -> Floats:
    """Median step (points,) of the points that repeat a sample; infinite for those without a step."""
    typical = np.full(same.shape[1], np.inf)
    counted = np.append(False, runs.first[1:] == runs.first[:-1] + runs.length[:-1]) & (into > 0)
    edges = np.searchsorted(runs.point, np.arange(same.shape[1] + 1))
    for point in np.flatnonzero(same.any(axis=0)):
        part = slice(edges[point], edges[point + 1])
        steps = into[part][counted[part]]
        typical[point] = np.median(steps) if len(steps) else 0.0
    return typical


def _runs_of(mask: Booleans, positions: Floats, same: Booleans | None = None) -> _Runs:
    """Runs of equal positions (frames, points, 3) within the mask (frames, points).

    same (frames − 1, points): samples equal to the one before, if they are known.
    """
    same = _equal_to_before(positions) if same is None else same
    begins = mask.copy()
    begins[1:] &= ~(mask[:-1] & same)
    ends = mask.copy()
    ends[:-1] &= ~mask[1:] | begins[1:]
    point, first = np.nonzero(begins.T)
    _, last = np.nonzero(ends.T)
    return _Runs(first, last - first + 1, point)


def _within(lengths: Integers) -> Integers:
    """0, 1, … of each run, one run after the other."""
    return np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)


def _bits(positions: Floats) -> Integers:
    return np.ascontiguousarray(positions).view(np.int64)


def _equal(a: Floats, b: Floats) -> Booleans:
    """Where points (…, 3) have the same bits: −0 differs from 0."""
    same = _bits(a) == _bits(b)
    return same[..., 0] & same[..., 1] & same[..., 2]


def _equal_to_before(positions: Floats) -> Booleans:
    """Which samples (frames − 1, points) of all frames but the first are equal to those of the frame before."""
    blocks = parallel.blocks(max(0, len(positions) - 1))
    found = [positions[:0, :, 0] != 0, *parallel.over(lambda b: _equal(positions[1:][b], positions[:-1][b]), blocks)]
    return np.concatenate(found)


def restore(positions: Floats, data: bytes) -> Floats:
    """Decoded positions (frames, points, 3) with NaN in gaps and the values of frozen runs. Raises Corrupt."""
    frames, points = positions.shape[:2]
    if not data or data[0] != WITH_FROZEN:
        return gaps.apply(positions, gaps.unpack(data, (frames, points)))
    stored = _unpack(data, frames, points)
    return _put(gaps.apply(positions, stored.missing), stored)


def apart(data: bytes, shape: tuple[int, int]) -> Booleans:
    """`Split.apart` (frames, points) of the bytes that `Split.pack` made. Raises Corrupt."""
    if not data or data[0] != WITH_FROZEN:
        return gaps.unpack(data, shape)
    stored = _unpack(data, *shape)
    mask = stored.missing.copy()
    mask[stored.frames_and_points] = True
    return mask


class _Stored(NamedTuple):
    """The stored form of a chunk with frozen runs.

    missing (frames, points): mask. first, length: frames of each run; point: its column; which: its value, HELD or its
    number in the table, from 1. table (values, 3).
    """

    missing: Booleans
    first: Integers
    length: Integers
    point: Integers
    which: Integers
    table: Floats

    @property
    def frames_and_points(self) -> tuple[Integers, Integers]:
        """Frame and point of each frozen sample, run after run."""
        return np.repeat(self.first, self.length) + _within(self.length), np.repeat(self.point, self.length)


def _unpack(data: bytes, frames: int, points: int) -> _Stored:
    """Raises Corrupt."""
    (_, mask_bytes, count, run_bytes), at = varint.read(data, 4)
    stop = at + mask_bytes + run_bytes
    if stop > len(data) or not 0 < count <= frames * points:
        raise Corrupt("frozen runs that do not fit their chunk")
    missing = gaps.unpack(data[at : at + mask_bytes], (frames, points))
    waits, lengths, which = coder.unpack(data[at + mask_bytes : stop], (count, 3)).T
    lengths = lengths + 1
    if min(waits.min(), lengths.min() - 1, which.min()) < 0 or max(waits.max(), lengths.max()) > frames * points:
        raise Corrupt("frozen runs out of range")
    stops = np.cumsum(waits + lengths)
    if stops[-1] > frames * points or which.max() > count:
        raise Corrupt("frozen runs beyond the last sample")
    octets = coder.unpack(data[stop:], (int(which.max()), VALUE_BYTES))
    if octets.size and not 0 <= octets.min() <= octets.max() <= 255:
        raise Corrupt("frozen values that are not bytes")
    table = octets.astype(np.uint8).view("<f8").reshape(-1, 3).astype(np.float64)
    if not np.isfinite(table).all():
        raise Corrupt("frozen values that are not finite")
    starts = stops - lengths
    found = _Stored(missing, starts % frames, lengths, starts // frames, which, table)
    if (found.first + lengths > frames).any() or (found.first[which == HELD] == 0).any():
        raise Corrupt("a frozen run that its point does not have")
    return found


def _put(positions: Floats, stored: _Stored) -> Floats:
    """The positions with the runs' values."""
    held = stored.which == HELD
    values = positions[stored.first - 1, stored.point]
    if np.isnan(values[held]).any():
        raise Corrupt("a frozen run that holds a missing sample")
    values[~held] = stored.table[stored.which[~held] - 1]
    out = positions.copy()
    out[stored.frames_and_points] = np.repeat(values, stored.length, axis=0)
    return out
