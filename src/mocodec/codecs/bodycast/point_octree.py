"""Occupancy octree of lattice points, coded by contexts that are mixed: neighbours, siblings and the bodies' surface.

    sorted Morton codes ─► level by level, octant by octant ─► occupancy bits ─► adaptive binary coder

Encoder and decoder run the same function. All first octants of a level are coded before all second ones, as in
`octree`. Coordinates of a lattice point are all even or all odd: in the last level only the first and the last octant
of a cube can be occupied.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ... import native
from ...entropy.adaptive_bits import MIXERS
from ...entropy.bit_arrays import CUT_OFF, BitCoder
from ...errors import Corrupt
from ...typing import AnyInteger, Booleans, Integers
from . import octree
from .surface_hints import SurfaceHints

MAX_DEPTH = octree.MAX_DEPTH
ALL_OCTANTS, LATTICE_OCTANTS = tuple(range(8)), (0, 7)
POSTERIORS = 64  # levels of the probability that follows from the surface alone
BELL_STEPS, BELL_RANGE = 64, 4.0  # table of the normal density: entries, standard deviations
DISTANCE_STEPS = (1, 2, 3, 4, 5, 7, 9, 12, 16, 24)  # of a child's distance from the surface, quarters of its side
FAR = 2 * len(DISTANCE_STEPS) + 1  # class of a child without surface near it
NO_HINT = POSTERIORS  # class of a probability without surface near it


class LevelHints(NamedTuple):
    """What the surface says about the children (n, 8) of a level's cubes: classes of their distance, weights of a
    narrow and of a wide distribution around it, classes of how many samples they hold. usable (n,): False without a
    surface near the cube.
    """

    distance: AnyInteger
    narrow: AnyInteger
    wide: AnyInteger
    samples: AnyInteger
    usable: Booleans


def code_octree(
    coder: BitCoder, codes: Integers | None, depth: int, points: int, surface: SurfaceHints | None
) -> tuple[Integers, Integers]:
    """Code the sorted distinct Morton codes (points,) of a frame, points ≥ 1; returns them and, for each, a sample of
    the surface near it, −1 without one.

    codes: None in the decoder. depth: levels. Raises Corrupt in the decoder.
    """
    return code_levels("point_octree", _code_cubes, coder, codes, depth, points, surface)


class LevelOfCubes(NamedTuple):
    """The cubes (n,) of a level in order. nearest (n,): a sample near each, −1 without one. points: of the frame."""

    cubes: Integers
    level: int
    depth: int
    points: int
    surface: SurfaceHints | None
    nearest: Integers

    @property
    def octants(self) -> tuple[int, ...]:
        """Those that can be occupied."""
        return LATTICE_OCTANTS if self.level == self.depth - 1 else ALL_OCTANTS


CodeLevel = Callable[[BitCoder, LevelOfCubes, Booleans | None], Integers]
"""Codes which children (n, 8) of the cubes of a level are occupied, and returns them; None in the decoder."""


def code_levels(
    kernels: str,
    code_level: CodeLevel,
    coder: BitCoder,
    codes: Integers | None,
    depth: int,
    points: int,
    surface: SurfaceHints | None,
) -> tuple[Integers, Integers]:
    """As `code_octree`, each level by `code_level`, or all by the compiled kernels of this name."""
    if native.kernel("OctreeSurface") is not None and coder.compiled is not None:
        hints = None if surface is None else surface.compiled
        cubes, nearest = _code_compiled(kernels, coder.compiled, codes, depth, points, hints)
    else:
        cubes, nearest = _code_in_numpy(code_level, coder, codes, depth, points, surface)
    if len(cubes) != points:
        raise Corrupt(f"bodycast: an octree holds {len(cubes)} points instead of {points}")
    return cubes, nearest


def _code_compiled(
    kernels: str, coder: Any, codes: Integers | None, depth: int, points: int, surface: Any
) -> tuple[Integers, Integers]:
    if codes is not None:
        encode = native.kernel(f"{kernels}_encode")
        assert encode is not None
        return codes, np.asarray(encode(coder, codes.astype(np.uint64), depth, surface, bell()))
    decode = native.kernel(f"{kernels}_decode")
    assert decode is not None
    found, nearest, level, cubes = decode(coder, points, depth, surface, bell())
    if found is None and not level:
        raise Corrupt(CUT_OFF)
    if found is None:
        raise Corrupt(f"bodycast: an octree of {points} points has {cubes} cubes in level {level}")
    return np.asarray(found), np.asarray(nearest)


def samples_of_points(codes: Integers, surface: SurfaceHints) -> Integers:
    """(points,): a sample of the surface near each of the sorted distinct Morton codes, −1 without one: those that
    `code_octree` returns.
    """
    depth, before, nearest = surface.depth, np.zeros(1, np.int64), np.full(1, -1)
    for level in range(depth + 1):
        cubes = np.unique(codes >> 3 * (depth - level))
        nearest = nearest[np.searchsorted(before, cubes >> 3)] if level else nearest
        nearest, before = surface.attach(cubes, level, nearest) if level < depth else nearest, cubes
    return nearest


def _code_in_numpy(
    code_level: CodeLevel,
    coder: BitCoder,
    codes: Integers | None,
    depth: int,
    points: int,
    surface: SurfaceHints | None,
) -> tuple[Integers, Integers]:
    cubes, nearest = np.zeros(1, np.int64), np.full(1, -1)
    for level in range(depth):
        occupied = None if codes is None else _occupancy(codes, cubes, depth, level)
        if surface is not None:
            nearest = surface.attach(cubes, level, nearest)
        known = code_level(coder, LevelOfCubes(cubes, level, depth, points, surface, nearest), occupied)
        parent, octant = np.nonzero(known)
        if not 0 < len(parent) <= points:
            raise Corrupt(f"bodycast: an octree of {points} points has {len(parent)} cubes in level {level + 1}")
        cubes, nearest = cubes[parent] << 3 | octant, nearest[parent]
    return cubes, nearest


def _occupancy(codes: Integers, cubes: Integers, depth: int, level: int) -> Booleans:
    """(n, 8): which children of the cubes of a level hold points."""
    children = codes >> 3 * (depth - level - 1)
    occupied = np.zeros((len(cubes), 8), bool)
    occupied[np.searchsorted(cubes, children >> 3), children & 7] = True
    return occupied


def _code_cubes(coder: BitCoder, own: LevelOfCubes, occupied: Booleans | None) -> Integers:
    """Octant by octant, all cubes of each."""
    cubes, level, octants, height = own.cubes, own.level, own.octants, own.depth - own.level
    hints = None if own.surface is None else _level_hints(own.surface, cubes, level, own.nearest)
    known = np.zeros((len(cubes) + 1, 8), np.int64)
    neighbours = octree.neighbour_rows(cubes, level)
    filled = (neighbours < len(cubes)).sum(axis=0)
    count = np.zeros(len(cubes), np.int64)
    for place, octant in enumerate(octants):
        last = place == len(octants) - 1
        rows = np.flatnonzero(count > 0) if last else np.arange(len(cubes))
        contexts = _contexts(known, neighbours, filled, count, height, octants[place:], hints)[rows]
        few = np.minimum(count[rows], 3)
        surface = np.zeros(len(rows), np.int64) if hints is None else 1 + hints.usable[rows]
        sets = (min(height, 20) * 4 + few) * 3 + surface
        bit = np.ones(len(cubes), bool)
        bit[rows] = coder.code(contexts, sets % MIXERS, None if occupied is None else occupied[rows, octant])
        known[:-1, octant] = bit
        count += bit
    return known[:-1]


def _contexts(
    known: Integers,
    neighbours: Integers,
    filled: Integers,
    count: Integers,
    height: int,
    remaining: tuple[int, ...],
    hints: LevelHints | None,
) -> Integers:
    """(n, 5): the contexts of the first of the `remaining` octants in each cube."""
    octant = remaining[0]
    few, tall = np.minimum(count, 3), min(height, 15)
    beside = np.zeros(len(count), np.int64)
    nearby = np.zeros(len(count), np.int64)
    for axis in range(3):
        if octant >> axis & 1:
            opposite = octant ^ 1 << axis
            inner, outer = known[:-1, opposite], known[neighbours[2 * axis + 1], opposite]
        else:
            inner, outer = np.zeros(len(count), np.int64), (neighbours[2 * axis] < len(count)).astype(np.int64)
        beside = beside * 4 + 2 * inner + outer
        nearby += inner + outer
    if hints is None:
        narrow = wide = np.full(len(count), NO_HINT)
        distance, samples = np.full(len(count), FAR), np.zeros(len(count), np.int64)
    else:
        narrow, wide = (_posterior(w, hints.usable, remaining) for w in (hints.narrow, hints.wide))
        distance, samples = hints.distance[:, octant], hints.samples[:, octant]
    columns = (
        ((octant * 4 + few) * 64 + beside) * 4 + np.minimum(filled // 2, 3),
        narrow * 4 + few,
        (wide * 4 + few) * 16 + tall,
        ((distance * 5 + samples) * 4 + few) * 16 + tall,
        ((narrow * 7 + nearby) * 4 + few) * 8 + len(remaining) - 1,
    )
    return np.stack(columns, axis=1)


# --- surface --------------------------------------------------------------------------------------------------------


@cache
def bell() -> NDArray[np.int32]:
    """Weights of the normal density, by distance in 1/16 of a standard deviation; never 0."""
    step = BELL_RANGE / BELL_STEPS
    return np.array([1 + round(4096 * math.exp(-((k * step) ** 2) / 2)) for k in range(BELL_STEPS + 1)], np.int32)


def _level_hints(surface: SurfaceHints, cubes: Integers, level: int, nearest: Integers) -> LevelHints:
    """What the surface says about the children of these cubes; nearest (n,): a sample near each."""
    usable = nearest >= 0
    size = surface.child_size(level)
    offset, spread = surface.offsets(cubes, level, nearest)
    distance = surface.child_distances(cubes, level, np.maximum(nearest, 0), offset)
    spread = np.maximum(spread, size // 4)[:, None]
    edge = np.array(DISTANCE_STEPS) * size
    magnitude = np.searchsorted(edge, 4 * np.abs(distance), side="right")
    signed = len(DISTANCE_STEPS) + np.where(distance < 0, -magnitude, magnitude)
    samples = surface.samples_inside(cubes, level) if 2 * size > surface.spacing else np.zeros(distance.shape, np.int64)
    return LevelHints(
        np.where(usable[:, None], signed, FAR),
        _weights(distance, spread),
        _weights(distance, 2 * spread),
        np.searchsorted([1, 2, 3, 5], samples, side="right"),
        usable,
    )


def _weights(distance: Integers, deviation: Integers) -> Integers:
    """The normal density at distances (n, 8), for standard deviations (n, 1)."""
    steps = np.abs(distance) * (BELL_STEPS // int(BELL_RANGE)) // np.maximum(deviation, 1)
    return bell()[np.minimum(steps, BELL_STEPS)].astype(np.int64)


def _posterior(weights: Integers, usable: Booleans, remaining: tuple[int, ...]) -> Integers:
    """(n,): classes of the probability of the first of the remaining octants, if one of them holds the only point."""
    chosen = weights[:, list(remaining)]
    share = chosen[:, 0] * POSTERIORS // (chosen.sum(axis=1) + 1)
    return np.where(usable, share, NO_HINT)
