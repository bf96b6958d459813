"""Mixed bits and the colours of points, written from docs/payloads/bodycast-points.md; no code of mocodec is used."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache

Vector = tuple[int, ...]
Group = tuple[int, dict[int, int], dict[int, int], dict[int, int]]


def difference(a: Sequence[int], b: Sequence[int]) -> Vector:
    return tuple(x - y for x, y in zip(a, b, strict=True))


def dot(a: Sequence[int], b: Sequence[int]) -> int:
    return sum(x * y for x, y in zip(a, b, strict=True))


def squared(a: Sequence[int], b: Sequence[int]) -> int:
    return dot(difference(a, b), difference(a, b))


def at_most(edges: Sequence[int], value: int) -> int:
    """How many of the edges are at most the value."""
    return sum(edge <= value for edge in edges)


# --- mixed bits


@cache
def squash(x: int) -> int:
    return min(max(math.floor(65536 / (1 + math.exp(-(x - 2048) / 256)) + 0.5), 16), 65520)


@cache
def stretch(x: int) -> int:
    q = (x + 0.5) / 4096
    return min(max(math.floor(256 * math.log(q / (1 - q)) + 0.5), -2047), 2047)


class MixedBits:
    def __init__(self, data: bytes) -> None:
        self.source, self.at = data, 4
        self.low, self.high = 0, 2**32 - 1
        self.code = int.from_bytes(data[:4].ljust(4, b"\0"), "big")
        self.counters: dict[tuple[int, int], tuple[int, int]] = {}
        self.weights: dict[int, list[int]] = {}

    def bit(self, contexts: Sequence[int], weight_set: int) -> int:
        slots = [(i, (257 * c * 2654435761 % 2**32) >> 17) for i, c in enumerate(contexts)]
        known = [self.counters.get(slot, (2**15, 0)) for slot in slots]
        weights = self.weights.setdefault(weight_set, [18350] * 5)
        t = [stretch(p >> 4) for p, _ in known]
        p = squash(min(max(dot(weights, t) >> 16, -2048), 2048 - 1) + 2048)
        extent = self.high - self.low
        middle = self.low + (extent >> 16) * p + ((extent % 2**16) * p >> 16)
        bit = int(self.code <= middle)
        self.low, self.high = (self.low, middle) if bit else (middle + 1, self.high)
        while self.low >> 24 == self.high >> 24:
            following = self.source[self.at] if self.at < len(self.source) else 0
            self.at += 1
            self.low = (self.low << 8) % 2**32
            self.high = (self.high << 8 | 255) % 2**32
            self.code = (self.code << 8 | following) % 2**32
        error = 65536 * bit - p
        for i, (slot, (probability, seen)) in enumerate(zip(slots, known, strict=True)):
            weights[i] = min(max(weights[i] + (3 * t[i] * error >> 16), -(2**22)), 2**22)
            rate = math.floor(65536 / (seen + 1.6))
            moved = probability + (((65535 if bit else 0) - probability) * rate >> 16)
            self.counters[slot] = moved, min(seen + 1, 250)
        return bit

    def end(self) -> None:
        """After the last bit."""
        assert len(self.source) <= self.at <= len(self.source) + 4, "the stream leaves bytes, or needs more"


# --- colours


class Colours:
    def __init__(self, bits: MixedBits, steps: tuple[int, int, int]) -> None:
        self.bits, self.steps = bits, steps
        self.share, self.first, self.second = [8] * 3, [0] * 3, [0] * 3

    def frame(self, cells: list[Vector], expected: list[Vector | None]) -> list[Vector]:
        colours: list[Vector] = [(0, 0, 0)] * len(cells)
        bases: list[Vector] = [(0, 0, 0)] * len(cells)
        passes = [range(0, len(cells), 64)] + [range(s, len(cells), 2 * s) for s in (32, 16, 8, 4, 2, 1)]
        for number, rows in enumerate(passes):
            stride = 0 if number == 0 else 64 >> number
            around = {i: self.around(i, stride, cells, colours, bases, expected[i]) for i in rows}
            predicted = {
                i: tuple(b + (c * s >> 4 if expected[i] is not None else 0)
                         for b, c, s in zip(base, correction, self.share, strict=True))
                for i, (base, correction, _, _) in around.items()
            }  # fmt: skip
            for i, colour in self.values(list(rows), predicted, around, number).items():
                colours[i], bases[i] = colour, around[i][0]
                if expected[i] is not None:
                    for k in range(3):
                        self.first[k] += (colour[k] - bases[i][k]) * around[i][1][k]
                        self.second[k] += around[i][1][k] ** 2
        for k in range(3):
            if self.second[k] > 0:
                self.share[k] = min(max((16 * self.first[k] + self.second[k] // 2) // self.second[k], 0), 16)
            self.first[k], self.second[k] = self.first[k] // 2, self.second[k] // 2
        return colours

    @staticmethod
    def around(
        i: int, stride: int, cells: list[Vector], colours: list[Vector], bases: list[Vector], expected: Vector | None
    ) -> tuple[Vector, Vector, Vector, Vector]:
        """Base, correction, activity, spread."""
        zero = (0, 0, 0)
        if not stride:
            return expected or (128, 0, 0), zero, zero, zero
        apart = 2 * stride
        known = -(-len(cells) // apart)
        n = min(16, known)
        start = min(max(i // apart - 7, 0), known - n)
        near = sorted((k * apart for k in range(start, start + n)), key=lambda j: squared(cells[j], cells[i]))[:4]
        weights = [max(2**20 // (squared(cells[j], cells[i]) + 2), 1) for j in near]

        def mean(values: list[Vector]) -> Vector:
            return tuple(sum(w * v[k] for w, v in zip(weights, values, strict=True)) // sum(weights) for k in range(3))

        middle = mean([colours[j] for j in near])
        errors = [difference(colours[j], bases[j]) for j in near]
        activity = mean([tuple(map(abs, error)) for error in errors])
        spread = tuple(max(abs(colours[j][k] - middle[k]) for j in near) for k in range(3))
        return middle if expected is None else expected, mean(errors), activity, spread

    def values(
        self, rows: list[int], predicted: dict[int, Vector], around: dict[int, tuple[Vector, ...]], number: int
    ) -> dict[int, Vector]:
        result: dict[int, list[int]] = {i: [] for i in rows}
        coded = dict.fromkeys(rows, 0)
        for channel, step in enumerate(self.steps):
            edges = (1, 2, 3, 5, 8, 12, 18, 28)
            a = {i: at_most(edges, 2 * around[i][2][channel] // step) for i in rows}
            r = {i: at_most(edges, around[i][3][channel] // step) for i in rows}

            def bit(i: int, kind: int, group: Group = (channel * 37, a, r, coded)) -> int:
                first, activity, spread, known = group
                b = first + kind
                contexts = [
                    b * 9 + activity[i], b * 6 + known[i], (b * 9 + spread[i]) * 7 + number,
                    (b * 9 + activity[i]) * 6 + known[i], (b * 9 + spread[i]) * 9 + activity[i],
                ]  # fmt: skip
                return self.bits.bit(contexts, b * 6 + known[i])

            magnitudes = groups_of_bits(rows, bit)
            for i in rows:
                value = predicted[i][channel] + magnitudes[i] * step
                result[i].append(min(max(value, -512), 511))
            coded = {i: max(coded[i], at_most((1, 2, 4, 8, 16), abs(magnitudes[i]))) for i in rows}
        return {i: tuple(colour) for i, colour in result.items()}


def groups_of_bits(rows: list[int], bit: Callable[[int, int], int]) -> dict[int, int]:
    """The values of all rows, in the order of their groups."""
    values = {i: bit(i, 0) for i in rows}
    rows = [i for i in rows if values[i]]
    signs = {i: -1 if bit(i, 1) else 1 for i in rows}
    large = rows
    for size in range(1, 25):
        large = [i for i in large if bit(i, 1 + size)]
        for i in large:
            values[i] = size + 1
    for digit in range(11):
        for i in large:
            values[i] += bit(i, 26 + digit) << digit
    return {i: value * signs.get(i, 1) for i, value in values.items()}


def rgb(colour: Vector) -> Vector:
    y, co, cg = colour
    h = y - (cg >> 1)
    green, blue = h + cg, h - (co >> 1)
    return tuple(min(max(v, 0), 255) for v in (blue + co, green, blue))
