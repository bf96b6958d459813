"""The form of a channel: the one that gives its samples back with the smallest integers (`forms`).

    constant ─► integers with a common step ─► counts of an earlier channel ─► counts of its own ─► corrected ─► grid

The first that suits is taken. Floats of few values have a palette, which the codec compares with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..typing import Booleans
from . import steps
from .forms import (
    CONSTANT,
    CORRECTED,
    COUNTS,
    GRID,
    INTEGERS,
    MANTISSA_BITS,
    MAX_CORRECTION,
    MAX_INTEGER,
    MAX_PALETTE,
    PALETTE,
    Form,
    extra_widths,
    forward,
    nearest_all,
    sortable,
    words,
)  # fmt: skip

Array = NDArray[Any]

PALETTE_SHARE = 0.9
"""A palette has at most this many values for each sample."""
MOST_SPECIAL = 0.03
"""The share of samples that may differ from their counts; zeros and gaps do not matter."""
GRID_BITS = 28
SAMPLE = 256
"""Number of samples that forms are compared on, about; the best is then checked on all samples."""
CORRECTION_COST = 2.0
"""Bits a sample that corrections take beyond the logarithm of their size."""


def fit(values: Array, known: list[Form]) -> Form | None:
    """The form of a channel (samples,): a known one that gives its values back, or the best of its own; None if its
    integers would be too large."""
    plain = words(values)
    if len(values) == 0 or (plain == plain[0]).all():
        return Form(CONSTANT, item=values[:1].tobytes() or bytes(values.dtype.itemsize))
    if values.dtype.kind in "biu":
        low, high = int(values.min()), int(values.max())
        step = _common_step(values) if high < 1 << 62 else 1
        return Form(INTEGERS, step) if low // step > -MAX_INTEGER and high // step < MAX_INTEGER else None
    binary = steps.binary(values, MANTISSA_BITS[values.dtype.itemsize]) or 0.0
    for form in _exact_forms([form for form in known if form.step > 0.9 * binary], values):
        return form
    candidates = count_forms(values, binary or None)
    best = _largest_step(list(_exact_forms(candidates, values)), values)
    return best or _corrected(values, [*known, *candidates]) or _grid(values)


def _largest_step(exact: list[Form], values: Array) -> Form | None:
    """The form with the fewest special samples; among equal ones the first of about the largest step."""
    special = [int(forward(form, values)[1].sum()) for form in exact]
    fewest = [form for form, count in zip(exact, special, strict=True) if count == min(special)]
    largest = max((form.step for form in fewest), default=0.0)
    return next((form for form in fewest if form.step > 0.99 * largest), None)


def _common_step(values: Array) -> int:
    """The greatest common divisor of integers."""
    step = 0
    for part in (values[: steps.SAMPLE], values[steps.SAMPLE :]):
        step = int(np.gcd(step, np.gcd.reduce(steps.distinct_of(part.astype(np.int64))))) if len(part) else step
        if step == 1:
            break
    return step


def palette(values: Array) -> Form | None:
    """The distinct values of a channel of floats, if they are few."""
    if values.dtype.kind != "f":
        return None
    most = min(MAX_PALETTE, int(PALETTE_SHARE * len(values)))
    if len(steps.distinct_of(words(values[:: max(1, len(values) // 512)]))) > 512 * PALETTE_SHARE:
        return None
    distinct = steps.distinct_of(sortable(values))
    return Form(PALETTE, palette=tuple(distinct.tolist())) if len(distinct) <= most else None


def count_forms(values: Array, exact: float | None) -> list[Form]:
    """Forms of counts that may give a channel of floats back; exact: a step of which all are multiples."""
    usable = steps.candidates(values, exact, MANTISSA_BITS[values.dtype.itemsize], MAX_INTEGER)
    return [Form(COUNTS, step, offset) for step, offset in usable]


def _exact_forms(forms: Sequence[Form], values: Array) -> Iterator[Form]:
    """The forms of counts that give nearly all samples of a channel back exactly; the first samples decide early."""
    if not forms:
        return
    usual = _usual(values[: 4 * SAMPLE])
    usual = (usual if len(usual) >= SAMPLE else _usual(values))[:SAMPLE]
    if not len(usual):
        return
    special = nearest_all(forms, usual)[1].sum(axis=1)
    for form, count in zip(forms, special, strict=True):
        if count <= MOST_SPECIAL * len(usual) and _are_few(forward(form, values)[1], values):
            yield form


def _corrected(values: Array, candidates: list[Form]) -> Form | None:
    """The form of counts with the smallest corrections in a sample, if they take less than the lower bits of a grid."""
    forms = [Form(CORRECTED, *form) for form in dict.fromkeys((form.step, form.offset) for form in candidates)]
    if not forms:
        return None
    grid = _grid(values)
    some = values[:: -(-len(values) // SAMPLE)]
    lower = extra_widths(grid, forward(grid, some)[0], some.dtype).mean()
    _, special, extra = nearest_all(forms, some)
    sizes = np.abs(extra)
    kept = np.maximum((~special).sum(axis=1), 1)
    bits = np.where(special, 0.0, np.log2(2.0 * np.minimum(sizes, MAX_CORRECTION) + 1)).sum(axis=1) / kept
    unusual = (special & (some != 0) & np.isfinite(some)).mean(axis=1)
    costs = bits + CORRECTION_COST - (np.log2([form.step for form in forms]) - grid.exponent) + 40 * unusual
    best = int(costs.argmin())
    is_shorter = costs[best] < lower and _are_few(forward(forms[best], values)[1], values)
    return forms[best] if is_shorter else None


def _grid(values: Array) -> Form:
    """A grid as fine as the last bit of the largest value, or coarser for integers of 28 bits."""
    finite = values[np.isfinite(values)].astype(np.float64)
    largest = float(np.abs(finite).max(initial=0.0)) or 1.0
    leading = int(np.frexp(largest)[1])
    return Form(GRID, exponent=leading - min(MANTISSA_BITS[values.dtype.itemsize] + 1, GRID_BITS))


def _usual(values: Array) -> Array:
    """Those that are finite and not 0."""
    return values[np.isfinite(values) & (values != 0)]


def _are_few(special: Booleans, values: Array) -> bool:
    """Whether few samples are special, but for gaps and the −0 of a plate that is switched off."""
    usual = np.isfinite(values) & (values != 0)
    return int((special & usual).sum()) <= MOST_SPECIAL * int(usual.sum()) and bool(usual.any())
