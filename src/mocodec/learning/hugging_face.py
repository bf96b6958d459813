# pyright: strict
"""Windows of an archive as a data set of Hugging Face `datasets`, which decodes while it is read. Needs [datasets].

to_datasets("vault", frames=64, rate=30).shuffle(seed=0, buffer_size=1000).with_format("torch")
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from os import PathLike
from typing import Any

from ..archive import Recordings
from ..arrays.libraries import library
from ..errors import BadInput
from .dataset import WindowSet

SHARDS = 64
"""Parts that the workers of a loader share, at most."""


def to_datasets(recordings: Recordings | str | PathLike[str] | WindowSet, **options: Any) -> Any:
    """A `datasets.IterableDataset` of windows: the columns are the features, `recording` and `second`.

    recordings: an archive (or its path), those of a query, or a WindowSet. options: those of `WindowSet`. `recording`
    is the name, `second` where the window begins. Features are float32 arrays (frames, …) of fixed shape; gaps are NaN.
    The data set has up to 64 shards, each a run of blocks, so that the workers of a loader decode apart, and `shuffle`
    shuffles the shards. Raises BadInput as `WindowSet`, MissingExtra without datasets.
    """
    datasets = library("datasets", "mocodec.learning.to_datasets", "datasets")
    if isinstance(recordings, WindowSet):
        if options:
            raise BadInput(f"a WindowSet has its options already, but got {', '.join(options)}")
        windows = recordings
    else:
        windows = WindowSet(recordings, **options)
    columns: dict[str, Any] = {"recording": datasets.Value("string"), "second": datasets.Value("float64")}
    for name, array in WindowSet.__getitem__(windows, 0).items():
        columns[name] = getattr(datasets, f"Array{array.ndim}D")(shape=array.shape, dtype="float32")
    return datasets.IterableDataset.from_generator(
        _examples, datasets.Features(columns), {"windows": windows, "ranges": windows.runs_of_blocks(SHARDS)}
    )


def _examples(windows: WindowSet, ranges: Sequence[tuple[int, int]]) -> Iterator[dict[str, Any]]:
    """The windows of some shards, in order, so that each block is decoded once."""
    for start, stop in ranges:
        for number in range(start, stop):
            recording, second = windows.place(number)
            yield {"recording": recording, "second": second, **WindowSet.__getitem__(windows, number)}
