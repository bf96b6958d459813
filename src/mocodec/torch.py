"""Windows of an archive as a map-style dataset of PyTorch.

windows = mocodec.torch.Windows("vault", frames=64, stride=16, rate=30, features=("positions", "velocities"))
loader = DataLoader(windows, batch_sampler=windows.sampler(256, seed=0, workers=2), num_workers=2)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from .errors import MissingExtra
from .learning import WindowSet

try:
    import torch  # pyright: ignore[reportMissingImports]
    from torch.utils.data import Dataset, Sampler  # pyright: ignore[reportMissingImports]
except ImportError:
    raise MissingExtra("mocodec.torch", "torch") from None

__all__ = ["BatchSampler", "Windows"]


class Windows(WindowSet, Dataset[dict[str, "torch.Tensor"]]):
    """As `mocodec.learning.WindowSet`, with tensors: `windows[i]` is a dict of float32 tensors (frames, …).

    It can be pickled; a worker of a DataLoader opens the archive when it first reads.
    """

    def __getitem__(self, number: int) -> dict[str, Any]:
        """A window as tensors, which share no memory with others. Raises IndexError."""
        return {name: torch.from_numpy(array) for name, array in super().__getitem__(number).items()}

    def __getitems__(self, numbers: Sequence[int]) -> list[dict[str, Any]]:
        """Windows for a loader, which decodes each block once for all windows of the batch."""
        stacked = {name: torch.from_numpy(array) for name, array in self.batch(numbers).items()}
        return [{name: tensor[i] for name, tensor in stacked.items()} for i in range(len(numbers))]

    def sampler(self, size: int, seed: int = 0, workers: int = 1, drop_last: bool = False) -> BatchSampler:
        """Batches in an order that is shuffled in each epoch and reads each block once; for `batch_sampler=`."""
        return BatchSampler(self, size, seed, workers, drop_last)


class BatchSampler(Sampler[list[int]]):
    """Batches of window numbers. `set_epoch(n)` chooses the order; without it each pass is the next epoch."""

    def __init__(self, windows: WindowSet, size: int, seed: int, workers: int, drop_last: bool) -> None:
        self.windows, self.size, self.seed, self.workers, self.drop_last = windows, size, seed, workers, drop_last
        self.epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """The next pass is this epoch."""
        self.epoch = epoch

    def _batches(self) -> list[Any]:
        return self.windows.batch_numbers(self.size, self.seed, self.epoch, self.workers, self.drop_last)

    def __iter__(self) -> Iterator[list[int]]:
        batches = self._batches()
        self.epoch += 1
        for numbers in batches:
            yield numbers.tolist()

    def __len__(self) -> int:
        """The number of batches."""
        return len(self._batches())
