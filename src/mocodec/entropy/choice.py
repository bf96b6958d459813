"""The parameters that code an array shortest, found by counting some thousands of its tokens.

tokens ─► order of differences · Neighbours ─► counts per mixture and law ─► Parameters: what the stream begins with
"""

from __future__ import annotations

from functools import cache
from math import gcd
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..typing import AnyInteger, Bytes, Floats, Integers
from . import models
from .models import PRECISION, Tables
from .neighbours import MIXTURES, WITHOUT_HINTS, Neighbours, rough_means

OFFSETS = 8
"""Offsets along the ladder: −4 … 3."""
ZERO_LAWS = 32
"""This many laws, the first, may be the one where all neighbours are zero."""
COUNTED = 3000
"""Number of tokens that are counted, about."""


class Parameters(NamedTuple):
    """What a stream of `coder.pack` begins with, in this order.

    mixture: of neighbours. shape: of the laws. zero_law: the law where all neighbours are zero. offset: how many rungs
    wider than usual the other laws are, + 4. order: of differences along the steps. long_ladder: 1 for the long ladder
    of laws. rows, columns: how many are coded, see `kept`.
    """

    mixture: int
    shape: int
    zero_law: int
    offset: int
    order: int
    long_ladder: int
    rows: int
    columns: int

    @property
    def laws(self) -> int:
        return models.LAWS_LARGE if self.long_ladder else models.LAWS

    @property
    def family(self) -> Tables:
        return models.family(self.laws, self.shape)

    @property
    def ladder(self) -> Bytes:
        """The law of each expected token in sixteenths."""
        return models.law_of_expectation(self.laws, self.zero_law, self.offset - OFFSETS // 2)


@cache
def parameter_tables() -> Tables:
    """One table for each of `Parameters`, by how likely its values are."""
    zero_law = [2] * 4 + [4] * 8 + [6] * 10 + [3] * 6 + [1] * 4
    whole = [1] * 31 + [120]
    return Tables(
        [[12, 5, 8, 4, 6, 5, 5, 4, 4, 4], [2, 1], zero_law, [1, 2, 3, 5, 8, 5, 3, 2], [6, 2, 1], [20, 1], whole, whole]
    )


def kept(extent: int, symbol: int) -> int:
    """Rows (or columns) that are coded: symbol + 1 thirty-seconds of all, at least one; the others are zero."""
    return max(1, -(-extent * (symbol + 1) // 32))


def kept_symbol(extent: int, needed: int) -> int:
    """The symbol of `kept` that codes the fewest rows, at least `needed`."""
    exact = 32 * (needed - 1) // extent
    return 31 if kept(extent, exact) == extent else exact


def differences(v: Integers, order: int) -> Integers:
    """Differences along the steps, taken `order` times, the first from zero."""
    for _ in range(order):
        v = np.diff(v, axis=0, prepend=np.zeros((1, v.shape[1]), np.int64))
    return v


def best_order(v: Integers) -> int:
    """How often to take differences along the steps to make the numbers shortest: 0, 1 or 2."""
    if len(v) < 3 or np.abs(v).max() >= 1 << 59:
        return 0
    v = v[:, :: max(1, v.shape[1] // 512)]
    if v.size > 8 * COUNTED and len(v) >= 64:  # of a long array, eight runs of steps
        steps = max(8, COUNTED // v.shape[1])
        begins = np.linspace(0, len(v) - steps, 8).astype(int).tolist()
        bits = np.sum([_bits_by_order(v[a : a + steps], 2) for a in begins], axis=0)
    else:
        bits = _bits_by_order(v)
    bits[0] *= 0.97  # a tie goes to the numbers as they are
    return int(np.argmin(bits))


def _bits_by_order(v: Integers, begin: int = 0) -> Floats:
    """About how many bits the steps from `begin` take as they are, as first and as second differences."""
    return np.array([np.log2(1 + 2 * np.abs(differences(v, order)[begin:])).sum() for order in (0, 1, 2)])


def sample(token: AnyInteger, hints: AnyInteger | None) -> tuple[AnyInteger, AnyInteger | None]:
    """Tokens and hints of some runs of a long array, one behind the other, along its longer axis (see `bulk`)."""
    if token.shape[1] > len(token):
        token, hints = token.T, None if hints is None else hints.T
    if token.size <= 10 * COUNTED:
        return token, hints
    runs = min(8, max(1, len(token) // 128))
    steps = min(len(token), max(1, 10 * COUNTED // (runs * token.shape[1])))
    begins = np.linspace(0, len(token) - steps, runs).astype(int)
    places = np.unique(begins[:, None] + np.arange(steps))
    return token[places], None if hints is None else hints[places]


def choose(
    token: Bytes, hints: Bytes | None, order: int, long_ladder: int, rows: int, columns: int
) -> tuple[Parameters, float]:
    """The parameters that code these tokens shortest, and the bits a token then takes, without signs and mantissas.

    token, hints (steps, lanes). order, long_ladder, rows, columns: parameters that are decided already.
    """
    most = int(token.max()) + 1
    laws = models.LAWS_LARGE if long_ladder else models.LAWS
    mixtures = len(MIXTURES) if hints is not None else WITHOUT_HINTS
    counts, share, inactive = _counts(token, hints, laws, most)
    counts = counts * share
    counts[:, laws, 0] += inactive

    field_bits = _bits_of_tables(parameter_tables())
    cost = _bit_costs(laws)
    zero_bits = counts[:, laws] @ cost[:, :ZERO_LAWS, :most].reshape(-1, most).T
    zero_bits = zero_bits.reshape(mixtures, -1, ZERO_LAWS) + field_bits[2, :ZERO_LAWS]
    active = counts[:, :laws].reshape(mixtures, -1)
    seen = np.flatnonzero(active.any(axis=0))
    costs = _offset_costs(laws).take(seen // most * 256 + seen % most, axis=1)
    expected = active[:, seen].astype(np.float32) @ costs.T
    expected = expected.reshape(mixtures, -1, OFFSETS) + field_bits[3, :OFFSETS]
    total = zero_bits.min(axis=2) + expected.min(axis=2) + field_bits[0, :mixtures, None] + field_bits[1, :2]
    mixture, shape = (int(a) for a in np.unravel_index(total.argmin(), total.shape))
    zero_law, offset = int(zero_bits[mixture, shape].argmin()), int(expected[mixture, shape].argmin())
    fields = Parameters(mixture, shape, zero_law, offset, order, long_ladder, rows, columns)
    return fields, float(total[mixture, shape]) / token.size


def _counts(token: Bytes, hints: Bytes | None, laws: int, most: int) -> tuple[Integers, float, int]:
    """How often each token below `most` occurs in a sample under each rung that each mixture gives it, (mixtures,
    laws + 1, most), and `_some` of the sample. The last of the rungs is where all neighbours are zero."""
    mixtures = len(MIXTURES) if hints is not None else WITHOUT_HINTS
    ladder = _rung_or_zero(laws)
    if (kernel := native.kernel("entropy_counts")) is not None:
        no_hints = np.zeros((0, 0), np.uint8)
        counts, active, some, size = kernel(
            token, no_hints if hints is None else hints, ladder, np.array(MIXTURES[:mixtures]), laws, most, COUNTED
        )
        return counts, active / max(1, some), size - active
    around = Neighbours.of(token, hints)
    means = rough_means(token, around.near[0])
    some, share, inactive = _some(around, means)
    near = tuple(a.ravel()[some] for a in around.near)
    few = Neighbours(token.ravel()[some], near, None if around.hints is None else around.hints.ravel()[some])
    means = means.ravel()[some]
    keys = np.stack([ladder.take(few.roughly_expected(m, means)) + m * (laws + 1) for m in range(mixtures)]) * most
    keys += few.token
    counts = np.bincount(keys.ravel(), minlength=mixtures * (laws + 1) * most).reshape(mixtures, laws + 1, most)
    return counts, share, inactive


def _some(around: Neighbours, means: AnyInteger) -> tuple[AnyInteger, float, int]:
    """Places of a sample of the active tokens, those that are not zero or have a neighbour that is not; how many tokens
    each of them stands for; and how many tokens are not active."""
    any_active = np.bitwise_or.reduce([around.token, *around.near] + ([] if around.hints is None else [around.hints]))
    active = np.flatnonzero((any_active > 0) | (means >= 1 / 16))
    stride, lanes = max(1, len(active) // COUNTED), around.token.shape[1]
    while gcd(stride, lanes) > 1:  # a common factor would leave lanes out
        stride -= 1
    some = active[::stride]
    return some, len(active) / max(1, len(some)), any_active.size - len(active)


@cache
def _rung_or_zero(laws: int) -> Integers:
    """The law of each expected token in sixteenths; `laws` where that is zero."""
    ladder = models.law_of_expectation(laws, 0, 0).astype(np.int64)
    ladder[0] = laws
    return ladder


def _bits_of_tables(tables: Tables) -> Floats:
    return PRECISION - np.log2(np.maximum(tables.frequency.reshape(-1, tables.width), 1))


@cache
def _bit_costs(laws: int) -> NDArray[np.float32]:
    """Bits of each token under each law, escapes included, (shapes, laws, 256): to choose by, never to code with."""
    cost = np.full((len(models.SHAPES), laws, 256), 64, np.float32)
    for shape in range(len(models.SHAPES)):
        family = models.family(laws, shape)
        bits = _bits_of_tables(family)
        for law, size in enumerate(family.sizes[:-1].tolist()):
            cost[shape, law, : size - 1] = bits[law, : size - 1]
            cost[shape, law, size - 1 : family.width] = bits[law, size - 1] + bits[-1, : family.width - size + 1]
    return cost


@cache
def _offset_costs(laws: int) -> NDArray[np.float32]:
    """`_bit_costs` with each offset along the ladder: (shapes × offsets, laws × 256)."""
    rungs = np.clip(np.arange(laws) + np.arange(OFFSETS)[:, None] - OFFSETS // 2, 0, laws - 1)
    return _bit_costs(laws)[:, rungs].reshape(-1, laws * 256)
