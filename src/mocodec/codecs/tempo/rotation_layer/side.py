"""Side values as coefficients: metres at joints and shell points, decorrelated, quantised and entropy coded.

    side values ─less the nominal─► ─Lᵀ─► metres ─DCT over the chunk, stored basis─► coefficients ─► integers ─► bytes

L Lᵀ is the Cholesky factorisation of G = Jᵀ J, with J the derivative of all joints and shell points by all side values
at the usual pose. An error of 1 in a coordinate is then an error of 1 m in the points, whatever the reach of a joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ....entropy.lanes import StaticTables
from ....stages import dct
from ....typing import Floats, Integers
from ..coding import contexts, quantise
from ..coding.rows import POSE, step_size
from ..models import stored_basis
from ..models.model import Statistics
from ..models.prior import Prior
from ..models.stored_basis import Components, StoredBasis
from . import shell, solve
from .rules import Rules

DIFFERENCE = 1e-4
"""Change of a side value for its derivative."""
RIDGE = 1e-5
"""G is made positive by this part of its largest diagonal entry."""
NOTHING = -4000
"""log₂, 1/32 octave, of the expected magnitude of rows that are not used: the heading and the place."""


def coordinates(rules: Rules, reach_m: float) -> Floats:
    """L (side_values, side_values): metres = side values · L. reach_m: of shell points."""
    count = rules.side_values
    if not count:
        return np.zeros((0, 0))
    usual = np.array([rule.usual for rule in rules.joints])[None]
    targets = shell.forward(rules.skeleton, usual, rules.own_frame)[0]
    values = np.tile(rules.nominal, (2 * count, 1))
    values[:count] += DIFFERENCE * np.eye(count)
    values[count:] -= DIFFERENCE * np.eye(count)
    local, positions = solve.solve(rules, np.tile(targets, (2 * count, 1, 1)), values)
    points = shell.points(rules.skeleton, local, positions, reach_m).reshape(2 * count, -1)
    derivative = (points[:count] - points[count:]) / (2 * DIFFERENCE)
    gram = derivative @ derivative.T
    largest = max(float(np.diag(gram).max(initial=0.0)), reach_m**2)
    return np.asarray(np.linalg.cholesky(gram + RIDGE * largest * np.eye(count)), np.float64)


@dataclass(frozen=True, eq=False)
class SideModel:
    """The expected magnitudes of the coefficients of side values, and how to get from one to the other.

    points: how many the lists of corrections may name. factor: L. Coefficients (frames, rows) begin with rows that are
    not used, so that the coder of positions codes them.
    """

    factor: Floats
    statistics: Statistics
    tables: StaticTables
    rate: float
    points: int
    nominal: Floats
    _expected: dict[int, Integers] = field(default_factory=dict)

    @classmethod
    def of(cls, stored: StoredBasis | None, prior: Prior, rules: Rules, factor: Floats, rate: float) -> SideModel:
        """stored: None where there are no side values."""
        if stored is None:
            nothing = np.zeros((POSE, prior.joints.statistics.spreads.shape[1]), np.int64)
            known = Statistics((np.zeros((0, 0)),), nothing, nothing[:, 0])
        else:
            known = stored.statistics(prior, rules.side_values, None)
        spreads, means = known.spreads.copy(), known.means.copy()
        spreads[:POSE], means[:POSE] = NOTHING, NOTHING
        points = len(rules.joints) + -(-rules.side_values // 3)
        return cls(factor, Statistics(known.bases, spreads, means), prior.tables, rate, points, rules.nominal)

    @property
    def rows(self) -> int:
        return len(self.statistics.spreads)

    @property
    def basis(self) -> Floats:
        """(components, dimensions)."""
        return self.statistics.bases[0]

    def expected(self, frames: int, step: int) -> Integers:
        """log₂ of the expected magnitudes, in steps, 1/32 octave: (frames, rows). Integer arithmetic only."""
        if frames not in self._expected:
            if len(self._expected) > 16:
                self._expected.clear()
            known = self.statistics
            self._expected[frames] = contexts.expect(known.spreads, known.means, frames, self.rate, 0)
        return self._expected[frames] - step

    def analyse(self, values: Floats) -> Floats:
        """Coefficients (frames, rows), metres, of side values (frames, n) less the nominal ones."""
        return np.pad(dct.forward(values @ self.factor) @ self.basis.T, ((0, 0), (POSE, 0)))

    def synthesise(self, coefficients: Floats, frames: int) -> Floats:
        """Side values (frames, n) of coefficients of the lowest frequencies."""
        return dct.inverse(coefficients[:, POSE:] @ self._inverse, frames) + self.nominal

    @cached_property
    def _inverse(self) -> Floats:
        return np.asarray(np.linalg.solve(self.factor.T, self.basis.T).T, np.float64)

    def quantised(self, coefficients: Floats, step: int, slope: float) -> quantise.Quantised:
        return quantise.quantise(self, coefficients / step_size(step), step, slope)

    def dequantised(self, values: Integers, step: int, frames: int) -> Floats:
        """Side values (frames, n) of integers (frequencies, rows)."""
        return self.synthesise(quantise.dequantise(values, np.full(self.rows, step_size(step))), frames)


def fit(chunks: Sequence[Floats], factor: Floats, prior: Prior, rate: float, step: int) -> StoredBasis:
    """Statistics of side values of chunks (frames, n), less the nominal ones, for about this step."""
    components = Components.of([dct.forward(values @ factor) for values in chunks])
    return stored_basis.fit(components, prior, rate, step)
