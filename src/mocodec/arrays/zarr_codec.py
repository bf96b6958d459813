"""The zarr codec "mocodec" (zarr v3, array → bytes): found by the entry point `zarr.codecs`.

    zarr.create_array(store, shape=(86400, 41, 3), chunks=(1440, 41, 3), dtype="float32", fill_value=float("nan"),
                      serializer=MocodecCodec(atol=0.001, rate=120), compressors=None)

    block of an array (frames, points, 3) ─► Motion ─► one .mocz ─► Motion ─► block

NaN is a gap. Each block is a whole .mocz, so with sharding the inner chunks are what can be decoded alone.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .. import api
from ..codecs.tempo import Tempo
from ..errors import BadInput, Corrupt, MissingExtra
from ..motion import Motion

try:
    from zarr.abc.codec import ArrayBytesCodec
except ImportError:
    raise MissingExtra("mocodec.arrays.zarr_codec", "zarr") from None

NAME = "mocodec"
"""In the metadata of arrays: never change it."""
DTYPES = ("float32", "float64")
ROUNDING = 2.0
"""The rounding of decoded positions to the type of the array, in steps of the largest value: √3 · ½ for three axes, and
as much again for arithmetic."""


@dataclass(frozen=True)
class MocodecCodec(ArrayBytesCodec):
    """Codes blocks of motion within a tolerance.

    atol: no point of any frame is farther off than this, in the unit of the data, whatever it is; 0 is lossless.
    rate: frames per second, on which sizes depend, but not the bound.
    Raises BadInput for values out of range, and at creation for arrays of other shapes or types.
    """

    atol: float
    rate: float

    is_fixed_size = False

    def __post_init__(self) -> None:
        for name, least in (("atol", 0.0), ("rate", math.ulp(0.0))):
            value = getattr(self, name)
            is_number = isinstance(value, float | int) and not isinstance(value, bool)
            if not (is_number and math.isfinite(value) and value >= least):
                raise BadInput(f"{NAME}: {name} must be a {'positive ' if least else ''}number, not {value!r}")

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Self:
        """From the metadata of an array. Raises BadInput for settings that are missing or unknown."""
        settings = data.get("configuration", {})
        try:
            return cls(**settings)
        except TypeError:
            raise BadInput(
                f"{NAME} takes the configuration atol and rate, not {', '.join(settings) or 'an empty one'}"
            ) from None

    def to_dict(self) -> dict[str, Any]:
        """For the metadata of an array."""
        return {"name": NAME, "configuration": {"atol": self.atol, "rate": self.rate}}

    def validate(self, *, shape: tuple[int, ...], dtype: Any, chunk_grid: Any) -> None:
        """Raises BadInput for arrays that are not (frames, points, 3) of float32 or float64, or are cut along axes."""
        block = getattr(chunk_grid, "chunk_shape", shape)
        _require(tuple(shape), tuple(block), dtype.to_native_dtype())

    def evolve_from_array_spec(self, array_spec: Any) -> Self:
        """The codec itself; called for inner chunks of shards too, which `validate` is not. Raises BadInput."""
        _require(array_spec.shape, array_spec.shape, array_spec.dtype.to_native_dtype())
        return self

    def compute_encoded_size(self, input_byte_length: int, chunk_spec: Any) -> int:
        """Sizes depend on the motion. Raises NotImplementedError."""
        raise NotImplementedError

    def _encode_sync(self, chunk_array: Any, chunk_spec: Any) -> Any:
        blob = encode_block(np.asarray(chunk_array.as_numpy_array()), self)
        return chunk_spec.prototype.buffer.from_bytes(blob)

    def _decode_sync(self, chunk_bytes: Any, chunk_spec: Any) -> Any:
        block = decode_block(chunk_bytes.to_bytes(), chunk_spec.shape, chunk_spec.dtype.to_native_dtype())
        return chunk_spec.prototype.nd_buffer.from_numpy_array(block)

    async def _encode_single(self, chunk_data: Any, chunk_spec: Any) -> Any:
        return await asyncio.to_thread(self._encode_sync, chunk_data, chunk_spec)

    async def _decode_single(self, chunk_data: Any, chunk_spec: Any) -> Any:
        return await asyncio.to_thread(self._decode_sync, chunk_data, chunk_spec)


def encode_block(block: NDArray[Any], codec: MocodecCodec) -> bytes:
    """The .mocz of a block (frames, points, 3). Raises BadInput for infinite or partly missing points."""
    motion = Motion(block, codec.rate)
    largest = float(np.nanmax(np.abs(block), initial=0.0, where=~np.isnan(block)))
    bound = codec.atol - ROUNDING * float(np.spacing(np.asarray(largest, block.dtype)))
    if bound > 0:
        return api.encode(motion, Tempo(max_error=bound))  # in the unit of the array, which need not be metres
    return api.encode(motion, "lossless", float64=block.dtype == np.float64)


def decode_block(blob: bytes, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """The block of a .mocz. Raises Corrupt if it has another shape, and what `decode` raises."""
    motion = api.decode(blob, Motion, threads=1)
    if motion.positions.shape != tuple(shape):
        raise Corrupt(f"a block of the array holds {motion.positions.shape}, not {tuple(shape)}")
    return motion.positions.astype(dtype)


def _require(shape: tuple[int, ...], block: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Raises BadInput for arrays that are no motion."""
    if dtype.name not in DTYPES or len(shape) != 3 or shape[2] != 3:
        raise BadInput(f"{NAME} codes arrays (frames, points, 3) of float32 or float64, not {shape} of {dtype.name}")
    if block[2:] != (3,):
        raise BadInput(f"{NAME} needs all three axes in one chunk, not chunks of the shape {block}")
