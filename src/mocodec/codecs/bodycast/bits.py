"""Yes or no, many times, each with what is known around it: adaptive binary coding in whole numbers.

    bits, contexts ──Writer.put──► one state of rANS ──► bytes          bytes ──Reader.get──► bits

How likely a yes is in a context is what was counted there so far. A group of bits is coded with the counts from before
it, so that whole arrays go through at once; counts move after each group.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...entropy.coder import Decoder, Encoder, Tables

Array = NDArray[Any]
LEVELS = 128  # of a probability
START = 2  # counts of yes and of no before anything is known, in halves
MOST = 1 << 12  # counts are halved here


@cache
def _tables() -> Tables:
    return Tables([[2 * LEVELS - 2 * level - 1, 2 * level + 1] for level in range(LEVELS)])


class Counts:
    """What was seen in each context."""

    def __init__(self, contexts: int) -> None:
        self.seen = np.full((2, contexts), START, np.int64)

    def level(self, context: Array) -> Array:
        """The table for each context."""
        no, yes = self.seen[:, context]
        return yes * LEVELS // (no + yes)

    def add(self, context: Array, bits: Array) -> None:
        size = self.seen.shape[1]
        for value in (0, 1):
            self.seen[value] += 2 * np.bincount(context[bits == value], minlength=size)
        full = self.seen.sum(axis=0) > MOST
        self.seen[:, full] = np.maximum(self.seen[:, full] >> 1, 1)


class Writer:
    """Groups of bits to bytes."""

    def __init__(self) -> None:
        self.encoder = Encoder()

    def put(self, counts: Counts, context: Array, bits: Array) -> None:
        """One group: bits (n,) with their contexts (n,)."""
        self.encoder.put(_tables(), counts.level(context), bits.astype(np.int64))
        counts.add(context, bits)

    def finish(self, values: Array | None = None, widths: Array | None = None) -> bytes:
        """The bytes; at their end integers of so many bits each, as they are."""
        if values is not None and widths is not None:
            self.encoder.raw(values, widths)
        return self.encoder.finish().ljust(2, b"\0")  # what is told with certainty may take less


class Reader:
    """The inverse of `Writer`, call for call. Raises Corrupt."""

    def __init__(self, data: bytes) -> None:
        self.decoder = Decoder(data)

    def get(self, counts: Counts, context: Array) -> Array:
        bits = self.decoder.next(_tables(), counts.level(context)).astype(np.int64)
        counts.add(context, bits)
        return bits

    def finish(self, widths: Array | None = None) -> Array:
        """What `Writer.finish` was given."""
        return self.decoder.raw(np.zeros(0, np.int64) if widths is None else widths)


def pack_mask(mask: NDArray[np.bool_]) -> bytes:
    """A picture of yes and no, row by row."""
    writer, counts = Writer(), Counts(_MASK_CONTEXTS)
    padded = _framed(mask.shape)
    for row, values in enumerate(mask.astype(np.int64)):
        for half in (0, 1):
            writer.put(counts, _around(padded, row, half), values[half::2])
            padded[row + 2, 2 + half : 2 + mask.shape[1] : 2] = values[half::2]
    return writer.finish()


def unpack_mask(data: bytes, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """The inverse of `pack_mask`. Raises Corrupt."""
    reader, counts = Reader(data), Counts(_MASK_CONTEXTS)
    padded = _framed(shape)
    for row in range(shape[0]):
        for half in (0, 1):
            padded[row + 2, 2 + half : 2 + shape[1] : 2] = reader.get(counts, _around(padded, row, half))
    reader.finish()
    return padded[2:, 2:-2] != 0


_MASK_CONTEXTS = 2 << 8


def _framed(shape: tuple[int, int]) -> NDArray[np.int64]:
    return np.zeros((shape[0] + 2, shape[1] + 4), np.int64)


def _around(padded: NDArray[np.int64], row: int, half: int) -> Array:
    """The context of every second place of a row: six places above, and in the second round both neighbours."""
    above, over, here = padded[row + 1], padded[row], padded[row + 2]
    width = padded.shape[1] - 4
    at = np.arange(half, width, 2) + 2
    context = np.full(len(at), half)
    for line, shift in ((above, -2), (above, -1), (above, 0), (above, 1), (over, 0), (above, 2)):
        context = context * 2 + line[at + shift]
    for shift in (-1, 1):
        context = context * 2 + (here[at + shift] if half else 0)
    return context
