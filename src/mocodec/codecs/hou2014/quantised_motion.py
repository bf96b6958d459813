"""From positions to quantised coefficients at a given quantisation step: the encoder of section IV-B.

PreparedMotion  rows of Mᵀ, clip lengths, left transform: the same for every step
quantise_motion PreparedMotion at one step ─► QuantisedMotion: shared header, coefficients Bᵀ M_i D̃ as integers
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

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

MIN_GEOMETRIC_RATIO = 1e-4
"""Lower limit of E / (1 + E), the ratio of the geometric distribution with mean magnitude E."""


@dataclass(frozen=True, eq=False)
class PreparedMotion:
    """A motion and its coding parameters, independent of the quantisation step.

    rows (frames, 3 points): Mᵀ without gaps, metres. lengths (N,): L_i. clip_frames: L; 0 if clips are adaptive.
    rung_offsets (N,): rungs to add to the common quantisation step of each clip. frequencies (N,): l_i at most; None
    for no limit. components: k at most; None for as many as reduce the cost. fitted: B of these rows; None if `learned`
    holds left transforms from a database. fitted_frequencies: where there is no limit, B is fitted to so many of the
    lowest frequencies of the whole motion; None for all. The other fields are those of `Hou2014` and `SharedHeader`.
    """

    points: int
    rows: Floats
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

    def weighted(self, rows: Floats) -> Floats:
        """Rows of Mᵀ (…, 3 points) times the weights of the points."""
        return rows if self.weight_rungs is None else rows * stream.row_weights(self.weight_rungs, self.points)

    @cached_property
    def mean(self) -> Floats:
        """The mean pose, (3 points,), metres."""
        return self.rows.mean(axis=0)

    @cached_property
    def spectra(self) -> tuple[ClipSpectra, ...]:
        """The spectra that all steps quantise, run after run."""
        rows = self.weighted(self.rows - self.mean)
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
    rows = motion.weighted(motion.rows - motion.mean if motion.centre else motion.rows)
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
    rest = motion.weighted(motion.mean - header.mean_pose)  # of the mean pose, which the clips code
    transform_index = _best_transforms(motion, header.mean_pose, transforms)
    spectra: list[Integers] = []
    for clips in motion.spectra:
        steps = header.steps_m(motion.rung_offsets[clips.run])
        scaled = _project(clips, rest, steps, transforms, transform_index[clips.run])
        spectra.extend(_quantised(scaled, motion.economy))
    return _without_zero_components(header, motion, spectra, transform_index)


def _project(
    clips: ClipSpectra, rest: Floats, steps: Floats, transforms: tuple[LeftTransform, ...], transform_index: Integers
) -> Floats:
    """B_jᵀ M_i D̃ of a run of clips, transposed, in steps: (clips, l, k), up to the last frequency that matters.

    rest (3 points,): added to every frame. steps (clips,), metres.
    """
    large = (clips.magnitudes >= ALMOST_HALF * steps[:, None]).any(axis=0)
    reach = int(np.flatnonzero(large).max(initial=0)) + 1 + SMOOTHED_FREQUENCIES
    constant = rest * clips.length**0.5
    if len(transforms) == 1:
        scaled = clips.spectrum[:, :reach] @ transforms[0].matrix
        scaled[:, :1] += constant @ transforms[0].matrix
    else:
        matrices = [transforms[j].matrix for j in transform_index.tolist()]
        scaled = np.stack([one[:reach] @ matrix for one, matrix in zip(clips.spectrum, matrices, strict=True)])
        scaled[:, :1] += np.stack([constant @ matrix for matrix in matrices])[:, None]
    scaled /= steps[:, None, None]
    return scaled


def _quantised(scaled: Floats, economy: float) -> Integers:
    """Coefficients (clips, l, k) in steps as integers, without the highest frequencies: those below half a step."""
    largest = np.maximum(scaled.max(axis=(0, 2), initial=0.0), -scaled.min(axis=(0, 2), initial=0.0))
    known = int(np.flatnonzero(largest >= 0.5).max(initial=-1)) + 1
    low = scaled[:, : known + SMOOTHED_FREQUENCIES]
    rounding = _rdo_rounding(low, economy)[:, :known] if economy else 0.5
    return quantise.forward(low[:, :known], 1.0, rounding)


def component_curves(motion: PreparedMotion, step: float) -> Floats:
    """Bᵀ M, transposed: (frames, k), the input of the DCT along time, before segmentation into clips."""
    transform = motion.learned[0] if motion.fitted is None else _worthwhile_components(motion, motion.fitted, step)
    return motion.weighted(motion.rows - motion.mean) @ transform.matrix


def component_spectra(motion: PreparedMotion, step: float) -> list[Floats]:
    """The coefficients of `component_curves`, (clips, l, k) of each run of clips of equal length."""
    transform = motion.learned[0] if motion.fitted is None else _worthwhile_components(motion, motion.fitted, step)
    return [clips.spectrum @ transform.matrix for clips in motion.spectra]


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
    rung = round(header.rung - quantise.LADDER * 0.5 * math.log2(len(motion.rows)))
    step = header.unit * quantise.step(rung)
    return replace(header, mean_numbers=quantise.forward(motion.mean, step), mean_rung=rung)


def _best_transforms(motion: PreparedMotion, mean_pose: Floats, transforms: tuple[LeftTransform, ...]) -> Integers:
    """Index of the left transform that keeps the most energy of each clip, (N,)."""
    lengths = motion.lengths
    if len(transforms) == 1:
        return np.zeros(len(lengths), np.int64)
    rows = motion.weighted(motion.rows - mean_pose)
    starts = np.cumsum(lengths) - lengths
    energies = [np.add.reduceat(np.einsum("fk,fk->f", c := rows @ one.matrix, c), starts) for one in transforms]
    return np.argmax(energies, axis=0)


def _rdo_rounding(scaled: Floats, economy: float) -> Floats:
    """Rate–distortion optimised rounding: the rounding offset of `quantise.forward` for each coefficient.

    scaled (clips, l, k): coefficients in steps. economy: RDO λ, the squared error in squared steps that justifies one
    bit; 0.12 at high rates in theory. The bits of a coefficient come from a Laplacian (two-sided geometric) model of
    the local mean magnitude.
    """
    magnitudes = np.abs(scaled)
    expected = _smooth_magnitudes(magnitudes.mean(axis=0))
    bits_per_unit = -np.log2(np.maximum(expected / (1 + expected), MIN_GEOMETRIC_RATIO))
    saved_bits = np.where(magnitudes < 1.5, bits_per_unit + 1, bits_per_unit)  # rounding to zero saves the sign too
    return np.clip(0.5 - economy / 2 * saved_bits, 0.02, 0.5)


def _smooth_magnitudes(magnitudes: Floats) -> Floats:
    """Weighted means over five frequencies and three components, (l, k)."""
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
    used = [np.flatnonzero(spectrum.any(axis=0)).max(initial=-1) + 1 for spectrum in spectra]
    k = int(max(used))
    clips = stream.join_clips(motion.lengths, [s[:, :k] for s in spectra], transform_index, motion.rung_offsets)
    transforms = tuple(transform.leading(k) for transform in header.transforms)
    return QuantisedMotion(replace(header, transforms=transforms, components=k), clips)
