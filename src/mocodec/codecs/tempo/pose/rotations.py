"""Rotation vectors, directions and frames, for many bones and frames at once.

A frame is its three axes, (3, 3, …), the axis first: `frame[a]` is where axis a points. The third axis of a bone's
frame is the bone's direction. Trailing axes are (bones, frames) or (frames,), so that the frames of a bone lie next to
each other in memory. Angles are in radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ....typing import Floats

LARGEST_SERIES_ANGLE_2 = 10.0
"""Squared angle up to which the series are exact to rounding: just beyond half a turn."""
AXES = np.eye(3)
_SINE_TERMS = tuple(1 / math.factorial(2 * k + 1) for k in range(8))
_COSINE_TERMS = tuple(1 / math.factorial(2 * k) for k in range(9))

_ARCTAN_NUMERATOR = (
    -8.750608600031904122785e-1,
    -1.615753718733365076637e1,
    -7.500855792314704667340e1,
    -1.228866684490136173410e2,
    -6.485021904942025371773e1,
)
_ARCTAN_DENOMINATOR = (
    2.485846490142306297962e1,
    1.650270098316988542046e2,
    4.328810604912902668951e2,
    4.853903996359136964868e2,
    1.945506571482613964425e2,
)
"""(arctan t − t) / t up to tan(π / 8) is a fraction in t² (Cephes, atan.c)."""


class SinCos(NamedTuple):
    """sin a / a, cos a and (1 − cos a) / a² of angles a, each in the shape of the angles."""

    sine: Floats
    cosine: Floats
    versed: Floats

    @classmethod
    def of(cls, squared: Floats) -> SinCos:
        """Sine and cosine of angles, from their squares.

        Small angles use series of a quarter of the angle: twice as fast as NumPy's sine.
        """
        if squared.max(initial=0.0) <= LARGEST_SERIES_ANGLE_2:
            quarter = squared * (-1 / 16)
            share, cosine = _series(quarter, _SINE_TERMS), _series(quarter, _COSINE_TERMS)
            share *= cosine
            cosine *= cosine
            cosine *= 2
            cosine -= 1
        else:
            half = np.maximum(np.sqrt(squared) * 0.5, 1e-150)
            share, cosine = np.sin(half) / half, np.cos(half)
        versed = share * share
        versed *= 0.5
        share *= cosine
        return cls(share, 1 - versed * squared, versed)

    def at(self, some: slice) -> SinCos:
        return SinCos(*(each[some] for each in self))


def _series(x: Floats, terms: Sequence[float]) -> Floats:
    """terms[0] + terms[1] x + terms[2] x² + …"""
    out = x * terms[-1]
    for term in terms[-2:0:-1]:
        out += term
        out *= x
    out += terms[0]
    return out


def squared_length(vectors: Floats) -> Floats:
    """Squared length of vectors (n, …), summed from the first coordinate on: `einsum` may fuse products and sums."""
    out = vectors[0] * vectors[0]
    for coordinate in vectors[1:]:
        out += coordinate * coordinate
    return out


def angle_of(y: Floats, squared_y: Floats, x: Floats) -> Floats:
    """arctan2(y, x) for y ≥ 0, with the bits of the compiled module: bases are fitted to coordinates (rotations4.h)."""
    half = y / np.maximum(np.sqrt(x * x + squared_y) + np.abs(x), 1e-300)
    t = half / (np.sqrt(half * half + 1) + 1)
    z = t * t
    p, q = z * _ARCTAN_NUMERATOR[0], z + _ARCTAN_DENOMINATOR[0]
    for term in _ARCTAN_NUMERATOR[1:]:
        p += term
        p *= z
    for term in _ARCTAN_DENOMINATOR[1:]:
        q *= z
        q += term
    angle = (t + t * (p / q)) * 4
    return np.where(x < 0, np.pi - angle, angle)


def tilted_directions(rest: Floats, tilts: Floats, trig: SinCos, out: Floats) -> None:
    """Directions (3, bones, frames) of bones with rest frames (3, 3, bones, 1) after tilts (2, bones, frames).

    A tilt is the sphere's exponential map: it moves the direction towards the first and the second axis.
    """
    np.multiply(rest[0], tilts[0] * trig.sine, out=out)
    out += rest[1] * (tilts[1] * trig.sine)
    out += rest[2] * trig.cosine


def tilted_frames(rest: Floats, tilts: Floats, trig: SinCos, out: Floats) -> None:
    """Frames (3, 3, bones, frames) after such tilts, by Rodrigues' formula: the smallest rotation of the direction."""
    tilt = rest[0] * tilts[0]
    tilt += rest[1] * tilts[1]
    np.multiply(tilt, trig.sine, out=out[2])
    out[2] += rest[2] * trig.cosine
    tilt *= trig.versed
    tilt += rest[2] * trig.sine
    np.subtract(rest[0], tilts[0] * tilt, out=out[0])
    np.subtract(rest[1], tilts[1] * tilt, out=out[1])


def frames_of(vectors: Floats) -> Floats:
    """Frames (3, 3, …) of rotation vectors (3, …)."""
    return frames_with(vectors, SinCos.of(squared_length(vectors)))


def frames_with(vectors: Floats, trig: SinCos) -> Floats:
    """The same, given sine and cosine of their lengths."""
    out = vectors[:, None] * (vectors * trig.versed)
    flat, across = out.reshape(9, *vectors.shape[1:]), vectors * trig.sine
    flat[::4] += trig.cosine
    flat[[5, 6, 1]] += across
    flat[[7, 2, 3]] -= across
    return out


