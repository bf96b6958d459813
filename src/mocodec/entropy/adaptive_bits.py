"""Adaptive binary coder: each bit has a probability mixed from several contexts. Integers only.

    contexts ─counters─► probabilities ─stretch, weigh, squash─► one probability ─range coder─► bytes

A counter holds the probability of a 1 in its context and adapts with every bit, fast at first. Probabilities are mixed
in the logistic domain by weights that adapt too (Mahoney, Adaptive weighing of context models, 2005). The compiled
module has the same in `adaptive_bits.h`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

INPUTS = 5
"""Contexts of a bit."""
SLOT_BITS = 15
"""Each input has 2^15 counters; contexts share them by a hash."""
MIXERS = 1 << 11
FIRST_WEIGHT = 18350
"""0.28 in 2^-16."""
LEARNING = 3
LARGEST_WEIGHT = 1 << 22
SLOWEST = 250
"""Bits that a counter has seen when its rate becomes constant."""
HALF = 1 << 15
"""Probability 1/2, in 2^-16."""
MASK = (1 << 32) - 1


class Tables(NamedTuple):
    """int32 arrays. squash (4096): probability, 2^-16, of a logit from −2048 to 2047, 1/256. stretch (4096): the logit
    of a probability, 2^-12. rate (256): of counters, 2^-16, by bits seen. cost (4096): of a bit whose probability is
    this, 2^-12, in 1/256 bit."""

    squash: NDArray[np.int32]
    stretch: NDArray[np.int32]
    rate: NDArray[np.int32]
    cost: NDArray[np.int32]


@cache
def tables() -> Tables:
    """The same on every machine: no value before rounding is near a half."""
    logits = (np.arange(4096) - 2048) / 256
    squash = np.clip(np.floor(65536 / (1 + np.exp(-logits)) + 0.5), 16, 65520)
    probability = (np.arange(4096) + 0.5) / 4096
    stretch = np.clip(np.floor(256 * np.log(probability / (1 - probability)) + 0.5), -2047, 2047)
    rate = np.floor(65536 / (np.arange(256) + 1.6))
    cost = np.floor(-256 * np.log2(probability) + 0.5)
    return Tables(*(each.astype(np.int32) for each in (squash, stretch, rate, cost)))


class Mixer:
    """Probabilities of bits, from contexts and the bits seen so far."""

    def __init__(self) -> None:
        known = tables()
        self._squash, self._stretch, self._rate, self.cost = (each.tolist() for each in known)
        self._counters = [[HALF] * (1 << SLOT_BITS) for _ in range(INPUTS)]
        self._seen = [[0] * (1 << SLOT_BITS) for _ in range(INPUTS)]
        self._weights = [[FIRST_WEIGHT] * INPUTS for _ in range(MIXERS)]
        self._contexts: list[int] = [0] * INPUTS
        self._slots: list[int] = [0] * INPUTS
        self._stretched: list[int] = [0] * INPUTS
        self._used = self._weights[0]
        self._p = HALF

    def contexts(self, contexts: Sequence[int]) -> None:
        """The contexts of the bits that follow."""
        self._contexts = [c * 257 for c in contexts]

    def mix(self, kind: int, weights: int) -> int:
        """The probability, 2^-16, that the next bit is 1. kind: which decision it codes; weights: their set."""
        shift = 32 - SLOT_BITS
        self._slots = [((c + kind) * 2654435761 & MASK) >> shift for c in self._contexts]
        self._stretched = [
            self._stretch[counters[at] >> 4] for counters, at in zip(self._counters, self._slots, strict=True)
        ]
        self._used = self._weights[weights % MIXERS]
        total = sum(w * s for w, s in zip(self._used, self._stretched, strict=True))
        self._p = self._squash[min(max(total >> 16, -2048), 2047) + 2048]
        return self._p

    def learn(self, bit: int) -> None:
        """Adapt counters and weights to the bit whose probability the last `mix` returned."""
        error, target = (bit << 16) - self._p, 65535 if bit else 0
        for i, at in enumerate(self._slots):
            moved = self._used[i] + (self._stretched[i] * error * LEARNING >> 16)
            self._used[i] = min(max(moved, -LARGEST_WEIGHT), LARGEST_WEIGHT)
            counters, seen = self._counters[i], self._seen[i]
            counters[at] += (target - counters[at]) * self._rate[seen[at]] >> 16
            seen[at] += seen[at] < SLOWEST


class Encoder:
    """Bits of given probabilities to bytes: a range coder of 32 bits without carry."""

    def __init__(self) -> None:
        self._low, self._high = 0, MASK
        self._out = bytearray()

    def bit(self, bit: int, probability: int) -> None:
        """probability: that the bit is 1, 2^-16."""
        middle = _middle(self._low, self._high, probability)
        if bit:
            self._high = middle
        else:
            self._low = middle + 1
        while not (self._low ^ self._high) >> 24:
            self._out.append(self._high >> 24)
            self._low, self._high = self._low << 8 & MASK, (self._high << 8 | 255) & MASK

    @property
    def size(self) -> int:
        """Whole bytes so far."""
        return len(self._out)

    def finish(self) -> bytes:
        """The fewest bytes that decode correctly if zeros follow."""
        for count in range(1, 5) if self._low else ():
            unit = 1 << (32 - 8 * count)
            value = -(-self._low // unit) * unit
            if value <= self._high:
                self._out += value.to_bytes(4, "big")[:count]
                break
        return bytes(self._out)


class Decoder:
    """The inverse of `Encoder`."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 4
        self._low, self._high = 0, MASK
        self._code = int.from_bytes(data[:4].ljust(4, b"\0"), "big")

    def bit(self, probability: int) -> int:
        """The next bit, whose probability of being 1 is this, 2^-16."""
        middle = _middle(self._low, self._high, probability)
        bit = self._code <= middle
        if bit:
            self._high = middle
        else:
            self._low = middle + 1
        while not (self._low ^ self._high) >> 24:
            following = self._data[self._at] if self._at < len(self._data) else 0
            self._at += 1
            self._low, self._high = self._low << 8 & MASK, (self._high << 8 | 255) & MASK
            self._code = (self._code << 8 | following) & MASK
        return int(bit)

    @property
    def at_end(self) -> bool:
        """Whether all bytes were used, and none beyond the end but the zeros that `Encoder.finish` leaves out."""
        return len(self._data) <= self._at <= len(self._data) + 4

    @property
    def exhausted(self) -> bool:
        """Whether more bytes were needed than there are: the data are cut off or damaged."""
        return self._at > len(self._data) + 4


def _middle(low: int, high: int, probability: int) -> int:
    """The largest code of a 1."""
    extent = high - low
    return low + (extent >> 16) * probability + ((extent & 0xFFFF) * probability >> 16)
