"""The body-centred cubic lattice that points are rounded to under a bound on their distance.

    points ──nearest──► integers, all even or all odd ──positions──► points within the bound

Among the lattices it covers a ball with the fewest cells: a cell of covering radius b has 2.86 b³, a cube 1.54 b³
(Conway and Sloane, Sphere Packings, Lattices and Groups, chapter 2). Coordinates are in units of half a cubic cell.
"""

from __future__ import annotations

import math

import numpy as np

from ... import native
from ...typing import Floats, Integers

ROUNDING = 1e-9  # share of the bound that is left for the rounding of floats
RMS_PER_BOUND = math.sqrt(3 * 0.0785433 * (16 / (5 * math.sqrt(5)) * 2) ** (2 / 3))
"""Root mean square distance over the bound, of points spread evenly over a cell; 0.0785433 is the lattice's second
moment (Conway and Sloane, table 2.3)."""


def step_of_bound(bound_m: float) -> float:
    """The unit of the lattice, metres, whose points are at most `bound_m` away from any place."""
    return 2 * bound_m / math.sqrt(5) * (1 - ROUNDING)


def bound_of_step(step_m: float) -> float:
    """The inverse of `step_of_bound`."""
    return step_m * math.sqrt(5) / 2 / (1 - ROUNDING)


def nearest(points: Floats, step_m: float) -> Integers:
    """The lattice point (n, 3) nearest to each of the points (n, 3)."""
    if (kernel := native.kernel("nearest_lattice_points")) is not None:
        return np.asarray(kernel(points, step_m))
    scaled = points / step_m
    even = 2 * np.round(scaled / 2)
    odd = 2 * np.round((scaled - 1) / 2) + 1
    is_odd = squares(scaled - odd) < squares(scaled - even)
    return np.where(is_odd[:, None], odd, even).astype(np.int64)


def squares(offsets: Floats) -> Floats:
    """Squared lengths (n,), column by column: a sum over the short axis takes three times as long."""
    x, y, z = offsets.T
    return x * x + y * y + z * z


def positions(coordinates: Integers, step_m: float) -> Floats:
    """The places (n, 3) of lattice points, metres."""
    return np.asarray(coordinates * step_m, np.float64)
