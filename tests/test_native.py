"""The compiled module can be switched off, and gives the same numbers as NumPy."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

import mocodec
from mocodec import Motion, native
from mocodec.codecs.tempo import coefficients, contexts, model, prior
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
@pytest.mark.parametrize("step", [-500, -250, -120])
@pytest.mark.parametrize("frames", [1, 2, 17, 130, 480])
def test_coefficients_are_coded_alike(step: int, frames: int) -> None:
    used = prior.shipped()
    known = model.of_names(used.sets[0].names, used, 120.0)
    assert known is not None
    rng = np.random.default_rng(frames)
    expected = 2.0 ** (known.expected(frames, step) / contexts.OCTAVE)
    scaled = rng.laplace(size=expected.shape) * expected
    scaled[rng.integers(frames), rng.integers(known.rows)] *= 1e3
    quantised, numbers = [], []
    for economy in (coefficients.SLOPE, 0.0):
        quantised.append(coefficients.quantise(known, scaled, step, economy))
        values, threshold, _ = quantised[-1]
        inside = values[: coefficients.plan(known, frames, step, threshold, 0).frequencies]
        lists = rng.integers(-40, 40, (5, rng.integers(min(31 * frames, 60))))
        lists[3:] = np.abs(lists[3:])
        numbers.append(coefficients.Numbers(frames, inside, step, threshold, lists if lists.size else None))
    payloads = coefficients.pack(known, numbers)
    decoded = coefficients.unpack(known, [frames, frames], payloads, 5)
    with native.without():
        for ours, economy in zip(quantised, (coefficients.SLOPE, 0.0), strict=True):
            theirs = coefficients.quantise(known, scaled, step, economy)
            np.testing.assert_array_equal(ours[0], theirs[0])
            assert ours[1:] == theirs[1:]
        assert payloads == coefficients.pack(known, numbers)
        pure = coefficients.unpack(known, [frames, frames], payloads, 5)
    for ours, theirs, given in zip(decoded, pure, numbers, strict=True):
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(ours[0], given.values)


@compiled
@pytest.mark.parametrize("shape", [(1, 1), (400, 1), (60, 7), (40, 90)])
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
def test_limbs_are_posed_alike(frames: int) -> None:
    known = prior.of_limbs()
    limbs = known.sets[0].limbs if known else None
    assert limbs is not None
    rng = np.random.default_rng(frames)
    turns = rng.normal(size=(frames, limbs.dimensions)) * rng.choice([0.0, 1e-9, 1.0, 3.0], size=limbs.dimensions)
    posed = limbs.inverse(turns)
    with native.without():
        np.testing.assert_array_equal(posed, limbs.inverse(turns))


@compiled
@pytest.mark.parametrize("settings", [{"max_error": 0.004}, {"mean_error": 0.002}])
def test_files_are_alike(settings: dict[str, float]) -> None:
    motion = synthetic.markers(frames=700, seed=3)
    names = prior.shipped().sets[0].names
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
