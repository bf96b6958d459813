"""A mean error in few bits: each chunk in a step and a λ of its own, all at one slope of rate and distortion.

    a step for all, near the target ─one step finer, one coarser─► price: bits that a metre of error is worth
    chunk ─settings downhill in bits + price · error─► costs ─lower convex hull─► trades of error for bits
    trades, best first, while the error allowed lasts ─► settings ─one chunk's λ, finely─► drafts

The error is a mean of distances, not of their squares, so that a common step is not best. λ is no part of a stream.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from ... import parallel, progress
from ...stages import search
from . import chunk, target
from .chunk import ChunkEncoder, Draft
from .coding.contexts import OCTAVE

Item = TypeVar("Item")
Result = TypeVar("Result")

SLOPE_OCTAVE = 256
"""λ is numbered by its log₂ in 1/256 octave."""
FIRST_SLOPE = round(np.log2(0.2) * SLOPE_OCTAVE)
"""λ of the first trials. For all chunks alike, 0.2 to 0.3 is best at means of some millimetres, 0.16 at 0.3 mm."""
LEAST_SLOPE, MOST_SLOPE = round(np.log2(0.04) * SLOPE_OCTAVE), 0
SAMPLED = 4
"""At most this many chunks are used for the first search of the step."""
NEAR = 3.0
"""The search of the common step ends within this of the target, 1/32 octave of the error."""
USUAL_RISE, RISES = 0.75, (0.4, 1.0)
"""Rise of the logarithm of the error per logarithm of the step: at first, and its range."""
STEP_RISE, SLOPE_RISE = USUAL_RISE / OCTAVE, 0.2 / SLOPE_OCTAVE
"""Usual rise of log₂ of the error per number of the step and of λ."""
MOST_MOVES = 2
"""Number of moves in one direction, at most."""
FINER = 6
"""Number of times that all chunks are tried in finer steps while their least errors exceed the target."""
TUNING = 2
"""Trials of λ that use up what other chunks leave, from each of two settings."""
TUNED = 3e-4
"""They end with at most this share of the error allowed left."""
UNUSED = 5e-3
"""Further settings are tuned while more than this share of the error allowed is left."""
SAFETY = 1e-6
"""Share of the error that is not used: decoders round differently."""


class Setting(NamedTuple):
    """step: log₂ in 1/32 octave. slope: log₂ of λ in 1/256 octave."""

    step: int
    slope: int

    def moved(self, by: Setting, times: int = 1) -> Setting:
        step = min(max(self.step + times * by.step, target.SMALLEST_STEP), target.LARGEST_STEP)
        return Setting(step, min(max(self.slope + times * by.slope, LEAST_SLOPE), MOST_SLOPE))


COARSER, SPARSER = Setting(4, 0), Setting(-5, 150)
"""Moves to more error and fewer bits, and to a larger λ in a finer step: about the same error, more zeros."""


class Cost(NamedTuple):
    """error: sum of distances, metres. bits: an estimate."""

    error: float
    bits: float


class Trade(NamedTuple):
    """More error of a chunk (its number) for fewer bits: the setting to take, and both changes."""

    chunk: int
    setting: Setting
    error: float
    bits: float


class Curve:
    """What a chunk costs in the settings that were tried."""

    def __init__(self, encoder: ChunkEncoder) -> None:
        self.encoder = encoder
        self.tried: dict[Setting, Cost] = {}

    def draft(self, setting: Setting) -> Draft:
        found = self.encoder.draft(setting.step, 2.0 ** (setting.slope / SLOPE_OCTAVE))
        self.tried[setting] = Cost(found.error, found.bits)
        return found

    def cost(self, setting: Setting) -> Cost:
        if setting not in self.tried:
            self.draft(setting)
        return self.tried[setting]

    def descend(self, start: Setting, price: float) -> None:
        """Try settings downhill in bits + price · error: steps, then sparser ones, then steps near the best."""

        def total(setting: Setting) -> float:
            cost = self.cost(setting)
            return cost.bits + price * cost.error

        def downhill(best: Setting, move: Setting, sign: int) -> Setting:
            for _ in range(MOST_MOVES):
                other = best.moved(move, sign)
                if total(other) >= total(best):
                    break
                best = other
            return best

        first = min((start, start.moved(COARSER), start.moved(COARSER, -1)), key=total)
        sparser = downhill(first, SPARSER, 1)
        if sparser != first and downhill(sparser, COARSER, 1) == sparser:
            downhill(sparser, COARSER, -1)

    def tune(self, start: Setting, allowed: float, near: float) -> None:
        """Try other λ at a setting's step until the error is between allowed − near and allowed."""
        at, rise = start, SLOPE_RISE
        for _ in range(TUNING):
            error = self.cost(at).error
            if allowed - near <= error <= allowed:
                return
            change = round(_octaves(allowed - near / 2, error) / rise)
            after = at.moved(Setting(0, change))
            if after in self.tried:
                return
            measured = _octaves(self.cost(after).error, error) / (after.slope - at.slope)
            at, rise = after, min(max(measured, SLOPE_RISE / 3), 3 * SLOPE_RISE)

    def hull(self) -> list[Setting]:
        """The settings on the lower convex hull of error and bits, by rising error."""
        found: list[Setting] = []
        for setting in sorted(self.tried, key=lambda at: self.tried[at]):
            cost = self.tried[setting]
            if found and cost.bits >= self.tried[found[-1]].bits:
                continue
            while len(found) > 1 and not _is_convex(self.tried[found[-2]], self.tried[found[-1]], cost):
                found.pop()
            found.append(setting)
        return found

    def fewest_bits(self, error: float) -> Setting:
        """The setting of fewest bits within an error, metres."""
        return min((at for at, cost in self.tried.items() if cost.error <= error), key=lambda at: self.tried[at].bits)


