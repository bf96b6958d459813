"""From positions to quantised coefficients at a given quantisation step: the encoder of section IV-B.

PreparedMotion  rows of Mᵀ, clip lengths, left transform: the same for every step
quantise_motion PreparedMotion at one step ─► QuantisedMotion: shared header, coefficients Bᵀ M_i D̃ as integers
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ... import native
from ...stages import dct, quantise
from ...typing import Floats, Integers
from . import left_transform, parameters, stream
from .left_transform import LeftTransform
from .stream import QuantisedClips, SharedHeader

COMPONENT_LAMBDA = 0.16
"""RDO λ for the number of components: the squared error, in squared steps, that justifies one bit."""

BITS_PER_ENTRY = 2.1
"""Estimated bits per entry of a weak component of B at adaptive precision."""

BITS_PER_PUBLISHED_ENTRY = 16

SMOOTHED_FREQUENCIES = 2
"""How far beyond a frequency magnitudes count for its rounding."""

ALMOST_HALF = 0.49
"""Coefficients of this many steps round to zero, also where a stored basis is not quite orthonormal."""

ROUNDING = (0.02, 0.5)
"""Limits of the rounding offset of `quantise.forward`."""

WITHOUT_SIGN_BELOW = 1.5
"""Steps: rounding a smaller coefficient to zero saves the bit of its sign too."""

MIN_GEOMETRIC_RATIO = 1e-4
"""Lower limit of E / (1 + E), the ratio of the geometric distribution with mean magnitude E."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Mᵀ without gaps: positions (frames, 3 points), metres. weights (3 points,): of the rows of M, None for ones."""

    positions: Floats
    weights: Floats | None = None

    def weighted(self, rows: Floats) -> Floats:
        """Rows of Mᵀ (…, 3 points) times the weights."""
        return rows if self.weights is None else rows * self.weights

    @cached_property
    def mean(self) -> Floats:
        """The mean pose, (3 points,), metres."""
        return self.positions.mean(axis=0)

    @cached_property
    def centred(self) -> Floats:
        """Mᵀ about the mean pose, weighted, (frames, 3 points); not to be written to."""
        return self.weighted(self.positions - self.mean)


@dataclass(frozen=True, eq=False)
class PreparedMotion:
    """A motion and its coding parameters, independent of the quantisation step.

    rows: Mᵀ, with the weights of `weight_rungs`. lengths (N,): L_i. clip_frames: L; 0 if clips are adaptive.
    rung_offsets (N,): rungs to add to the common quantisation step of each clip. frequencies (N,): l_i at most; None
    for no limit. components: k at most; None for as many as reduce the cost. fitted: B of these rows; None if `learned`
    holds left transforms from a database. fitted_frequencies: where there is no limit, B is fitted to this number of
    the lowest frequencies of the whole motion; None for all. The others are those of `Hou2014` and `SharedHeader`.
    """

    points: int
    rows: Rows
    lengths: Integers
    clip_frames: int
    rung_offsets: Integers
    weight_rungs: Integers | None = None
    frequencies: Integers | None = None
    components: int | None = None
    unit: float = parameters.UNIT_M
    centre: bool = True
    compress_basis: bool = True
    economy: float = 0.0
    max_error: float | None = None
    fitted: LeftTransform | None = None
    fitted_frequencies: int | None = None
    learned: tuple[LeftTransform, ...] = ()

    @cached_property
    def spectra(self) -> tuple[ClipSpectra, ...]:
        """The spectra that all steps quantise, run after run."""
        rows = self.rows.centred
        spectra: list[ClipSpectra] = []
        for length, run, frames in _clip_runs(self.lengths):
            count = None if self.frequencies is None else int(self.frequencies[run.start])
            spectrum = dct.forward(rows[frames].reshape(-1, length, rows.shape[1]), count, axis=1)
            spectra.append(ClipSpectra(length, run, spectrum, np.sqrt(np.einsum("nfk,nfk->nf", spectrum, spectrum))))
        return tuple(spectra)


@dataclass(frozen=True, eq=False)
class ClipSpectra:
    """(M_i D̃)ᵀ of a run of clips of equal length, about the mean pose, with row weights.

    length: L. run: the clips. spectrum (clips, l, 3 points), metres. magnitudes (clips, l): Euclidean norms across
    points, which no coefficient of an orthonormal basis exceeds.
    """

    length: int
    run: slice
    spectrum: Floats
    magnitudes: Floats


@dataclass(frozen=True, eq=False)
class QuantisedMotion:
    """The header and all clips of a motion, quantised at one step."""

    header: SharedHeader
    clips: QuantisedClips


