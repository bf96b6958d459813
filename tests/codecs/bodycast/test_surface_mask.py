"""Masks of surface cells."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.bodycast import surface_mask
from mocodec.errors import Corrupt


def test_masks_round_trip():
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:40, :57]
    for mask in (
        np.hypot(x - 25, y - 20) < 15,
        rng.random((9, 5)) < 0.3,
        np.zeros((3, 4), bool),
        np.ones((1, 1), bool),
    ):
        np.testing.assert_array_equal(surface_mask.unpack_mask(surface_mask.pack_mask(mask), mask.shape), mask)
    assert len(surface_mask.pack_mask(np.hypot(x - 25, y - 20) < 15)) < 60
    with pytest.raises(Corrupt):
        surface_mask.unpack_mask(surface_mask.pack_mask(np.hypot(x - 25, y - 20) < 15)[:-3], (40, 57))
