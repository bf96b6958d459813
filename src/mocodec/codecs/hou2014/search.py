"""Searches over the ladder of quantisation steps, with few evaluations: each one encodes the whole motion.

Every function takes `of(rung)`, a function of the rung that is nearly monotonic, and the rung to begin at.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from ...stages import quantise

NEAR = 0.985
"""The search ends at a value between this fraction of the limit and the limit."""

TRIES = 24
"""Evaluations at most."""

WIDEST = 30 * quantise.LADDER
"""Rungs between the first and any other rung at most: 30 octaves."""


def largest_within(of: Callable[[int], float], limit: float, start: int) -> int | None:
    """About the largest rung where a rising `of` is at most the limit; None if no rung in reach meets it."""
    return _bracketed(of, limit, start, rising=True)


def smallest_within(of: Callable[[int], float], limit: float, start: int) -> int | None:
    """About the smallest rung where a falling `of` is at most the limit; None if no rung in reach meets it."""
    return _bracketed(of, limit, start, rising=False)


def _bracketed(of: Callable[[int], float], limit: float, start: int, rising: bool) -> int | None:
    """Secant steps in logarithms, bracketed by the last rung within the limit and the last beyond it."""
    sign = 1 if rising else -1
    good: tuple[int, float] | None = None
    bad: tuple[int, float] | None = None
    rung = start
    for _ in range(TRIES):
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
    """About the rung with the smallest `of`: a descent in steps of half an octave, then of a fifth."""
    values = {start: of(start)}
    best = start
    for stride in (quantise.LADDER // 2, quantise.LADDER // 5):
        while True:
            for rung in (best - stride, best + stride):
                if rung not in values and abs(rung - start) <= WIDEST:
                    values[rung] = of(rung)
            nearer = min(values, key=lambda rung: (values[rung], rung))
            if nearer == best or len(values) > TRIES:
                break
            best = nearer
    return best
