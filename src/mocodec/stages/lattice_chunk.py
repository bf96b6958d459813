"""One chunk of the lattice engine, sample by sample: what `lattice.h` of the compiled module does, in Python.

    for each point, after its neighbours; for each level of frames, coarse to fine; for each frame of the level:
        prediction (recursive least squares) ─► along the direction to the partner: kept at their mean distance
        ─► residual in axes along and across that direction ─► lattice point ─► bits in contexts of activities nearby

Encoder and decoder run the same code; `lattice_points` turns lattice points into bits. Floats are computed in the
same order everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..entropy import adaptive_bits
from ..typing import Floats
from .lattice_points import PointCoder, TooLarge, Vector, coarse_log, square

NEIGHBOURS, OWN = 3, 4
FEATURES = OWN + 2 * NEIGHBOURS
FORGETTING, FIRST_COVARIANCE = 0.999, 1 / 128
DISTANCE_MEMORY, RADIAL_MEMORY = 0.995, 0.98
NEAR = 8.0
"""Partners nearer than this, half steps, have no direction."""
LIMIT = 2.0**40
EDGE, ORIGIN = 7, 6
"""Classes of samples beside gaps and ends, and of the first sample."""
LARGEST_ACTIVITY = 4000


class _Predictor:
    """Recursive least squares: one set of weights for the three axes."""

    def __init__(self, weights: Floats) -> None:
        self.weights = weights.copy()
        self._reset()

    def _reset(self) -> None:
        self._covariance = np.eye(FEATURES) * FIRST_COVARIANCE

    def predict(self, x: Vector) -> float:
        total = 0.0
        for weight, value in zip(self.weights.tolist(), x, strict=True):
            total += weight * value
        return total

    def learn(self, x: Vector, error: float, forgetting: float) -> None:
        gain = np.zeros(FEATURES)
        for row, value in zip(self._covariance, x, strict=True):
            gain += row * value
        power = forgetting
        for each, value in zip(gain.tolist(), x, strict=True):
            power += each * value
        if not 0.5 * forgetting <= power < 1e300:
            self._reset()
            return
        scaled = gain * (1 / power)
        self.weights += scaled * error
        self._covariance = (self._covariance - scaled[:, None] * gain) * (1 / forgetting)


class _Chunk:
    """wanted (points, frames, 3) in half steps, None for a decoder; missing (frames, points); the first neighbour of
    each point in (points, 3) is its partner."""

    def __init__(
        self,
        wanted: Floats | None,
        missing: NDArray[np.uint8],
        sequence: NDArray[np.int32],
        neighbours: NDArray[np.int32],
        stride: int,
        coder: PointCoder,
    ) -> None:
        self.frames, self.points = missing.shape
        self.wanted = None if wanted is None else wanted.tolist()
        self.missing = missing.T.tolist()
        self.sequence, self.stride = sequence.tolist(), stride
        self.neighbours = [[n for n in row if n >= 0] for row in neighbours.tolist()]
        self.coder = coder
        self.decoded: list[list[Vector]] = [[[0.0] * 3 for _ in range(self.frames)] for _ in range(self.points)]
        self.activity = [[0] * self.frames for _ in range(self.points)]
        self.radial = [[0] * self.frames for _ in range(self.points)]
        self.mean_weights = [np.zeros(FEATURES) for _ in range(stride + 1)]
        for weights in self.mean_weights[1:]:
            weights[0] = -0.0625
        self.level_activity = [64 * 16] * (stride + 1)

    def run(self) -> Floats:
        for point in self.sequence:
            self.p = point
            self.near = self.neighbours[self.p]
            self.here, self.partner = self.decoded[self.p], self.decoded[self.near[0]] if self.near else None
            self.distance = self.distances = 0.0
            for level in range(self.stride + 1):
                self.level = level
                self._level()
        return np.array(self.decoded, np.float64).reshape(self.points, self.frames, 3)

    def _level(self) -> None:
        half = 1 << (self.stride - self.level)
        step = 2 * half if self.level else half
        self.half, self.step = half, step
        self.predictor = _Predictor(self.mean_weights[self.level])
        self.slow = self.level_activity[self.level]
        self.radial_square, self.radial_product = 1e-3, 0.0
        for t in range(half if self.level else 0, self.frames, step):
            if self.missing[self.p][t]:
                self.here[t] = _limited(self._followed(t), None)
                self.activity[self.p][t] = self.activity[self.p][t - step] if t >= step else 0
            else:
                self._sample(t)
        self.level_activity[self.level] = (self.level_activity[self.level] * 7 + self.slow * 3) // 10
        self.mean_weights[self.level] = (self.mean_weights[self.level] + self.predictor.weights) / 2

    def _sample(self, t: int) -> None:
        missing, half = self.missing[self.p], self.half
        if self.level:
            inside = t + half < self.frames and not missing[t - half] and not missing[t + half]
        else:
            inside = t >= 2 * half and not missing[t - half] and not missing[t - 2 * half]
        base, features = self._followed(t), [[0.0] * FEATURES] * 3
        guess = base
        if inside:
            base, features = self._interpolated(t) if self.level else self._extrapolated(t)
            guess = [b + self.predictor.predict(x) for b, x in zip(base, features, strict=True)]
        else:
            guess = [b + 0.0 for b in base]
        linear = _limited(guess, base)
        axes, guess, away = self._towards_partner(t, linear, inside)
        kinds = self._contexts(t, inside, axes is not None)
        z = self.coder.code(self._residual(t, guess, axes), *kinds)
        x, y, w = map(float, z)
        u, v, n = axes or _STRAIGHT
        value = [guess[k] + (u[k] * x + v[k] * y + n[k] * w) for k in range(3)]
        self.here[t] = value
        total = min(LARGEST_ACTIVITY, sum(map(abs, z)))
        self.activity[self.p][t] = total
        self.radial[self.p][t] = min(LARGEST_ACTIVITY, abs(z[0]))
        if inside:
            self.slow += (total * 256 - self.slow) >> 4
        self._measure(t, value, linear, axes, away)
        if inside:
            for k in range(3):
                error = value[k] - base[k] - self.predictor.predict(features[k])
                self.predictor.learn(features[k], error, FORGETTING if k == 0 else 1.0)

    def _followed(self, t: int) -> Vector:
        """The prediction beside a gap or an end: the frame before or after, moved as the partner moves between the two;
        where both are decoded or both are gaps, their mean."""
        half, missing = self.half, self.missing[self.p]
        before, after = t >= half, self.level > 0 and t + half < self.frames
        if not before and not after:
            return self.partner[t] if self.partner is not None else [0.0] * 3
        if before and after and missing[t - half] == missing[t + half]:
            return [(a + b) / 2 for a, b in zip(self.here[t - half], self.here[t + half], strict=True)]
        from_before = before and not (after and missing[t - half] and not missing[t + half])
        start = t - half if from_before else t + half
        if self.partner is None:
            return self.here[start]
        moved = zip(self.here[start], self.partner[t], self.partner[start], strict=True)
        return [a + (b - c) for a, b, c in moved]

    def _extrapolated(self, t: int) -> tuple[Vector, list[Vector]]:
        """Level 0: from the two frames before, each `half` apart."""
        half, here = self.half, self.here
        base, features = [], []
        for k in range(3):
            x = [0.0] * FEATURES
            base.append(2 * here[t - half][k] - here[t - 2 * half][k])
            for i in range(OWN):
                if t >= (i + 3) * half:
                    x[i] = _bend(here, t - (i + 1) * half, half, k)
            for q, n in enumerate(self.near):
                other = self.decoded[n]
                x[OWN + 2 * q] = _bend(other, t, half, k)
                if t + half < self.frames:
                    x[OWN + 2 * q + 1] = _bend(other, t + half, half, k)
            features.append(x)
        return base, features

    def _interpolated(self, t: int) -> tuple[Vector, list[Vector]]:
        """Other levels: from the frames around, each `half` apart."""
        half, frames = self.half, self.frames
        base, features = [], []
        for k in range(3):

            def at(s: int, otherwise: float, k: int = k) -> float:
                return self.here[s][k] if 0 <= s < frames else otherwise

            left, right = self.here[t - half][k], self.here[t + half][k]
            left3, right3 = at(t - 3 * half, 2 * left - right), at(t + 3 * half, 2 * right - left)
            left5, right5 = at(t - 5 * half, 2 * left3 - left), at(t + 5 * half, 2 * right3 - right)
            x = [0.0] * FEATURES
            base.append((left + right) / 2)
            x[0] = (left3 - left) - (right - right3)
            x[1] = self.here[t - 2 * half][k] - (left3 + left) / 2 if t >= 2 * half else 0.0
            x[2] = (left5 - left3) - (right3 - right5)
            x[3] = self.here[t - 4 * half][k] - (left3 + left5) / 2 if t >= 4 * half else 0.0
            for q, n in enumerate(self.near):
                other = self.decoded[n]
                off: Callable[[int], float] = lambda s, other=other, k=k: (  # noqa: E731
                    0.0
                    if s < half or s + half >= frames
                    else other[s][k] - (other[s - half][k] + other[s + half][k]) / 2
                )
                x[OWN + 2 * q] = off(t)
                x[OWN + 2 * q + 1] = off(t - half) + off(t + half)
            features.append(x)
        return base, features

    def _towards_partner(self, t: int, linear: Vector, inside: bool) -> tuple[list[Vector] | None, Vector, float]:
        """Axes along and across the direction from the partner, the guess at the mean distance, and by how much the
        distance was off; no axes where there is no direction."""
        if self.partner is None or not inside or not self.distances > 0:
            return None, linear, 0.0
        direction = [g - p for g, p in zip(linear, self.partner[t], strict=True)]
        length = math.sqrt(square(direction))
        if not length > NEAR:
            return None, linear, 0.0
        u = [d / length for d in direction]
        away = self.distance / self.distances - length
        share = min(1.0, max(0.0, self.radial_product / self.radial_square))
        return _frame(u), [g + share * away * a for g, a in zip(linear, u, strict=True)], away

    def _measure(self, t: int, value: Vector, linear: Vector, axes: list[Vector] | None, away: float) -> None:
        """Mean distance to the partner, and how much of a distance that was off to put right."""
        if self.partner is None:
            return
        length = math.sqrt(square([v - p for v, p in zip(value, self.partner[t], strict=True)]))
        self.distance = self.distance * DISTANCE_MEMORY + length
        self.distances = self.distances * DISTANCE_MEMORY + 1
        if axes is not None:
            along = 0.0
            for k in range(3):
                along += axes[0][k] * (value[k] - linear[k])
            self.radial_square = self.radial_square * RADIAL_MEMORY + away * away
            self.radial_product = self.radial_product * RADIAL_MEMORY + away * along

    def _contexts(self, t: int, inside: bool, has_axes: bool) -> tuple[int, int]:
        """Contexts from activities nearby; returns the sample's class and the context of the radial coordinate."""
        half, step, own = self.half, self.step, self.activity[self.p]
        before = own[t - step] if t >= step else self.slow // 256
        before2 = own[t - 2 * step] if t >= 2 * step else before
        beside = [self.activity[n][t] for n in self.near] or [before]
        beside += [beside[-1]] * (3 - len(beside))
        following = bool(self.near) and t + step < self.frames
        after = self.activity[self.near[0]][t + step] if following else beside[0]
        around = 2 * before
        if self.level:
            around = own[t - half] + own[t + half if t + half < self.frames else t - half]
        first = self.p == self.sequence[0] and t == 0 and self.level == 0
        c = ORIGIN if first else min(self.level, 5) if inside else EDGE
        mean, mine = coarse_log(self.slow // 16), coarse_log(8 * (2 * before + before2))
        near = coarse_log(8 * (beside[0] + beside[1]) + 4 * (beside[2] + after))
        outer = coarse_log(8 * around)
        nearby = 8 * (2 * beside[0] + beside[1] + beside[2])
        every = coarse_log((self.slow // 16 * 2 + 10 * (2 * before + before2) + nearby) // 4)
        self.coder.mixer.contexts(
            [
                c * 24 + mean,
                200 + mine * 24 + near,
                1000 + (c * 24 + near) * 24 + mean,
                8000 + (c * 24 + outer) * 24 + near,
                14000 + c * 24 + every,
            ]
        )
        if not has_axes:
            return c, 0
        radial = self.radial[self.p]
        r1, r2 = radial[t - step] if t >= step else 0, radial[t - 2 * step] if t >= 2 * step else 0
        return c, 1 + coarse_log(16 * (r1 + r2))

    def _residual(self, t: int, guess: Vector, axes: list[Vector] | None) -> Vector | None:
        """What the sample wanted is off the guess, along the axes; None for a decoder."""
        if self.wanted is None:
            return None
        off = [w - g for w, g in zip(self.wanted[self.p][t], guess, strict=True)]
        residual = [a[0] * off[0] + a[1] * off[1] + a[2] * off[2] for a in axes or _STRAIGHT]
        if not all(abs(r) < LIMIT for r in residual):
            raise TooLarge
        return residual


_STRAIGHT: list[Vector] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def _bend(points: list[Vector], t: int, half: int, k: int) -> float:
    return points[t][k] - 2 * points[t - half][k] + points[t - 2 * half][k]


def _frame(u: Vector) -> list[Vector]:
    """Two more axes at right angles to the first."""
    a, b, c = (abs(x) for x in u)
    least = (0 if a < c else 2) if a < b else (1 if b < c else 2)
    v = [(1.0 if k == least else 0.0) - u[least] * u[k] for k in range(3)]
    length = math.sqrt(square(v))
    v = [x / length for x in v]
    return [u, v, [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]]


def _limited(guess: Vector, base: Vector | None) -> Vector:
    """The guess, replaced where it is out of range."""
    base = guess if base is None else base
    return [g if abs(g) < LIMIT else b if abs(b) < LIMIT else 0.0 for g, b in zip(guess, base, strict=True)]


def encode(
    wanted: Floats,
    missing: NDArray[np.uint8],
    sequence: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    stride: int,
) -> tuple[bytes, Floats] | None:
    """The stream of samples (points, frames, 3) in half steps, and what it decodes to; None where one is too large."""
    encoder = adaptive_bits.Encoder()
    try:
        decoded = _Chunk(wanted, missing, sequence, neighbours, stride, PointCoder(encoder, None)).run()
    except TooLarge:
        return None
    return encoder.finish(), decoded


def decode(
    stream: bytes,
    missing: NDArray[np.uint8],
    sequence: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    stride: int,
) -> Floats | None:
    """The samples (points, frames, 3) of a stream; None for one that no encoder writes."""
    decoder = adaptive_bits.Decoder(stream)
    try:
        decoded = _Chunk(None, missing, sequence, neighbours, stride, PointCoder(None, decoder)).run()
    except TooLarge:
        return None
    return decoded if decoder.at_end else None
