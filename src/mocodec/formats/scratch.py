# pyright: strict
"""Samples in a temporary file, channel after channel: for signals of recordings that do not fit into memory."""

from __future__ import annotations

import math
import tempfile
import weakref
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

Array = NDArray[Any]
BLOCK_BYTES = 1 << 20
"""Bytes that `Rows.by_column` has in memory, about."""


class Columns:
    """Rows of samples that come one after the other, in a temporary file that is deleted with the last use of `values`.

    rows: how many there will be; shape: of a row. Raises OSError where the file cannot be written.
    """

    def __init__(self, rows: int, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self.rows, self.shape, self.dtype = rows, shape, np.dtype(dtype)
        self._file = tempfile.TemporaryFile()  # noqa: SIM115
        weakref.finalize(self, self._file.close)
        self._filled = 0

    @property
    def channels(self) -> int:
        """Numbers of a row."""
        return math.prod(self.shape)

    def add(self, rows: Array) -> None:
        """The next rows (rows, *shape)."""
        for channel, samples in enumerate(rows.reshape(len(rows), self.channels).T):
            self._write(channel, self._filled, samples)
        self._filled += len(rows)

    def put(self, channel: int, samples: Array) -> None:
        """All samples of a channel."""
        self._write(channel, 0, samples)

    def _write(self, channel: int, start: int, samples: Array) -> None:
        self._file.seek((channel * self.rows + start) * self.dtype.itemsize)
        self._file.write(np.ascontiguousarray(samples, self.dtype).data)

    @property
    def values(self) -> Array:
        """(rows, *shape): all samples, read from the file where they are used; those never written are 0."""
        if not self.rows or not self.channels:
            return np.empty((self.rows, *self.shape), self.dtype)
        self._file.truncate(self.rows * self.channels * self.dtype.itemsize)
        self._file.flush()
        table = np.memmap(self._file, self.dtype, "r", shape=(self.channels, self.rows))
        return np.asarray(table.T).reshape(self.rows, *self.shape)


class Rows:
    """Rows of samples that come one after the other, in a temporary file, of recordings whose length is not known yet.

    shape: of a row. Raises OSError where the file cannot be written.
    """

    def __init__(self, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self.shape, self.dtype, self.rows = shape, np.dtype(dtype), 0
        self._file = tempfile.TemporaryFile()  # noqa: SIM115
        weakref.finalize(self, self._file.close)

    def add(self, rows: Array) -> None:
        """The next rows (rows, *shape)."""
        self._file.write(np.ascontiguousarray(rows, self.dtype).data)
        self.rows += len(rows)

    def by_column(self) -> Columns:
        """The same rows, channel after channel."""
        columns, size = Columns(self.rows, self.shape, self.dtype), math.prod(self.shape) * self.dtype.itemsize
        self._file.seek(0)
        while data := self._file.read(max(1, BLOCK_BYTES // size) * size):
            columns.add(np.frombuffer(data, self.dtype).reshape(-1, *self.shape))
        return columns
