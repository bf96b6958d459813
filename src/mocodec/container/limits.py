"""The joint limits of a skeleton on disk: angles in decimal fractions of a degree where that is exact, else float64.

Skeleton files write limits and axis frames in degrees with a few decimals, so integers hold them in few bytes. Only
files whose motion has rotations store limits: angles are coded about the axes of the limits. Skeletons of one source
share most limits, so they are stored as departures from reference limits (`tables.REFERENCE_LIMITS`), or from zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ..errors import BadInput, Corrupt
from ..fields import Record, array, fixed, flag, sized, unsigned
from ..geometry import rigid
from ..motion import Limits
from ..typing import Booleans, Floats, Integers
from .tables import CMU_FRAMES, CMU_RANGES, REFERENCE_LIMITS

ORDERS = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")
"""By number on disk."""
LOCKED, UNLIMITED, RANGE = 0, 1, 2
KINDS = 3
MOST_DIGITS = 7
EXACT_WITHIN = 1e-12
"""Radians by which angles in decimal degrees may differ from the original: rounding of the conversion."""
MOST = 1 << 48


LIMITS = Record(
    "joint limits",
    flag("exact", "angles and frames are float64"),
    unsigned("reference", most=len(REFERENCE_LIMITS), meaning="reference limits by number, 0 none"),
    unsigned("digits", most=MOST_DIGITS, meaning="decimals of a degree"),
    *sized(
        array("orders", ("joints",), least=0, most=len(ORDERS) - 1, meaning="orders, departures modulo 6"),
        array("kinds", ("joints", 3), least=0, most=RANGE, meaning="0 locked, 1 unlimited, 2 a range; modulo 3"),
        array(
            "ranges", ("joints", 3, 2), most=MOST, meaning="least and greatest", when=lambda known: not known["exact"]
        ),
        array("axes", ("joints", 3), most=MOST, meaning="frame, angles", when=lambda known: not known["exact"]),
        fixed("exact_ranges", ("joints", 3, 2), "<f8", when=lambda known: known["exact"]),
        fixed("exact_axes", ("joints", 4), "<f8", when=lambda known: known["exact"]),
    ),
)


class Reference(NamedTuple):
    """orders (joints,) and kinds (joints, 3) by number; ranges (joints, 3, 2) and frames (joints, 3), degrees."""

    orders: Integers
    kinds: Integers
    ranges: Integers
    frames: Integers


def reference(number: int, joints: int) -> Reference:
    """The reference limits of this number, or zeros for 0. Raises Corrupt for another number of joints."""
    if not number:
        zeros = np.zeros((joints, 3, 2), np.int64)
        return Reference(zeros[:, 0, 0], zeros[..., 0], zeros, zeros[..., 0])
    table = np.array(REFERENCE_LIMITS[number])
    if len(table) != joints:
        raise Corrupt("joint limits that depart from those of another skeleton")
    ranges = np.array(CMU_RANGES)[table[:, 1]]
    kinds = np.where((ranges == 0).all(axis=2), LOCKED, RANGE)
    kinds[0] = UNLIMITED
    return Reference(table[:, 0], kinds, ranges, np.array(CMU_FRAMES)[table[:, 2]])


def pack(limits: Limits) -> bytes:
    """The bytes of joint limits."""
    joints = len(limits.orders)
    numbers = [0, *(n for n, table in REFERENCE_LIMITS.items() if len(table) == joints)]
    return min((_packed(limits, number) for number in numbers), key=len)


def _packed(limits: Limits, number: int) -> bytes:
    """The bytes of joint limits as departures from the reference of this number."""
    of = reference(number, len(limits.orders))
    kinds = _kinds(limits)
    orders = np.array([ORDERS.index(order) for order in limits.orders], np.int64)
    known: dict[str, Any] = {
        "reference": number,
        "orders": (orders - of.orders) % len(ORDERS),
        "kinds": (kinds - of.kinds) % KINDS,
    }
    ranged = (kinds == RANGE)[..., None]
    ranges, axes = np.where(ranged, limits.ranges, 0.0), _frame_angles(limits)
    if np.isfinite(ranges).all():
        for digits in range(MOST_DIGITS + 1):
            steps = _steps(ranges, digits), _axis_steps(axes, digits)
            if _same(limits, ranges, *steps, digits):
                ten = 10**digits
                values = {"ranges": (steps[0] - ten * of.ranges) * ranged, "axes": steps[1] - ten * of.frames}
                return LIMITS.pack({"exact": False, "digits": digits, **values, **known, **_NOT_EXACT})
    values = {"exact": True, "digits": 0, "ranges": None, "axes": None, **known}
    return LIMITS.pack({**values, "exact_ranges": limits.ranges, "exact_axes": limits.axes})


_NOT_EXACT: dict[str, Any] = {"exact_ranges": None, "exact_axes": None}


def unpack(data: bytes, joints: int) -> Limits:
    """The inverse of `pack`. Raises Corrupt."""
    values = LIMITS.unpack(data, joints=joints)
    of = reference(values["reference"], joints)
    orders = tuple(ORDERS[n] for n in ((values["orders"] + of.orders) % len(ORDERS)).tolist())
    try:
        if values["exact"]:
            return Limits(orders, values["exact_axes"], values["exact_ranges"])
        kinds, ten = (values["kinds"] + of.kinds) % KINDS, 10 ** values["digits"]
        ranges = _radians(values["ranges"] + ten * of.ranges, values["digits"])
        ranges[kinds == LOCKED] = 0.0
        ranges[kinds == UNLIMITED] = -np.inf, np.inf
        return Limits(orders, _frames(orders, _radians(values["axes"] + ten * of.frames, values["digits"])), ranges)
    except BadInput as problem:
        raise Corrupt(f"the skeleton's joint limits: {problem}") from None


def _kinds(limits: Limits) -> Integers:
    """(joints, 3): whether each axis is locked, unlimited or has a range."""
    low, high = limits.ranges[..., 0], limits.ranges[..., 1]
    kinds = np.full(low.shape, RANGE)
    kinds[np.isinf(low) & np.isinf(high)] = UNLIMITED
    kinds[(low == 0) & (high == 0)] = LOCKED
    return kinds


def _of_order(orders: tuple[str, ...]) -> Iterator[tuple[str, Booleans]]:
    """Each order that joints have, and which joints have it."""
    for order in sorted(set(orders)):
        yield order, np.array([one == order for one in orders])


def _frame_angles(limits: Limits) -> Floats:
    """Angles (joints, 3) of the axis frames, in the orders of the rotations."""
    angles = np.zeros((len(limits.orders), 3))
    for order, those in _of_order(limits.orders):
        angles[those] = rigid.to_euler(order, limits.axes[those])
    return angles


def _frames(orders: tuple[str, ...], angles: Floats) -> Floats:
    frames = np.zeros((len(orders), 4))
    for order, those in _of_order(orders):
        frames[those] = rigid.from_euler(order, angles[those])
    return frames


def _axis_steps(angles: Floats, digits: int) -> Integers:
    """Angles of frames in steps: half a turn is positive."""
    steps, half = _steps(angles, digits), 180 * 10**digits
    return np.where(steps == -half, half, steps)


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
