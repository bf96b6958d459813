"""Searches over the ladder of steps: few tries, each a coding of the whole motion.

Every function takes `of(rung)`, which rises with the rung or nearly so, and the rung to begin at.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from ... import progress
from ...stages import quantise

NEAR = 0.985
"""A value is near enough to its limit from this share of it on."""

TRIES = 24
WIDEST = 30 * quantise.LADDER
"""No rung is farther than this from the first: 30 octaves."""


def largest_within(of: Callable[[int], float], limit: float, start: int) -> int | None:
    """The largest rung, near enough, at which `of` is at most the limit; none where there is none."""
    return _bracketed(of, limit, start, rising=True)


def smallest_within(of: Callable[[int], float], limit: float, start: int) -> int | None:
    """The smallest rung, near enough, at which a falling `of` is at most the limit; none where there is none."""
    return _bracketed(of, limit, start, rising=False)


def _bracketed(of: Callable[[int], float], limit: float, start: int, rising: bool) -> int | None:
    """Secants in logarithms, kept between the best rung that holds and the nearest that does not."""
    sign = 1 if rising else -1
    good: tuple[int, float] | None = None
    bad: tuple[int, float] | None = None
    rung = start
    for attempt in range(TRIES):
        with progress.attempt(attempt):
            value = of(rung)
        if value <= limit:
            good = (rung, value)
            if value >= NEAR * limit:
                break
        else:
            bad = (rung, value)
        if good and bad and abs(good[0] - bad[0]) <= 1:
            break
        rung = _next(good, bad, limit, sign)
        if abs(rung - start) > WIDEST:
            break
    return good[0] if good else None


def _next(good: tuple[int, float] | None, bad: tuple[int, float] | None, limit: float, sign: int) -> int:
    if good and bad:
        low, high = math.log(max(good[1], 1e-300)), math.log(bad[1])
        share = (math.log(0.993 * limit) - low) / (high - low) if high > low else 0.5
        rung = good[0] + round(min(max(share, 0.1), 0.9) * (bad[0] - good[0]))
        inner = sorted((good[0], bad[0]))
        return min(max(rung, inner[0] + 1), inner[1] - 1)
    known = good or bad
    assert known is not None
    octaves = math.log2(limit / max(known[1], 1e-300))
    step = max(1, min(round(abs(octaves) * 1.4 * quantise.LADDER), 6 * quantise.LADDER))
    return known[0] + (sign if good else -sign) * step


def smallest(of: Callable[[int], float], start: int) -> int:
    """The rung of the least `of`, near enough: a walk in half octaves, then in fifths about the best."""
    values = {start: of(start)}
    best = start
    for stride in (quantise.LADDER // 2, quantise.LADDER // 5):
        while True:
            for rung in (best - stride, best + stride):
                if rung not in values and abs(rung - start) <= WIDEST:
                    values[rung] = of(rung)
                    progress.report(1 - 0.85 ** len(values))
            nearer = min(values, key=lambda rung: (values[rung], rung))
            if nearer == best or len(values) > TRIES:
                break
            best = nearer
    return best
