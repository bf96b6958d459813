"""Searches for the setting of an encoder that meets a target: a quantisation step, a tolerance, a size.

    closest_within   the value nearest below a limit           "the coarsest step whose mean error is at most 2 mm"
    nearest_root     the value nearest to a target             "the step whose mean error is 2 mm"
    largest_true     the last setting that passes a test       "the finest step that fits into 10 kB"
    minimum          the setting of the least value            "the step at which all bytes together are fewest"

Every trial codes the motion, so the searches are made for few trials and for values that are only nearly monotone:
quantisation makes all of them rough. Settings are whole numbers on a logarithmic scale (rungs of `quantise.LADDER`,
1/32 octaves) or logarithms, on which errors and sizes are nearly straight lines. No setting is tried twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

Result = TypeVar("Result")


@dataclass(frozen=True)
class Trial(Generic[Result]):
    """A setting that was tried, the value that was measured, and what else the encoder gave."""

    setting: float
    value: float
    result: Result


def closest_within(
    measure: Callable[[float], tuple[float, Result]],
    start: float,
    *,
    rising: bool,
    stride: Callable[[float], float],
    farthest: float,
    aim: float = 0.993,
    near: float = 0.985,
    margin: float = 0.1,
    tries: int = 24,
    whole: bool = True,
    close: float = 0.0,
) -> Trial[Result] | None:
    """The trial farthest towards larger values whose value is at most 1, or None where no trial has one.

    measure(setting): value / limit, positive, and a result to keep with it. rising: whether the value rises or falls
    with the setting. stride(logarithm of the value): how far to go, in settings, while all values are on one side of
    the limit. farthest: from start. Between two sides, the secant through the logarithms aims at `aim`, and stays away
    from the ends of the bracket by `margin` of its width. A value from `near` to 1 ends the search. whole: whether
    settings are whole numbers. close: width of a bracket that ends the search, where they are not: values may jump.
    """
    best: Trial[Result] | None = None
    inside: tuple[float, float] | None = None  # setting and logarithm of the last value on either side of the limit
    outside: tuple[float, float] | None = None
    setting = start
    for _ in range(tries):
        value, result = measure(setting)
        here = setting, math.log(max(value, 1e-300))
        if value <= 1:
            inside, best = here, Trial(setting, value, result)
            if value >= near:
                break
        else:
            outside = here
        if inside and outside:
            if abs(inside[0] - outside[0]) <= (1 if whole else close):
                break
            setting = _between(inside, outside, math.log(aim), margin, whole)
        else:
            setting += stride(here[1]) * (1 if rising == (value <= 1) else -1)
            if abs(setting - start) > farthest:
                break
    return best


def _between(
    inside: tuple[float, float], outside: tuple[float, float], aim: float, margin: float, whole: bool
) -> float:
    """A setting between two, by the secant through their (setting, logarithm)."""
    share = (aim - inside[1]) / (outside[1] - inside[1])
    change = min(max(share, margin), 1 - margin) * (outside[0] - inside[0])
    if not whole:
        return inside[0] + change
    low, high = sorted((inside[0], outside[0]))
    return min(max(inside[0] + round(change), low + 1), high - 1)


def nearest_root(
    excess: Callable[[int], tuple[float, Result]],
    start: int,
    low: int,
    high: int,
    *,
    slope: float = 1.0,
    slopes: tuple[float, float] = (0.4, 2.0),
    near: float = 0.5,
    tries: int = 12,
) -> tuple[Trial[Result], dict[int, float]]:
    """The trial whose excess is nearest to zero, and the excess of every setting that was tried.

    excess(setting): how far too large the value is, in the unit of the settings (for instance both in 1/32 octave), and
    a result to keep with it; it rises with the setting, which lies in [low, high]. The search goes along `slope`, later
    along the slope of the trials, limited to `slopes`, until they bracket zero, and then by secants. It ends with a
    trial within `near`, between neighbouring settings, or after `tries`.
    """
    tried: dict[int, float] = {}
    best: Trial[Result] | None = None
    setting = min(max(start, low), high)
    while setting not in tried and len(tried) < tries:
        tried[setting], result = excess(setting)
        if best is None or abs(tried[setting]) <= abs(best.value):
            best = Trial(setting, tried[setting], result)
        if abs(tried[setting]) < near:
            break
        setting = min(max(_next_towards_root(tried, slope, slopes), low), high)
    assert best is not None
    return best, tried


def _next_towards_root(tried: dict[int, float], slope: float, slopes: tuple[float, float]) -> int:
    """Where the excess should vanish: between the settings on either side of zero, or along a slope."""
    below = [s for s in tried if tried[s] <= 0]
    above = [s for s in tried if tried[s] > 0]
    if below and above:
        a, b = max(below), min(above)
        if b - a <= 1:
            return a
        between = round(a - tried[a] * (b - a) / (tried[b] - tried[a]))
        return min(max(between, a + 1), b - 1)
    last, *before = sorted(tried, reverse=bool(below))
    if before:
        slope = min(max((tried[last] - tried[before[0]]) / (last - before[0]), slopes[0]), slopes[1])
    change = -tried[last] / slope
    return last + (math.ceil(change) if change >= 0 else math.floor(change))


def largest_true(
    holds: Callable[[int], bool], start: int, low: int, high: int, *, stride: int = 16, longest_stride: int = 512
) -> int | None:
    """The largest setting in [low, high] for which `holds`, given that it holds for all settings below; None where it
    does not hold at `low`.

    From `start` in strides that double up to `longest_stride`, until one setting holds and one does not; then by
    bisection.
    """
    at = min(max(start, low), high)
    true, false = low - 1, high + 1
    while true < at < false:
        if holds(at):
            true, at = at, min(at + stride, high)
            if false <= high:
                break
        else:
            false, at = at, max(at - stride, low)
            if true >= low:
                break
        stride = min(2 * stride, longest_stride)
    while false - true > 1:
        middle = (true + false) // 2
        if holds(middle):
            true = middle
        else:
            false = middle
    return true if true >= low else None


def minimum(
    value: Callable[[int], float], start: int, strides: Sequence[int], *, farthest: int, tries: int = 24
) -> int:
    """The setting of the least value, or one near it: from `start` downhill in the first of the strides, then in the
    next ones around the best so far.

    farthest: from start. tries: beyond this many, each stride tries two settings at most. Of equal values the lowest
    setting wins.
    """
    values = {start: value(start)}
    best = start
    for stride in strides:
        while True:
            for setting in (best - stride, best + stride):
                if setting not in values and abs(setting - start) <= farthest:
                    values[setting] = value(setting)
            lowest = min(values, key=lambda setting: (values[setting], setting))
            if lowest == best or len(values) > tries:
                break
            best = lowest
    return best
