"""The clock of a TRC: frame of each row, start and rate, by the numbering, the time column and the header."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..errors import BadInput
from ..typing import Floats, Integers
from .conventions import USUAL_RATES

MAX_DROPPED_SHARE = 16
"""Frames that the numbering may skip, as a multiple of those that are there; more is taken for damage."""
RATE_TOLERANCE = 5e-4
"""Relative difference between DataRate and the time column that needs no note."""


class Declared(NamedTuple):
    """Rate (hertz) and number of frames that a header declares; None for what it lacks."""

    rate: float | None
    frames: int | None


class Clock(NamedTuple):
    """frames (rows,): frame of each row, from 0; first: number of the first; start: its time in seconds, or NaN."""

    frames: Integers
    first: int
    start: float
    rate: float


def of_columns(columns: Floats, decimals: int, declared: Declared, rate: float | None, notes: list[str]) -> Clock:
    """Frame of each row, number and time of the first, and rate; contradictions are settled and noted.

    columns (rows, 2): frame numbers and times. decimals: of the times' texts. rate: in place of all others, hertz.
    Raises BadInput.
    """
    rows, count = len(columns), declared.frames or 0
    ids, times = columns.T
    if not rows:
        if count:
            raise BadInput(f"cut off: its header declares {count} frames, the file has none")
        return Clock(np.empty(0, np.int64), 1, math.nan, _positive(rate or declared.rate))
    if np.isnan(ids).all():
        ids = np.arange(1.0, rows + 1)
    if not (math.isfinite(ids[0]) and abs(ids[0]) < 2**53):
        raise BadInput(f"the number of its first frame is {ids[0]}")
    has_times = bool(np.isfinite(times).all() and (np.diff(times) > 0).all())
    digit = 0.5 * 10.0**-decimals
    index = _frame_index(ids, times if has_times else None, declared.frames, notes)
    missing = int(index[-1]) + 1 - rows
    if rows < count and int(index[-1]) + 1 < count:
        raise BadInput(f"cut off: its header declares {count} frames, the file has {rows}; --salvage reads these")
    if rows > count and int(index[-1]) + 1 != count:
        notes.append(f"the header declares {count} frames, the file has {rows}: all are read")
    if missing:
        notes.append(f"{missing} frames are missing from the file's numbering: they are gaps")
    if has_times and rows > 1:
        times, digit = _seconds(times, digit, declared.rate, int(index[-1]), notes)
        rate = _rate_of_times(index, times, digit, declared.rate, notes) if rate is None else rate
    start = float(times[0]) if math.isfinite(times[0]) else math.nan
    first = int(ids[0])
    chosen = _positive(rate or declared.rate)
    if abs(start - (first - 1) / chosen) <= digit + 1e-9:
        start = (first - 1) / chosen  # its digits say no more
    return Clock(index, first, start, chosen)


def _positive(rate: float | None) -> float:
    """The rate. Raises BadInput unless it is positive and finite."""
    if rate is None or not 0 < rate < math.inf:
        raise BadInput(f"the frame rate must be positive, not {rate}; use rate= (--rate)")
    return rate


def _seconds(
    times: Floats, digit: float, declared: float | None, frames: int, notes: list[str]
) -> tuple[Floats, float]:
    """Times and half their last digit in seconds: times that run at a thousandth of DataRate are milliseconds."""
    slowness = declared * float(times[-1] - times[0]) / frames if declared else 1.0
    if abs(slowness / 1000 - 1) > 0.01:
        return times, digit
    notes.append("the time column is in milliseconds, by DataRate")
    return times / 1000, digit / 1000


def _frame_index(ids: Floats, times: Floats | None, declared: int | None, notes: list[str]) -> Integers:
    """The frame of each row from 0, by the numbering; by the times if these skip frames that are numbered through.

    Numbers that all step by the same amount are those of a decimated recording, without missing frames.
    """
    rows = len(ids)
    counted = np.arange(rows)
    if rows < 2:
        return counted
    steps = np.diff(ids)
    if not (np.isfinite(steps).all() and (steps >= 1).all() and (steps == np.rint(steps)).all()):
        notes.append("the frame numbers do not increase by whole numbers: frames are counted by rows")
        return counted
    by_time = None
    if times is not None:
        periods = np.diff(times) / np.median(np.diff(times))
        if np.abs(periods - np.rint(periods)).max() < 0.1:
            by_time = np.rint(periods)
    if (steps == steps[0]).all():
        if by_time is None or (by_time == 1).all():
            return counted
        steps = by_time
    elif by_time is not None and (by_time == 1).all() and rows == declared:
        notes.append(
            "the frame numbers skip, the times and the number of frames do not: no frames are taken for missing"
        )
        return counted
    index = np.concatenate([[0.0], np.cumsum(steps)])
    if index[-1] > MAX_DROPPED_SHARE * rows + 1000:
        raise BadInput(f"damaged: {rows} rows have frame numbers from {ids[0]:.0f} to {ids[-1]:.0f}")
    return index.astype(np.int64)


def _rate_of_times(
    index: Integers, times: Floats, digit: float, declared: float | None, notes: list[str]
) -> float | None:
    """The rate of the time column if it contradicts the header's, else None. digit: half the last decimal, seconds."""
    span, frames = float(times[-1] - times[0]), int(index[-1])
    if declared and abs(span - frames / declared) <= 2 * digit + RATE_TOLERANCE * span:
        return None
    period_error = 2 * digit / frames
    period = span / frames
    usual = min(USUAL_RATES, key=lambda rate: abs(1 / rate - period))
    rate = float(usual) if abs(1 / usual - period) <= period_error + 1e-4 * period else 1 / period
    other = f" (--rate {declared:g} takes the other)" if declared else ""
    says = "DataRate is missing" if declared is None else f"DataRate is {declared:g} Hz"
    notes.append(f"{says}, the time column runs at {rate:.6g} Hz: the time column is used{other}")
    return rate
