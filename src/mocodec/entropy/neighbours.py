"""What a token's law depends on: the tokens around it that the decoder knows already, mixed to an expected token.

tokens (steps, lanes) ─of─► Neighbours ─expected(mixture)─► expected tokens, in sixteenths of a token
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..typing import AnyInteger, Bytes

MIXTURES = (
    (5, 2, 5, 2, 2, 0, 0),
    (0, 0, 0, 0, 0, 16, 0),
    (3, 1, 7, 3, 2, 0, 0),
    (0, 0, 8, 5, 3, 0, 0),
    (4, 2, 3, 2, 1, 4, 0),
    (7, 3, 3, 1, 2, 0, 0),
    (0, 0, 0, 0, 0, 0, 0),
    (3, 1, 3, 1, 0, 0, 8),
    (2, 0, 2, 0, 0, 4, 8),
    (1, 0, 1, 0, 0, 2, 12),
)
"""Weights in sixteenths of: the lane's last token and the one before it; the tokens of the lane before and of the one
before that, at this step; the lane before at the last step; the lane's running mean; the hint of the caller."""
WITHOUT_HINTS = 7
"""This many mixtures, the first, need no hints."""


def mean_shift(step: int) -> int:
    """A lane's running mean moves to its newest token by 2^−(this) of their difference."""
    return 1 if step == 0 else 2 if step < 3 else 3


class Neighbours(NamedTuple):
    """The five neighbours of MIXTURES of each token (steps, lanes); at the edges, the nearest inside.

    hints (steps, lanes): tokens of expected magnitudes.
    """

    token: AnyInteger
    near: tuple[AnyInteger, ...]
    hints: AnyInteger | None

    @classmethod
    def of(cls, token: Bytes, hints: Bytes | None) -> Neighbours:
        steps, lanes = token.shape
        padded = np.zeros((steps + 2, lanes + 2), np.int32)
        padded[2:, 2:] = token
        padded[:2, 3:] = token[:1, :-1]
        past, past2 = padded[1:-1, 2:], padded[:-2, 2:]
        padded[2:, 0] = padded[2:, 1] = past[:, 0]
        beside, beside2, corner = padded[2:, 1:-1], padded[2:, :-2].copy(), padded[1:-1, 1:-1].copy()
        beside2[:, 1:2] = token[:, :1]
        corner[:, 0] = past[:, 0]
        return cls(token, (past, past2, beside, beside2, corner), None if hints is None else hints.astype(np.int32))

    def expected(self, mixture: int) -> AnyInteger:
        """Expected tokens in sixteenths, as the decoder computes them."""
        *weights, mean, hint = MIXTURES[mixture]
        if mean:
            return self._add(_means(self.token, self.near[0]) * mean >> 8, weights, hint)
        return self._add(np.zeros(self.token.shape, np.int32), weights, hint)

    def roughly_expected(self, mixture: int, means: NDArray[np.float32]) -> AnyInteger:
        """About the same, from the means of `rough_means`, to choose a mixture by."""
        *weights, mean, hint = MIXTURES[mixture]
        return self._add((means * mean).astype(np.int32), weights, hint)

    def _add(self, result: AnyInteger, weights: list[int], hint: int) -> AnyInteger:
        for tokens, weight in zip(self.near, weights, strict=True):
            if weight:
                result += tokens * np.int32(weight)
        if self.hints is not None and hint:
            result += self.hints * np.int32(hint)
        return result


def _means(token: Bytes, past: AnyInteger) -> AnyInteger:
    """Each lane's running mean before each step, × 256."""
    if (kernel := native.kernel("entropy_means")) is not None:
        return kernel(token, past[0].astype(np.int32))
    steps, lanes = token.shape
    result = np.empty((steps, lanes), np.int32)
    result[0] = past[0] << 8
    if lanes < 8:  # Python's lists are faster than arrays this short
        for lane in range(lanes):
            value, values = int(result[0, lane]), []
            for t, now in enumerate(token[:, lane].tolist()):
                values.append(value)
                value += (now << 8) - value >> mean_shift(t)
            result[:, lane] = values
    else:
        scaled = token.astype(np.int32) << 8
        for t in range(steps - 1):
            np.add(result[t], scaled[t] - result[t] >> mean_shift(t), out=result[t + 1])
    return result


def rough_means(token: Bytes, past: AnyInteger) -> NDArray[np.float32]:
    """About `_means` / 256, without a loop over steps: each mean is 7/8 of the one before, summed by doubling."""
    means = past.astype(np.float32)
    means[1:] /= 8
    keep, reach = np.float32(7 / 8), 1
    while reach < min(len(token), 32):
        means[reach:] += means[:-reach] * keep
        keep, reach = keep * keep, 2 * reach
    return means
