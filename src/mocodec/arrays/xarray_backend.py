"""`xarray.open_dataset("walk.mocz", engine="mocodec")`: found by the entry point `xarray.backends`.

The dataset is that of `datasets.plain`, with the attributes codec and promise added. Frames are decoded only when
their values are used.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from typing import Any

from .. import api
from ..errors import MissingExtra
from ..motion import Motion
from .datasets import plain
from .stored import StoredArray

try:
    import xarray
    from xarray.backends import BackendArray, BackendEntrypoint
    from xarray.core import indexing
except ImportError:
    raise MissingExtra("mocodec.arrays.xarray_backend", "xarray") from None


class LazyArray(BackendArray):
    """A StoredArray with the indexing of xarray."""

    def __init__(self, array: StoredArray) -> None:
        self.array, self.shape, self.dtype = array, array.shape, array.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.BASIC, self.array.__getitem__
        )


class MocodecBackend(BackendEntrypoint):
    """Opens a .mocz of a motion: a path, a URL or a binary file object."""

    description = "Open .mocz recordings of motion (mocodec); frames are decoded when they are used"
    open_dataset_parameters = ("filename_or_obj", "drop_variables")

    def open_dataset(
        self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None
    ) -> xarray.Dataset:
        """The recording as a dataset. Closing it closes the file. Raises what `mocodec.open` raises."""
        file = api.open(filename_or_obj, Motion)
        about = file.encoded.about
        rotations = None if about.rotations is None else _lazy(StoredArray(file, "rotations"))
        attributes = {"codec": file.encoded.codec, "promise": json.dumps(file.encoded.promise)}
        dataset = plain(about, _lazy(StoredArray(file)), rotations, attributes)
        dataset = dataset.drop_vars(drop_variables or [], errors="ignore")
        dataset.set_close(file.close)
        return dataset

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Whether the name ends with .mocz."""
        return isinstance(filename_or_obj, str | os.PathLike) and api.is_mocz(filename_or_obj)


def _lazy(array: StoredArray) -> Any:
    return indexing.LazilyIndexedArray(LazyArray(array))
