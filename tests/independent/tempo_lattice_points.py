"""Lattice points and the adaptive bits they are coded in, written from docs/payloads/tempo-lattice.md."""

from __future__ import annotations

import math

# --- adaptive bits


def squash(i: int) -> int:
    return min(max(math.floor(65536 / (1 + math.exp(-(i - 2048) / 256)) + 0.5), 16), 65520)


def stretch(i: int) -> int:
    share = (i + 0.5) / 4096
    return min(max(math.floor(256 * math.log(share / (1 - share)) + 0.5), -2047), 2047)


SQUASH, STRETCH = [squash(i) for i in range(4096)], [stretch(i) for i in range(4096)]
RATE = [math.floor(65536 / (i + 1.6)) for i in range(251)]
HALF = 32768


class Coder:
    """Bits with adaptive probabilities, from the bytes of a range coder."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0
        self.low, self.high, self.code = 0, 2**32 - 1, 0
        for _ in range(4):
            self.code = self.code << 8 | self.next_byte()
        self.counters: dict[tuple[int, int], tuple[int, int]] = {}
        self.mixers: dict[int, list[int]] = {}

    def next_byte(self) -> int:
        self.at += 1
        return self.data[self.at - 1] if self.at <= len(self.data) else 0

    def plain_bit(self, probability: int = HALF) -> int:
        extent = self.high - self.low
        middle = self.low + (extent >> 16) * probability + ((extent % 2**16) * probability >> 16)
        bit = int(self.code <= middle)
        if bit:
            self.high = middle
        else:
            self.low = middle + 1
        while self.low >> 24 == self.high >> 24:
            self.low = self.low % 2**24 << 8
            self.high = self.high % 2**24 << 8 | 255
            self.code = self.code % 2**24 << 8 | self.next_byte()
        return bit

    def bit(self, kind: int, mixer: int, contexts: list[int]) -> int:
        slots = [(i, (257 * context + kind) * 2654435761 % 2**32 >> 17) for i, context in enumerate(contexts)]
        counters = [self.counters.get(slot, (HALF, 0)) for slot in slots]
        weights = self.mixers.get(mixer, [18350] * 5)
        inputs = [STRETCH[p >> 4] for p, _ in counters]
        total = sum(weight * st for weight, st in zip(weights, inputs, strict=True))
        probability = SQUASH[min(max(total >> 16, -2048), 2047) + 2048]
        bit = self.plain_bit(probability)
        error = 65536 * bit - probability
        moved = [weight + (st * error * 3 >> 16) for weight, st in zip(weights, inputs, strict=True)]
        self.mixers[mixer] = [min(max(weight, -(2**22)), 2**22) for weight in moved]
        for slot, (p, seen) in zip(slots, counters, strict=True):
            self.counters[slot] = p + ((65535 * bit - p) * RATE[seen] >> 16), min(seen + 1, 250)
        return bit

    def end(self) -> None:
        assert len(self.data) <= self.at <= len(self.data) + 4, "the stream does not end where it should"


# --- lattice points


def log(v: int) -> int:
    if v <= 0:
        return 0
    octave = v.bit_length() - 1
    return min(23, 2 * octave + 1 + (v >> octave - 1 & 1 if octave else 0))


def lattice_point(coder: Coder, c: int, contexts: list[int], rho: int) -> list[int]:
    """rho: 0 where the axes are x, y, z."""
    odd = coder.bit(0, c, contexts)
    out = []
    for i in range(3):
        radial = rho if i == 0 else 0
        h = odd + 2 * (radial > 0)
        bucket = 0
        while bucket < 95 and coder.bit(
            1 + 32 * h + min(bucket, 30) + 65792 * radial, 8 * (1 + 8 * h + min(bucket, 7)) + c, contexts
        ):
            bucket += 1
        magnitude, bits = bucket, 0
        if bucket > 4:
            pair, second = divmod(bucket - 5, 2)
            bits = pair + 1
            assert bits <= 42
            magnitude = 5 + 2 * sum(2**k for k in range(1, bits)) + second * 2**bits
        extra = 0
        for k in range(bits):
            extra = 2 * extra + (coder.plain_bit() if k else coder.bit(140 + bucket, 320 + c, contexts))
        coordinate = 2 * (magnitude + extra) + odd
        out.append(-coordinate if coordinate and coder.plain_bit() else coordinate)
    return out
