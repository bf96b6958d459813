"""Signals in a file: each as its head in the extras section and its chunks behind it, read when they are needed.

signal ─► head, chunks (signals.codec)          file: extras section · checksum · (chunk · checksum) …
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ..errors import BadInput, Corrupt
from ..motion import Signal
from ..signals import codec
from ..signals.codec import Head
from . import arrays
from .arrays import Array
from .wire import Cursor, checksum

CHECKSUM_BYTES = 4
COMPARED_BYTES = 1 << 20
"""Signals up to this size are also coded as arrays, which is shorter for a few samples."""


@dataclass(frozen=True, eq=False)
class CodedSignal:
    """A signal as bytes, and the type and shape of its values."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    head: bytes
    chunks: tuple[bytes, ...]

    @property
    def nbytes(self) -> int:
        """Bytes of the values."""
        return math.prod(self.shape) * self.dtype.itemsize


_coded: WeakKeyDictionary[Signal, tuple[int, CodedSignal | None]] = WeakKeyDictionary()


def coded(signal: Signal) -> CodedSignal | None:
    """A signal as bytes; None where an array is shorter, or the only way.

    A codec that has to meet a size packs a file more than once: the last result for each signal is kept as long as the
    signal, and used while its values are the same.
    """
    values = np.asarray(signal.values)
    if not codec.suits(values) or values.ndim > arrays.MAX_DIMENSIONS:
        return None
    channels = values.reshape(len(values), -1).T
    is_by_channel = channels.flags.c_contiguous
    same = zlib.crc32(np.ascontiguousarray(channels if is_by_channel else values).view(np.uint8).data)
    if signal not in _coded or _coded[signal][0] != same:
        _coded[signal] = same, _code(signal, values)
    return _coded[signal][1]


def _code(signal: Signal, values: Array) -> CodedSignal | None:
    encoded = codec.encode(values, float(signal.rate))
    if encoded is None:
        return None
    head, chunks = encoded
    result = CodedSignal(values.dtype, values.shape, codec.pack(head), tuple(chunks))
    stored = len(result.head) + sum(map(len, chunks)) + CHECKSUM_BYTES * len(chunks)
    return None if values.nbytes <= COMPARED_BYTES and len(arrays.pack(values)) <= stored else result


class Section:
    """The signals' part of a file: takes the chunks of one signal after the other. read: bytes from an offset on."""

    def __init__(self, read: Callable[[int, int], bytes], size: int) -> None:
        self.read = read
        self.size = size
        self.at = 0
        self.head_bytes = 0
        self.all: list[StoredSamples] = []

    def next(self, cursor: Cursor, dtype: np.dtype[Any], shape: tuple[int, ...]) -> StoredSamples:
        """The samples of the next signal, whose head is read from the extras. Raises Corrupt."""
        head_at = cursor.at
        head = codec.unpack(cursor, dtype, shape)
        self.head_bytes += cursor.at - head_at
        offsets = []
        for size in head.chunk_bytes:
            offsets.append(self.at)
            self.at += size + CHECKSUM_BYTES
            if self.at > self.size:
                raise cursor.corrupt("chunks of signals run past their part of the file")
        self.all.append(StoredSamples(head, self.read, tuple(offsets), 0, head.samples))
        return self.all[-1]

    def done(self, cursor: Cursor) -> None:
        """Raises Corrupt if there is more than the chunks of all signals."""
        if self.at != self.size:
            raise cursor.corrupt(f"{self.size - self.at} bytes of signals belong to none")


@dataclass(frozen=True, eq=False)
class StoredSamples:
    """Samples [start, stop) of a signal in a file."""

    head: Head
    read: Callable[[int, int], bytes]
    offsets: tuple[int, ...]
    start: int
    stop: int

    def payload(self, number: int) -> bytes:
        """The bytes of a chunk. Raises Corrupt, Truncated."""
        size = self.head.chunk_bytes[number]
        data = self.read(self.offsets[number], size + CHECKSUM_BYTES)
        if checksum(data[:size]) != data[size:]:
            first = number * self.head.chunk_samples
            last = min(first + self.head.chunk_samples, self.head.samples)
            raise Corrupt(
                f"samples {first} to {last} of a signal are damaged; the motion and other samples can still be read"
            )
        return data[:size]

    def between(self, start: int, stop: int) -> StoredSamples:
        """Samples [start, stop) of these."""
        low, high, _ = slice(start, stop).indices(self.stop - self.start)
        return replace(self, start=self.start + low, stop=self.start + max(low, high))

    def decode(self, channels: list[int] | None = None) -> Array:
        """(samples, channels): the samples of all channels, or of some."""
        return codec.decode(self.head, self.payload, self.start, self.stop, channels)

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.stop - self.start, *self.head.shape[1:])


class StoredSignal(Signal):
    """A signal in a file: its values are read and decoded when they are used. With values in memory, it is a Signal.

    Using the values raises Corrupt or Truncated if their chunks are damaged.
    """

    def __new__(cls, values: Any, rate: float, labels: tuple[str, ...] = (), units: tuple[str, ...] = ()) -> Signal:
        if not isinstance(values, StoredSamples):
            return Signal(values, rate, labels, units)
        return object.__new__(cls)

    def __init__(
        self, values: StoredSamples, rate: float, labels: tuple[str, ...] = (), units: tuple[str, ...] = ()
    ) -> None:
        if not (math.isfinite(rate) and rate > 0):
            raise BadInput(f"a signal has a positive rate, not {rate}")
        for name, value in (("stored", values), ("rate", rate), ("labels", labels), ("units", units)):
            object.__setattr__(self, name, value)

    stored: StoredSamples

    @cached_property
    def values(self) -> Array:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.stored.decode().reshape(self.stored.shape)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.stored.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.stored.head.dtype

    def samples(self, start: int, stop: int) -> Signal:
        return StoredSignal(self.stored.between(start, stop), self.rate, self.labels, self.units)

    def channel(self, number: int, start: int, stop: int) -> Array:
        return self.stored.between(start, stop).decode([number])[:, 0]

    def loaded(self) -> Signal:
        return Signal(self.values, self.rate, self.labels, self.units)

    def __reduce__(self) -> tuple[Any, ...]:
        return Signal, (self.values, self.rate, self.labels, self.units)
