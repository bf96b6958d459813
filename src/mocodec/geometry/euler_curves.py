"""Euler angles of moving joints: curves that an animator can edit, and joints with fewer than three free axes.

`nearest`      the angles that come nearest to rotations, where some angles are given (locked axes, hinges)
`along_time`   the same, continuous over the frames: no jump of half or whole turns, none at gimbal lock

Two triples of angles make the same rotation: (a, b, c) and (a + π, π − b, c + π). Which of them continues the frame
before does not depend on the triple chosen there, so the choices of all frames are one cumulative sum.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..errors import BadInput
from ..typing import Floats
from . import rigid

LOCKED_RAD = 2e-6
"""A middle angle this near ±π/2 is gimbal lock: only the sum or the difference of the outer two is known."""


def nearest(order: str, q: Floats, fixed: Mapping[int, float] | None = None) -> Floats:
    """Angles (…, len(order)), radians, whose `rigid.from_euler` comes nearest to q (…, 4).

    order: at most three different axes. fixed: angles that are given, by their place in `order`. The free angles are
    in (−π, π], except that all three of three are those of `rigid.to_euler`. One free angle maximises a cos θ/2 +
    b sin θ/2; two maximise a bilinear form in (cos, sin) of both halves, which their sum and difference separate.
    Raises BadInput for axes that repeat.
    """
    fixed = fixed or {}
    if len(set(order)) != len(order) or not set(order) <= set("xyz"):
        raise BadInput(f"Euler angles need an order of different axes x, y, z, not {order!r}")
    free = [i for i in range(len(order)) if i not in fixed]
    if len(free) == 3:
        return rigid.to_euler(order, q)
    angles = np.zeros((*q.shape[:-1], len(order)))
    for i, value in fixed.items():
        angles[..., i] = value
    if len(free) == 1:
        cosine, sine = (_product(order, fixed, {free[0]: part}, q) for part in (0, 1))
        angles[..., free[0]] = _within_half_turn(2 * np.arctan2(sine, cosine))
    elif free:
        i, k = free
        m = [[_product(order, fixed, {i: s, k: t}, q) for t in (0, 1)] for s in (0, 1)]
        total = np.arctan2(m[1][0] + m[0][1], m[0][0] - m[1][1])  # (θi + θk) / 2
        difference = np.arctan2(m[1][0] - m[0][1], m[0][0] + m[1][1])
        angles[..., i] = _within_half_turn(total + difference)
        angles[..., k] = _within_half_turn(total - difference)
    return angles


def _product(order: str, fixed: Mapping[int, float], half_turns: Mapping[int, int], q: Floats) -> Floats:
    """The dot product (…,) of q with the rotation whose free axes turn by no turn (0) or half a turn (1)."""
    product = rigid.IDENTITY
    for i, axis in enumerate(order):
        angle = fixed[i] if i in fixed else np.pi * half_turns[i]
        product = rigid.multiply(product, rigid.about_axis(axis, np.asarray(angle)))
    return q @ product


def _within_half_turn(angles: Floats) -> Floats:
    return np.pi - (np.pi - angles) % (2 * np.pi)


def along_time(order: str, q: Floats, near: Floats | None = None, fixed: Mapping[int, float] | None = None) -> Floats:
    """As `nearest` of q (frames, 4), continuous over time, also beyond ±π, and beyond ±π/2 for the middle of three.

    near (len(order),): angles that those of the first frame should be near, such as the file's own; by default those
    of `nearest`. At gimbal lock the last angle stays what it was before, so that both outer angles are continuous.
    """
    angles = nearest(order, q, fixed)
    if not len(q):
        return angles
    if len(order) - len(fixed or {}) == 3:
        angles = _one_branch(order, angles, near)
    moving = [i for i in range(len(order)) if i not in (fixed or {})]
    angles[:, moving] = np.unwrap(angles[:, moving], axis=0)
    if near is not None:
        angles[:, moving] += 2 * np.pi * np.rint((near - angles[0]) / (2 * np.pi))[moving]
    return angles


def _one_branch(order: str, angles: Floats, near: Floats | None) -> Floats:
    """The one of the two triples of each frame (frames, 3) that continues the frame before, without whole turns."""
    locked = np.pi / 2 - np.abs(angles[:, 1]) < LOCKED_RAD
    known = np.flatnonzero(~locked)
    if len(known):
        free = angles[known]
        other = np.pi + free * [1.0, -1.0, 1.0]
        jumps = _turning(free[1:] - free[:-1]) > _turning(other[1:] - free[:-1])
        first = near is not None and bool(_turning(free[0] - near) > _turning(other[0] - near))
        is_other = np.concatenate([[first], first ^ (np.cumsum(jumps) % 2 == 1)])
        angles[known] = np.where(is_other[:, None], other, free)
    if locked.any():
        before = np.searchsorted(known, np.arange(len(angles)), side="right") - 1
        start = 0.0 if near is None else float(near[2])
        last = angles[known[np.maximum(before, 0)], 2] if len(known) else np.full(len(angles), start)
        even = 1.0 if order in ("xyz", "yzx", "zxy") else -1.0
        sign = even * np.sign(angles[:, 1])  # first + sign · last is what the rotation shows
        angles[locked, 0] += (sign * (angles[:, 2] - last))[locked]
        angles[locked, 2] = last[locked]
    return angles


def _turning(differences: Floats) -> Floats:
    """The sum of absolute differences of angles (…, 3), whole turns aside."""
    return np.abs(differences - 2 * np.pi * np.rint(differences / (2 * np.pi))).sum(axis=-1)


def distance(order: str, angles: Floats, q: Floats) -> Floats:
    """The angle (…,) between the rotations of `angles` and q (…, 4), radians."""
    dot = np.abs(np.sum(rigid.from_euler(order, angles) * q, axis=-1)) if order else np.abs(q[..., 0])
    return 2 * np.arccos(np.minimum(dot, 1.0))
