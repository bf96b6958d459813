"""A chunk in one step: its integers, what they decode to, and how far that is from the samples.

    coefficients, step ─quantise─► integers ─synthesise─► positions ─errors─► distances · corrections within a bound

The compiled module does all of it in one call, without the interpreter; NumPy's integers are the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...typing import Booleans, Floats, Integers
from . import compiled_chunks
from .coding import coefficients, corrections, quantise, rows
from .models.model import Model


class Trial(NamedTuple):
    """quantised: integers (frequencies in the coded zone, rows), threshold, bits.

    distance: sum of the distances of samples that are not apart, times the points' weights, metres. squared: sum of the
    squared distances of all samples, m². decoded: positions (frames, points, 3), None unless they were asked for.
    """

    quantised: quantise.Quantised
    distance: float
    squared: float
    decoded: Floats | None


class Bounded(NamedTuple):
    """quantised: as in `Trial`, bits with those of the corrections. moved: `corrections.numbers`."""

    quantised: quantise.Quantised
    moved: Integers


def errors(model: Model, wanted: Floats, decoded: Floats, apart: Booleans) -> Floats:
    """Distances (frames, points) times the points' weights, 0 where samples are set apart."""
    d = np.where(apart, 0.0, np.sqrt(((wanted - decoded) ** 2).sum(axis=2)))
    return d if model.weights is None else d * model.weights


def of_step(
    model: Model, spectrum: Floats, wanted: Floats, apart: Booleans, step: int, slope: float, keeps: bool = False
) -> Trial:
    """The trial of a step (log₂ in 1/32 octave), with distances.

    spectrum: coefficients (frames, rows), metres. wanted: positions (frames, points, 3). apart (frames, points): mask
    of samples without an error. slope: λ. keeps: whether the decoded positions are wanted too.
    """
    if (found := compiled_chunks.of_step(model, spectrum, wanted, apart, step, slope, keeps)) is not None:
        values, threshold, bits, distance, squared, decoded = found
        return Trial(quantise.Quantised(values, threshold, bits), distance, squared, decoded)
    found, sizes = _quantised(model, spectrum, step, slope)
    decoded = model.synthesise(quantise.dequantise(found.values, sizes), len(spectrum))
    distance = float(errors(model, wanted, decoded, apart).sum())
    return Trial(found, distance, float(((wanted - decoded) ** 2).sum()), decoded if keeps else None)


def within_bound(
    model: Model,
    spectrum: Floats,
    wanted: Floats,
    apart: Booleans,
    step: int,
    slope: float,
    bound: float,
    grid: float,
    most_bits: float = np.inf,
) -> Bounded | None:
    """The trial of a step, with the corrections in steps of `grid` metres that bring all samples within the bound.

    None where the coefficients alone take `most_bits` or more: they are not decoded. The rest as in `of_step`. Raises
    CannotEncode for errors too large to correct.
    """
    asked = (step, slope, bound, grid, most_bits)
    if (compiled := compiled_chunks.within_bound(model, spectrum, wanted, apart, *asked)) is not None:
        values, threshold, bits, moved = compiled
        return None if values is None else Bounded(quantise.Quantised(values, threshold, bits), moved)
    found, sizes = _quantised(model, spectrum, step, slope)
    if found.bits >= most_bits:
        return None
    error = wanted - model.synthesise(quantise.dequantise(found.values, sizes), len(spectrum))
    error[apart] = 0.0
    if model.weights is not None:
        error *= model.weights[:, None]
    moved = corrections.numbers(corrections.find(error, bound, grid))
    return Bounded(found._replace(bits=found.bits + coefficients.list_coding(model, moved)[1]), moved)


def _quantised(model: Model, spectrum: Floats, step: int, slope: float) -> tuple[quantise.Quantised, Floats]:
    """Integers in the coded zone, and the steps (frames, rows), metres."""
    sizes, frames = rows.sizes(model.rows, len(spectrum), step), len(spectrum)
    found = quantise.quantise(model, spectrum / sizes, step, slope)
    known = coefficients.plan(model, frames, step, found.threshold, 0).frequencies
    return found._replace(values=found.values[:known]), sizes
