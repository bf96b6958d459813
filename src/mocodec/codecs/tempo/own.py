"""A model learned from the recording itself, and stored with it: for points that no prior knows, or long recordings.

    spectra of the recording ─fit─► mean pose, basis, gain of each component ─pack─► bytes ─unpack─► Model

The basis is rounded as finely as each component deserves (`stages.basis`). Of the spectra only one gain a component is
stored: the shape is that of the prior's component of the same rank.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...motion import Floats
from ...stages import basis
from . import body, contexts
from .model import POSE, Model, of_names, step_size
from .prior import PointSet, Prior

Integers = NDArray[np.int64]

GAIN_UNIT = 8
MEAN_FINER = 64
"""The mean pose is rounded to steps of Δ/√frames, made coarser by this (1/32 octave)."""


def fit(positions: Sequence[Floats], prior: Prior, names: tuple[str, ...], rate: float, step: int) -> bytes:
    """The stored form of a model for the chunks (frames, points, 3), y up, of a recording to be coded in this step.

    Where the prior knows the points, its mean pose is kept, and the basis is stored in terms of the prior's.
    """
    frames = sum(map(len, positions))
    noise = step - int(contexts.log2(np.array([frames]))[0]) // 2
    start = of_names(names, prior, rate)
    entries = np.zeros((0, 3), np.int64)
    if start is None:
        centred = np.concatenate([p - p.mean(axis=1, keepdims=True) for p in positions])
        pose = body.mean_pose(centred[:: max(1, frames // 2000)])
        entries = np.rint(pose / step_size(noise + MEAN_FINER)).astype(np.int64)
    plain = _start(start, entries, noise, prior, names, rate)
    spectra = [plain.analyse(p)[:, POSE:] for p in positions]
    own = [s if start is None else s[: 1 + int(len(s) * 4 / rate)] for s in spectra]
    moving = sum(s.T @ s for s in own) / frames
    vectors, variances = basis.fit(np.asarray(moving))
    strength = np.rint(contexts.OCTAVE / 2 * np.log2(np.maximum(variances, 1e-30))).astype(np.int64)
    count = int(np.clip((strength > noise + WEAKEST).sum(), 1, len(strength)))
    count = min(count, frames)
    shape = _shape(prior, count)
    seen = np.array([_gain(np.concatenate([(s @ v)[1:] for s in spectra]), spectra, rate, shape[c]) for c, v in enumerate(vectors[:, :count].T)])
    gains = np.rint(seen / GAIN_UNIT).astype(np.int64)
    precision = _precision(gains, noise)
    packed_pose = coder.pack(np.diff(entries, axis=0, prepend=0)) if len(entries) else b""
    packed_gains = coder.pack(np.diff(gains, prepend=0)[:, None])
    head = varint.write([varint.signed(noise), count, len(packed_pose), len(packed_gains)])
    return head + packed_pose + packed_gains + basis.pack(vectors[:, :count], precision, None if start else _alike(entries))


WEAKEST = 64
"""A component is kept while its standard deviation is above Δ/√frames by this (1/32 octave)."""


def unpack(data: bytes, prior: Prior, names: tuple[str, ...], rate: float) -> Model:
    """The model of `fit`. Raises Corrupt."""
    (noise, count, pose_size, gains_size), at = varint.read(data, 4)
    noise = varint.unsigned(noise)
    start = of_names(names, prior, rate)
    dimensions = len(start.points.bases[0]) if start else 3 * len(names)
    if not 1 <= count <= dimensions or abs(noise) > 6000 or at + pose_size + gains_size > len(data):
        raise Corrupt("tempo: a model that is out of range")
    entries = np.zeros((0, 3), np.int64)
    if start is None:
        entries = np.cumsum(coder.unpack(data[at : at + pose_size], (len(names), 3)), axis=0)
    at += pose_size
    gains = np.cumsum(coder.unpack(data[at : at + gains_size], (count, 1))[:, 0])
    if (np.abs(gains) > 4000).any() or (np.abs(entries) > 1 << 40).any():
        raise Corrupt("tempo: a model that is out of range")
    shape = _shape(prior, count)
    precision = _precision(gains, noise)
    found = basis.unpack(data[at + gains_size :], dimensions, precision, None if start else _alike(entries))
    plain = _start(start, entries, noise, prior, names, rate)
    low = found.T @ plain.points.bases[0]
    spreads = shape + gains[:, None] * GAIN_UNIT
    means = spreads[:, 2] - MEAN_BELOW
    if start is None:
        known = prior.sets[0]
        return replace(
            plain,
            points=replace(
                plain.points,
                bases=(low,) * len(known.bases),
                spreads=np.concatenate([known.spreads[:POSE], spreads]),
                means=np.concatenate([known.means[:POSE], means]),
            ),
        )
    known = start.points
    bases = list(known.bases)
    all_spreads, all_means = known.spreads.copy(), known.means.copy()
    for band in range(OWN_BANDS):
        bases[band] = np.zeros_like(known.bases[band])
        bases[band][:count] = low
    all_spreads[POSE:, :OWN_BELOW] = NEVER
    all_means[POSE:] = NEVER
    all_spreads[POSE : POSE + count, :OWN_BELOW] = spreads[:, :OWN_BELOW]
    all_means[POSE : POSE + count] = means
    return replace(plain, points=replace(known, bases=tuple(bases), spreads=all_spreads, means=all_means))


OWN_BANDS, OWN_BELOW = 2, 8
"""Where the prior knows the points, the own basis serves only the lowest bands, up to 2 Hz."""
NEVER = -4000
"""Spread of a component that is not there."""


MEAN_BELOW = 96
"""A component's mean over a chunk against its movement at 0.2 Hz over the root of the frames (1/32 octave)."""


