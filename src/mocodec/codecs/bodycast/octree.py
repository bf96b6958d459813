"""Points on a grid as an octree: which eighths of each cube hold any, told from what is known of the cubes around.

    cells ─► Morton codes, sorted ─► level by level, eighth by eighth ─► adaptive bits          until nearly every cube
                                                                        holds one point; the rest of its place as it is

All first eighths of a level go through before all second ones, so that an eighth knows its finished neighbours in its
own cube and in the next.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import Corrupt
from . import bits

Integers = NDArray[np.int64]
Array = NDArray[Any]
DEEPEST = 20  # levels
ALONE = 0.9  # of the points that have a cube of their own, from which on their places follow as they are
MOST = 1 << 24  # points of a frame
AXES = tuple(sum(1 << 3 * bit + axis for bit in range(DEEPEST)) for axis in range(3))


class State(NamedTuple):
    """What was counted in the frames before."""

    eighths: bits.Counts
    crowds: bits.Counts

    @staticmethod
    def new() -> State:
        return State(bits.Counts(8 * 64 * 3 * 7), bits.Counts(4))


def codes(cells: Integers) -> Integers:
    """Morton codes (n,) of cells (n, 3) from 0 to 2^20 − 1."""
    result = np.zeros(len(cells), np.int64)
    for axis in range(3):
        v = cells[:, axis].astype(np.int64)
        for shift, mask in _SPREAD:
            v = (v | v << shift) & mask
        result |= v << axis
    return result


def cells_of(code: Integers) -> Integers:
    """The inverse of `codes`."""
    result = np.empty((len(code), 3), np.int64)
    for axis in range(3):
        v = code >> axis & _SPREAD[-1][1]
        for (shift, _), (_, mask) in zip(_SPREAD[::-1], (*_SPREAD[-2::-1], (0, (1 << 21) - 1)), strict=True):
            v = (v | v >> shift) & mask
        result[:, axis] = v
    return result


_SPREAD = (
    (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)  # fmt: skip


def stop_level(code: Integers, depth: int) -> int:
    """How many levels of cubes are worth telling for sorted codes (n,)."""
    kinds = len(np.unique(code))
    for level in range(depth):
        if len(np.unique(code >> 3 * (depth - level))) >= ALONE * kinds:
            return level
    return depth


def write(writer: bits.Writer, state: State, code: Integers, depth: int, stop: int) -> Integers:
    """Sorted codes (n,), n at least 1, of so many levels, down to level `stop`; gives back what of each is left."""
    for level in range(stop):
        nodes, below = np.unique(code >> 3 * (depth - level)), np.unique(code >> 3 * (depth - level - 1))
        filled = np.zeros((len(nodes) + 1, 8), np.int64)
        filled[np.searchsorted(nodes, below >> 3), below & 7] = 1
        known = np.zeros_like(filled)
        around = _around(nodes, level)
        for eighth in range(8):
            writer.put(state.eighths, _context(known, around, eighth), filled[:-1, eighth])
            known[:, eighth] = filled[:, eighth]
    _, count = np.unique(code >> 3 * (depth - stop), return_counts=True)
    for more in range(int(count.max())):
        writer.put(state.crowds, np.full(len(count), min(more, 3)), (count > 1).astype(np.int64))
        count = count[count > 1] - 1
    return code & (1 << 3 * (depth - stop)) - 1


def read(reader: bits.Reader, state: State, points: int, stop: int) -> Integers:
    """The cubes (n,) of level `stop` that hold the points, in order. Raises Corrupt."""
    nodes = np.zeros(1, np.int64)
    for level in range(stop):
        known = np.zeros((len(nodes) + 1, 8), np.int64)
        around = _around(nodes, level)
        for eighth in range(8):
            known[:-1, eighth] = reader.get(state.eighths, _context(known, around, eighth))
        parent, eighth = np.nonzero(known[:-1])
        if not 0 < len(parent) <= points:
            raise Corrupt("bodycast: more cells than points")
        nodes = nodes[parent] << 3 | eighth
    count, at, more = np.ones(len(nodes), np.int64), np.arange(len(nodes)), 0
    while len(at):
        at = at[reader.get(state.crowds, np.full(len(at), min(more, 3))) > 0]
        count[at] += 1
        more += 1
        if more > points:
            break
    if int(count.sum()) != points:
        raise Corrupt("bodycast: cells do not hold their points")
    return np.repeat(nodes, count)


def _around(nodes: Integers, level: int) -> Integers:
    """(6, n): the row of the cube before and behind each along every axis; n, one too many, where there is none."""
    result = np.full((6, len(nodes)), len(nodes))
    inside = (1 << 3 * level) - 1
    for axis, every in enumerate(AXES):
        mask = every & inside
        own, rest = nodes & mask, nodes & ~mask
        for side, edge, moved in (
            (0, own == 0, (own - 1) & mask | rest),
            (1, own == mask, ((own | ~mask) + 1) & mask | rest),
        ):
            row = np.minimum(np.searchsorted(nodes, moved), len(nodes) - 1)
            there = (nodes[row] == moved) & ~edge
            result[2 * axis + side][there] = row[there]
    return result


def _context(known: Integers, around: Integers, eighth: int) -> Array:
    """What is known about an eighth of each cube: its finished neighbours, or whether the cube beside it is
    there; how many of its cube's eighths are filled so far, and how many cubes lie around that.
    """
    count = around.shape[1]
    context = np.full(count, eighth)
    for axis in range(3):
        if eighth >> axis & 1:
            other = eighth ^ 1 << axis
            context = context * 4 + 2 * known[:-1, other] + known[around[2 * axis + 1], other]
        else:
            context = context * 4 + (around[2 * axis] < count)
    context = context * 3 + np.minimum(known[:-1].sum(axis=1), 2)
    return context * 7 + (around < count).sum(axis=0)
