"""Lattices that meet a target: a bound on the error, its mean, the bytes, and the PSNR of the colours.

max_error ─► bound of the lattice
mean_error ─► bounds, each coded, finer until the mean error is as small
size ─► bounds between the finest and the coarsest, each coded ─► the finest that fits
psnr ─► colour step; colours are decoded and measured, until the coarsest step that meets it is found
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import count

import numpy as np

from ...errors import CannotEncode
from ...typing import Floats
from . import point_colours
from .lattice_frames import LatticeFrame

DEFAULT_BOUND_M = 0.005  # without a target, of frames without a body
COLOUR_BOUND_M = 0.002  # of frames with a target for their colours alone
FINEST_BOUND_M, COARSEST_BOUND_M = 2e-5, 0.04  # that a size is met with
SIZE_ATTEMPTS = 9  # codings of the points to meet a size
TIGHTENING = 0.98  # factor on a bound whose mean error is too large, at most
LEAST_MEAN_SHARE, MEAN_ATTEMPTS = 0.97, 4  # least share of a mean error to use; most codings
MEAN_PER_BOUND = 0.59  # mean distance over the bound, of points on a smooth surface
BODY_MEAN_PER_BOUND = 0.57  # the same of points that `point_choice` chooses


def usual_colour_step(bound_m: float) -> int:
    """A step of colours that suits a bound: coarse points show coarse colours."""
    return int(np.clip(round(4 * math.sqrt(bound_m / 0.001)), 1, 16))


def bound_of_mean(mean_m: float, mean_error_of: Callable[[float], float], first_m: float) -> float:
    """A bound with which the mean error of the decoded points is at most `mean_m`, and not much less.

    mean_error_of: the mean error with a bound, metres; about in proportion to it. first_m: the bound to try first.
    """
    bound, found = first_m, 0.0
    for attempt in count(1):
        measured = mean_error_of(bound)
        if measured <= mean_m:
            found = max(found, bound)
        is_close = measured >= LEAST_MEAN_SHARE * mean_m or bound >= COARSEST_BOUND_M or not measured
        if found and (is_close or attempt >= MEAN_ATTEMPTS):
            return found
        bound *= mean_m / measured if measured <= mean_m else min(TIGHTENING, mean_m / measured)
    raise AssertionError


def mean_error(frames: Sequence[tuple[LatticeFrame, Floats]]) -> float:
    """The larger of the mean distances from points to their decoded points and back, an upper bound of the mean error.

    frames: with the decoded points (n, 3) of each. A decoded point counts with the nearest of its points.
    """
    there, back = list[Floats](), list[Floats]()
    for frame, decoded in frames:
        distance = frame.own_distances(decoded)
        nearest = np.full(len(decoded), np.inf)
        np.minimum.at(nearest, frame.rows, distance)
        there.append(distance)
        back.append(nearest)
    return max(float(np.concatenate(parts).mean()) for parts in (there, back)) if frames else 0.0


def finest_that_fits(size: float, coded_bytes: Callable[[float], float], beside: float) -> float:
    """The smallest bound whose bytes fit into `size`: bisection in the logarithm. Raises CannotEncode.

    beside: bytes of the file besides the points, for the message.
    """
    low, high = math.log(FINEST_BOUND_M), math.log(COARSEST_BOUND_M)
    smallest = coded_bytes(COARSEST_BOUND_M)
    if smallest > size:
        raise CannotEncode(
            f"points within {COARSEST_BOUND_M * 1000:g} mm take about {smallest + beside:,.0f} bytes; "
            "a surface without a bound on its points (residual) takes fewer"
        )
    for _ in range(SIZE_ATTEMPTS):
        middle = (low + high) / 2
        if coded_bytes(math.exp(middle)) <= size:
            high = middle
        else:
            low = middle
    return math.exp(high)


def coarsest_step(start: int, meets: Callable[[int], bool]) -> int | None:
    """The coarsest luma step, up to MAX_STEP, that meets a target, if finer ones always do; None if not even 1 does.

    start: the first to try; the search doubles the distance from it, then bisects.
    """
    low, high = 0, point_colours.MAX_STEP + 1  # low meets the target, high does not
    step, reach = start, 1
    while high - low > 1:
        if meets(step):
            low, step = step, step + reach
        else:
            high, step = step, step - reach
        reach *= 2
        if not low < step < high:
            step = (low + high) // 2
    return low or None


def step_of_psnr(psnr_db: float) -> int:
    """The first step to try for a PSNR: that of errors spread evenly over a step."""
    step = math.sqrt(12) * 255 / 10 ** (psnr_db / 20)
    return int(np.clip(round(step), 1, point_colours.MAX_STEP))
