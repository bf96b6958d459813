"""Rival coders of motion, each in its best layout: positions (frames, points, 3) float32 ⇄ bytes at one knob.

    knob      error bound or quantisation step in metres: a larger one gives fewer bytes and more error
    layout    time fastest, one row per coordinate; SZ3 and pcodec get it as one 1-D array, image codecs as a picture

They include the rivals of the papers (`mocodec.codecs.baselines`). Most others need packages of the [bench] extra.
`knob_of` estimates the knob for a mean error, where the search in `runner` starts.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from mocodec import __version__
from mocodec.codecs import baselines

from ..packages import installed_version, needs

Array = NDArray[Any]
"""Positions in any float type, or integers."""


class Rival(Protocol):
    """A coder of motion."""

    @property
    def name(self) -> str: ...

    def encode(self, positions: Array, knob: float) -> bytes: ...

    def decode(self, data: bytes, shape: tuple[int, int, int]) -> Array: ...

    def knob_of(self, mean_error: float) -> float: ...

    def version(self) -> str: ...


def by_row(positions: Array) -> Array:
    """(frames, points, 3) → (points × 3, frames) float32, time fastest."""
    return np.ascontiguousarray(positions.reshape(len(positions), -1).T, np.float32)


def by_frame(rows: Array, shape: tuple[int, int, int]) -> Array:
    """(points × 3, frames) → (frames, points, 3): the inverse of `by_row`."""
    return np.asarray(rows, np.float64).reshape(shape[1] * 3, shape[0]).T.reshape(shape)


def by_axis(positions: Array) -> Array:
    """(frames, points, 3) → (3, points, frames) float32, time fastest."""
    return np.ascontiguousarray(positions.transpose(2, 1, 0), np.float32)


def from_axes(values: Array, shape: tuple[int, int, int]) -> Array:
    """The inverse of `by_axis`."""
    return np.asarray(values, np.float64).reshape(3, shape[1], shape[0]).transpose(2, 1, 0)


@dataclass(frozen=True)
class Sz3:
    """SZ3's interpolation predictor with an absolute bound per coordinate, on one 1-D array.

    Time is fastest, then points, then axes. With axes before points, short recordings are up to a sixth larger.
    """

    name: str = "sz3"

    def encode(self, positions: Array, knob: float) -> bytes:
        pysz = needs("pysz")
        config = pysz.szConfig()
        config.errorBoundMode = pysz.szErrorBoundMode.ABS
        config.absErrorBound = knob
        config.cmprAlgo = pysz.szAlgorithm.INTERP
        return pysz.sz.compress(by_axis(positions).reshape(-1), config)[0].tobytes()

    def decode(self, data: bytes, shape: tuple[int, int, int]) -> Array:
        pysz = needs("pysz")
        flat = pysz.sz.decompress(np.frombuffer(data, np.uint8), np.float32, (int(np.prod(shape)),))
        return from_axes(flat[0] if isinstance(flat, tuple) else flat, shape)

    def knob_of(self, mean_error: float) -> float:
        return mean_error * 1.9

    def version(self) -> str:
        return installed_version("pysz")


@dataclass(frozen=True)
class Zfp:
    """zfp with fixed accuracy, on the rows × frames matrix."""

    name: str = "zfp"

    def encode(self, positions: Array, knob: float) -> bytes:
        return needs("zfpy").compress_numpy(by_row(positions), tolerance=knob)

    def decode(self, data: bytes, shape: tuple[int, int, int]) -> Array:
        return by_frame(needs("zfpy").decompress_numpy(data), shape)

    def knob_of(self, mean_error: float) -> float:
        return mean_error * 8

    def version(self) -> str:
        return installed_version("zfpy")


@dataclass(frozen=True)
class Sperr:
    """SPERR with a point-wise error bound, on the rows × frames matrix, through its HDF5 filter."""

    name: str = "sperr"

    def encode(self, positions: Array, knob: float) -> bytes:
        h5py, plugin = needs("h5py"), needs("hdf5plugin")
        rows = by_row(positions)
        buffer = io.BytesIO()
        with h5py.File(buffer, "w") as f:
            f.create_dataset("p", data=rows, chunks=rows.shape, **plugin.Sperr(absolute=knob))
            dataset = f["p"]
            return dataset.id.read_direct_chunk((0, 0))[1]

    def decode(self, data: bytes, shape: tuple[int, int, int]) -> Array:
        h5py, plugin = needs("h5py"), needs("hdf5plugin")
        rows = (shape[1] * 3, shape[0])
        buffer = io.BytesIO()
        with h5py.File(buffer, "w") as f:
            dataset = f.create_dataset("p", rows, "f4", chunks=rows, **plugin.Sperr(absolute=1.0))
            dataset.id.write_direct_chunk((0, 0), data)
            return by_frame(dataset[:], shape)

    def knob_of(self, mean_error: float) -> float:
        return mean_error * 2

    def version(self) -> str:
        return installed_version("hdf5plugin")


def to_grid(positions: Array, step: float) -> NDArray[np.int32]:
    """Positions in steps, (points × 3, frames) integers."""
    return np.round(by_row(positions).astype(np.float64) / step).astype(np.int32)


def from_grid(integers: Array, step: float, shape: tuple[int, int, int]) -> Array:
    """The inverse of `to_grid`."""
    return by_frame(np.asarray(integers, np.float64) * step, shape)


def with_step(step: float, data: bytes) -> bytes:
    """Prepends the step as float64 to the data."""
    return np.float64(step).tobytes() + data


def step_of(data: bytes) -> tuple[float, bytes]:
    """Step and data: the inverse of `with_step`."""
    return float(np.frombuffer(data[:8], np.float64)[0]), data[8:]


@dataclass(frozen=True)
class QuantisePcodec:
    """Positions rounded to a step, then pcodec, which chooses the order of differences."""

    name: str = "quantise + pcodec"

    def encode(self, positions: Array, knob: float) -> bytes:
        pcodec = needs("pcodec")
        flat = to_grid(positions, knob).reshape(-1)
        return with_step(knob, bytes(pcodec.standalone.simple_compress(flat, pcodec.ChunkConfig(compression_level=8))))

    def decode(self, data: bytes, shape: tuple[int, int, int]) -> Array:
        step, rest = step_of(data)
        return from_grid(needs("pcodec").standalone.simple_decompress(rest), step, shape)

    def knob_of(self, mean_error: float) -> float:
        return mean_error * 2.1

    def version(self) -> str:
        return installed_version("pcodec")


@dataclass(frozen=True)
class QuantiseDeltaZstd:
    """Positions rounded to a step, differences along time, bytes shuffled, zstd at level 19."""

    name: str = "quantise + delta + zstd"

    def encode(self, positions: Array, knob: float) -> bytes:
        zstandard = needs("zstandard")
        delta = np.diff(to_grid(positions, knob), axis=1, prepend=np.int32(0))
        shuffled = np.ascontiguousarray(delta.view(np.uint8).reshape(-1, 4).T)
        return with_step(knob, zstandard.ZstdCompressor(level=19).compress(shuffled.tobytes()))

    def decode(self, data: bytes, shape: tuple[int, int, int]) -> Array:
        step, rest = step_of(data)
        shuffled = np.frombuffer(needs("zstandard").ZstdDecompressor().decompress(rest), np.uint8)
        delta = np.ascontiguousarray(shuffled.reshape(4, -1).T).view(np.int32).reshape(shape[1] * 3, shape[0])
        return from_grid(np.cumsum(delta, axis=1), step, shape)

    def knob_of(self, mean_error: float) -> float:
        return mean_error * 2.1

    def version(self) -> str:
        return installed_version("zstandard")


@dataclass(frozen=True)
class JpegXl:
    """The rows × frames matrix as a 16-bit grey picture in JPEG XL, scaled to its range of values.

    JPEG XL's distance is the knob, divided by this range.
    """

    name: str = "jpeg xl"

    def encode(self, positions: Array, knob: float) -> bytes:
        codecs = needs("imagecodecs")
        rows = by_row(positions).astype(np.float64)
        low, high = float(rows.min()), float(rows.max())
        picture = np.round((rows - low) / max(high - low, 1e-9) * 65535).astype(np.uint16)
        distance = float(np.clip(knob / max(high - low, 1e-9) * 65, 0.001, 25.0))
        return np.array([low, high]).tobytes() + codecs.jpegxl_encode(picture, distance=distance, effort=5)

    def decode(self, data: bytes, shape: tuple[int, int, int]) -> Array:
        low, high = np.frombuffer(data[:16], np.float64)
        picture = needs("imagecodecs").jpegxl_decode(data[16:])
        return by_frame(np.asarray(picture, np.float64) / 65535 * (high - low) + low, shape)

    def knob_of(self, mean_error: float) -> float:
        return mean_error

    def version(self) -> str:
        return installed_version("imagecodecs")


@dataclass(frozen=True)
class Npz:
    """float32 in `numpy.savez_compressed`: lossless, the usual way to store arrays."""

    name: str = "npz"
    lossless: ClassVar[bool] = True

    def encode(self, positions: Array, knob: float) -> bytes:
        buffer = io.BytesIO()
        np.savez_compressed(buffer, positions=np.asarray(positions, np.float32))
        return buffer.getvalue()

    def decode(self, data: bytes, shape: tuple[int, int, int]) -> Array:
        return np.load(io.BytesIO(data))["positions"].astype(np.float64)

    def knob_of(self, mean_error: float) -> float:
        return mean_error

    def version(self) -> str:
        return f"numpy {np.__version__}, zlib {zlib.ZLIB_VERSION}"


@dataclass(frozen=True)
class PcodecLossless:
    """float32 in lossless pcodec, as one 1-D array, time fastest."""

    name: str = "pcodec"
    lossless: ClassVar[bool] = True

    def encode(self, positions: Array, knob: float) -> bytes:
        pcodec = needs("pcodec")
        flat = by_row(positions).reshape(-1)
        return bytes(pcodec.standalone.simple_compress(flat, pcodec.ChunkConfig(compression_level=8)))

    def decode(self, data: bytes, shape: tuple[int, int, int]) -> Array:
        return by_frame(needs("pcodec").standalone.simple_decompress(data), shape)

    def knob_of(self, mean_error: float) -> float:
        return mean_error

    def version(self) -> str:
        return installed_version("pcodec")


@dataclass(frozen=True)
class PaperRival:
    """One of `codecs.baselines`: a paper's rival with our quantiser and entropy coder."""

    method: baselines.Baseline

    @property
    def name(self) -> str:
        return self.method.name.lower()

    def encode(self, positions: Array, knob: float) -> bytes:
        return self.method.encode(positions, knob)

    def decode(self, data: bytes, shape: tuple[int, int, int]) -> Array:
        return self.method.decode(data, shape)

    def knob_of(self, mean_error: float) -> float:
        return self.method.initial_step(mean_error)

    def version(self) -> str:
        return f"mocodec {__version__}"


RIVALS: dict[str, Callable[[], Rival]] = {
    "sz3": Sz3,
    "zfp": Zfp,
    "sperr": Sperr,
    "quantise + pcodec": QuantisePcodec,
    "quantise + delta + zstd": QuantiseDeltaZstd,
    "jpeg xl": JpegXl,
    "npz": Npz,
    "pcodec": PcodecLossless,
    **{method.name.lower(): partial(PaperRival, method) for method in baselines.BASELINES},
}


def is_lossless(rival: Rival) -> bool:
    """Whether a rival has no knob."""
    return getattr(rival, "lossless", False)
