"""The zarr codec: bounds, gaps, shards, refusals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec.testing import synthetic

zarr: Any = pytest.importorskip("zarr", minversion="3", reason="needs the [zarr] extra")
codec: Any = pytest.importorskip("mocodec.arrays.zarr_codec")


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    """The codec is known by name, also where mocodec runs from its sources without an entry point."""
    zarr.registry.register_codec(codec.NAME, codec.MocodecCodec)
    return


def walk(frames: int = 250) -> np.ndarray:
    positions = synthetic.markers(frames=frames, rate=100.0).positions.copy()
    positions[10:20, 1] = np.nan
    return positions


def array(data: np.ndarray, chunks: int = 100, atol: float = 0.002, **options: Any) -> tuple[Any, Any]:
    store = zarr.storage.MemoryStore()
    points = data.shape[1]
    options = {"chunks": (chunks, points, 3), "fill_value": np.nan, "compressors": None} | options
    z = zarr.create_array(
        store, shape=data.shape, dtype=data.dtype, serializer=codec.MocodecCodec(atol=atol, rate=100.0), **options
    )
    z[:] = data
    return zarr.open_array(store, mode="r"), store


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("scale", [1.0, 1000.0], ids=["m", "mm"])
def test_the_bound_holds_after_rounding(dtype: type, scale: float) -> None:
    data = (walk() * scale).astype(dtype)
    z, store = array(data, atol=0.002 * scale)
    back = z[:]
    assert back.dtype == dtype
    np.testing.assert_array_equal(np.isnan(back), np.isnan(data))
    assert np.nanmax(np.linalg.norm(back.astype(float) - data, axis=2)) <= 0.002 * scale
    assert sum(len(value) for key, value in store._store_dict.items() if "/c/" in f"/{key}") < data.nbytes / 5
    np.testing.assert_array_equal(z[105:130, 3], back[105:130, 3])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_without_tolerance_every_bit_returns(dtype: type) -> None:
    data = walk(60).astype(dtype)
    np.testing.assert_array_equal(array(data, atol=0)[0][:], data)
    np.testing.assert_array_equal(array(data, atol=1e-9)[0][:], data) if dtype is np.float32 else None


def test_shards() -> None:
    data = walk()
    z, _ = array(data, chunks=50, shards=(150, data.shape[1], 3))
    assert np.nanmax(np.linalg.norm(z[:] - data, axis=2)) <= 0.002
    assert np.nanmax(np.linalg.norm(z[120:180] - data[120:180], axis=2)) <= 0.002


def test_parts_are_written_and_blocks_that_are_all_gaps() -> None:
    data = walk()
    z, store = array(np.full_like(data, np.nan))
    assert np.isnan(z[:]).all()
    writable = zarr.open_array(store, mode="r+")
    writable[30:180] = data[30:180]
    assert np.nanmax(np.linalg.norm(writable[30:180] - data[30:180], axis=2)) <= 0.002
    assert np.isnan(writable[:30]).all()


@pytest.mark.parametrize(
    ("shape", "chunks", "dtype"),
    [
        ((10, 4, 2), (5, 4, 2), "f4"),
        ((10, 12), (5, 12), "f4"),
        ((10, 4, 3), (5, 4, 3), "i4"),
        ((10, 4, 3), (5, 4, 1), "f8"),
    ],
)
def test_other_arrays_are_refused_at_creation(shape: Any, chunks: Any, dtype: str) -> None:
    for more in ({}, {"shards": shape}):
        with pytest.raises(mc.BadInput, match="mocodec"):
            zarr.create_array(
                zarr.storage.MemoryStore(), shape=shape, chunks=chunks, dtype=dtype,
                serializer=codec.MocodecCodec(atol=0.001, rate=100.0), compressors=None, **more,
            )  # fmt: skip


def test_settings() -> None:
    for wrong in (
        {"atol": -1.0, "rate": 100},
        {"atol": 0.1, "rate": 0},
        {"atol": "1", "rate": 100},
        {"atol": np.nan, "rate": 1},
    ):
        with pytest.raises(mc.BadInput, match="must be"):
            codec.MocodecCodec(**wrong)
    one = codec.MocodecCodec(atol=0.001, rate=100)
    assert codec.MocodecCodec.from_dict(one.to_dict()) == one
    with pytest.raises(mc.BadInput, match="configuration"):
        codec.MocodecCodec.from_dict({"name": "mocodec", "configuration": {"step": 1}})


def test_partly_missing_points_and_damage_are_one_line() -> None:
    data = walk(60)
    data[5, 2, 1] = np.nan
    with pytest.raises(mc.BadInput, match="some coordinates missing"):
        array(data)
    z, store = array(walk(60))
    key = next(key for key in store._store_dict if key.startswith("c/"))
    store._store_dict[key] = store._store_dict[key][:-9]
    with pytest.raises(mc.MocodecError):
        z[:]