def into(frames: Floats, vectors: Floats) -> Floats:
    """Vectors (3, …) expressed in frames (3, 3, …)."""
    out = frames[:, 0] * vectors[0]
    out += frames[:, 1] * vectors[1]
    out += frames[:, 2] * vectors[2]
    return out


def out_of(frames: Floats, vectors: Floats) -> Floats:
    """The inverse of `into`; also of the axes of frames, (3, 3, …)."""
    out = frames[0] * vectors[..., 0, None, :, :]
    out += frames[1] * vectors[..., 1, None, :, :]
    out += frames[2] * vectors[..., 2, None, :, :]
    return out


def tilt_to(directions: Floats) -> Floats:
    """Tilts (2, …) that take the third axis to directions (3, …) of any length: the sphere's logarithm."""
    squared = squared_length(directions[:2])
    horizontal = np.sqrt(squared)
    return directions[:2] * _ratio(angle_of(horizontal, squared, directions[2]), horizontal, 0.0)


def unwrapped(vectors: Floats) -> Floats:
    """Rotation vectors or tilts (n, …, frames) that continue past half a turn instead of jumping to the other side."""
    crossed = (np.diff(vectors) ** 2).sum(axis=0) > np.pi**2
    if not crossed.any():
        return vectors
    odd = np.zeros(vectors.shape[1:], bool)
    odd[..., 1:] = np.cumsum(crossed, axis=-1) % 2 == 1
    angle = np.sqrt((vectors**2).sum(axis=0))
    return np.where(odd, vectors * (1 - _ratio(np.full_like(angle, 2 * np.pi), angle, 0.0)), vectors)


def frame_of_pair(pair: Floats) -> Floats:
    """Matrices (frames, 3, 3), axes as columns, of two vectors (3, 2, frames): bisector, difference, normal."""
    a, b = unit(pair[:, 0]), unit(pair[:, 1])
    first, second = a + b, a - b
    third = cross(first, second)
    return np.stack([unit(first), unit(second), unit(third)], axis=-1).swapaxes(0, 1)


def relative_to(matrices: Floats, frame: Floats) -> Floats:
    """matrices (frames, 3, 3) · frameᵀ, from the first axis to the last, as the compiled module adds."""
    out = matrices[:, :, :1] * frame[:, 0]
    out += matrices[:, :, 1:2] * frame[:, 1]
    out += matrices[:, :, 2:] * frame[:, 2]
    return out


def frame_along(direction: Floats) -> Floats:
    """A rotation matrix (3, 3), axes as columns, whose third axis is this unit direction."""
    least = int(np.abs(direction).argmin())
    first = AXES[least] - direction * direction[least]
    first /= np.sqrt(first @ first)
    (a, b, c), (x, y, z) = first.tolist(), direction.tolist()  # single vectors: Python's floats are faster
    return np.array([[a, y * c - z * b, x], [b, z * a - x * c, y], [c, x * b - y * a, z]])


def cross(a: Floats, b: Floats) -> Floats:
    """a × b of vectors (3, …): the same bits as np.cross, which takes many times as long for single vectors."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def unit(vectors: Floats) -> Floats:
    """Vectors (3, …) of length 1; zero vectors stay zero."""
    return vectors / np.maximum(np.sqrt((vectors * vectors).sum(axis=0)), 1e-30)


def angle_between(a: Floats, b: Floats) -> Floats:
    """Between vectors (3, …)."""
    return np.arctan2(np.sqrt((cross(a, b) ** 2).sum(axis=0)), (a * b).sum(axis=0))


def rotation_between(rest: Floats, vectors: Floats) -> Floats:
    """Rotation vectors (3, frames) that bring a rigid set (n, 3) nearest to vectors (3, n, frames) (Kabsch)."""
    between = np.einsum("anf,nb->fab", vectors, rest)
    u, _, vt = np.linalg.svd(between)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return vector_of(u @ vt)


def rotated_onto(shape: Floats, target: Floats) -> Floats:
    """A rigid set (n, 3) rotated so that it lies nearest to another."""
    return shape @ frames_of(rotation_between(shape, target.T[..., None]))[..., 0]


def vector_of(matrices: Floats) -> Floats:
    """Rotation vectors (3, frames), at most π long, of rotation matrices (frames, 3, 3), by way of quaternions."""
    m = matrices
    trace = m.trace(axis1=1, axis2=2)
    largest = np.stack([trace, m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]]).argmax(axis=0)  # the part to divide by
    w = np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]])
    q = np.empty((4, len(m)))
    q[0], q[1:] = 1 + trace, w
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        here = largest == a + 1
        part = m[here]
        q[0, here] = w[a, here]
        q[1 + a, here] = 1 + part[:, a, a] - part[:, b, b] - part[:, c, c]
        q[1 + b, here] = part[:, b, a] + part[:, a, b]
        q[1 + c, here] = part[:, c, a] + part[:, a, c]
    q *= np.where(q[0] < 0, -1.0, 1.0)
    squared = squared_length(q[1:])
    size = np.sqrt(squared)
    return q[1:] * _ratio(2 * angle_of(size, squared, q[0]), size, 0.0)


def _ratio(a: Floats, b: Floats, otherwise: float) -> Floats:
    """a / b, or `otherwise` where b is tiny."""
    tiny = b < 1e-8
    return np.where(tiny, otherwise, a / np.where(tiny, 1.0, b))
