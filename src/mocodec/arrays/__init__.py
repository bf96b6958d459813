# pyright: strict
"""Motions as the arrays of other libraries, and back. Each needs the extra of its name, imported when it is used.

to_xarray, from_xarray    datasets, also in the conventions of pyomeca and movement       [xarray]
to_pandas, from_pandas    a frame with a row per frame and columns (point, axis)          [pandas]
to_dask                   positions of an open file, a block per chunk, decoded late      [dask]

Found by entry points once mocodec is installed: `xarray.open_dataset("walk.mocz", engine="mocodec")`
(`xarray_backend`) and the zarr codec "mocodec" (`zarr_codec`).
"""

from __future__ import annotations

from .blocks import to_dask
from .datasets import STYLES, from_xarray, to_xarray
from .tables import from_pandas, to_pandas

__all__ = ["STYLES", "from_pandas", "from_xarray", "to_dask", "to_pandas", "to_xarray"]
