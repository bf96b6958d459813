"""Rotations as unit quaternions, w first, in the last axis of an array; leading axes are free.

Euler angles are intrinsic rotations in the order of their letters: "zyx" is Rz · Ry · Rx (as BVH lists its channels).
"""

from __future__ import annotations

import numpy as np

from ..errors import BadInput
from ..typing import Floats

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
"""No rotation."""


def multiply(a: Floats, b: Floats) -> Floats:
    """a · b (…, 4): the rotation b, then a; leading axes broadcast."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    first = aw * bw - ax * bx - ay * by - az * bz
    product = np.empty((*first.shape, 4), first.dtype)
    product[..., 0] = first
    product[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    product[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    product[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return product


def inverse(q: Floats) -> Floats:
    """The inverse rotations of unit quaternions (…, 4)."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: Floats, v: Floats) -> Floats:
    """Vectors v (…, 3) rotated by q (…, 4): v + 2 u × (u × v + w v), with u the vector part of q."""
    u = q[..., 1:]
    return v + 2.0 * np.cross(u, np.cross(u, v) + q[..., :1] * v)


def about_axis(axis: str, angle: Floats) -> Floats:
    """(…, 4): rotations by `angle` (…), radians, about "x", "y" or "z". Raises BadInput for another axis."""
    half = np.asarray(angle) / 2
    result = np.zeros((*half.shape, 4))
    result[..., 0] = np.cos(half)
    result[..., 1 + _axis(axis)] = np.sin(half)
    return result


def from_euler(order: str, angles: Floats) -> Floats:
    """Quaternions (…, 4) of angles (…, len(order)), radians, about the axes of `order`, any number of them."""
    result = np.zeros((*angles.shape[:-1], 4))
    result[..., 0] = 1.0
    for i, axis in enumerate(order):
        rotation = about_axis(axis, angles[..., i])
        result = rotation if i == 0 else multiply(result, rotation)
    return result


def to_euler(order: str, q: Floats) -> Floats:
    """Angles (…, len(order)), radians, whose `from_euler` is q (…, 4), for an order of at most three different axes.

    The middle one of three angles is within ±π/2; at ±π/2 (gimbal lock) the last angle is 0. Raises BadInput for axes
    that repeat, and for rotations that fewer than three axes cannot represent.
    """
    order = order.lower()
    if len(set(order)) != len(order) or not set(order) <= set("xyz"):
        raise BadInput(f"Euler angles need an order of different axes x, y, z, not {order!r}")
    if len(order) < 3:
        angles = _to_fewer(order, q)
        if np.abs(np.abs(np.sum(from_euler(order, angles) * q, axis=-1)) - 1.0).max(initial=0.0) > 1e-6:
            raise BadInput(f"rotations about {' and '.join(order) or 'no axis'} alone do not make these rotations")
        return angles
    i, j, k = (_axis(axis) for axis in order)
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    m = to_matrix(q)
    sin_middle = np.clip(sign * m[..., i, k], -1.0, 1.0)
    locked = np.abs(sin_middle) > 1.0 - 1e-12
    first = np.where(
        locked,
        np.arctan2(sign * m[..., k, j], m[..., j, j]),
        np.arctan2(-sign * m[..., j, k], m[..., k, k]),
    )
    last = np.where(locked, 0.0, np.arctan2(-sign * m[..., i, j], m[..., i, i]))
    return np.stack([first, np.arcsin(sin_middle), last], axis=-1)


def _to_fewer(order: str, q: Floats) -> Floats:
    """Angles about at most two axes, in the whole circle; of two, as an order of three whose middle angle is 0."""
    if len(order) == 2:
        between = next(axis for axis in "xyz" if axis not in order)
        return to_euler(order[0] + between + order[1], q)[..., ::2]
    half = [np.arctan2(q[..., 1 + _axis(axis)], q[..., 0]) for axis in order]
    return np.stack([(2 * h + np.pi) % (2 * np.pi) - np.pi for h in half], axis=-1) if half else q[..., :0]


def to_matrix(q: Floats) -> Floats:
    """Rotation matrices (…, 3, 3) of unit quaternions (…, 4)."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _axis(letter: str) -> int:
    index = "xyz".find(letter.lower())
    if index < 0 or len(letter) != 1:
        raise BadInput(f"an axis is x, y or z, not {letter!r}")
    return index


def slerp(a: Floats, b: Floats, share: Floats) -> Floats:
    """Rotations between a and b (…, 4) along the shorter arc: a at share (…) 0, b at 1, of unit length."""
    dot = np.sum(a * b, axis=-1, keepdims=True)
    b, dot = np.where(dot < 0, -b, b), np.minimum(np.abs(dot), 1.0)
    share = np.asarray(share)[..., None]
    angle = np.arccos(dot)
    is_small = angle < 1e-4
    sine = np.where(is_small, 1.0, np.sin(angle))
    weight_a = np.where(is_small, 1 - share, np.sin((1 - share) * angle) / sine)
    between = weight_a * a + np.where(is_small, share, np.sin(share * angle) / sine) * b
    return between / np.linalg.norm(between, axis=-1, keepdims=True)