def with_fitted_transform(motion: PreparedMotion) -> PreparedMotion:
    """With B fitted to C = Σ M_i D̃ D̃ᵀ M_iᵀ: equation (5) and Theorem 1. Unchanged if transforms are learned."""
    if motion.learned:
        return motion
    rows = motion.rows.centred if motion.centre else motion.rows.weighted(motion.rows.positions)
    if motion.frequencies is None:
        lowest = rows if motion.fitted_frequencies is None else dct.forward(rows, motion.fitted_frequencies)
        return replace(motion, fitted=left_transform.fit_rows(lowest))
    spectra: list[Floats] = []
    for length, run, frames in _clip_runs(motion.lengths):
        count = int(motion.frequencies[run.start])
        spectra.append(
            dct.forward(rows[frames].reshape(-1, length, rows.shape[1]), count, axis=1).reshape(-1, rows.shape[1])
        )
    return replace(motion, fitted=left_transform.fit_rows(np.concatenate(spectra)))


def quantise_motion(motion: PreparedMotion, rung: int) -> QuantisedMotion:
    """Transform and quantise at a step of unit · 2^(rung / 64). Raises CannotEncode if the step is too small."""
    transforms = _rounded_transforms(motion, motion.unit * quantise.step(rung))
    header = SharedHeader(
        points=motion.points,
        transforms=transforms,
        components=min(map(len, transforms)),
        rung=rung,
        clip_frames=motion.clip_frames,
        unit=motion.unit,
        weight_rungs=motion.weight_rungs,
        max_error=motion.max_error,
        clip_steps=bool(motion.rung_offsets.any()),
        shared_transforms=bool(motion.learned),
    )
    if motion.centre:
        header = _with_mean_pose(header, motion)
    rest = motion.rows.weighted(motion.rows.mean - header.mean_pose)  # of the mean pose, which the clips code
    transform_index = _best_transforms(motion, header.mean_pose, transforms)
    spectra: list[Integers] = []
    for clips in motion.spectra:
        steps = header.steps_m(motion.rung_offsets[clips.run])
        projected = _project(clips, rest, steps, transforms, transform_index[clips.run])
        spectra.extend(_quantised(projected, steps, motion.economy))
    return _without_zero_components(header, motion, spectra, transform_index)


def _project(
    clips: ClipSpectra, rest: Floats, steps: Floats, transforms: tuple[LeftTransform, ...], transform_index: Integers
) -> Floats:
    """B_jᵀ M_i D̃ of a run of clips, transposed, in metres: (clips, l, k), up to the last frequency that matters.

    rest (3 points,): added to every frame. steps (clips,), metres.
    """
    large = (clips.magnitudes >= ALMOST_HALF * steps[:, None]).any(axis=0)
    reach = int(np.flatnonzero(large).max(initial=0)) + 1 + SMOOTHED_FREQUENCIES
    constant = rest * clips.length**0.5
    if len(transforms) == 1:
        projected = clips.spectrum[:, :reach] @ transforms[0].matrix
        projected[:, :1] += constant @ transforms[0].matrix
    else:
        matrices = [transforms[j].matrix for j in transform_index.tolist()]
        projected = np.stack([one[:reach] @ matrix for one, matrix in zip(clips.spectrum, matrices, strict=True)])
        projected[:, :1] += np.stack([constant @ matrix for matrix in matrices])[:, None]
    return projected


def _quantised(projected: Floats, steps: Floats, economy: float) -> Integers:
    """Coefficients (clips, l, k) as integers, without the highest frequencies: those below half a step.

    steps (clips,): in the unit of the coefficients. Raises CannotEncode if a step is too small.
    """
    largest, means = _magnitudes(projected, steps)
    known = int(np.flatnonzero(largest >= 0.5).max(initial=-1)) + 1
    quantise.require_exact(largest[:known].max(initial=0.0), float(steps.min()))
    bits = _bits_of_a_step(means[: known + SMOOTHED_FREQUENCIES])[:known] if economy else None
    return _to_integers(projected, steps, known, bits, economy)


def _magnitudes(projected: Floats, steps: Floats) -> tuple[Floats, Floats]:
    """Magnitudes in steps: the largest of each frequency, (l,), and the means over the clips, (l, k)."""
    if (kernel := native.kernel("clip_magnitudes")) is not None:
        return kernel(projected, steps)
    magnitudes = np.abs(projected / steps[:, None, None])
    return magnitudes.max(axis=(0, 2), initial=0.0), magnitudes.mean(axis=0)


def _bits_of_a_step(means: Floats) -> Floats:
    """What a step of a coefficient costs, from mean magnitudes (l, k): a Laplacian (two-sided geometric) model."""
    expected = _smooth_magnitudes(means)
    return -np.log2(np.maximum(expected / (1 + expected), MIN_GEOMETRIC_RATIO))


def _to_integers(projected: Floats, steps: Floats, known: int, bits: Floats | None, economy: float) -> Integers:
    """The lowest `known` frequencies (clips, known, k) as integers.

    bits (known, k): of a step of each coefficient, for rate–distortion optimised rounding; None rounds to nearest.
    economy: RDO λ, the squared error in squared steps that justifies one bit; 0.12 at high rates in theory.
    """
    if bits is not None and (kernel := native.kernel("clip_integers")) is not None:
        return kernel(projected, steps, bits, economy / 2, WITHOUT_SIGN_BELOW, *ROUNDING)
    scaled = projected[:, :known] / steps[:, None, None]
    rounding = 0.5
    if bits is not None:
        saved = np.where(np.abs(scaled) < WITHOUT_SIGN_BELOW, bits + 1, bits)
        rounding = np.clip(0.5 - economy / 2 * saved, *ROUNDING)
    return quantise.forward(scaled, 1.0, rounding)


