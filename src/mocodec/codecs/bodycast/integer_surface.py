"""The posed surface of a body in integers, the same on every machine: contexts of a decoder depend on it.

    key picture ─► canonical samples ─┐
                                      ├─rounded robustly─► integers ─blend─► samples of a frame, for `SurfaceHints`
    pose of a frame ─► transforms ────┘

Floats differ in their last bits between machines. So the encoder looks for a shift of the rounding at which no value
lies near the border between two integers, and stores it: every decoder then rounds to the same integers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ... import native
from ...errors import Corrupt
from ...geometry import articulation
from ...geometry.articulation import Pose
from ...typing import Floats, Integers
from .surface_hints import NEIGHBOURS, NORMAL_BITS, SUBUNIT_BITS, UNLIMITED, SurfaceHints
from .surface_sampling import SurfaceSamples

SHIFTS = 64  # of the rounding, in 1/64 of a step
MARGIN = 1e-7  # of a step, that values keep from the border
MARGIN_SPACINGS = 8  # of floats as large as the largest value, that they keep too
SAMPLES = 8000  # of the surface of a body
PLACE_BITS = 16  # places are in 2^-16 m
TURN_BITS = 20  # entries of rotation matrices are in 2^-20
SHARE_BITS = 12  # shares of links are in 2^-12
SMOOTHING_ROUNDS = 3  # over which the shares of links spread to neighbouring samples
MAX_PLACE_M = 1 << 14
MAX_COORDINATE = 1 << 30  # of points whose neighbours the compiled search finds
TIES = 8  # samples at the same distance that a search may end with


def rounding_shift(values: Floats) -> int:
    """The first shift at which no value lies near a border; 0 if there is none."""
    fraction = values.reshape(-1) % 1.0
    margin = max(MARGIN, MARGIN_SPACINGS * float(np.spacing(np.abs(values).max(initial=0.0))))
    for shift in range(SHIFTS):
        moved = (fraction + shift / SHIFTS) % 1.0
        if ((moved > margin) & (moved < 1 - margin)).all():
            return shift
    return 0


def rounded(values: Floats, shift: int) -> Integers:
    """Values rounded down after the shift."""
    return np.floor(values + shift / SHIFTS).astype(np.int64)


@dataclass(frozen=True, eq=False)
class IntegerSurface:
    """Samples of a body's surface in the canonical pose.

    points (m, 3) in 2^-PLACE_BITS metres. normals (m, 3) of length 2^NORMAL_BITS. neighbours (m, NEIGHBOURS): rows.
    links (m, 2): that move each sample; shares (m,): of the first, in 2^-SHARE_BITS.
    """

    points: Integers
    normals: Integers
    neighbours: Integers
    links: Integers
    shares: Integers

    @staticmethod
    def values(samples: SurfaceSamples, canonical: Floats) -> Floats:
        """(m, 6): places and normals before rounding."""
        return np.concatenate([canonical * (1 << PLACE_BITS), samples.normals * (1 << NORMAL_BITS)], axis=1)

    @staticmethod
    def build(samples: SurfaceSamples, canonical: Floats, shift: int, links: int) -> IntegerSurface:
        """shift: of the rounding of `values`. links: of the body."""
        both = rounded(IntegerSurface.values(samples, canonical), shift)
        points, normals = np.ascontiguousarray(both[:, :3]), np.ascontiguousarray(both[:, 3:])
        neighbours = nearest_samples(points, normals)
        pairs, shares = _blended_links(np.asarray(samples.links, np.int64), neighbours, links)
        return IntegerSurface(points, normals, neighbours, pairs, shares)

    def posed(self, turns: Integers, moves: Integers) -> tuple[Integers, Integers]:
        """Samples (m, 3) in 2^-PLACE_BITS metres and their normals under turns (links, 3, 3) and moves (links, 3)."""
        if (kernel := native.kernel("posed_surface")) is not None:
            places, normals = kernel(self.points, self.normals, self.links, self.shares, turns, moves)
            return np.asarray(places), np.asarray(normals)
        places = list[Integers]()
        for column in (0, 1):
            link = self.links[:, column]
            turned = (turns[link] * self.points[:, None]).sum(axis=2) >> TURN_BITS
            places.append(turned + moves[link])
        share = self.shares[:, None]
        blended = places[1] + ((places[0] - places[1]) * share >> SHARE_BITS)
        return blended, (turns[self.links[:, 0]] * self.normals[:, None]).sum(axis=2) >> TURN_BITS


def pose_values(body: articulation.Body, pose: Pose) -> Floats:
    """(links, 12): the transforms of a pose before rounding: rotation matrices, then translations."""
    a, b = articulation.transforms(body, pose)
    moves = np.clip(b, -MAX_PLACE_M, MAX_PLACE_M) * (1 << PLACE_BITS)
    return np.concatenate([a.reshape(len(a), 9) * (1 << TURN_BITS), moves], axis=1)


def posed_samples(surface: IntegerSurface, values: Floats, shift: int) -> tuple[Integers, Integers, Integers]:
    """`IntegerSurface.posed` of the `pose_values` of a frame rounded with this shift, and the turns (links, 3, 3)."""
    whole = rounded(values, shift)
    turns = whole[:, :9].reshape(-1, 3, 3)
    return *surface.posed(turns, whole[:, 9:]), turns


def nearest_samples(points: Integers, normals: Integers) -> Integers:
    """(m, NEIGHBOURS): of the NEIGHBOURS nearest samples around each those that face the same way, nearest first, then
    itself. Equal distances in the order of rows.
    """
    count = len(points)
    own = np.arange(count)[:, None]
    found, kernel = None, native.kernel("nearest_others")
    if kernel is not None and count > NEIGHBOURS and np.abs(points).max() < MAX_COORDINATE:
        found = np.asarray(kernel(points))
        if (points[found[:, 0]] == points).all(axis=1).any():
            found = None  # the search in a tree counts points at one place in another way
    if found is None:
        found = _nearest_in_tree(points)
    faces_alike = (normals[found] * normals[:, None]).sum(axis=2) > 0
    others = faces_alike & (found != own)
    order = np.argsort(~others, axis=1, kind="stable")[:, :NEIGHBOURS]
    result = np.repeat(own, NEIGHBOURS, axis=1)
    kept = np.take_along_axis(np.where(others, found, own), order, axis=1)
    result[:, : kept.shape[1]] = kept
    return result


def _nearest_in_tree(points: Integers) -> Integers:
    """(m, NEIGHBOURS + 1), or fewer columns for fewer points: the nearest of the points (m, 3), itself among them."""
    from scipy.spatial import KDTree

    count = len(points)
    taken = min(NEIGHBOURS + 1, count)
    searched = min(taken + TIES, count)
    found = np.asarray(KDTree(points).query(points, searched)[1], np.int64).reshape(count, searched)
    square = ((points[found] - points[:, None]) ** 2).sum(axis=2)
    order = np.lexsort((found, square), axis=1)
    found, square = (np.take_along_axis(values, order, axis=1) for values in (found, square))
    if searched < count:  # where the last ones tie, the tree may have left out others that are as near
        for row in np.flatnonzero(square[:, taken - 1] == square[:, -1]).tolist():
            every = ((points - points[row]) ** 2).sum(axis=1)
            found[row] = np.lexsort((np.arange(count), every))[:searched]
    return found[:, :taken]


def _blended_links(links: Integers, neighbours: Integers, count: int) -> tuple[Integers, Integers]:
    """The two links (m, 2) with the largest shares of each sample, and the share (m,) of the first, 2^-SHARE_BITS."""
    shares = np.zeros((len(links), count), np.int64)
    shares[np.arange(len(links)), links] = 1 << SHARE_BITS
    for _ in range(SMOOTHING_ROUNDS):
        total = 4 * shares
        for column in neighbours.T:
            total += shares[column]
        shares = total // (4 + NEIGHBOURS)
    order = np.argsort(-shares, axis=1, kind="stable")[:, :2] if count > 1 else np.zeros((len(links), 2), np.int64)
    first, second = (np.take_along_axis(shares, order[:, k : k + 1], axis=1)[:, 0] for k in (0, 1))
    order[second <= 0, 1] = order[second <= 0, 0]
    return np.ascontiguousarray(order), (first << SHARE_BITS) // np.maximum(first + np.where(second > 0, second, 0), 1)


def hints_of_frame(
    places: Integers,
    normals: Integers,
    neighbours: Integers,
    step_m: float,
    corner: Integers,
    depth: int,
    smooths: bool,
) -> SurfaceHints | None:
    """The samples of all bodies in a frame as the octree sees them; None without samples.

    places (m, 3): 2^-PLACE_BITS metres. normals (m, 3). neighbours (m, NEIGHBOURS): rows. step_m: unit of the octree.
    corner (3,): of the octree, in that unit. smooths: as in `hints_of_samples`. Raises Corrupt for a pose out of range.
    """
    if not len(places):
        return None
    scale = float(1 << SUBUNIT_BITS) / (step_m * (1 << PLACE_BITS))
    if np.abs(places).max() * scale > 2.0**40:
        raise Corrupt("bodycast: a pose is out of range")
    points = np.floor(places * scale).astype(np.int64) - (corner << SUBUNIT_BITS)
    return hints_of_samples(points, normals, neighbours, depth, smooths)


def hints_of_samples(
    points: Integers, normals: Integers, neighbours: Integers, depth: int, smooths: bool
) -> SurfaceHints:
    """Samples (m, 3) in units of the octree as it sees them. smooths: only cubes up to the spacing of the samples
    correct the surface, since the centres of larger ones tell less than the body; otherwise all cubes do.
    """
    spacing = _spacing_of(points, neighbours)
    return SurfaceHints(points, normals, neighbours, spacing, depth, spacing if smooths else UNLIMITED)


def _spacing_of(points: Integers, neighbours: Integers) -> int:
    """The median distance of samples (m, 3) from the first of their neighbours (m, k), at least 1."""
    if (kernel := native.kernel("median_gap")) is not None:
        return math.isqrt(max(kernel(points, neighbours), 1))
    x, y, z = (points[neighbours[:, 0]] - points).T
    gaps = x * x + y * y + z * z
    middle = len(gaps) // 2
    return math.isqrt(max(int(np.partition(gaps, middle)[middle]), 1))
