# pyright: strict
"""The samples of an open file as an array that is read by slices, for xarray and Dask."""

from __future__ import annotations

import weakref
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..motion import Motion
from ..opened import File


class StoredArray:
    """Positions (frames, points, 3) in metres or rotations (frames, joints, 4) of an open file.

    `a[i]`, `a[1200:1320]`, `a[::4, 3]`: integers and slices, the first of which says which frames are decoded.
    It can be pickled if the file can. field: "positions" or "rotations".
    """

    def __init__(self, file: File[Motion], field: str = "positions", dtype: np.dtype[Any] | None = None) -> None:
        self.file, self.field = file, field
        self.dtype = np.dtype(np.float64) if dtype is None else dtype
        self.shape = (*file.shape[:2], 3 if field == "positions" else 4)
        self.ndim = 3

    def __getitem__(self, key: Any) -> NDArray[Any]:
        """Raises what `File.decode` raises, IndexError."""
        keys = cast("tuple[Any, ...]", key if isinstance(key, tuple) else (key,))
        first, *others = keys
        numbers = cast("range | int", range(self.shape[0])[first])
        if isinstance(numbers, int):
            return self._decoded(numbers, numbers + 1)[(0, *others)]
        if not numbers:
            return np.empty((0, *self.shape[1:]), self.dtype)[(slice(None), *others)]
        start, last = min(numbers[0], numbers[-1]), max(numbers[0], numbers[-1])
        decoded = self._decoded(start, last + 1)
        return decoded[:: numbers.step][(slice(None), *others)]

    def __setstate__(self, state: dict[str, Any]) -> None:
        """After unpickling, the file is the array's own and is closed with it."""
        self.__dict__.update(state)
        weakref.finalize(self, self.file.close)

    def _decoded(self, start: int, stop: int) -> NDArray[Any]:
        """Frames [start, stop)."""
        if self.field == "positions" and stop - start == self.shape[0]:
            return self.file.positions(dtype=self.dtype)
        motion = self.file.decode(slice(start, stop), keep_chunks=True)
        return np.asarray(getattr(motion, self.field), self.dtype)

    def __dask_tokenize__(self) -> tuple[Any, ...]:
        """What names the tasks of this array: the bytes of the file, which its index and size stand for."""
        file = self.file
        return type(self).__qualname__, repr(file), tuple(file.chunk_bytes), self.field, self.dtype.str