def _start(
    start: Model | None, entries: Integers, noise: int, prior: Prior, names: tuple[str, ...], rate: float
) -> Model:
    """The model whose components the basis is stored in: the prior's in one band, or each coordinate by itself."""
    bands = len(prior.sets[0].bases)
    if start is None:
        pose, basis_ = entries * step_size(noise + MEAN_FINER), np.eye(3 * len(names))
    else:
        pose, basis_ = start.points.pose, start.points.bases[START_BAND]
    spreads = np.zeros((POSE + len(basis_), len(contexts.BANDS_MHZ)), np.int64)
    return Model(PointSet(names, pose, (basis_,) * bands, spreads, spreads[:, 0]), prior, rate)


START_BAND = 1


def _shape(prior: Prior, count: int) -> Integers:
    """Spectra (components, bands) of the prior's components of the same rank, without their strength."""
    known = prior.sets[0].spreads[POSE:]
    rank = np.minimum(np.arange(count), len(known) - 1)
    return known[rank] - known[rank][:, 5:6]


def _gain(values: Floats, spectra: Sequence[Floats], rate: float, shape: Integers) -> float:
    """How much stronger than its shape a component is, 1/32 octave."""
    logs = []
    at = 0
    for s in spectra:
        n = len(s) - 1
        f = np.arange(1, len(s)) * rate / (2 * len(s))
        here = (f > 0.3) & (f < 2)
        part = np.abs(values[at : at + n])[here]
        at += n
        if len(part):
            expected = 2.0 ** (np.interp(f[here] * 1000, contexts.BANDS_MHZ, shape) / contexts.OCTAVE)
            logs.append((part / np.sqrt(rate / 120)).sum() / expected.sum())
    return float(contexts.OCTAVE * np.log2(max(np.mean(logs) if logs else np.abs(values).mean() if len(values) else 1e-9, 1e-9)))


def _precision(gains: Integers, noise: int) -> Integers:
    """How finely each component is rounded: integers only."""
    strength = gains * GAIN_UNIT + STRENGTH
    return np.clip(2 * (strength - noise) // contexts.OCTAVE, 0, basis.FINEST)


STRENGTH = -105
"""From a component's gain (its magnitudes at 1 Hz) to its standard deviation over all frames, in 1/32 octave."""


def _alike(entries: Integers) -> Integers:
    """For each coordinate that of the nearest point before it, (3 points,); −1 for the first point's."""
    points = len(entries)
    out = np.full((points, 3), -1, np.int64)
    for i in range(1, points):
        nearest = int(((entries[:i] - entries[i]).astype(np.float64) ** 2).sum(axis=1).argmin())
        out[i] = 3 * nearest + np.arange(3)
    return out.ravel()
