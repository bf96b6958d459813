"""Rotations as unit quaternions, w first; the last axis holds the four numbers, leading axes are free.

Euler angles are read from left to right as intrinsic turns: order "zyx" is Rz · Ry · Rx (BVH's channels as written).
"""

from __future__ import annotations

import numpy as np

from ..errors import BadInput
from ..motion import Floats


def multiply(a: Floats, b: Floats) -> Floats:
    """a · b: first turn by b, then by a. (…, 4) each, broadcast."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def inverse(q: Floats) -> Floats:
    """The opposite turn of a unit quaternion (…, 4)."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: Floats, v: Floats) -> Floats:
    """Vectors v (…, 3) turned by q (…, 4): v + 2 u × (u × v + w v), with u the vector part of q."""
    u = q[..., 1:]
    return v + 2.0 * np.cross(u, np.cross(u, v) + q[..., :1] * v)


def about_axis(axis: str, angle: Floats) -> Floats:
    """Turns by `angle` (…), radians, about "x", "y" or "z"; (…, 4)."""
    result = np.zeros((*np.shape(angle), 4))
    result[..., 0] = np.cos(np.asarray(angle) / 2)
    result[..., 1 + _axis(axis)] = np.sin(np.asarray(angle) / 2)
    return result


def from_euler(order: str, angles: Floats) -> Floats:
    """Quaternions (…, 4) of turns about the axes of `order`, any number of them; angles (…, len(order)) in radians."""
    result = np.zeros((*angles.shape[:-1], 4))
    result[..., 0] = 1.0
    for i, axis in enumerate(order):
        turn = about_axis(axis, angles[..., i])
        result = turn if i == 0 else multiply(result, turn)
    return result


def to_euler(order: str, q: Floats) -> Floats:
    """Angles (…, len(order)) in radians whose `from_euler` is q, for an order of one to three different axes.

    Of three, the middle angle is within ±π/2; at ±π/2, where the outer two turn about the same axis, the last is 0.
    Raises BadInput where fewer than three axes cannot make the turn.
    """
    order = order.lower()
    if len(set(order)) != len(order) or not set(order) <= set("xyz"):
        raise BadInput(f"Euler angles need an order of different axes x, y, z, not {order!r}")
    if len(order) < 3:
        angles = _to_fewer(order, q)
        if np.abs(np.abs(np.sum(from_euler(order, angles) * q, axis=-1)) - 1.0).max(initial=0.0) > 1e-6:
            raise BadInput(f"turns about {' and '.join(order) or 'no axis'} alone do not make these rotations")
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
    """Angles about no, one or two axes; of two, the axis between them stands still, so both have the whole circle."""
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


def to_euler_along_time(order: str, q: Floats) -> Floats:
    """As `to_euler` of q (frames, 4), but of all angles that make the same turns those nearest to the frame before:
    angles that ran on past ±π, or past ±π/2 in the middle, come back as they were."""
    angles = to_euler(order, q)
    if len(order) != 3 or np.abs(np.diff(angles, axis=0)).sum(axis=1).max(initial=0.0) < np.pi / 2:
        return angles
    others = np.pi + angles * [1.0, -1.0, 1.0]  # the other triple of angles of a turn
    before = angles[0]
    for frame, choices in enumerate(np.stack([angles, others], axis=1)):
        choices = choices + 2 * np.pi * np.rint((before - choices) / (2 * np.pi))
        before = choices[np.abs(choices - before).sum(axis=1).argmin()]
        angles[frame] = before
    return angles