def component_curves(motion: PreparedMotion, step: float) -> Floats:
    """Bᵀ M, transposed: (frames, k), the input of the DCT along time, before segmentation into clips."""
    transform = motion.learned[0] if motion.fitted is None else _worthwhile_components(motion, motion.fitted, step)
    return motion.rows.centred @ transform.matrix


def component_spectra(motion: PreparedMotion, step: float, every: int = 1) -> list[Floats]:
    """The coefficients of `component_curves`, (clips, l / every, k) of each run of clips of equal length.

    every: distance of the frequencies that are taken.
    """
    transform = motion.learned[0] if motion.fitted is None else _worthwhile_components(motion, motion.fitted, step)
    return [clips.spectrum[:, ::every] @ transform.matrix for clips in motion.spectra]


def _worthwhile_components(motion: PreparedMotion, fitted: LeftTransform, step: float) -> LeftTransform:
    """The leading components whose energy justifies the bits of their entries in B."""
    bits = 3 * motion.points * (BITS_PER_ENTRY if motion.compress_basis else BITS_PER_PUBLISHED_ENTRY)
    return fitted.leading(int((fitted.variances > COMPONENT_LAMBDA * bits * step**2).sum()))


def _clip_runs(lengths: Integers) -> list[tuple[int, slice, slice]]:
    """Runs of consecutive clips of equal length, as (length, clips, frames)."""
    starts = np.concatenate([[0], np.cumsum(lengths)])
    return [
        (length, run, slice(int(starts[run.start]), int(starts[run.stop])))
        for length, run in stream.equal_length_runs(lengths)
    ]


def _rounded_transforms(motion: PreparedMotion, step: float) -> tuple[LeftTransform, ...]:
    """The left transforms as the decoder will have them."""
    k = motion.components
    if motion.fitted is None:
        available = min(map(len, motion.learned))
        return tuple(one.leading(available if k is None else min(available, k)) for one in motion.learned)
    fitted = _worthwhile_components(motion, motion.fitted, step) if k is None else motion.fitted.leading(k)
    return (fitted.rounded(step) if motion.compress_basis else fitted.rounded_to_16_bits(),)


def _with_mean_pose(header: SharedHeader, motion: PreparedMotion) -> SharedHeader:
    """With the mean pose, rounded to multiples of step / √frames, since its error is the same in every frame."""
    rung = round(header.rung - quantise.LADDER * 0.5 * math.log2(len(motion.rows.positions)))
    step = header.unit * quantise.step(rung)
    return replace(header, mean_numbers=quantise.forward(motion.rows.mean, step), mean_rung=rung)


def _best_transforms(motion: PreparedMotion, mean_pose: Floats, transforms: tuple[LeftTransform, ...]) -> Integers:
    """Index of the left transform that keeps the most energy of each clip, (N,)."""
    lengths = motion.lengths
    if len(transforms) == 1:
        return np.zeros(len(lengths), np.int64)
    rows = motion.rows.weighted(motion.rows.positions - mean_pose)
    starts = np.cumsum(lengths) - lengths
    energies = [np.add.reduceat(np.einsum("fk,fk->f", c := rows @ one.matrix, c), starts) for one in transforms]
    return np.argmax(energies, axis=0)


def _smooth_magnitudes(magnitudes: Floats) -> Floats:
    """Weighted means over five frequencies and three components, (l, k)."""
    if (kernel := native.kernel("smooth_magnitudes")) is not None:
        return kernel(magnitudes)
    if not magnitudes.size:
        return magnitudes
    for axis, kernel in ((0, (1, 3, 4, 3, 1)), (1, (1, 2, 1))):
        values, reach = np.moveaxis(magnitudes, axis, 0), len(kernel) // 2
        padded = np.concatenate([values[:1].repeat(reach, 0), values, values[-1:].repeat(reach, 0)])
        smooth = np.zeros_like(values)
        for i, weight in enumerate(kernel):
            smooth += weight * padded[i : i + len(values)]
        magnitudes = np.moveaxis(smooth / sum(kernel), 0, axis)
    return magnitudes


def _without_zero_components(
    header: SharedHeader, motion: PreparedMotion, spectra: list[Integers], transform_index: Integers
) -> QuantisedMotion:
    """Without trailing components and frequencies whose coefficients are all zero."""
    k = max(stream.extent(spectrum)[1] for spectrum in spectra)
    clips = stream.join_clips(motion.lengths, spectra, transform_index, motion.rung_offsets, k)
    transforms = tuple(transform.leading(k) for transform in header.transforms)
    return QuantisedMotion(replace(header, transforms=transforms, components=k), clips)
