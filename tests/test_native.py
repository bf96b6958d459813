"""The compiled module is there where it can be built, stays aside where it is told to, and gives NumPy's numbers."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.tempo import lanes, prior

compiled = pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or left aside")


@compiled
def test_it_can_be_left_aside() -> None:
    assert native.kernel("lanes_encode") is not None
    assert native.kernel("no such kernel") is None
    with native.without():
        assert not native.available()
        assert native.kernel("lanes_encode") is None
    assert native.available()
    code = "from mocodec import native; raise SystemExit(native.available())"
    assert subprocess.run([sys.executable, "-c", code], env=os.environ | {"MOCODEC_PURE": "1"}).returncode == 0


@compiled
@pytest.mark.parametrize(("steps", "width"), [(0, 3), (1, 1), (257, 12)])
def test_lanes_are_coded_alike(steps: int, width: int) -> None:
    rng = np.random.default_rng(steps)
    coder = prior.shipped().coder
    tables = rng.integers(0, coder.idle + 1, (steps, width))
    slots = rng.integers(0, lanes.TOTAL, (steps, width))
    symbols = coder.symbols[tables * lanes.TOTAL + slots]
    layouts = [(symbols, tables), (symbols[: steps // 2, :1], tables[: steps // 2, :1])]
    raw = [rng.integers(0, 1 << 16, width), rng.integers(0, 1 << 16, 1)]
    compiled_ones = lanes.encode(layouts, coder, raw)
    with native.without():
        pure = lanes.encode(layouts, coder, raw)
    for ours, theirs in zip(compiled_ones, pure, strict=True):
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
