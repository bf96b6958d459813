"""Datasets of xarray: the engine, three conventions, and back."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import arrays
from mocodec.testing import synthetic

xr: Any = pytest.importorskip("xarray", reason="needs the [xarray] extra")
backend = pytest.importorskip("mocodec.arrays.xarray_backend")


def markers() -> mc.Motion:
    motion = synthetic.markers(frames=300, rate=100.0)
    positions = motion.positions.copy()
    positions[20:30, 2] = np.nan
    return mc.Motion(positions, motion.rate, motion.names, "y", source={"format": "c3d", "first_frame": 5})


def same(a: mc.Motion, b: mc.Motion) -> None:
    np.testing.assert_array_equal(a.positions, b.positions)
    assert (a.names, a.rate, a.up) == (b.names, b.rate, b.up)


@pytest.fixture
def walk(tmp_path: Path) -> tuple[Path, mc.Motion]:
    mc.write(tmp_path / "walk.mocz", markers(), max_error=0.001)
    return tmp_path / "walk.mocz", mc.read(tmp_path / "walk.mocz", mc.Motion)


def test_a_file_opens_as_a_dataset(walk: tuple[Path, mc.Motion]) -> None:
    path, motion = walk
    with xr.open_dataset(path, engine=backend.MocodecBackend) as ds:
        assert dict(ds.sizes) == {"time": 300, "point": motion.points, "axis": 3}
        assert ds.attrs["rate"] == 100
        assert ds.attrs["up"] == "y"
        assert ds.attrs["codec"] == "tempo"
        assert ds.attrs["promise"] == '{"max_error": 0.001}'
        assert ds.positions.attrs["units"] == "m"
        part = ds.sel(time=slice(1.0, 1.5), point=list(motion.names[:2]))
        np.testing.assert_array_equal(part.positions.values, motion.positions[100:151, :2])
        np.testing.assert_array_equal(ds.positions[7, 3].values, motion.positions[7, 3])
        np.testing.assert_array_equal(ds.positions[::-7].values, motion.positions[::-7])
        np.testing.assert_array_equal(ds.positions[[5, 2, 250]].values, motion.positions[[5, 2, 250]])
        assert ds.positions[5:5].shape == (0, motion.points, 3)
        back = arrays.from_xarray(ds)
        same(back, motion)
        assert back.source == motion.source
        cut = arrays.from_xarray(ds.isel(time=slice(100, 200)))
        same(cut, motion[100:200])
        assert cut.source["first_frame"] == 105
        assert "first_frame" not in arrays.from_xarray(ds.isel(time=slice(None, None, 2))).source
        assert arrays.from_xarray(ds.isel(time=slice(None, None, 2))).rate == pytest.approx(50)


def test_only_the_frames_that_are_used_are_decoded(
    walk: tuple[Path, mc.Motion], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[slice] = []
    decode = mc.File.decode

    def spy(self: Any, frames: slice, **options: Any) -> Any:
        asked.append(frames)
        return decode(self, frames, **options)

    monkeypatch.setattr(mc.File, "decode", spy)
    with xr.open_dataset(walk[0], engine=backend.MocodecBackend) as ds:
        window = ds.positions[40:60]
        assert asked == []
        window.load()
    assert asked == [slice(40, 60)]


def test_a_dataset_can_be_sent_to_workers(walk: tuple[Path, mc.Motion]) -> None:
    with xr.open_dataset(walk[0], engine=backend.MocodecBackend) as ds:
        again = pickle.loads(pickle.dumps(ds))
        np.testing.assert_array_equal(again.positions[3:5].values, walk[1].positions[3:5])
        del again


def test_rotations_and_skeleton(tmp_path: Path) -> None:
    skeleton = mc.Skeleton(("hip", "knee", "foot"), (-1, 0, 1), [[0, 0, 0], [0, -0.4, 0], [0, -0.4, 0]])
    rotations = np.tile([1.0, 0, 0, 0], (20, 3, 1))
    positions = np.tile(np.cumsum(skeleton.offsets, axis=0), (20, 1, 1))
    motion = mc.Motion(positions, 60.0, skeleton.names, "y", skeleton, rotations)
    mc.write(tmp_path / "leg.mocz", motion, codec="lossless")
    with xr.open_dataset(tmp_path / "leg.mocz", engine=backend.MocodecBackend) as ds:
        np.testing.assert_array_equal(ds.rotations[3:5].values, rotations[3:5])
        for data in (ds, arrays.to_xarray(motion)):
            back = arrays.from_xarray(data)
            assert back.skeleton is not None
            assert back.skeleton.parents == skeleton.parents
            np.testing.assert_array_equal(back.skeleton.offsets, skeleton.offsets)
            np.testing.assert_array_equal(back.rotations, rotations)
        assert arrays.from_xarray(ds.sel(point=["hip", "foot"])).skeleton is None


@pytest.mark.parametrize("style", list(arrays.STYLES))
def test_styles_come_back(style: str) -> None:
    motion = markers()
    same(arrays.from_xarray(arrays.to_xarray(motion, style=style)), motion)
    one = arrays.to_xarray(motion[:1], style=style)
    same(arrays.from_xarray(one), motion[:1])


def test_pyomeca() -> None:
    motion = markers()
    array = arrays.to_xarray(motion, style="pyomeca")
    assert array.dims == ("axis", "channel", "time")
    assert array.axis.values.tolist() == ["x", "y", "z", "ones"]
    assert (array.sel(axis="ones") == 1).all()
    assert array.attrs["rate"] == 100
    assert (array.attrs["first_frame"], array.attrs["last_frame"]) == (5, 304)
    millimetres = array * 1000  # as pyomeca reads a C3D
    millimetres.attrs.update(array.attrs, units="mm")
    np.testing.assert_allclose(arrays.from_xarray(millimetres).positions, motion.positions, atol=1e-12)


@pytest.mark.parametrize(
    ("style", "keypoint", "individual"),
    [("movement", "keypoint", "individual"), ("movement_plural", "keypoints", "individuals")],
)
def test_movement(style: str, keypoint: str, individual: str) -> None:
    motion = replace(markers(), up="y")
    ds = arrays.to_xarray(motion, style=style, individual="anna")
    assert ds.position.dims == ("time", "space", keypoint, individual)
    assert ds.confidence.dims == ("time", keypoint, individual)
    assert ds.attrs["ds_type"] == "poses"
    assert ds.attrs["fps"] == 100
    assert ds.attrs["time_unit"] == "seconds"
    np.testing.assert_array_equal(ds.confidence.values[..., 0] == 0, motion.gaps)
    alone = arrays.from_xarray(ds.position)
    assert (alone.up, alone.rate) == ("y", 100)
    two = xr.concat([ds, ds.assign_coords({individual: ["bert"]})], individual)
    both = arrays.from_xarray(two)
    assert both.names[0] == f"anna:{motion.names[0]}"
    assert both.names[-1] == f"bert:{motion.names[-1]}"
    np.testing.assert_array_equal(both.positions[:, : motion.points], motion.positions)


def test_what_cannot_be_read_is_one_line() -> None:
    plain = arrays.to_xarray(markers())
    with pytest.raises(mc.BadInput, match="style"):
        arrays.to_xarray(markers(), style="netcdf")
    with pytest.raises(mc.BadInput, match="dimensions"):
        arrays.from_xarray(plain.rename(axis="coordinate"))
    with pytest.raises(mc.BadInput, match="labels x, y, z"):
        arrays.from_xarray(plain.isel(axis=[0, 1]))
    with pytest.raises(mc.BadInput, match="evenly"):
        arrays.from_xarray(plain.isel(time=[0, 1, 5]))
    with pytest.raises(mc.BadInput, match="units"):
        arrays.from_xarray(plain.assign_attrs(units="inch"))


def test_the_engine_opens_mocz_only() -> None:
    guess = backend.MocodecBackend().guess_can_open
    assert guess("a/walk.mocz")
    assert guess(Path("WALK.MOCZ"))
    assert not guess("walk.nc")
    assert not guess(b"mocz")
