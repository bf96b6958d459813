"""The Blender add-on, with Blender as a Python module: what it imports it exports again."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec.testing import skeletal

bpy: Any = pytest.importorskip("bpy", reason="needs Blender as a Python module (pip install bpy)")

ADD_ON = Path(__file__).parents[1] / "blender" / "add_on"


@pytest.fixture
def blender() -> Iterator[Any]:
    """An empty scene with the add-on registered."""
    place = {"submodule_search_locations": [str(ADD_ON)]}
    spec = importlib.util.spec_from_file_location("mocodec_add_on", ADD_ON / "__init__.py", **place)
    assert spec is not None
    assert spec.loader is not None
    add_on = importlib.util.module_from_spec(spec)
    sys.modules["mocodec_add_on"] = add_on
    spec.loader.exec_module(add_on)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    add_on.register()
    yield bpy
    add_on.unregister()
    for name in [name for name in sys.modules if name.startswith("mocodec_add_on")]:
        del sys.modules[name]


def armature(seed: int, frames: int = 40) -> mc.Motion:
    """Nine joints that turn and one root that travels, z up."""
    motion = skeletal.random_motion(frames=frames, joints=9, seed=seed)
    return motion.turned("z")


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_an_armature_comes_back(blender: Any, tmp_path: Path, seed: int, scale: float) -> None:
    original = armature(seed)
    mc.write(tmp_path / "in.mocz", original, codec="lossless")
    assert blender.ops.import_anim.mocz(filepath=str(tmp_path / "in.mocz"), scale=scale) == {"FINISHED"}
    assert blender.context.scene.render.fps / blender.context.scene.render.fps_base == pytest.approx(original.rate)
    out = str(tmp_path / "out.mocz")
    assert blender.ops.export_anim.mocz(filepath=out, target="lossless", scale=scale) == {"FINISHED"}
    again = mc.read(out, mc.Motion)
    assert again.names == original.names
    assert again.skeleton is not None
    assert original.skeleton is not None
    assert again.skeleton.parents == original.skeleton.parents
    np.testing.assert_allclose(again.positions, original.positions, atol=2e-5)
    assert original.rotations is not None
    assert again.rotations is not None
    dots = np.abs((original.rotations * again.rotations).sum(axis=-1))
    assert dots.min() > 1 - 1e-6


def test_markers_come_back_with_their_gaps(blender: Any, tmp_path: Path) -> None:
    positions = np.random.default_rng(0).normal(size=(30, 4, 3)).cumsum(axis=0) * 0.01
    positions[5:9, 1] = np.nan
    positions[:3, 2] = np.nan
    positions[:, 3] = np.nan
    long_name = "a name longer than sixty-three characters, as some programs write them"
    original = mc.Motion(positions, 29.97, ("LKNE", "RKNE", long_name, "x"))
    mc.write(tmp_path / "in.mocz", original, codec="lossless")
    assert blender.ops.import_anim.mocz(filepath=str(tmp_path / "in.mocz")) == {"FINISHED"}
    blender.data.objects["LKNE"].select_set(True)
    out = str(tmp_path / "out.mocz")
    assert blender.ops.export_anim.mocz(filepath=out, target="lossless") == {"FINISHED"}
    again = mc.read(out, mc.Motion)
    assert again.names == original.names
    assert again.rate == pytest.approx(29.97)
    np.testing.assert_allclose(again.positions, original.positions, atol=1e-5)


def test_a_promise_is_kept(blender: Any, tmp_path: Path) -> None:
    original = armature(5)
    mc.write(tmp_path / "in.mocz", original, codec="lossless")
    blender.ops.import_anim.mocz(filepath=str(tmp_path / "in.mocz"))
    out = str(tmp_path / "out.mocz")
    assert blender.ops.export_anim.mocz(filepath=out, target="max_error", error=0.005) == {"FINISHED"}
    with mc.open(out, mc.Motion) as opened:
        assert opened.encoded.promise == {"max_error": pytest.approx(0.005)}
        assert mc.compare(original, opened[:]).max_error <= 0.00502


def test_wrong_files_are_one_line(blender: Any, tmp_path: Path) -> None:
    (tmp_path / "bad.mocz").write_bytes(b"nothing")
    with pytest.raises(RuntimeError, match=r"bad\.mocz"):
        blender.ops.import_anim.mocz(filepath=str(tmp_path / "bad.mocz"))
    with pytest.raises(RuntimeError, match="select an armature"):
        blender.ops.export_anim.mocz(filepath=str(tmp_path / "none.mocz"))
