"""The joint limits of a skeleton on disk: angles in decimal fractions of a degree where that is exact, else float64.

Skeleton files write limits and axis frames in degrees with a few decimals, so integers hold them in few bytes. Only
files whose motion has rotations store limits: angles are coded about the axes of the limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import BadInput, Corrupt
from ..fields import Record, array, fixed, flag, sized, unsigned
from ..geometry import rigid
from ..motion import Limits
from ..typing import Floats, Integers

ORDERS = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")
"""By number on disk."""
LOCKED, UNLIMITED, RANGE = 0, 1, 2
MOST_DIGITS = 7
EXACT_WITHIN = 1e-12
"""Radians by which angles in decimal degrees may differ from the original: rounding of the conversion."""
MOST = 1 << 48


def _ranged(known: Mapping[str, Any]) -> int:
    """How many axes have a range."""
    return int((known["kinds"] == RANGE).sum())


LIMITS = Record(
    "joint limits",
    flag("exact", "angles and frames are float64"),
    unsigned("digits", most=MOST_DIGITS, meaning="decimals of a degree"),
    *sized(
        array("orders", ("joints",), least=0, most=len(ORDERS) - 1, meaning="orders of rotations, by number"),
        array("kinds", ("joints", 3), least=0, most=RANGE, meaning="0 locked, 1 unlimited, 2 a range"),
        array("ranges", (_ranged, 2), most=MOST, meaning="least and greatest", when=lambda known: not known["exact"]),
        array("axes", ("joints", 3), most=MOST, meaning="frame, angles", when=lambda known: not known["exact"]),
        fixed("exact_ranges", ("joints", 3, 2), "<f8", when=lambda known: known["exact"]),
        fixed("exact_axes", ("joints", 4), "<f8", when=lambda known: known["exact"]),
    ),
)


def pack(limits: Limits) -> bytes:
    """The bytes of joint limits."""
    low, high = limits.ranges[..., 0], limits.ranges[..., 1]
    kinds = np.full(low.shape, RANGE)
    kinds[np.isinf(low) & np.isinf(high)] = UNLIMITED
    kinds[(low == 0) & (high == 0)] = LOCKED
    known: dict[str, Any] = {"orders": [ORDERS.index(order) for order in limits.orders], "kinds": kinds}
    ranges, axes = limits.ranges[kinds == RANGE], _frame_angles(limits)
    for digits in range(MOST_DIGITS + 1):
        steps = _steps(ranges, digits), _steps(axes, digits)
        if np.isfinite(ranges).all() and _same(limits, ranges, *steps, digits):
            values = {"exact": False, "digits": digits, "ranges": steps[0], "axes": steps[1], **known}
            return LIMITS.pack({**values, "exact_ranges": None, "exact_axes": None})
    values = {"exact": True, "digits": 0, "ranges": None, "axes": None, **known}
    return LIMITS.pack({**values, "exact_ranges": limits.ranges, "exact_axes": limits.axes})


def unpack(data: bytes, joints: int) -> Limits:
    """The inverse of `pack`. Raises Corrupt."""
    values = LIMITS.unpack(data, joints=joints)
    orders = tuple(ORDERS[number] for number in values["orders"])
    try:
        if values["exact"]:
            return Limits(orders, values["exact_axes"], values["exact_ranges"])
        ranges = np.zeros((joints, 3, 2))
        ranges[values["kinds"] == UNLIMITED] = -np.inf, np.inf
        ranges[values["kinds"] == RANGE] = _radians(values["ranges"], values["digits"])
        return Limits(orders, _frames(orders, _radians(values["axes"], values["digits"])), ranges)
    except BadInput as problem:
        raise Corrupt(f"the skeleton's joint limits: {problem}") from None


def _frame_angles(limits: Limits) -> Floats:
    """Angles (joints, 3) of the axis frames, in the orders of the rotations."""
    return np.array([rigid.to_euler(o, q) for o, q in zip(limits.orders, limits.axes, strict=True)]).reshape(-1, 3)


def _frames(orders: tuple[str, ...], angles: Floats) -> Floats:
    return np.array([rigid.from_euler(o, a) for o, a in zip(orders, angles, strict=True)]).reshape(-1, 4)


def _steps(angles: Floats, digits: int) -> Integers:
    return np.rint(np.degrees(np.where(np.isfinite(angles), angles, 0.0)) * 10.0**digits).astype(np.int64)


def _radians(steps: Integers, digits: int) -> Floats:
    return np.radians(np.asarray(steps) / 10.0**digits)


def _same(limits: Limits, ranges: Floats, range_steps: Integers, axis_steps: Integers, digits: int) -> bool:
    """Whether angles in these steps are the original's."""
    frames = _frames(limits.orders, _radians(axis_steps, digits))
    flipped = frames * np.where((frames * limits.axes).sum(axis=1, keepdims=True) < 0, -1, 1)
    near = bool(np.abs(flipped - limits.axes).max(initial=0.0) < EXACT_WITHIN)
    return near and bool(np.abs(_radians(range_steps, digits) - ranges).max(initial=0.0) < EXACT_WITHIN)
