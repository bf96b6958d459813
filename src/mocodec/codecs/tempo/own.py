"""A model learned from the recording itself, and stored with it: for points that no prior knows, or long recordings.

    spectra of the recording ─fit─► mean pose, basis, gain of each component ─pack─► bytes ─unpack─► Model

The basis is rounded as finely as each component deserves (`stages.basis`), and completed to all dimensions, so that
what rounding and the weak components leave can still be coded. Of the spectra only one gain a component is stored: the
shape is that of the prior's component of the same rank.

Where the prior knows the points, its mean pose is kept, the basis is stored in terms of the prior's components, and it
serves the low frequencies only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...motion import Floats
from ...stages import basis
from . import body, contexts
from .model import EDGES_MHZ, POSE, Model, step_size
from .prior import PointSet, Prior

Integers = NDArray[np.int64]

GAIN_UNIT = 8
"""Gains are stored in quarters of an octave."""
POSE_COARSER = 64
"""The mean pose is rounded to steps of Δ/√frames, made coarser by this (1/32 octave)."""
WEAKEST = 96
"""A component is stored while its standard deviation is above Δ/√frames by this (1/32 octave)."""
COARSER = 36
"""Entries of the basis are rounded to steps of Δ/√(λ frames), made coarser by this (1/32 octave)."""
MEAN_BELOW = 128
"""A component's mean over a chunk against its movement at 0.2 Hz over the root of the frames (1/32 octave)."""
START_BAND = 1
"""The band whose components an own basis is stored in terms of, where the prior knows the points."""
OWN_BANDS, OWN_BELOW = 2, 8
"""The own basis then serves this many bands, and has spreads of its own below this number of `BANDS_MHZ`."""
FITTED_HZ = (0.3, 2.0)
"""Gains are measured between these."""


@dataclass(frozen=True, eq=False)
class Stored:
    """What is stored: the noise that everything is rounded by, the mean pose, gains, and the basis in bytes."""

    noise: int
    pose: Integers
    gains: Integers
    precision: Integers
    basis: bytes

    def pack(self) -> bytes:
        pose = coder.pack(np.diff(self.pose, axis=0, prepend=0)) if len(self.pose) else b""
        numbers = coder.pack(np.diff(np.concatenate([self.gains, self.precision]), prepend=0)[:, None])
        head = varint.write([varint.signed(self.noise), len(self.gains), len(pose), len(numbers)])
        return head + pose + numbers + self.basis

    @classmethod
    def unpack(cls, data: bytes, points: int, dimensions: int) -> Stored:
        """points: how many the mean pose has, 0 where it is the prior's. Raises Corrupt."""
        (noise, count, pose_size, gains_size), at = varint.read(data, 4)
        if not 2 <= count <= dimensions + 1 or noise > 6000 or at + pose_size + gains_size > len(data):
            raise Corrupt("tempo: a model that is out of range")
        pose = np.cumsum(coder.unpack(data[at : at + pose_size], (points, 3)), axis=0)
        at += pose_size
        numbers = np.cumsum(coder.unpack(data[at : at + gains_size], (2 * count - 1, 1))[:, 0])
        gains, precision = numbers[:count], numbers[count:]
        fits = (precision == precision.clip(0, basis.FINEST)).all() and (np.abs(gains) <= 4000).all()
        if not fits or (np.abs(pose) > 1 << 40).any():
            raise Corrupt("tempo: a model that is out of range")
        return cls(varint.unsigned(noise), pose, gains, precision, data[at + gains_size :])


