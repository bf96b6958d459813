"""Context-adaptive binary coder, in integers only.

    bits, contexts ──BinaryEncoder.encode──► one rANS state ──► bytes ──BinaryDecoder.decode──► bits

The probability of a bit in a context follows from the bits counted there so far. Bits are coded in groups: a group uses
the counts from before it, so that whole arrays are coded at once; the counts are updated after each group.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ...entropy.coder import StateDecoder, StateEncoder, Tables
from ...typing import AnyInteger, Integers

LEVELS = 128  # of a probability
FIRST_COUNT, COUNT_STEP = 2, 2  # of zeros and of ones in each context
MAX_COUNT = 1 << 12  # of zeros and ones together; above it both are halved
MIN_BYTES = 2  # that a rANS decoder reads


@cache
def _probability_tables() -> Tables:
    return Tables([[2 * LEVELS - 2 * level - 1, 2 * level + 1] for level in range(LEVELS)])


class ContextCounts:
    """Zeros and ones counted in each context."""

    def __init__(self, contexts: int) -> None:
        self.counts = np.full((2, contexts), FIRST_COUNT, np.int64)

    def levels(self, context: AnyInteger) -> Integers:
        """(n,): the probability of a one in each context (n,), as a level from 0 to LEVELS − 1."""
        zeros, ones = self.counts[:, context]
        return ones * LEVELS // (zeros + ones)

    def update(self, context: AnyInteger, bits: AnyInteger) -> None:
        """Count a group of bits (n,) in their contexts (n,)."""
        size = self.counts.shape[1]
        for value in (0, 1):
            self.counts[value] += COUNT_STEP * np.bincount(context[bits == value], minlength=size)
        full = self.counts.sum(axis=0) > MAX_COUNT
        self.counts[:, full] = np.maximum(self.counts[:, full] >> 1, 1)


class BinaryEncoder:
    """Groups of bits to bytes."""

    def __init__(self) -> None:
        self._encoder = StateEncoder()

    def encode(self, counts: ContextCounts, context: AnyInteger, bits: AnyInteger) -> None:
        """One group: bits (n,) in their contexts (n,). Updates the counts."""
        self._encoder.put(_probability_tables(), counts.levels(context), bits.astype(np.int64))
        counts.update(context, bits)

    def finish(self, values: AnyInteger | None = None, widths: AnyInteger | None = None) -> bytes:
        """The bytes. values, widths: non-negative integers of `widths` bits each, appended without a model."""
        if values is not None and widths is not None:
            self._encoder.raw(values, widths)
        return self._encoder.finish().ljust(MIN_BYTES, b"\0")


class BinaryDecoder:
    """The inverse of `BinaryEncoder`, call for call. Every method raises Corrupt."""

    def __init__(self, data: bytes) -> None:
        self._decoder = StateDecoder(data)

    def decode(self, counts: ContextCounts, context: AnyInteger) -> Integers:
        """The bits (n,) of one group. Updates the counts."""
        bits = self._decoder.next(_probability_tables(), counts.levels(context)).astype(np.int64)
        counts.update(context, bits)
        return bits

    def finish(self, widths: AnyInteger | None = None) -> AnyInteger:
        """The values given to `BinaryEncoder.finish`."""
        return self._decoder.raw(np.zeros(0, np.int64) if widths is None else widths)
