"""Lattice points of the lattice engine as bits: which parity, then each coordinate's bucket, place in it and sign.

    residual ─nearest or cheapest lattice point─► parity, buckets ─contexts─► mixed probabilities ─► adaptive bits

Encoder and decoder run the same code; only `PointCoder.plain` differs. The compiled module has the same in `lattice.h`.
"""

from __future__ import annotations

import math
from functools import cache

from ..entropy import adaptive_bits

DISTORTION = 384.0
"""Cost of an error at the bound, 1/256 bit: what it does to predictions."""
BUCKETS, COMMON = 96, 30
"""Number of buckets of magnitudes; from bucket COMMON on they share a context."""
LARGEST_WIDTH = 42
RADIUS_2 = 1.25
"""Squared covering radius of the lattice, half steps."""
WIDE = 12.0
"""Residuals with a coordinate beyond are not optimised."""

Vector = list[float]


class TooLarge(Exception):
    """A sample that the engine does not code."""


@cache
def _buckets() -> list[tuple[int, int]]:
    """(first magnitude, bits within): 0 … 4, then two buckets an octave."""
    found, first = [], 0
    for number in range(BUCKETS):
        width = 0 if number < 5 else (number - 5) // 2 + 1
        found.append((first, width))
        first += 1 << width
    return found


def _bucket_of(magnitude: int) -> int:
    table, b = _buckets(), min(magnitude, 5)
    while b + 1 < BUCKETS and magnitude >= table[b + 1][0]:
        b += 1
    return b


def coarse_log(value: int) -> int:
    """About twice the logarithm of a number of sixteenths, 0 … 23."""
    if value <= 0:
        return 0
    octave = value.bit_length() - 1
    half = value >> (octave - 1) & 1 if octave else 0
    return min(23, 2 * octave + half + 1)


class PointCoder:
    """Codes lattice points in contexts that `mixer.contexts` sets: the ones wanted, or the ones decoded."""

    def __init__(self, encoder: adaptive_bits.Encoder | None, decoder: adaptive_bits.Decoder | None) -> None:
        self.mixer = adaptive_bits.Mixer()
        self.encoder, self.decoder = encoder, decoder

    def bit(self, wanted: int, kind: int, weights: int) -> int:
        """A bit in contexts: the one wanted, or the one decoded."""
        bit = self.plain(wanted, self.mixer.mix(kind, weights))
        self.mixer.learn(bit)
        return bit

    def plain(self, wanted: int, probability: int = adaptive_bits.HALF) -> int:
        if self.encoder is not None:
            self.encoder.bit(wanted, probability)
            return wanted
        assert self.decoder is not None
        return self.decoder.bit(probability)

    def code(self, residual: Vector | None, c: int, radial: int) -> list[int]:
        """The lattice point of a residual in half steps, None for a decoder.

        c: class of the sample; radial: context of the coordinate along the direction to the partner, 0 without one.
        """
        z = [0, 0, 0] if residual is None else self._chosen(residual, c, radial)
        bit = self.bit
        odd = bit(z[0] & 1, 0, c)
        for k in range(3):
            along = radial > 0 and k == 0
            magnitude = abs(z[k]) >> 1
            wanted, b = _bucket_of(magnitude), 0
            while b < BUCKETS - 1 and bit(wanted > b, *_kind(odd, along, b, c, radial)):
                b += 1
            first, width = _buckets()[b]
            if width > LARGEST_WIDTH:
                raise TooLarge
            rest = magnitude - first if residual is not None else 0
            found = 0
            for place in range(width - 1, -1, -1):
                this = rest >> place & 1
                this = bit(this, 140 + b, 320 + c) if place == width - 1 else self.plain(this)
                found |= this << place
            value = 2 * (first + found) + odd
            if value and self.plain(int(z[k] < 0)):
                value = -value
            z[k] = value
        if self.decoder is not None and self.decoder.exhausted:
            raise TooLarge
        return z

    def _chosen(self, residual: Vector, c: int, radial: int) -> list[int]:
        """The nearest lattice point; of a small residual, the one within the bound that costs least."""
        even = [math.floor(r / 2 + 0.5) * 2 for r in residual]
        odd = [math.floor(r / 2) * 2 + 1 for r in residual]
        distances = [square([r - z for r, z in zip(residual, point, strict=True)]) for point in (even, odd)]
        best = even if distances[0] <= distances[1] else odd
        if max(map(abs, residual)) > WIDE:
            return best
        cost_of = self.mixer.cost
        p = self.mixer.mix(0, c)
        parity = (cost_of[(65536 - p) >> 4], cost_of[p >> 4])
        costs = self._costs(residual, c, radial)
        least = math.inf
        for o in (0, 1):
            low = [math.floor((r - o) / 2) * 2 + o for r in residual]
            for corner in range(8):
                y = [low[0] + 2 * (corner & 1), low[1] + (corner & 2), low[2] + (corner >> 1 & 2)]
                off = square([r - float(v) for r, v in zip(residual, y, strict=True)])
                if off > RADIUS_2:
                    continue
                cost = parity[o] + DISTORTION * off / RADIUS_2
                for k in range(3):
                    cost += costs[radial > 0 and k == 0][o][_bucket_of(abs(y[k]) >> 1)]
                if cost < least:
                    least, best = cost, y
        return best

    def _costs(self, residual: Vector, c: int, radial: int) -> list[list[list[int]]]:
        """Costs of buckets, 1/256 bit: of coordinates across and along, even and odd."""
        most = [0, 0]
        for k, r in enumerate(residual):
            along = radial > 0 and k == 0
            most[along] = max(most[along], _bucket_of(int(abs(r) + 1.2) >> 1))
        cost_of, mix = self.mixer.cost, self.mixer.mix
        found: list[list[list[int]]] = []
        for along in range(2 if radial else 1):
            found.append([])
            for o in (0, 1):
                total, listed = 0, list[int]()
                for b in range(most[along] + 1):
                    p = mix(*_kind(o, bool(along), b, c, radial))
                    sign = 256 if o or b else 0
                    listed.append(total + cost_of[(65536 - p) >> 4] + sign + 256 * _buckets()[b][1])
                    total += cost_of[p >> 4]
                found[-1].append(listed)
        return found


def _kind(odd: int, along: bool, b: int, c: int, radial: int) -> tuple[int, int]:
    """What "the magnitude is beyond bucket b" is called, and the weights that mix it."""
    which = 2 * along + odd
    kind = 1 + which * 32 + min(b, COMMON) + (radial * 256 * 257 if along else 0)
    return kind, (1 + which * 8 + min(b, 7)) * 8 + c


def square(vector: Vector) -> float:
    total = 0.0
    for value in vector:
        total += value * value
    return total
