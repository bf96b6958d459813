"""From positions to quantised clips at a given step: what the codec's searches try out.

Material    rows, clips, basis: once for a motion
draft       Material at one step ─► head, quantised clips: B and S_i of section IV-B, rounded as the step deserves
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...motion import Floats
from ...stages import dct, quantise
from . import parameters, stream, transform
from .stream import Clips, Head
from .transform import Transform

Integers = NDArray[np.int64]

WORTH = 0.16
"""What a bit is worth in squared steps when components are chosen."""

ENTRY_BITS = 2.1
"""What an entry of the weakest components costs in the fine form."""


@dataclass(frozen=True, eq=False)
class Material:
    """A motion ready for coding.

    rows (frames, 3 points): Mᵀ, without gaps. lengths (N,): L_i. clip_frames: L, 0 for adaptive clips. frequencies
    (N,): at most l_i, where limited. components: at most k, where limited. offsets (N,): each clip's step in rungs
    above the common one. fitted: B of all rows; none where `given` holds transforms that were learned elsewhere.
    """

    points: int
    rows: Floats
    lengths: Integers
    clip_frames: int
    offsets: Integers
    weight_rungs: Integers | None = None
    frequencies: Integers | None = None
    components: int | None = None
    unit: float = parameters.UNIT_M
    centre: bool = True
    compress_basis: bool = True
    economy: float = 0.0
    max_error: float | None = None
    fitted: Transform | None = None
    given: tuple[Transform, ...] = ()

    @property
    def weights(self) -> Floats:
        return stream.row_weights(self.weight_rungs, self.points)


@dataclass(frozen=True, eq=False)
class Draft:
    """A motion coded at one step: everything but the bytes. `clips` are those of the whole motion."""

    head: Head
    clips: Clips


def fitted(material: Material) -> Material:
    """With B found from the rows, unless some is given: from C = Σ M_i D̃ D̃ᵀ M_iᵀ, equation (5) and Theorem 1."""
    if material.given:
        return material
    mean = material.rows.mean(axis=0) if material.centre else 0.0
    rows = (material.rows - mean) * material.weights
    if material.frequencies is None:
        return replace(material, fitted=transform.fit_rows(rows))
    spectra: list[Floats] = []
    for length, run, frames in clip_runs(material.lengths):
        kept = int(material.frequencies[run.start])
        spectra.append(
            dct.forward(rows[frames].reshape(-1, length, rows.shape[1]), kept, axis=1).reshape(-1, rows.shape[1])
        )
    return replace(material, fitted=transform.fit_rows(np.concatenate(spectra)))


def draft(material: Material, rung: int) -> Draft:
    """Code at a step of unit · 2^(rung / 64). Raises CannotEncode where the numbers would be too large."""
    step = material.unit * quantise.step(rung)
    transforms = _transforms(material, step)
    head = Head(
        points=material.points,
        transforms=transforms,
        components=min(map(len, transforms)),
        rung=rung,
        clip_frames=material.clip_frames,
        unit=material.unit,
        weight_rungs=material.weight_rungs,
        max_error=material.max_error,
        allocated=bool(material.offsets.any()),
        shared=bool(material.given),
    )
    rows = material.rows
    if material.centre:
        head = _with_mean(head, rows)
        rows = rows - head.mean_pose
    rows = rows * material.weights if material.weight_rungs is not None else rows
    choice = _choice(rows, material.lengths, transforms)
    spectra: list[Integers] = []
    for length, run, frames in clip_runs(material.lengths):
        curves = _project(rows[frames], length, transforms, choice[run])
        limit = None if material.frequencies is None else int(material.frequencies[run.start])
        scaled = dct.forward(curves, limit, axis=1) / head.step(material.offsets[run])[:, None, None]
        rounding = _economical(scaled, material.economy) if material.economy else 0.5
        spectra.extend(quantise.forward(scaled, 1.0, rounding))
    return _trimmed(head, material, spectra, choice)


def curves(material: Material, step: float) -> Floats:
    """The rows in the basis, (frames, k): what the DCT along time sees, whatever the clips."""
    matrix = material.given[0].matrix if material.fitted is None else _paying(material, material.fitted, step).matrix
    return (material.rows - material.rows.mean(axis=0)) * material.weights @ matrix


def _paying(material: Material, found: Transform, step: float) -> Transform:
    """The components whose energy is worth the bits of their entries."""
    bits = 3 * material.points * (ENTRY_BITS if material.compress_basis else 16)
    return found.leading(int((found.variances > WORTH * bits * step**2).sum()))


def clip_runs(lengths: Integers) -> list[tuple[int, slice, slice]]:
    """Runs of clips of one length, as (length, clips, frames)."""
    starts = np.concatenate([[0], np.cumsum(lengths)])
    return [(length, run, slice(int(starts[run.start]), int(starts[run.stop]))) for length, run in stream.runs(lengths)]


def _transforms(material: Material, step: float) -> tuple[Transform, ...]:
    if material.fitted is None:
        k = min(map(len, material.given))
        if material.components is not None:
            k = min(k, material.components)
        return tuple(one.leading(k) for one in material.given)
    found = material.fitted
    k = material.components
    found = _paying(material, found, step) if k is None else found.leading(k)
    return (found.rounded(step) if material.compress_basis else found.rounded_to_16_bits(),)


def _with_mean(head: Head, rows: Floats) -> Head:
    """With the mean pose, as finely as an error that stays for all frames deserves."""
    rung = round(head.rung - quantise.LADDER * 0.5 * math.log2(len(rows)))
    step = head.unit * quantise.step(rung)
    return replace(head, mean=quantise.forward(rows.mean(axis=0), step), mean_rung=rung)


def _choice(rows: Floats, lengths: Integers, transforms: tuple[Transform, ...]) -> Integers:
    """The transform that keeps most of each clip, (N,)."""
    if len(transforms) == 1:
        return np.zeros(len(lengths), np.int64)
    starts = np.cumsum(lengths) - lengths
    kept = [np.add.reduceat(np.einsum("fk,fk->f", c := rows @ one.matrix, c), starts) for one in transforms]
    return np.argmax(kept, axis=0)


def _project(rows: Floats, length: int, transforms: tuple[Transform, ...], choice: Integers) -> Floats:
    """B_jᵀ M_i of clips of one length, transposed: (clips, length, k)."""
    if len(transforms) == 1:
        return (rows @ transforms[0].matrix).reshape(len(choice), length, len(transforms[0]))
    clips = rows.reshape(-1, length, rows.shape[1])
    return np.stack([clip @ transforms[j].matrix for clip, j in zip(clips, choice, strict=True)])


def _economical(scaled: Floats, economy: float) -> Floats:
    """How to round each coefficient so that the bits it saves are worth the error: the offset of `quantise.forward`.

    scaled (clips, l, k): in steps. A Laplacian (two-sided geometric) law of the local mean size prices each number;
    `economy` is what a bit is worth in squared steps, 0.12 at high rates in theory.
    """
    sizes = np.abs(scaled)
    expected = _blurred(sizes.mean(axis=0))
    bits = -np.log2(np.maximum(expected / (1 + expected), 1e-4))
    worth = np.where(sizes < 1.5, bits + 1, bits)
    return np.clip(0.5 - economy / 2 * worth, 0.02, 0.5)


def _blurred(sizes: Floats) -> Floats:
    """Means over about five frequencies and three components, (l, k)."""
    for axis, kernel in ((0, (1, 3, 4, 3, 1)), (1, (1, 2, 1))):
        reach = len(kernel) // 2
        pad = [(0, 0), (0, 0)]
        pad[axis] = (reach, reach)
        wide = np.pad(sizes, pad, mode="edge") if sizes.size else sizes
        count = sizes.shape[axis]
        shifted = (wide.take(range(i, i + count), axis) * w for i, w in enumerate(kernel))
        sizes = sum(shifted, np.zeros_like(sizes)) / sum(kernel) if sizes.size else sizes
    return sizes


def _trimmed(head: Head, material: Material, spectra: list[Integers], choice: Integers) -> Draft:
    """Without components and frequencies that are zero throughout."""
    used = [np.flatnonzero(spectrum.any(axis=0)).max(initial=-1) + 1 for spectrum in spectra]
    k = int(max(used))
    clips = stream.assembled(material.lengths, [spectrum[:, :k] for spectrum in spectra], choice, material.offsets)
    return Draft(replace(head, transforms=tuple(one.leading(k) for one in head.transforms), components=k), clips)
