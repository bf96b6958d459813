"""Points within a bound, written from docs/payloads/bodycast-points.md; no code of mocodec is used.

The integer surface is given: samples of the bodies in the canonical pose, and where they stand in each frame.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

from .bodycast_colours import Colours, MixedBits, Vector, difference, dot, groups_of_bits, rgb, squared
from .bodycast_cubes import CubeOctree
from .bodycast_octree import FrameOctree, Posed, Smoothing
from .bodycast_references import References, Samples
from .integers import Bytes


@dataclass
class Surface:
    """Samples of all bodies: places p, the twelve neighbours of each, and colours of the atlas as Y, Co, Cg."""

    places: list[Vector] = field(default_factory=list)
    neighbours: list[list[int]] = field(default_factory=list)
    colours: list[Vector] = field(default_factory=list)


# --- what earlier frames showed


class Learned:
    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self.distances, self.counts = [0] * len(surface.places), [0] * len(surface.places)
        empty = [((2**24, 2**24, 2**24), (0, 0, 0))] * 7
        self.slots = [[(p, c), *empty] for p, c in zip(surface.places, surface.colours, strict=True)]
        self.seen = [1] * len(surface.places)

    def moved(self, posed: Posed) -> list[Vector]:
        result = list[Vector]()
        for i, (place, normal) in enumerate(zip(posed.places, posed.normals, strict=True)):
            around = self.surface.neighbours[i][:6]
            total = 2 * self.distances[i] + sum(self.distances[n] for n in around)
            count = 2 * self.counts[i] + sum(self.counts[n] for n in around) + 32
            offset = 16 * total // count
            result.append(tuple(x + (offset * n >> 10) for x, n in zip(place, normal, strict=True)))
        return result

    def learn(self, posed: Posed, points: list[Vector], samples: list[int]) -> None:
        self.distances = [4 * d // 5 for d in self.distances]
        self.counts = [4 * c // 5 for c in self.counts]
        for point, s in zip(points, samples, strict=True):
            if s >= 0 and abs(d := dot(difference(point, posed.places[s]), posed.normals[s]) >> 10) <= 983:
                self.distances[s] += d
                self.counts[s] += 16

    def canonical(self, posed: Posed, point: Vector, s: int) -> Vector:
        apart, turn = difference(point, posed.places[s]), posed.turns[s]
        turned = [sum(turn[k][axis] * apart[k] for k in range(3)) >> 20 for axis in range(3)]
        return tuple(min(max(p + t, -(2**23)), 2**23) for p, t in zip(self.surface.places[s], turned, strict=True))

    def expected(self, s: int, place: Vector) -> Vector:
        found = [slot for n in [s, *self.surface.neighbours[s][:6]] for slot in self.slots[n]]
        near = sorted(found, key=lambda slot: squared(slot[0], place))[:4]
        weights = [2**40 // (squared(where, place) + 2000) for where, _ in near]
        total = max(sum(weights), 1)
        return tuple(
            (sum(w * colour[k] for w, (_, colour) in zip(weights, near, strict=True)) + total // 2) // total
            for k in range(3)
        )

    def see(self, s: int, place: Vector, colour: Vector) -> None:
        self.slots[s][self.seen[s] % 8] = place, colour
        self.seen[s] += 1


# --- the part of a chunk


Decoded = list[tuple[list[list[float]], list[Vector]]]


def points(
    data: bytes, frames: int, bodies: int, poses: int, surface: Surface, posed: Callable[[int, list[int]], Posed]
) -> Decoded:
    """Places in metres and colours of each frame. poses: of all bodies in all frames; posed(frame, pose shifts of the
    chunk): the samples of the surface, all of which are in every frame."""
    stream = Bytes(data)
    if data[0] == 7:
        return exact(stream, lambda part: Layer(part, frames, bodies, poses, surface, posed))
    layer = Layer(stream, frames, bodies, poses, surface, posed)
    colour_bits = MixedBits(stream.rest())
    colours = Colours(colour_bits, layer.steps) if layer.steps[0] else None
    result: Decoded = []
    for cells, own, shifts in layer.frames(colours, lambda count: [0] * count):
        places = [
            [(256 * (x + c) + y) * layer.step / 256 for x, c, y in zip(cell, layer.corner, shift, strict=True)]
            for cell, shift in zip(cells, shifts, strict=True)
        ]
        result.append((places, own))
    colour_bits.end()
    return result


def exact(stream: Bytes, layer_of: Callable[[Bytes], Layer]) -> Decoded:
    _, grid, nanometres, exponent = stream.varint(), stream.varint(), stream.varint(), stream.folded()
    spacing = stream.varint()
    corner = [stream.folded() for _ in range(3)]
    sizes = [stream.varint() for _ in range(3)]
    place_bytes = Bytes(stream.take(sizes[0]))
    layer = layer_of(place_bytes)
    repeat_bits, float_bits = MixedBits(stream.take(sizes[1])), stream.take(sizes[2])
    rest = stream.rest()
    colour_bits = MixedBits(rest)
    colours = Colours(colour_bits, (1, 1, 1)) if rest else None

    def repeats(count: int) -> list[int]:
        rows = list(range(count))
        found = groups_of_bits(rows, lambda _, kind: repeat_bits.bit([kind] * 5, kind))
        return [found[i] for i in rows]

    found = list(layer.frames(colours, repeats))
    for bits in (repeat_bits, MixedBits(place_bytes.rest()), colour_bits):
        bits.end()
    assert not (grid and float_bits)
    cells = [
        [[c + spacing * (x >> 1) for x, c in zip(cell, corner, strict=True)] for cell in own] for own, _, _ in found
    ]
    if grid:
        step = 2.0**exponent if grid == 1 else nanometres * 1e-9
        places = [[[x * step for x in cell] for cell in own] for own in cells]
    else:
        values = iter(floats_of([x for own in cells for cell in own for x in cell], float_bits))
        places = [[[next(values) for _ in range(3)] for _ in own] for own in cells]
    return [(own, colour) for own, (_, colour, _) in zip(places, found, strict=True)]


class Layer:
    """Points within a bound: kind 4, 5 or 8, or 6 before it."""

    def __init__(
        self, stream: Bytes, frames: int, bodies: int, poses: int, surface: Surface,
        posed: Callable[[int, list[int]], Posed],
    ) -> None:  # fmt: skip
        self.references = References([(0, (0, 0, 0), False)] * frames)
        if (kind := stream.varint()) == 6:
            self.references = References.read(stream, frames)
            kind = stream.varint()
        assert kind in (4, 5, 8)
        self.kind = kind
        self.depth, luma, chroma = (stream.varint() for _ in range(3))
        self.steps = luma, chroma, chroma
        self.corner = [stream.folded() for _ in range(3)]
        self.step = stream.float64()
        self.counts = [stream.varint() for _ in range(frames)]
        for _ in range(bodies):
            stream.varint()
        shifts = [stream.varint() for _ in range(poses)]
        self.octrees = MixedBits(stream.blob())
        self.surface, self.posed = surface, lambda k: posed(k, shifts)
        self.learned = Learned(surface)

    def frames(
        self, colours: Colours | None, repeats: Callable[[int], list[int]]
    ) -> Iterator[tuple[list[Vector], list[Vector], list[Vector]]]:
        """Of each frame: cells and colours of its points, and shifts. repeats(count): more points of each cell."""
        for k, count in enumerate(self.counts):
            if not count:
                yield [], [], []
                continue
            standing, scale = self.posed(k), 16.0 / (self.step * 65536)
            subunits = [
                tuple(math.floor(x * scale) - 16 * c for x, c in zip(place, self.corner, strict=True))
                for place in self.learned.moved(standing)
            ]
            if self.references.numbers[k][2]:
                subunits = []
            own, near, seen = len(subunits), self.surface.neighbours[: len(subunits)], replace(standing)
            seen.normals = standing.normals[:own]
            if (earlier := self.references.samples(k, self.depth, bodies=own > 0)) is not None:
                subunits = subunits + earlier.places
                seen.normals = seen.normals + earlier.normals
                near = near + [[n + own for n in row] for row in earlier.neighbours]
            if self.kind == 8:
                octree = CubeOctree(self.octrees, self.depth, subunits, seen, near, count)
            else:
                octree = FrameOctree(self.octrees, self.depth, subunits, seen, near, self.kind)
            found, shifts = octree.decode(), [(0, 0, 0)] * count
            assert len(found) == count
            if self.kind in (5, 8):
                shifts = Smoothing(octree, [cell for cell, _ in found], [s for _, s in found]).shifts()
            yield *self.coloured(found, own, standing, earlier, colours, repeats(count)), shifts
        self.octrees.end()

    def coloured(
        self, found: list[tuple[Vector, int]], own: int, standing: Posed, earlier: Samples | None,
        colours: Colours | None, repeats: list[int],
    ) -> tuple[list[Vector], list[Vector]]:  # fmt: skip
        """The points of a frame with their repeats; the next frames learn from them. own: samples of bodies."""
        learned, cells = self.learned, [cell for cell, _ in found]
        samples = [s if s < own else -1 for _, s in found]
        scale = self.step * 65536
        fine = [
            tuple(
                min(max(math.floor((x + c) * scale), -(2**30)), 2**30) for x, c in zip(cell, self.corner, strict=True)
            )
            for cell in cells
        ]
        places = [learned.canonical(standing, p, s) if s >= 0 else None for p, s in zip(fine, samples, strict=True)]
        learned.learn(standing, fine, samples)
        rows = [i for i, more in enumerate(repeats) for _ in range(more + 1)]
        colour = list[Vector]()
        if colours is not None:
            expected = list[Vector | None]()
            for i in rows:
                place, n = places[i], found[i][1] - own
                of_earlier = None if earlier is None or n < 0 else self.references.expected(earlier, cells[i], n)
                expected.append(learned.expected(samples[i], place) if place else of_earlier)
            colour = colours.frame([cells[i] for i in rows], expected)
            for i, c in zip(rows, colour, strict=True):
                if (place := places[i]) is not None:
                    learned.see(samples[i], place, c)
        firsts = [colour[rows.index(i)] for i in range(len(cells))] if colour else []
        told = [explained(standing, p, s) for p, s in zip(fine, samples, strict=True)]
        self.references.keep(cells, told, firsts)
        return [cells[i] for i in rows], [rgb(c) for c in colour]


def floats_of(cells: list[int], data: bytes) -> list[float]:
    """Coordinates from cells of 2^-10 m and the raw bits within them."""

    def pattern(value: float) -> int:
        return struct.unpack("<I", struct.pack("<f", value))[0]

    sizes = [c if c >= 0 else -c - 1 for c in cells]
    starts = [pattern(m / 1024) for m in sizes]
    patterns = [max(pattern((m + 1) / 1024) - start, 1) for m, start in zip(sizes, starts, strict=True)]
    widths = [31 if m == 0 else math.ceil(math.log2(n)) for m, n in zip(sizes, patterns, strict=True)]
    bits, at, result = raw_bits(data, sum(widths)), 0, list[float]()
    for cell, start, width in zip(cells, starts, widths, strict=True):
        rest = int("".join(map(str, bits[at : at + width])) or "0", 2)
        at += width
        value = struct.unpack("<f", struct.pack("<I", min(start + rest, 0x7F7FFFFF)))[0]
        result.append(-value if cell < 0 else value)
    return result


def raw_bits(data: bytes, count: int) -> list[int]:
    """Adaptive bits without groups: the only state, then raw bits from their end."""
    head = len(data) if len(data) <= 4 else 4 if len(data) % 2 == 0 else 3
    x, words = int.from_bytes(data[:head], "little"), iter(struct.unpack(f"<{(len(data) - head) // 2}H", data[head:]))

    def refill(x: int) -> int:
        return x if x >= 2**16 or (word := next(words, None)) is None else x << 16 | word

    x = refill(x)
    slot = x % 2**14
    assert slot >= 64, "the stream does not begin as it must"
    x = refill(16320 * (x >> 14) + slot - 64)
    bits = list[int]()
    for size in [8] * (count // 8) + [count % 8]:
        part, x = x % 2**size, refill(x >> size)
        bits = [part >> k & 1 for k in range(size - 1, -1, -1)] + bits
    assert x == 1
    assert next(words, None) is None
    return bits


def explained(posed: Posed, point: Vector, s: int) -> bool:
    """Whether a body explains a point near its sample s."""
    apart = difference(point, posed.places[s]) if s >= 0 else (0, 0, 0)
    return s >= 0 and abs(dot(apart, posed.normals[s]) >> 10) <= 983 and dot(apart, apart) <= 2621**2