def to_mean(encoders: Sequence[ChunkEncoder], mean_error: float) -> list[bytes]:
    """Payloads whose mean error is at most the target (metres), and near it."""
    allowed = mean_error * (1 - SAFETY) * sum(e.samples for e in encoders)
    allowed -= sum(e.apart.rounding_error for e in encoders)
    drafts = None
    if allowed > 0 and any(e.spectrum is not None for e in encoders):
        drafts = _drafts(encoders, target.step_for_mean(mean_error), allowed)
    return target.directly_to_mean(encoders, mean_error) if drafts is None else chunk.pack(encoders, drafts)


def _drafts(encoders: Sequence[ChunkEncoder], step: int, allowed: float) -> list[Draft] | None:
    """Drafts whose errors (metres) add up to at most `allowed`, and nearly that; None if no settings tried do.

    step: near which a step that all chunks can share is searched.
    """
    curves = [Curve(encoder) for encoder in encoders]
    with progress.phase(0.0, 0.3):
        start = Setting(_common_step(curves, step, allowed), FIRST_SLOPE)
    with progress.phase(0.3, 0.4):
        price = _price(curves, start)
    with progress.phase(0.4, 0.8):
        _over(lambda curve: curve.descend(start, price), curves)
    settings = _within(curves, allowed)
    if settings is None:
        return None
    with progress.phase(0.8, 1.0):
        return _over(lambda each: each[0].draft(each[1]), list(zip(curves, settings, strict=True)))


