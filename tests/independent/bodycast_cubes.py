"""Octrees cube by cube, written from docs/payloads/bodycast-points.md; no code of mocodec is used."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .bodycast_colours import MixedBits, Vector, at_most, difference, dot
from .bodycast_octree import FrameOctree, Posed

UNIT = 2**16


@dataclass
class Cube:
    place: Vector
    sample: int
    centre: Vector
    point: Vector  # where it tells that the surface is
    noise: int
    children: list[int]


class CubeOctree(FrameOctree):
    """As FrameOctree, of kind 8. count: points of the frame."""

    def __init__(
        self, bits: MixedBits, depth: int, points: list[Vector], posed: Posed, near: list[list[int]], count: int
    ) -> None:
        super().__init__(bits, depth, points, posed, near, 8)
        self.count = count

    def decode(self) -> list[tuple[Vector, int]]:
        cubes: list[tuple[Vector, int]] = [((0, 0, 0), -1)]
        for level in range(self.depth):
            h = 16 * 2 ** (self.depth - level - 1)
            nearest = self.nearest([v for v, _ in cubes], [s for _, s in cubes], h)
            decoded = self.cubes_of_level([v for v, _ in cubes], nearest, level, h)
            cubes = [
                (tuple(2 * v + (octant >> axis & 1) for axis, v in enumerate(cube.place)), cube.sample)
                for cube in decoded
                for octant in cube.children
            ]
        return cubes

    def cubes_of_level(self, places: list[Vector], nearest: list[int], level: int, h: int) -> list[Cube]:
        centres = [tuple(2 * h * x + h - 8 for x in place) for place in places]
        cubes = [Cube(v, s, c, c, 4 * h * h, []) for v, s, c in zip(places, nearest, centres, strict=True)]
        row = {cube.place: cube for cube in cubes}
        known = [cube for cube in cubes if cube.sample >= 0]
        usual = sum(abs(self.far(cube)) for cube in known) // max(len(known), 1)
        of_sample: dict[int, list[Cube]] = {}
        for cube in known:
            of_sample.setdefault(cube.sample, []).append(cube)
        for s, own in of_sample.items():
            if len(own) > 4:
                of_sample[s] = [own[k * len(own) // 4] for k in range(4)]
        held: dict[Vector, int] = {}
        for sample in self.samples if 2 * h > self.spacing else []:
            child = tuple((x + 8) // h for x in sample)
            held[child] = held.get(child, 0) + 1
        for cube in cubes:
            self.children(cube, row, of_sample, usual, held, level, h)
            if cube.sample >= 0:
                n = len(cube.children)
                cube.point = tuple(
                    2 * h * x + h // 2 - 8 + sum(octant >> axis & 1 for octant in cube.children) * h // n
                    for axis, x in enumerate(cube.place)
                )
                cube.noise = 4 * h * h // (6 * n)
        return cubes

    def far(self, cube: Cube) -> int:
        return min(max(self.distance(cube.centre, cube.sample), -(2**25)), 2**25)

    def passage(self, cube: Cube, of_sample: dict[int, list[Cube]], usual: int, h: int) -> tuple[int, int]:
        """Offset and variance of the surface at a cube."""
        e, s, found = min(self.spacing, 2**16), cube.sample, list[tuple[int, int]]()
        for other in [s, *(n for n in self.near[s] if n != s)]:
            both = [a + b for a, b in zip(self.normals[s], self.normals[other], strict=True)]
            for known in of_sample.get(other, []):
                a = difference(known.point, cube.centre)
                w = e * e * UNIT // (13 * dot(a, a) + 10 * e * e + 64 * known.noise + 1)
                found.append((w, self.far(cube) + (dot(a, both) >> 11)))
        total = sum(w for w, _ in found)
        offset = sum(w * d for w, d in found) // (total + 5120)
        deviation = (sum(w * abs(d - offset) for w, d in found) + 1024 * usual) // (total + 1024)
        deviation = min(deviation, 2**20)
        return offset, max(166 * deviation * deviation // 256 - 4 * h * h // 20, 16)

    def children(
        self, cube: Cube, row: dict[Vector, Cube], of_sample: dict[int, list[Cube]], usual: int,
        held: dict[Vector, int], level: int, h: int,
    ) -> None:  # fmt: skip
        octants = [0, 7] if level == self.depth - 1 else list(range(8))
        s, far, expected = cube.sample, [0] * 8, list[list[int]]()
        if s >= 0:
            offset, variance = self.passage(cube, of_sample, usual, h)
            first = self.distance([2 * h * x + h // 2 - 8 for x in cube.place], s) - offset
            step = [n * h >> 10 for n in self.normals[s]]
            far = [first + sum(step[a] for a in range(3) if octant >> a & 1) for octant in range(8)]
            expected = [self.expected(far, math.isqrt(k * variance + 4 * h * h // 48), h) for k in (1, 3)]
        sides = [tuple(x + d * (a == axis) for a, x in enumerate(cube.place)) for axis in range(3) for d in (-1, 1)]
        filled = min(sum(side in row for side in sides) // 2, 3)
        for turn, octant in enumerate(octants):
            left = octants[turn + 1 :]
            if not left and not cube.children:
                cube.children.append(octant)
                continue
            few, tall = min(len(cube.children), 3), min(self.depth - level, 15)
            beside = nearby = 0
            for axis in range(3):
                upper = octant >> axis & 1
                side = row.get(sides[2 * axis + upper])
                known = cube.children if upper else side.children if side else []
                inner, outer = int(octant ^ 1 << axis in known), int(side is not None)
                beside, nearby = 4 * beside + 2 * inner + outer, nearby + inner + outer
            narrow, wide, distance_class, hint = 64, 64, 21, 1 if self.samples else 0
            if s >= 0:
                narrow, wide = (odds_class(own[octant], sum(own[o] for o in left), few) for own in expected)
                g = sum(edge * h <= 4 * abs(far[octant]) for edge in (1, 2, 3, 4, 5, 7, 9, 12, 16, 24))
                distance_class, hint = 10 + (g if far[octant] >= 0 else -g), 2
            child = tuple(2 * x + (octant >> a & 1) for a, x in enumerate(cube.place))
            contexts = [
                ((octant * 4 + few) * 64 + beside) * 4 + filled,
                narrow * 4 + few,
                (wide * 4 + few) * 16 + tall,
                ((distance_class * 5 + at_most((1, 2, 3, 5), held.get(child, 0))) * 4 + few) * 16 + tall,
                ((narrow * 7 + nearby) * 4 + few) * 8 + len(left),
            ]
            if self.bits.bit(contexts, (min(self.depth - level, 20) * 4 + few) * 3 + hint):
                cube.children.append(octant)

    def expected(self, far: list[int], sigma: int, h: int) -> list[int]:
        """Expected points of each child, 2^-16."""
        across = h * 256 // min(self.spacing, 2**16)
        density = min(self.count * 1634 * across * across // (16 * len(self.samples)), 2**24)
        most = min(density * h // (256 * sigma), 2**19)

        def weight(distance: int) -> int:
            k = min(abs(distance) * 16 // sigma, 64)
            return 1 + math.floor(4096 * math.exp(-((k / 16) ** 2) / 2) + 0.5)

        return [most * weight(distance) // 4096 + 1 for distance in far]


def odds_class(own: int, others: int, few: int) -> int:
    odds = own * (2 * UNIT + own) // (2 * UNIT)
    odds = 256 * odds if few or others >= 2 * UNIT else odds * 128 * (2 * UNIT + others) // others
    if odds < UNIT:
        return 0
    order = odds.bit_length() - 1
    return min(4 * (order - 16) + (odds * 4 // 2**order - 4), 63)
