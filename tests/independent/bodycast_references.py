"""Points of earlier frames as samples, written from docs/payloads/bodycast-references.md.

No code of mocodec is used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .bodycast_colours import Vector, difference, dot, squared
from .integers import Bytes


@dataclass
class Samples:
    """Places in subunits, normals, neighbours; origins: frame (1: the last) and point that each is from."""

    places: list[Vector]
    normals: list[Vector]
    neighbours: list[list[int]]
    origins: list[tuple[int, int]]


@dataclass
class Kept:
    """A frame's points as they stand now, whether a body explains each, and their colours."""

    cells: list[Vector]
    explained: list[bool]
    colours: list[Vector]


class References:
    """The last four frames with points, the latest first."""

    def __init__(self, numbers: list[tuple[int, Vector, bool]]) -> None:
        self.numbers, self.kept = numbers, list[Kept]()

    @staticmethod
    def read(stream: Bytes, frames: int) -> References:
        numbers = list[tuple[int, Vector, bool]]()
        for _ in range(frames):
            count, hides = divmod(stream.varint(), 2)
            numbers.append((count, tuple(stream.folded() for _ in range(3)) if count else (0, 0, 0), hides == 1))
        return References(numbers)

    def samples(self, k: int, depth: int, bodies: bool) -> Samples | None:
        """The samples of frame k. bodies: whether any body is in the frame. The kept frames move on."""
        count, motion, _ = self.numbers[k]
        for frame in self.kept:
            frame.cells = [tuple(x + m for x, m in zip(cell, motion, strict=True)) for cell in frame.cells]
        found: dict[Vector, tuple[int, int]] = {}
        for age, frame in enumerate(self.kept[:count], 1):
            for row, cell in enumerate(frame.cells):
                if all(0 <= x < 2**depth for x in cell) and not (bodies and frame.explained[row]):
                    found.setdefault(cell, (age, row))
        if len(found) < 48:
            return None
        cells = sorted(found, key=morton)
        return surface([tuple(16 * x for x in cell) for cell in cells], [found[cell] for cell in cells])

    def keep(self, cells: list[Vector], explained: list[bool], colours: list[Vector]) -> None:
        self.kept = [Kept(cells, explained, colours), *self.kept[:3]]

    def expected(self, samples: Samples, cell: Vector, s: int) -> Vector:
        place = tuple(16 * x for x in cell)
        candidates = [s, *samples.neighbours[s][:6]]
        near = sorted(candidates, key=lambda n: squared(samples.places[n], place))[:4]
        weights = [2**40 // (squared(samples.places[n], place) + 128) for n in near]
        total = max(sum(weights), 1)
        colours = [self.kept[age - 1].colours[row] for age, row in (samples.origins[n] for n in near)]
        return tuple(
            (sum(w * c[k] for w, c in zip(weights, colours, strict=True)) + total // 2) // total for k in range(3)
        )


def morton(cell: Sequence[int]) -> int:
    return sum((x >> digit & 1) << 3 * digit + axis for axis, x in enumerate(cell) for digit in range(20))


def surface(points: list[Vector], origins: list[tuple[int, int]]) -> Samples:
    centre = [sum(p[k] for p in points) // len(points) for k in range(3)]
    places, normals, around = list[Vector](), list[Vector](), list[list[int]]()
    for i, point in enumerate(points):
        near = sorted((n for n in range(len(points)) if n != i), key=lambda n: squared(points[n], point))[:12]
        apart = [difference(points[n], point) for n in near]
        normal = normal_of(apart)
        if dot(difference(point, centre), normal) < 0:
            normal = tuple(-x for x in normal)
        total = [sum(d[k] for d in apart) for k in range(3)]
        offset = (dot(total, normal) >> 10) // 13
        places.append(tuple(x + (offset * n >> 10) for x, n in zip(point, normal, strict=True)))
        normals.append(normal)
        around.append(near)
    neighbours = list[list[int]]()
    for i, near in enumerate(around):
        alike = [n for n in near if dot(normals[n], normals[i]) > 0]
        neighbours.append(alike + [i] * (12 - len(alike)))
    return Samples(places, normals, neighbours, origins)


def normal_of(apart: list[Vector]) -> Vector:
    shift = max(max(abs(x) for d in apart for x in d).bit_length() - 9, 0)
    small = [[x >> shift for x in d] for d in apart]
    total = [sum(d[k] for d in small) for k in range(3)]
    c = [[13 * sum(d[i] * d[j] for d in small) - total[i] * total[j] for j in range(3)] for i in range(3)]

    def cofactor(i: int, j: int) -> int:
        a, b, e, f = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
        return c[a][e] * c[b][f] - c[a][f] * c[b][e]

    column = max(range(3), key=lambda k: cofactor(k, k))
    vector = [cofactor(k, column) for k in range(3)]
    down = max(max(map(abs, vector)).bit_length() - 20, 0)
    vector = [x >> down for x in vector]
    length = math.isqrt(dot(vector, vector))
    return tuple((x << 10) // length for x in vector) if length else (0, 0, 1024)
