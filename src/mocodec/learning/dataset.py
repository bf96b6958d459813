# pyright: strict
"""Windows of an archive as a data set: by number, in batches, in an order that is random and quick.

recordings ─catalogue─► number of windows of each ─► window number ─► block (decoded once, kept) ─► float32 arrays
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..archive import Recordings, open_archive
from ..errors import BadInput
from ..motion import Motion
from . import blocks
from .blocks import Block, BlockCache, Cut
from .features import Float32, known

CACHE_BYTES = 256 << 20

Window = dict[str, Float32]
"""One array for each feature, by its name."""
Numbers = NDArray[np.int64]


class WindowSet:
    """Windows of equal length over the recordings of an archive; `mocodec.torch.Windows` gives them as tensors.

    recordings: an archive (or its path), or those of a query. frames, stride: of the windows, at `rate` hertz (None:
    the rate of each recording); another rate than a whole part of the recording's is interpolated by splines. features:
    names in `mocodec.learning.FEATURES`. points: names of points or joints, in this order; by default all, and then all
    recordings must have the same. up: turn all motion so that this axis is vertical. cache_bytes: how much decoded
    motion each process keeps.

    `len(w)`, `w[i]` (a dict of float32 arrays (frames, …), contiguous, gaps NaN), `w.batch(numbers)` (stacked). It can
    be pickled; each process opens the archive when it first reads. Recordings that are added later are not in it.
    Raises BadInput for recordings without a common set of points, and for unknown features.
    """

    def __init__(
        self,
        recordings: Recordings | str | PathLike[str],
        frames: int = 64,
        stride: int = 16,
        rate: float | None = None,
        features: Sequence[str] = ("positions",),
        points: Sequence[str] | None = None,
        up: str | None = None,
        cache_bytes: int = CACHE_BYTES,
    ) -> None:
        self.recordings = recordings if isinstance(recordings, Recordings) else open_archive(recordings)
        self.cut = Cut(frames, stride, rate)
        self.features = known(features)
        self.points = None if points is None else tuple(points)
        self.up = up
        self.cache_bytes = cache_bytes
        self._index()
        self._cache = BlockCache(cache_bytes, self._load)

    def _index(self) -> None:
        """Count windows and blocks of each recording, from the catalogue alone."""
        names, counts, layouts, sizes = list[str](), list[int](), set[str](), list[int]()
        for row in self.recordings.rows():
            windows = self.cut.windows(row.frames, row.rate) if row.kind == "motion" else 0
            if windows:
                names.append(row.name)
                counts.append(windows)
                sizes.append(self.cut.windows_per_block(row.rate))
                layouts.add(row.layout)
        if not names:
            raise BadInput(f"no recording is long enough for windows of {self.cut.frames} frames")
        if len(layouts) > 1 and self.points is None:
            raise BadInput(
                f"the recordings have {len(layouts)} different sets of points: choose points=(…) that all have, or "
                f'recordings with a query, such as layout == "{min(layouts)}"'
            )
        self.names = names
        self.per_block = np.array(sizes)
        self.first_window: Numbers = np.concatenate([[0], np.cumsum(counts)])
        self.first_block: Numbers = np.concatenate([[0], np.cumsum(-(-np.array(counts) // self.per_block))])

    def __len__(self) -> int:
        """The number of windows."""
        return int(self.first_window[-1])

    def place(self, number: int) -> tuple[str, float]:
        """Name of the recording of a window, and the second at which the window begins."""
        recording, inside, _, _ = self._where(self._checked(number))
        rate = self.cut.rate or self.recordings.entry(self.names[recording]).row.rate
        return self.names[recording], inside * self.cut.stride / rate

    def _checked(self, number: int) -> int:
        count = len(self)
        if not -count <= number < count:
            raise IndexError(f"there is no window {number}: there are {count:,}")
        return number % count

    def _where(self, number: int) -> tuple[int, int, int, int]:
        """Recording, number of the window in it, block, and number of the window in that."""
        recording = int(np.searchsorted(self.first_window, number, side="right")) - 1
        inside = number - int(self.first_window[recording])
        block, offset = divmod(inside, int(self.per_block[recording]))
        return recording, inside, int(self.first_block[recording]) + block, offset

    def __getitem__(self, number: int) -> Window:
        """A window: for each feature a float32 array (frames, …) of its own. Raises IndexError."""
        _, _, block, offset = self._where(self._checked(int(number)))
        start = offset * self.cut.stride
        return {name: array[start : start + self.cut.frames].copy() for name, array in self._cache.get(block).items()}

    def batch(self, numbers: Sequence[int] | Numbers) -> Window:
        """Windows stacked: for each feature a float32 array (windows, frames, …). Raises IndexError."""
        places = [self._where(self._checked(int(number))) for number in numbers]
        result: Window = {}
        for row in sorted(range(len(places)), key=lambda i: places[i][2]):
            _, _, block, offset = places[row]
            start = offset * self.cut.stride
            for name, array in self._cache.get(block).items():
                if name not in result:
                    result[name] = np.empty((len(places), self.cut.frames, *array.shape[1:]), np.float32)
                result[name][row] = array[start : start + self.cut.frames]
        return result

    def _load(self, block: int) -> Block:
        """Decode a block and compute its features. Errors name the recording."""
        recording = int(np.searchsorted(self.first_block, block, side="right")) - 1
        per_block = int(self.per_block[recording])
        first = (block - int(self.first_block[recording])) * per_block
        count = min(per_block, int(self.first_window[recording + 1] - self.first_window[recording]) - first)
        name = self.names[recording]
        with self.recordings.entry(name).open() as file:
            motion = blocks.read(file, self.cut, first, count, self._prepared)
        try:
            return blocks.features(motion, self.features, (count - 1) * self.cut.stride + self.cut.frames)
        except BadInput as error:
            raise BadInput(f"{name}: {error}") from None

    def _prepared(self, motion: Motion) -> Motion:
        if self.up is not None and motion.up != self.up:
            motion = motion.turned(self.up)
        return motion if self.points is None else motion.select(self.points)

    def order(self, seed: int | None = None, epoch: int = 0) -> Numbers:
        """All window numbers in an order that reads each block once: by seed and epoch, None in the archive's order.

        Blocks are shuffled, and then the windows of as many blocks as half the cache holds.
        """
        if seed is None:
            return np.arange(len(self))
        return np.concatenate(self._groups(seed, epoch))

    def _groups(self, seed: int, epoch: int) -> list[Numbers]:
        random = np.random.default_rng([seed, epoch])
        starts, stops = self._windows_of_blocks()
        chosen = random.permutation(len(starts))
        frames = (stops - starts - 1)[chosen] * self.cut.stride + self.cut.frames
        group = np.cumsum(frames * self._bytes_per_frame()) // max(1, self.cache_bytes // 2)
        borders = np.flatnonzero(np.diff(group)) + 1
        together = np.split(chosen, borders)
        windows = [np.concatenate([np.arange(int(starts[b]), int(stops[b])) for b in blocks_]) for blocks_ in together]
        return [random.permutation(numbers) for numbers in windows]

    def _windows_of_blocks(self) -> tuple[Numbers, Numbers]:
        """The first window of each block, and the window after its last."""
        starts = np.concatenate(
            [
                np.arange(int(a), int(b), int(per_block))
                for a, b, per_block in zip(self.first_window[:-1], self.first_window[1:], self.per_block, strict=True)
            ]
        )
        return starts, np.append(starts[1:], len(self))

    def runs_of_blocks(self, most: int) -> list[tuple[int, int]]:
        """All windows as at most `most` ranges (first number, number after the last) of whole blocks, of about the
        same number of blocks: processes that each read some of the ranges decode no block twice."""
        starts, _ = self._windows_of_blocks()
        borders = [int(run[0]) for run in np.array_split(starts, min(most, len(starts)))]
        return list(zip(borders, [*borders[1:], len(self)], strict=True))

    def _bytes_per_frame(self) -> int:
        one = self[0]
        return sum(array[0].nbytes for array in one.values())

    def batch_numbers(
        self, size: int, seed: int | None = None, epoch: int = 0, workers: int = 1, drop_last: bool = False
    ) -> list[Numbers]:
        """Window numbers in batches, in the order of `order`. workers: of a loader that gives batch after batch to one
        worker after the other: each worker then reads blocks of its own."""
        if size < 1:
            raise BadInput(f"a batch has at least 1 window, not {size}")
        if seed is None or workers <= 1:
            return _batches(self.order(seed, epoch), size, drop_last)
        starts, stops = self._windows_of_blocks()
        random = np.random.default_rng([seed, epoch])
        chosen = random.permutation(len(starts))
        streams = [chosen[worker::workers] for worker in range(workers)]
        order = [
            _batches(
                np.concatenate([random.permutation(np.arange(int(starts[b]), int(stops[b]))) for b in stream]),
                size,
                True,
            )
            for stream in streams
            if len(stream)
        ]
        rounds = min(map(len, order))
        interleaved = [stream[i] for i in range(rounds) for stream in order]
        used = np.concatenate(interleaved) if interleaved else np.zeros(0, np.int64)
        rest = random.permutation(np.setdiff1d(np.arange(len(self)), used))
        return interleaved + _batches(rest, size, drop_last)

    def batches(self, size: int, seed: int | None = None, epoch: int = 0, drop_last: bool = False) -> Iterator[Window]:
        """Batches of `size` windows, stacked, over all windows once."""
        for numbers in self.batch_numbers(size, seed, epoch, drop_last=drop_last):
            yield self.batch(numbers)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_cache"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._cache = BlockCache(self.cache_bytes, self._load)


def _batches(numbers: Numbers, size: int, drop_last: bool) -> list[Numbers]:
    whole = len(numbers) // size * size
    parts = list(numbers[:whole].reshape(-1, size))
    return parts if drop_last or whole == len(numbers) else [*parts, numbers[whole:]]
