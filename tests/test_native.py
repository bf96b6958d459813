"""The compiled module can be switched off, and gives the same numbers as NumPy."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import mocodec
from mocodec import Motion, native
from mocodec.codecs.tempo.coding import contexts
from mocodec.codecs.tempo.models import prior
from mocodec.codecs.tempo.pose import bone_directions
from mocodec.entropy import coder
from mocodec.testing import synthetic

compiled = pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")


@compiled
def test_it_can_be_switched_off() -> None:
    assert native.kernel("tempo_encode") is not None
    assert native.kernel("no such kernel") is None
    with native.without():
        assert not native.available()
        assert native.kernel("tempo_encode") is None
    assert native.available()
    code = "from mocodec import native; raise SystemExit(native.available())"
    assert subprocess.run([sys.executable, "-c", code], env=os.environ | {"MOCODEC_PURE": "1"}).returncode == 0


@compiled
@pytest.mark.parametrize("shape", [(1, 1), (400, 1), (60, 7), (40, 90), (9000, 1), (300, 45), (30, 700)])
@pytest.mark.parametrize("size", [0.3, 20.0, 1e9])
@pytest.mark.parametrize("hinted", [False, True])
def test_arrays_are_coded_alike(shape: tuple[int, int], size: float, hinted: bool) -> None:
    rng = np.random.default_rng(shape[0])
    values = np.rint(rng.laplace(size=shape) * size * rng.exponential(size=shape[1])).astype(np.int64)
    contexts_ = np.rint(np.abs(values) * rng.exponential(size=shape)).astype(np.int64) if hinted else None
    data = coder.pack(values, contexts_)
    unpacked = coder.unpack(data, shape, contexts_)
    with native.without():
        assert coder.pack(values, contexts_) == data
        np.testing.assert_array_equal(coder.unpack(data, shape, contexts_), unpacked)
    np.testing.assert_array_equal(unpacked, values)


@compiled
@pytest.mark.parametrize("frames", [1, 2, 64, 65, 300])
def test_bone_directions_are_posed_alike(frames: int) -> None:
    tree = prior.for_directions().joints.tree
    rng = np.random.default_rng(frames)
    coordinates = rng.normal(size=(frames, tree.dimensions)) * rng.choice([0.0, 1e-9, 1.0, 3.0], size=tree.dimensions)
    posed = bone_directions.inverse(tree, coordinates)
    with native.without():
        np.testing.assert_array_equal(posed, bone_directions.inverse(tree, coordinates))


@compiled
@pytest.mark.parametrize("codec", ["hou2014", "liu2006"])
def test_files_of_published_codecs_are_alike(codec: str) -> None:
    motion = synthetic.markers(frames=900, seed=4)
    blob = mocodec.encode(motion, codec, mean_error=0.004)
    decoded = mocodec.decode(blob)
    with native.without():
        assert mocodec.encode(motion, codec, mean_error=0.004) == blob
        pure = mocodec.decode(blob)
    np.testing.assert_allclose(decoded.positions, pure.positions, rtol=0, atol=1e-9)


@compiled
@pytest.mark.parametrize("settings", [{"max_error": 0.004}, {"mean_error": 0.002}])
def test_files_are_alike(settings: dict[str, Any]) -> None:
    """Of tempo's transform: encoders use the lattice engine only with the compiled module, see `engine_choice`."""
    settings = {**settings, "model": "transform"}
    motion = synthetic.markers(frames=700, seed=3)
    names = prior.for_points().joints.names
    for m in (motion, Motion(motion.positions[:, : len(names)], motion.rate, names, motion.up)):
        blob = mocodec.encode(m, **settings)
        decoded = mocodec.decode(blob)
        with native.without():
            assert mocodec.encode(m, **settings) == blob
            pure = mocodec.decode(blob)
        np.testing.assert_allclose(decoded.positions, pure.positions, rtol=0, atol=1e-9)


@compiled
def test_a_kernel_refuses_arrays_that_do_not_fit() -> None:
    decode = native.kernel("tempo_decode")
    assert decode is not None
    none, one = np.zeros(0, np.int64), np.ones(1, np.int64)
    with pytest.raises(ValueError, match="shapes differ"):
        decode(np.zeros((0, 0), np.int64), one, 3, one, np.zeros(0, np.uint16), one, one, none, *contexts.lookup(0))