def fit(
    positions: Sequence[Floats],
    prior: Prior,
    names: tuple[str, ...],
    rate: float,
    step: int,
    known: Model | None,
    limbs: PointSet | None = None,
) -> bytes:
    """The stored form of a model for the chunks (frames, points, 3), y up, of a recording to be coded in this step.

    known: what the prior makes of the points, if it knows them. limbs: the points as limbs that it does not know, if
    they are some; the basis is then one of their coordinates.
    """
    frames = sum(map(len, positions))
    noise = step - int(contexts.log2(np.array([frames]))[0]) // 2
    pose = np.zeros((0, 3), np.int64)
    if known is None and limbs is None:
        centred = np.concatenate([p - p.mean(axis=1, keepdims=True) for p in positions])
        mean = body.mean_pose(centred[:: max(1, frames // 2000)])
        pose = np.rint(mean / step_size(noise + POSE_COARSER)).astype(np.int64)
    start = _start(known, pose, noise, prior, names, rate, limbs)
    spectra = [start.analyse(p)[:, POSE:] for p in positions]
    if known is not None:
        for s in spectra:
            s[start.bands(len(s))[OWN_BANDS - 1].stop :] = 0.0
    vectors, variances = basis.fit(np.asarray(sum(s.T @ s for s in spectra)) / frames)
    strength = contexts.OCTAVE / 2 * np.log2(np.maximum(variances, 1e-30))
    count = int(np.clip((strength > noise + WEAKEST).sum(), 1, min(len(strength), frames)))
    shape = _shape(known.points if known else prior.sets[0], count + 1)
    gains = [_gain([s @ v for s in spectra], rate, g) for v, g in zip(vectors[:, :count].T, shape, strict=False)]
    precision = basis.precisions(variances[:count], float(step_size(noise + COARSER)))
    packed = basis.pack(vectors[:, :count], precision, _alike(pose))
    completed = _completed(basis.unpack(packed, len(vectors), precision, _alike(pose)))
    left = [s @ completed[:, count:] for s in spectra]
    last = _gain([np.sqrt((part**2).mean(axis=1)) for part in left], rate, shape[-1]) if left[0].shape[1] else gains[-1]
    rounded = np.rint(np.array([*gains, last]) / GAIN_UNIT).astype(np.int64)
    return Stored(noise, pose, rounded, precision, packed).pack()


def unpack(
    data: bytes,
    prior: Prior,
    names: tuple[str, ...],
    rate: float,
    known: Model | None,
    limbs: PointSet | None = None,
) -> Model:
    """The model of `fit`. Raises Corrupt."""
    dimensions = len(known.points.bases[0]) if known else 3 * len(names)
    if limbs is not None and limbs.limbs is not None:
        dimensions = limbs.limbs.dimensions
    stored = Stored.unpack(data, 0 if known or limbs else len(names), dimensions)
    found = _completed(basis.unpack(stored.basis, dimensions, stored.precision, _alike(stored.pose)))
    start = _start(known, stored.pose, stored.noise, prior, names, rate, limbs)
    own = found.T @ start.points.bases[0]
    count = len(stored.gains) - 1
    gains = np.concatenate([stored.gains[:-1], np.full(dimensions - count, stored.gains[-1])]) * GAIN_UNIT
    like = known.points if known else prior.sets[0]
    shape = _shape(like, count + 1)
    spreads = np.concatenate([shape[:-1], np.repeat(shape[-1:], dimensions - count, axis=0)]) + gains[:, None]
    means = spreads[:, 2] - MEAN_BELOW
    bases, below = [own] * len(like.bases), spreads.shape[1]
    if known is not None:
        bases[OWN_BANDS:], below = like.bases[OWN_BANDS:], OWN_BELOW
        spreads[:, below:] = like.spreads[POSE:, below:]
    points = PointSet(
        names,
        start.points.pose,
        tuple(bases),
        np.concatenate([like.spreads[:POSE], spreads]),
        np.concatenate([like.means[:POSE], means]),
        start.points.limbs,
        start.points.reach,
        start.points.columns,
    )
    return Model(points, prior, rate)


def _start(
    known: Model | None,
    pose: Integers,
    noise: int,
    prior: Prior,
    names: tuple[str, ...],
    rate: float,
    limbs: PointSet | None,
) -> Model:
    """The model whose components the basis is stored in: the prior's in one band, or each coordinate by itself."""
    if known is None:
        mean, components = pose * step_size(noise + POSE_COARSER), np.eye(3 * len(names))
    else:
        mean, components = known.points.pose, known.points.bases[START_BAND]
    spreads = np.zeros((POSE + len(components), len(contexts.BANDS_MHZ)), np.int64)
    bands = len(EDGES_MHZ) + 1
    if limbs is not None and limbs.limbs is not None:
        components = np.eye(limbs.limbs.dimensions)
        spreads = np.zeros((POSE + len(components), len(contexts.BANDS_MHZ)), np.int64)
        return Model(replace(limbs, bases=(components,) * bands, spreads=spreads, means=spreads[:, 0]), prior, rate)
    return Model(PointSet(names, mean, (components,) * bands, spreads, spreads[:, 0]), prior, rate)


def _shape(like: PointSet, count: int) -> Integers:
    """Spectra (components, bands) of the prior's components of the same rank, as if all were equally strong at 1 Hz."""
    known = like.spreads[POSE:]
    rank = np.minimum(np.arange(count), len(known) - 1)
    return known[rank] - known[rank][:, 5:6]


def _gain(curves: Sequence[Floats], rate: float, shape: Integers) -> float:
    """How much stronger than its shape a component's spectra (one a chunk) are, in 1/32 octave."""
    found, expected = 1e-9, 1e-9
    for c in curves:
        hertz = np.arange(len(c)) * rate / (2 * len(c))
        here = (hertz > FITTED_HZ[0]) & (hertz < FITTED_HZ[1])
        found += np.abs(c[here]).sum() / np.sqrt(rate / 120)
        expected += (2.0 ** (np.interp(hertz[here] * 1000, contexts.BANDS_MHZ, shape) / contexts.OCTAVE)).sum()
    return float(contexts.OCTAVE * np.log2(found / expected))


def _completed(basis_: Floats) -> Floats:
    """Orthonormal columns (n, k) with the n − k that are missing after them, by Householder's reflections."""
    n, k = basis_.shape
    rest, mirrors = basis_.copy(), []
    for i in range(k):
        mirror = rest[i:, i].copy()
        mirror[0] += 1.0 if mirror[0] >= 0 else -1.0
        mirror /= np.sqrt(mirror @ mirror)
        rest[i:] -= np.outer(2 * mirror, mirror @ rest[i:])
        mirrors.append(mirror)
    missing = np.eye(n)[:, k:]
    for i, mirror in reversed(list(enumerate(mirrors))):
        missing[i:] -= np.outer(2 * mirror, mirror @ missing[i:])
    return np.concatenate([basis_, missing], axis=1)


def _alike(pose: Integers) -> Integers | None:
    """For each coordinate that of the nearest point before it, (3 points,); −1 for the first point's."""
    if not len(pose):
        return None
    out = np.full((len(pose), 3), -1, np.int64)
    for i in range(1, len(pose)):
        nearest = int(((pose[:i] - pose[i]).astype(np.float64) ** 2).sum(axis=1).argmin())
        out[i] = 3 * nearest + np.arange(3)
    return out.ravel()
