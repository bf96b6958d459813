"""The octree of a frame and smoothing, written from docs/payloads/bodycast-points.md; no code of mocodec is used."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from .bodycast_colours import MixedBits, Vector, at_most, difference, dot, squared


@dataclass
class Posed:
    """The samples in a frame: places, normals, and the matrix A of the first link of each (rows)."""

    places: list[Vector] = field(default_factory=list)
    normals: list[Vector] = field(default_factory=list)
    turns: list[list[list[int]]] = field(default_factory=list)


# --- octree of a frame


class FrameOctree:
    """posed: samples, moved by their learned offsets. neighbours: of the samples in the frame."""

    def __init__(
        self, bits: MixedBits, depth: int, points: list[Vector], posed: Posed, near: list[list[int]], kind: int
    ) -> None:
        self.bits, self.depth, self.samples, self.kind = bits, depth, points, kind
        self.normals, self.near = posed.normals, near
        gaps = sorted(squared(points[row[0]], points[i]) for i, row in enumerate(near))
        self.spacing = max(math.isqrt(gaps[len(gaps) // 2]), 1) if gaps else 0

    def decode(self) -> list[tuple[Vector, int]]:
        """Lattice coordinates and nearest sample (−1: none) of each point, in order."""
        cubes: list[tuple[Vector, int]] = [((0, 0, 0), -1)]
        for level in range(self.depth):
            h = 16 * 2 ** (self.depth - level - 1)
            nearest = self.nearest([v for v, _ in cubes], [s for _, s in cubes], h)
            children = self.level([v for v, _ in cubes], nearest, level, h)
            cubes = [
                (tuple(2 * v + (octant >> axis & 1) for axis, v in enumerate(cube)), sample)
                for (cube, _), sample, octants in zip(cubes, nearest, children, strict=True)
                for octant in octants
            ]
        return cubes

    def nearest(self, cubes: list[Vector], parents: list[int], h: int) -> list[int]:
        if not self.samples or 2 * h > 4 * self.spacing:
            return [-1] * len(cubes)
        inside: dict[Vector, list[int]] = {}
        for i, sample in enumerate(self.samples):
            inside.setdefault(tuple((x + 8) // (2 * h) for x in sample), []).append(i)
        result = list[int]()
        for cube, parent in zip(cubes, parents, strict=True):
            centre = [2 * h * x + h - 8 for x in cube]
            best = (
                -1 if parent < 0 else min([parent, *self.near[parent]], key=lambda s: squared(centre, self.samples[s]))
            )
            if 4 * h > self.spacing:
                for dx in (0, -1, 1):
                    for dy in (0, -1, 1):
                        for dz in (0, -1, 1):
                            place = (cube[0] + dx, cube[1] + dy, cube[2] + dz)
                            for s in inside.get(place, [])[:3] if self.within(place, h) else []:
                                if best < 0 or squared(centre, self.samples[s]) < squared(centre, self.samples[best]):
                                    best = s
            result.append(best)
        return result

    def within(self, place: Vector, h: int) -> bool:
        return all(0 <= x < 16 * 2**self.depth // (2 * h) for x in place)

    def distance(self, place: Sequence[int], sample: int) -> int:
        return dot(difference(place, self.samples[sample]), self.normals[sample]) >> 10

    def corrections(self, cubes: list[Vector], nearest: list[int], h: int) -> list[tuple[int, int]]:
        """Offset and spread of each cube."""
        rows = [i for i, s in enumerate(nearest) if s >= 0]
        far = {i: self.distance([2 * h * x + h - 8 for x in cubes[i]], nearest[i]) for i in rows}

        def means(values: dict[int, int], extra: int) -> dict[int, int]:
            total, count = [0] * len(self.samples), [0] * len(self.samples)
            for i, value in values.items():
                total[nearest[i]] += value
                count[nearest[i]] += 1
            own = {s: [s, *self.near[s]] for s in {nearest[i] for i in rows}}
            return {s: (sum(total[n] for n in o) + extra) // (sum(count[n] for n in o) + 2) for s, o in own.items()}

        has_offsets = self.kind == 4 or 2 * h <= self.spacing
        offsets = means(far, 0) if has_offsets else dict.fromkeys((nearest[i] for i in rows), 0)
        deviations = {i: abs(far[i] - offsets[nearest[i]]) for i in rows}
        usual = sum(deviations.values()) // len(rows) if rows else 0
        spreads = means(deviations, 2 * usual)
        return [(offsets[s], spreads[s]) if s >= 0 else (0, 2 * h) for s in nearest]

    def level(self, cubes: list[Vector], nearest: list[int], level: int, h: int) -> list[list[int]]:
        octants = [0, 7] if level == self.depth - 1 else list(range(8))
        row = {cube: i for i, cube in enumerate(cubes)}
        hints = self.hints(cubes, nearest, h) if self.samples else None
        known: list[set[int]] = [set() for _ in cubes]
        for turn, octant in enumerate(octants):
            for i, cube in enumerate(cubes):
                left = octants[turn:]
                if len(left) == 1 and not known[i]:
                    known[i].add(octant)
                    continue
                contexts, weight_set = self.contexts(cube, i, known, row, octant, left, hints, nearest[i], level)
                if self.bits.bit(contexts, weight_set):
                    known[i].add(octant)
        return [sorted(own) for own in known]

    def hints(self, cubes: list[Vector], nearest: list[int], h: int) -> list[tuple[list[int], list[int], list[int]]]:
        """Of each cube: distances of its children, standard deviations, and classes of samples of its children."""
        counts: dict[Vector, int] = {}
        for sample in self.samples:
            place = tuple((x + 8) // h for x in sample)
            counts[place] = counts.get(place, 0) + 1
        result = list[tuple[list[int], list[int], list[int]]]()
        for cube, s, (offset, spread) in zip(cubes, nearest, self.corrections(cubes, nearest, h), strict=True):
            first = self.distance([2 * h * x + h // 2 - 8 for x in cube], max(s, 0)) - offset
            step = [n * h >> 10 for n in self.normals[max(s, 0)]]
            far = [first + sum(step[a] for a in range(3) if octant >> a & 1) for octant in range(8)]
            sigma = max(spread, h // 4)
            children = [tuple(2 * x + (octant >> a & 1) for a, x in enumerate(cube)) for octant in range(8)]
            held = [at_most((1, 2, 3, 5), counts.get(c, 0)) if 2 * h > self.spacing else 0 for c in children]
            result.append((far, [max(sigma, 1), max(2 * sigma, 1)], held))
        return result

    def contexts(
        self,
        cube: Vector,
        i: int,
        known: list[set[int]],
        row: dict[Vector, int],
        octant: int,
        left: list[int],
        hints: list[tuple[list[int], list[int], list[int]]] | None,
        sample: int,
        level: int,
    ) -> tuple[list[int], int]:
        few, tall = min(len(known[i]), 3), min(self.depth - level, 15)
        beside = nearby = filled = 0
        for axis in range(3):
            before, behind = (tuple(x + d * (a == axis) for a, x in enumerate(cube)) for d in (-1, 1))
            filled += (before in row) + (behind in row)
            inner, outer = 0, int(before in row)
            if octant >> axis & 1:
                opposite = octant - (1 << axis)
                inner, outer = int(opposite in known[i]), int(behind in row and opposite in known[row[behind]])
            beside, nearby = 4 * beside + 2 * inner + outer, nearby + inner + outer
        narrow, wide, distance_class, held, hint = 64, 64, 21, 0, 0
        if hints is not None:
            far, sigmas, samples = hints[i]
            held, hint = samples[octant], 1
            if sample >= 0:
                h = 16 * 2 ** (self.depth - level - 1)
                narrow, wide = (self.posterior(far, sigma, left) for sigma in sigmas)
                g = sum(edge * h <= 4 * abs(far[octant]) for edge in (1, 2, 3, 4, 5, 7, 9, 12, 16, 24))
                distance_class, hint = 10 + (g if far[octant] >= 0 else -g), 2
        contexts = [
            ((octant * 4 + few) * 64 + beside) * 4 + min(filled // 2, 3),
            narrow * 4 + few,
            (wide * 4 + few) * 16 + tall,
            ((distance_class * 5 + held) * 4 + few) * 16 + tall,
            ((narrow * 7 + nearby) * 4 + few) * 8 + len(left) - 1,
        ]
        return contexts, ((min(self.depth - level, 20) * 4 + few) * 3 + hint) % 2048

    @staticmethod
    def posterior(far: list[int], sigma: int, left: list[int]) -> int:
        def weight(octant: int) -> int:
            k = min(abs(far[octant]) * 16 // sigma, 64)
            return 1 + math.floor(4096 * math.exp(-((k / 16) ** 2) / 2) + 0.5)

        return weight(left[0]) * 64 // (sum(map(weight, left)) + 1)


# --- smoothing


class Smoothing:
    """cells, samples: of the points of a frame; octree: their samples, moved and with normals."""

    def __init__(self, octree: FrameOctree, cells: list[Vector], samples: list[int]) -> None:
        self.octree, self.cells, self.samples = octree, cells, samples
        self.references: list[list[int]] = [[] for _ in octree.samples]
        for i, s in enumerate(samples):
            if s >= 0:
                self.references[s].append(i)
        for s, own in enumerate(self.references):
            if len(own) > 4:
                self.references[s] = [own[k * len(own) // 4] for k in range(4)]

    def shifts(self) -> list[Vector]:
        """Of each point, in 1/256 of a lattice unit."""
        result = list[Vector]()
        for i, s in enumerate(self.samples):
            move, deviation = self.move(i, s) if s >= 0 else (0, 0)
            if move:
                n = abs(move)
                d = min(deviation // 16, 15)
                contexts = [n // 8, 32 + d, 64 + n // 8 * 16 + d, 1024 + n // 2, 2048]
                if self.octree.bits.bit([2**20 + c for c in contexts], 1024):
                    move = 0
            result.append(tuple(move * x + 512 >> 10 for x in self.octree.normals[s]) if move else (0, 0, 0))
        return result

    def move(self, i: int, s: int) -> tuple[int, int]:
        """Move along the normal, and deviation."""
        normals, spacing = self.octree.normals, min(self.octree.spacing, 2**16)
        found = list[tuple[int, int]]()
        for other in [s, *self.octree.near[s]]:
            if dot(normals[s], normals[other]) < 315 << 10:
                continue
            both = [a + b for a, b in zip(normals[s], normals[other], strict=True)]
            for j in self.references[other]:
                if j != i:
                    apart = difference(self.cells[j], self.cells[i])
                    w = spacing**2 * 1024 // (256 * dot(apart, apart) + spacing**2 // 4 + 1)
                    found.append((w, 256 * dot(apart, both) >> 11))
        total = sum(w for w, _ in found)
        largest = max((w for w, _ in found), default=0)
        mean = sum(w * d for w, d in found) // max(total + largest, 1)
        deviation = sum(w * abs(d - mean) for w, d in found) // max(total, 1)
        gain = min(max(48_000 // max(deviation, 1) - 90, 0), 256)
        return min(max(mean * gain >> 8, -128), 128), deviation
