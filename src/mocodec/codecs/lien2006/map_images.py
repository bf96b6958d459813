"""Residual maps of many frames as images: depth as PNG, colour as JPEG (section 5.2, table 2).

An image holds the maps of many frames: depth with all frames of a cell side by side, colour with the same row of all
frames one below the other. So frames share one header and one set of code tables, and values that stay the same from
frame to frame are neighbours in the image, which suits PNG's run lengths and JPEG's transform.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np

from ...errors import Corrupt, MissingExtra
from ...typing import Bytes
from .residual_maps import ZERO, ResidualMap

MAX_IMAGE_ROWS, MAX_IMAGE_PIXELS = 60_000, 40_000_000  # JPEG has at most 65,535 rows; Pillow warns of large images


def pack_images(residuals: Sequence[ResidualMap], coloured: bool, jpeg_quality: int) -> list[bytes]:
    """Images of depth for all groups of frames, then images of colour. Raises MissingExtra."""
    image = _pillow_image()
    images = list[bytes]()
    groups = _frame_groups(len(residuals), residuals[0].depth.shape) if residuals else []
    for group in groups:
        cells = np.stack([residual.depth for residual in residuals[group]], axis=2)
        picture = image.fromarray(cells.reshape(len(cells), -1))
        # a palette keeps PNG from predicting pixels, which costs bytes here
        picture.putpalette(np.repeat(np.arange(cells.max() + 1, dtype=np.uint8), 3).tobytes())
        images.append(_saved(picture, "PNG", compress_level=9, compress_type=zlib.Z_RLE))
    for group in groups if coloured else ():
        rows = np.stack([residual.colour for residual in residuals[group]], axis=1)
        picture = image.fromarray(rows.reshape(-1, *rows.shape[2:]))
        images.append(_saved(picture, "JPEG", quality=jpeg_quality, subsampling=2, optimize=True))
    return images


def unpack_images(
    images: Sequence[bytes], frames: int, size: tuple[int, int], coloured: bool, depth_by_cell: bool
) -> list[ResidualMap]:
    """The residual maps of `frames` frames. size: (height, width) of the map sheet. Raises Corrupt, MissingExtra."""
    groups = _frame_groups(frames, size)
    if len(images) != len(groups) * (1 + coloured):
        raise Corrupt(f"lien2006: {len(images)} images of residual maps instead of {len(groups) * (1 + coloured)}")
    depth, colour = list[Bytes](), list[Bytes]()
    height, width = size
    for data, group in zip(images, groups, strict=False):
        count = group.stop - group.start
        if depth_by_cell:
            depth += list(np.moveaxis(_open_image(data, height, "P", (height, width, count)), 2, 0))
        else:
            depth += list(np.moveaxis(_open_image(data, height * count, "L", (height, count, width)), 1, 0))
    for data, group in zip(images[len(groups) :], groups, strict=False):
        count = group.stop - group.start
        colour += list(_open_image(data, height * count, "RGB", (height, count, width, 3)).swapaxes(0, 1))
    no_difference = np.broadcast_to(np.uint8(ZERO), (*size, 3))
    return [ResidualMap(d, c) for d, c in zip(depth, colour or [no_difference] * frames, strict=True)]


def _frame_groups(frames: int, size: tuple[int, int]) -> list[slice]:
    """The frames whose maps share an image: as many as JPEG and its readers allow."""
    height, width = size
    most = max(1, min(MAX_IMAGE_ROWS // height, MAX_IMAGE_PIXELS // (height * width)))
    return [slice(start, min(start + most, frames)) for start in range(0, frames, most)]


def _saved(picture: Any, kind: str, **options: Any) -> bytes:
    out = io.BytesIO()
    picture.save(out, kind, **options)
    return out.getvalue()


def _open_image(data: bytes, rows: int, mode: str, shape: tuple[int, ...]) -> Bytes:
    """The pixels of an image of this many rows and this mode, in this shape. Raises Corrupt."""
    image = _pillow_image()
    try:
        picture = image.open(io.BytesIO(data), formats=("PNG", "JPEG"))
        pixels = picture.width * rows * len(picture.getbands())
        if picture.height != rows or picture.mode != mode or pixels != np.prod(shape):
            raise Corrupt(
                f"lien2006: an image of residual maps is {picture.width} × {picture.height}, mode {picture.mode}: "
                "not what the model needs"
            )
        return np.asarray(picture).reshape(shape)
    except Corrupt:
        raise
    except Exception as error:
        raise Corrupt(f"lien2006: an image of residual maps is damaged ({error})") from None


def _pillow_image() -> Any:
    """Pillow's Image module. Raises MissingExtra."""
    try:
        return import_module("PIL.Image")
    except ImportError:
        raise MissingExtra("coding residual maps as images", "cloud") from None
