"""Lattices that meet a target: a bound on the error, its mean, the bytes, and the PSNR of the colours.

    max_error, mean_error ─► bound of the lattice, before anything is coded
    size ─► bounds between the finest and the coarsest, each coded ─► the finest that fits
    psnr ─► colour step; colours are decoded and measured, and the step halved until they meet it
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ...errors import CannotEncode
from ...typing import Floats
from ..clouds.raw_frames import Cloud
from . import lattice, octree, point_colours
from .point_layer import LatticeFrame, LatticeGrid, to_lattice

DEFAULT_BOUND_M = 0.005  # without a target, of frames without a body
COLOUR_BOUND_M = 0.002  # of frames with a target for their colours alone
FINEST_BOUND_M, COARSEST_BOUND_M = 2e-5, 0.04  # that a size is met with
SIZE_ATTEMPTS = 9  # codings of the points to meet a size
TIGHTENING = 0.98  # factor on a bound whose mean error is too large
MEAN_PER_BOUND = 0.66  # mean distance over the bound, of points spread evenly over a cell
MAX_DB = 99.0


class Coding(NamedTuple):
    """How points are coded. bound_m: of the lattice. colour_step: 0 without colours."""

    bound_m: float
    colour_step: int


def usual_colour_step(bound_m: float) -> int:
    """A step of colours that suits a bound: coarse points show coarse colours."""
    return int(np.clip(round(4 * math.sqrt(bound_m / 0.001)), 1, 16))


def own_distances(frames: Sequence[Cloud], bound_m: float) -> Floats:
    """Distances of all points from their own lattice points, at least those from the nearest."""
    step = lattice.step_of_bound(bound_m)
    parts = [np.linalg.norm(p - lattice.positions(lattice.nearest(p, step), step), axis=1) for p, _ in frames]
    return np.concatenate(parts) if parts else np.zeros(0)


def bound_of_mean(frames: Sequence[Cloud], mean_m: float) -> float:
    """The bound of a lattice whose mean error is at most `mean_m`, from points and from decoded points."""
    bound = mean_m / MEAN_PER_BOUND
    while True:
        if mean_errors(frames, bound) <= mean_m:
            return bound
        bound *= TIGHTENING


def mean_errors(frames: Sequence[Cloud], bound_m: float) -> float:
    """The larger of the mean distances from points to their lattice points and back, an upper bound of the mean error.

    A lattice point counts with the nearest of its points.
    """
    distance = own_distances(frames, bound_m)
    if not len(distance):
        return 0.0
    step, back = lattice.step_of_bound(bound_m), list[Floats]()
    starts = np.cumsum([0, *(len(p) for p, _ in frames)])
    for (points, _), start in zip(frames, starts[:-1], strict=True):
        if not len(points):
            continue
        whole = lattice.nearest(points, step)
        code = octree.morton_codes(np.clip(whole - whole.min(axis=0), 0, (1 << octree.MAX_DEPTH) - 1))
        order = np.lexsort((distance[start : start + len(points)], code))
        first = np.flatnonzero(np.diff(code[order], prepend=-1))
        back.append(distance[start : start + len(points)][order[first]])
    return max(float(distance.mean()), float(np.concatenate(back).mean()))


def require_bound(grid: LatticeGrid, frames: Sequence[LatticeFrame], decoded: Sequence[Cloud], bound_m: float, source: Sequence[Cloud]) -> None:
    """Raises CannotEncode if decoded points are not those of the lattice, or a point is farther off than the bound."""
    for frame, (points, _), (original, _) in zip(frames, decoded, source, strict=True):
        if not np.array_equal(points, grid.positions(frame.codes)):
            raise CannotEncode("bodycast: the decoded points are not those that were coded")
        if len(original) and float(own_distances([(original, None)], bound_m).max()) > bound_m:
            raise CannotEncode(f"bodycast cannot bound the error of these points by {bound_m * 1000:g} mm")


def finest_that_fits(size: float, coded_bytes: Callable[[float], float]) -> float:
    """The smallest bound whose bytes fit into `size`: bisection in the logarithm. Raises CannotEncode."""
    low, high = math.log(FINEST_BOUND_M), math.log(COARSEST_BOUND_M)
    smallest = coded_bytes(COARSEST_BOUND_M)
    if smallest > size:
        raise CannotEncode(
            f"bodycast cannot encode these points to {size:,.0f} bytes, only to {smallest:,.0f} with points within "
            f"{COARSEST_BOUND_M * 1000:g} mm; a surface without a bound on its points is smaller: ask for a residual"
        )
    for _ in range(SIZE_ATTEMPTS):
        middle = (low + high) / 2
        if coded_bytes(math.exp(middle)) <= size:
            high = middle
        else:
            low = middle
    return math.exp(high)


def colour_psnr(source: Sequence[Cloud], decoded: Sequence[Cloud]) -> float:
    """PSNR of luma between nearest points over all frames, dB: the lower of both directions, at most MAX_DB."""
    from ...metrics import point_clouds

    return point_clouds.luma_psnr(zip(source, decoded, strict=True))


def coarser_steps(start: int) -> list[int]:
    """Colour steps to try, from coarse to lossless."""
    steps = [start]
    while steps[-1] > 1:
        steps.append(max(1, steps[-1] * 2 // 3))
    return steps


def step_of_psnr(psnr_db: float) -> int:
    """The first step to try for a PSNR: that of errors spread evenly over a step, a little coarser."""
    step = 1.5 * math.sqrt(12) * 255 / 10 ** (psnr_db / 20)
    return int(np.clip(round(step), 1, point_colours.MAX_STEP))


__all__ = [
    "COLOUR_BOUND_M",
    "DEFAULT_BOUND_M",
    "Coding",
    "bound_of_mean",
    "coarser_steps",
    "colour_psnr",
    "finest_that_fits",
    "mean_errors",
    "require_bound",
    "step_of_psnr",
    "to_lattice",
    "usual_colour_step",
]
