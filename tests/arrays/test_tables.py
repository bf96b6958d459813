"""pandas frames and Dask arrays; errors that name the extra; entry points that exist."""

from __future__ import annotations

import sys
import tomllib
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec import arrays
from mocodec.arrays.blocks import block_lengths
from mocodec.arrays.times import rate_of
from mocodec.testing import synthetic

ROOT = Path(__file__).resolve().parents[2]


def test_pandas() -> None:
    pytest.importorskip("pandas", reason="needs the [pandas] extra")
    motion = synthetic.markers(frames=120, rate=60.0)
    frame = arrays.to_pandas(motion)
    assert frame.shape == (120, 3 * motion.points)
    assert frame.columns.names == ["point", "axis"]
    assert frame.index.name == "time"
    assert frame.attrs == {"rate": 60.0, "up": motion.up, "units": "m"}
    np.testing.assert_array_equal(frame[motion.names[1]][["x", "y", "z"]], motion.positions[:, 1])
    back = arrays.from_pandas(frame[frame.columns[::-1]])
    assert back.names == motion.names[::-1]
    assert back.rate == 60.0
    assert back.up == motion.up
    np.testing.assert_array_equal(back.positions, motion.positions[:, ::-1])
    with pytest.raises(mc.BadInput, match="columns"):
        arrays.from_pandas(frame.iloc[:, 1:])
    with pytest.raises(mc.BadInput, match="evenly"):
        arrays.from_pandas(frame.iloc[[0, 1, 5]])


def test_dask(tmp_path: Path) -> None:
    pytest.importorskip("dask.array", reason="needs the [dask] extra")
    motion = synthetic.markers(frames=1200, rate=100.0)
    mc.write(tmp_path / "a.mocz", motion, max_error=0.002)
    with mc.open(tmp_path / "a.mocz", mc.Motion) as f:
        whole = f.positions()
        blocks = arrays.to_dask(f, np.float32, block_bytes=1)
        assert blocks.numblocks == (len(f.encoded.chunks), 1, 1)
        assert blocks.dtype == np.float32
        np.testing.assert_array_equal(blocks.compute(scheduler="threads"), whole.astype(np.float32))
        np.testing.assert_allclose(arrays.to_dask(f).mean(axis=0).compute(scheduler="sync"), whole.mean(axis=0))
        assert arrays.to_dask(f).name == arrays.to_dask(f).name != blocks.name


def test_blocks_are_whole_chunks() -> None:
    assert block_lengths([4, 4, 4, 10, 2], 8) == (8, 4, 10, 2)
    assert block_lengths([], 8) == ()


def test_rates_of_times() -> None:
    assert rate_of(np.round(np.arange(100) / 120, 3), {"rate": 120.0}) == 120.0
    assert rate_of(np.arange(50) / 30, {"fps": 60.0}) == pytest.approx(30)
    assert rate_of([2.0], {"fps": 60}) == 60
    for times, attributes in (([2.0], {}), ([1.0, 1.0], {}), ([0.0, 1.0, 3.0], {}), ([2.0, 1.0], {"rate": 1})):
        with pytest.raises(mc.BadInput):
            rate_of(times, attributes)


def test_a_missing_library_names_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("xarray", "pandas", "dask.array", "zarr.abc.codec"):
        monkeypatch.setitem(sys.modules, name, None)
    motion = synthetic.markers(frames=10)
    with mc.open(mc.encode(motion, "lossless"), mc.Motion) as f:
        for extra, call in (
            ("xarray", lambda: arrays.to_xarray(motion)),
            ("xarray", lambda: arrays.from_xarray(motion)),
            ("pandas", lambda: arrays.to_pandas(motion)),
            ("dask", lambda: arrays.to_dask(f)),
        ):
            with pytest.raises(mc.MissingExtra, match=rf"\[{extra}\]"):
                call()
    monkeypatch.delitem(sys.modules, "mocodec.arrays.zarr_codec", raising=False)
    with pytest.raises(mc.MissingExtra, match=r"\[zarr\]"):
        import_module("mocodec.arrays.zarr_codec")


def test_entry_points_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for group, extra in (("xarray.backends", "xarray"), ("zarr.codecs", "zarr")):
        pytest.importorskip(extra, reason=f"needs the [{extra}] extra")
        module, name = project["entry-points"][group]["mocodec"].split(":")
        assert hasattr(import_module(module), name)
        assert extra in project["optional-dependencies"]
