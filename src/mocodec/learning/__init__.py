# pyright: strict
"""Windows of motion for machine learning, straight from an archive, as NumPy arrays; `mocodec.torch` gives tensors.

windows, WindowSet     windows of an archive, in batches or by number
to_datasets            the same as a data set of Hugging Face `datasets`                   [datasets]
mocz, write_tar        samples in the tar shards of WebDataset: decode them, write them

for batch in mocodec.learning.windows("vault", frames=64, stride=16, rate=30, batch=256, seed=0):
    batch["positions"]                      (256, 64, joints, 3) float32
"""

from __future__ import annotations

from collections.abc import Iterator
from os import PathLike
from typing import Any

from ..archive import Recordings
from .dataset import Window, WindowSet
from .features import FEATURES
from .hugging_face import to_datasets
from .tar_samples import mocz, write_tar

__all__ = ["FEATURES", "Window", "WindowSet", "mocz", "to_datasets", "windows", "write_tar"]


def windows(
    recordings: Recordings | str | PathLike[str],
    *,
    batch: int | None = None,
    seed: int | None = None,
    epoch: int = 0,
    **options: Any,
) -> Iterator[Window]:
    """All windows of an archive once, as dicts of float32 arrays.

    batch: stack this many windows (the last batch may have fewer); None: one by one. seed: of the order, with `epoch`;
    None: in the order of names. options: those of `WindowSet` (frames, stride, rate, features, points, …).
    Raises BadInput.
    """
    found = WindowSet(recordings, **options)
    if batch is not None:
        yield from found.batches(batch, seed, epoch)
    else:
        for number in found.order(seed, epoch):
            yield found[int(number)]
