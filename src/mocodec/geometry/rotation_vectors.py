"""Rotation vectors (axis times angle, radians) and quaternions, and which of the vectors of a rotation it had.

v = a · û  ─►  q = (cos a/2, û sin a/2)         one q for each v shorter than a full turn: q and −q are two vectors
               largest part of q and its sign   "branch": picks q or −q again after small errors of the rotation
"""

from __future__ import annotations

import numpy as np

from ..typing import Booleans, Floats, Integers

CLEAR_W = 0.3
"""A branch is needed where w is below this: about 35° before the rotation by half a turn, where w changes sign."""
KEEP_PART = 0.3
"""A branch names the same part of the quaternion until it is below this: then errors of 35° cannot change its sign."""
PARTS = 4


def to_quaternions(vectors: Floats) -> Floats:
    """Unit quaternions (…, 4) of rotation vectors (…, 3); w is negative for angles beyond half a turn."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), vectors * (np.sinc(angle / (2 * np.pi)) / 2)], axis=-1)


def from_quaternions(quaternions: Floats) -> Floats:
    """Rotation vectors (…, 3), shorter than a full turn, of quaternions (…, 4) with their sign; of any length but 0."""
    size = np.linalg.norm(quaternions[..., 1:], axis=-1, keepdims=True)
    w = quaternions[..., :1]
    tiny = size < 1e-12 * np.abs(w)
    ratio = np.where(tiny, 2 / np.where(w == 0, 1.0, w), 2 * np.arctan2(size, w) / np.where(size == 0, 1.0, size))
    return quaternions[..., 1:] * ratio


def branches(vectors: Floats) -> Integers | None:
    """Integers (frames, joints) from which `with_branches` restores the vectors (frames, joints, 3); None if all are 0.

    2 · part + (1 if that part of the quaternion is negative) + 8 · (double turns beyond it): 0 for short vectors.
    """
    signed = to_quaternions(vectors)
    principal = from_quaternions(signed)
    length = np.linalg.norm(principal, axis=-1)
    along = np.einsum("fji,fji->fj", vectors, principal) / np.where(length > 0, length, 1.0)
    double_turns = np.rint((along - length) / (4 * np.pi)).astype(np.int64)
    codes = 2 * PARTS * double_turns
    for joint in np.flatnonzero((signed[..., 0] < CLEAR_W).any(axis=0)):
        codes[:, joint] += _signs(signed[:, joint])
    if not codes.any():
        return None
    fits = codes.min() >= -128 and codes.max() < 128
    return codes.astype(np.int8 if fits else np.int32)


def _signs(quaternions: Floats) -> Integers:
    """2 · part + (1 if negative) of quaternions (frames, 4): w, and other parts in long runs where w is small."""
    frames = len(quaternions)
    faint = [np.flatnonzero(np.abs(part) < KEEP_PART) for part in quaternions.T]
    codes = np.empty(frames, np.int64)
    frame = 0
    while frame < frames:
        size = np.abs(quaternions[frame])
        part = 0 if size[0] >= 0.5 else int(size.argmax())
        until = faint[part][np.searchsorted(faint[part], frame) :]
        end = int(until[0]) if len(until) else frames
        codes[frame:end] = 2 * part + (quaternions[frame:end, part] < 0)
        frame = end
    return codes


def with_branches(quaternions: Floats, codes: Integers | None) -> Floats:
    """Rotation vectors (frames, joints, 3) of quaternions (frames, joints, 4) of any sign; the inverse of `branches`.

    Rotations may differ from the ones that `branches` saw by up to 35°.
    """
    if codes is None:
        codes = np.zeros(quaternions.shape[:2], np.int64)
    sign, part, double_turns = codes % 2, codes // 2 % PARTS, codes // (2 * PARTS)
    chosen = np.take_along_axis(quaternions, part[..., None], axis=-1)[..., 0]
    wrong: Booleans = (chosen < 0) != (sign == 1)
    vectors = from_quaternions(np.where(wrong[..., None], -quaternions, quaternions))
    if not double_turns.any():
        return vectors
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors * (1 + 4 * np.pi * double_turns[..., None] / np.where(length > 0, length, 1.0))
