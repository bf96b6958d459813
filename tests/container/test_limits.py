"""Joint limits on disk: decimal degrees, departures from reference limits, exact where decimals do not suffice."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

from mocodec.container import limits, tables
from mocodec.errors import Corrupt
from mocodec.geometry import rigid
from mocodec.motion import Limits


def reference_limits() -> Limits:
    """Reference limits 1."""
    of = limits.reference(1, 31)
    orders = tuple(limits.ORDERS[n] for n in of.orders)
    axes = np.array([rigid.from_euler(o, np.radians(a)) for o, a in zip(orders, of.frames, strict=True)])
    ranges = np.radians(np.asarray(of.ranges, np.float64))
    ranges[of.kinds == limits.UNLIMITED] = -np.inf, np.inf
    return Limits(orders, axes, ranges)


def require_same(found: Limits, expected: Limits) -> None:
    assert found.orders == expected.orders
    np.testing.assert_allclose(found.ranges, expected.ranges, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.abs((found.axes * expected.axes).sum(axis=1)), 1, rtol=0, atol=1e-14)


def test_reference_limits_cost_nothing() -> None:
    known = reference_limits()
    packed = limits.pack(known)
    assert len(packed) < 10
    require_same(limits.unpack(packed, 31), known)


def test_departures_come_back() -> None:
    known = reference_limits()
    ranges, orders = known.ranges.copy(), list(known.orders)
    ranges[3] = 0.0
    ranges[4] = -np.inf, np.inf
    ranges[5] = np.radians([[-12.5, 13], [0, 0], [1.25, 2]])
    ranges[1] = np.radians([[-1, 1], [-2, 2], [0, 0]])
    orders[7] = "xyz"
    changed = Limits(tuple(orders), known.axes, ranges)
    packed = limits.pack(changed)
    assert len(packed) < 100
    require_same(limits.unpack(packed, 31), changed)


@pytest.mark.parametrize("joints", [1, 4, 31, 40])
def test_any_limits_come_back(joints: int) -> None:
    rng = np.random.default_rng(joints)
    orders = tuple(rng.choice(limits.ORDERS, joints).tolist())
    axes = rng.normal(0, 1, (joints, 4))
    axes /= np.sqrt((axes**2).sum(axis=1, keepdims=True))
    ranges = np.sort(rng.normal(0, 1, (joints, 3, 2)), axis=2)
    ranges[0, 0, 1] = np.inf
    require_same(limits.unpack(limits.pack(Limits(orders, axes, ranges)), joints), Limits(orders, axes, ranges))


def test_a_reference_of_another_skeleton_is_corrupt() -> None:
    with pytest.raises(Corrupt):
        limits.unpack(limits.pack(reference_limits()), 30)


def test_reference_limits_are_frozen() -> None:
    """Released entries never change."""
    first = (tables.CMU_RANGES[:16], tables.CMU_FRAMES[:11], tables.REFERENCE_LIMITS[1])
    assert zlib.crc32(repr(first).encode()) == REFERENCE_LIMITS_CRC


REFERENCE_LIMITS_CRC = 0x57443F10