def _common_step(curves: Sequence[Curve], step: int, allowed: float) -> int:
    """A step in which all chunks have about the error allowed: by some of the chunks first."""
    samples = sum(curve.encoder.samples for curve in curves)

    def excess(of: Sequence[Curve], step: int) -> tuple[float, None]:
        error = sum(cost.error for cost in _over(lambda curve: curve.cost(Setting(step, FIRST_SLOPE)), of))
        share = sum(curve.encoder.samples for curve in of) / max(1, samples)
        return OCTAVE * _octaves(error, max(share, 1e-12) * allowed), None

    some = curves[:: -(-len(curves) // SAMPLED)]
    for of in (some, curves) if len(some) < len(curves) else (curves,):
        trial = progress.attempts(functools.partial(excess, of))
        found, _ = search.nearest_root(
            trial, step, target.SMALLEST_STEP, target.LARGEST_STEP, slope=USUAL_RISE, slopes=RISES, near=NEAR
        )
        step = int(found.setting)
    return step


def _price(curves: Sequence[Curve], start: Setting) -> float:
    """Bits that a metre of error is worth near a setting."""
    finer = _over(lambda curve: curve.cost(start.moved(COARSER, -1)), curves)
    coarser = _over(lambda curve: curve.cost(start.moved(COARSER)), curves)
    bits = sum(c.bits for c in finer) - sum(c.bits for c in coarser)
    error = sum(c.error for c in coarser) - sum(c.error for c in finer)
    return max(bits, 0.0) / max(error, 1e-12)


def _within(curves: Sequence[Curve], allowed: float) -> list[Setting] | None:
    """A setting for each chunk; None if their least errors add up to more than is allowed."""
    for finer in range(FINER):
        hulls = [curve.hull() for curve in curves]
        spent = sum(curve.tried[hull[0]].error for curve, hull in zip(curves, hulls, strict=True))
        if spent <= allowed:
            break
        least = [hull[0].moved(COARSER, -(2**finer)) for hull in hulls]
        _over(lambda each: each[0].cost(each[1]), list(zip(curves, least, strict=True)))
    else:
        return None
    chosen = [hull[0] for hull in hulls]
    for trade in _trades(curves, hulls):
        if spent + trade.error > allowed:
            curve, at = curves[trade.chunk], chosen[trade.chunk]
            left = allowed - spent + curve.tried[at].error
            _tune(curve, (at, trade.setting), left, allowed)
            break
        chosen[trade.chunk] = trade.setting
        spent += trade.error
    return _used_up(curves, chosen, allowed)


def _tune(curve: Curve, ends: Sequence[Setting], left: float, allowed: float) -> None:
    """Try settings between two, and near them, that use up the rest of the allowed error."""
    for sparser in (0, 1, -1):
        for end in ends:
            coarser = np.floor(_octaves(left, curve.tried[end].error) / STEP_RISE)
            curve.tune(end.moved(Setting(int(coarser), 0)).moved(SPARSER, sparser), left, TUNED * allowed)
        if curve.tried[curve.fewest_bits(left)].error >= left - UNUSED * allowed:
            break


def _trades(curves: Sequence[Curve], hulls: Sequence[Sequence[Setting]]) -> list[Trade]:
    """All segments of the hulls, those first that save the most bits for their error."""
    found: list[Trade] = []
    for number, (curve, hull) in enumerate(zip(curves, hulls, strict=True)):
        for a, b in itertools.pairwise(hull):
            before, after = curve.tried[a], curve.tried[b]
            found.append(Trade(number, b, after.error - before.error, after.bits - before.bits))
    return sorted(found, key=lambda trade: trade.bits / trade.error)


def _used_up(curves: Sequence[Curve], chosen: Sequence[Setting], allowed: float) -> list[Setting]:
    """The settings, where each chunk in turn takes the one of fewest bits that the error left allows."""
    left = allowed - sum(curve.tried[at].error for curve, at in zip(curves, chosen, strict=True))
    found: list[Setting] = []
    for curve, at in zip(curves, chosen, strict=True):
        left += curve.tried[at].error
        found.append(curve.fewest_bits(max(left, curve.tried[at].error)))
        left -= curve.tried[found[-1]].error
    return found


def _is_convex(a: Cost, b: Cost, c: Cost) -> bool:
    """Whether b is below the line from a to c."""
    return (b.bits - a.bits) * (c.error - a.error) < (c.bits - a.bits) * (b.error - a.error)


def _octaves(error: float, of: float) -> float:
    return float(np.log2(max(error, 1e-12) / max(of, 1e-12)))


def _over(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """The results of all items, in the threads of `parallel`."""
    listed = list(items)
    found: list[Result] = []
    for result in parallel.over(function, listed):
        found.append(result)
        progress.report(len(found) / len(listed))
    return found
