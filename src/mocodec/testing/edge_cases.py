"""Edge cases: motions with what real files contain, and at the limits of what codecs must handle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..motion import Motion
from ..typing import Floats
from . import synthetic

NAN = np.nan


def _walk() -> Motion:
    return synthetic.markers(frames=150, seed=3)


def _modified_walk(change: Callable[[Floats], Floats | None]) -> Motion:
    motion = _walk()
    positions = motion.positions.copy()
    result = change(positions)
    return Motion(positions if result is None else result, motion.rate, motion.names, motion.up)


def _add_gaps(p: Floats) -> None:
    random = np.random.default_rng(5)
    p[random.random(p.shape[:2]) < 0.02] = NAN
    p[40:90, 7] = p[:30, 11] = p[120:, 12] = NAN


def _add_jumps(p: Floats) -> None:
    p[75] += (0.6, -0.9, 0.3)
    p[110, 4] += 0.8


def _park(p: Floats) -> None:
    p[30:90, [3, 8]] = p[110:113, 3] = 0.0
    p[20:60, 5] = p[100:, 6] = (3.2767, -3.2768, 3.2767)
    p[70:130, 32] = p[69, 32]
    p[:, 9] = (0.5, 0.25, -0.125)


MOTIONS: dict[str, Callable[[], Motion]] = {
    "one frame": lambda: _walk()[:1],
    "two frames": lambda: _walk()[:2],
    "three frames": lambda: _walk()[:3],
    "one point": lambda: _walk().select(["LKNE"]),
    "two points": lambda: _walk().select(["LKNE", "RKNE"]),
    "one sample": lambda: _walk()[:1].select(["C7"]),
    "still": lambda: _modified_walk(lambda p: np.repeat(p[:1], len(p), axis=0)),
    "all in one place": lambda: _modified_walk(np.zeros_like),
    "noise": lambda: _modified_walk(lambda p: np.random.default_rng(6).normal(scale=0.5, size=p.shape)),
    "gaps": lambda: _modified_walk(_add_gaps),
    "a point always missing": lambda: _modified_walk(lambda p: p.__setitem__((slice(None), 3), NAN)),
    "only one sample present": lambda: _modified_walk(
        lambda p: np.where(np.arange(p.size).reshape(p.shape) // 3 == 300, p, NAN)
    ),
    "first and last frames missing": lambda: _modified_walk(lambda p: p.__setitem__(np.r_[:20, 140:150], NAN)),
    "every other frame missing": lambda: _modified_walk(lambda p: p.__setitem__(slice(1, None, 2), NAN)),
    "parked": lambda: _modified_walk(_park),
    "jumps": lambda: _modified_walk(_add_jumps),
    "repeated samples": lambda: _modified_walk(lambda p: p[np.arange(len(p)) // 4 * 4]),
    "far away": lambda: _modified_walk(lambda p: p + np.array([4e5, -5e6, 100.0])),
    "huge": lambda: _modified_walk(lambda p: p * 1e5),
    "tiny": lambda: _modified_walk(lambda p: p * 1e-7),
    "slow": lambda: Motion(_walk().positions[::30], 4.0),
}
"""By name; functions, because some take a moment to create."""


def motion(name: str) -> Motion:
    """A new motion of this name in MOTIONS."""
    return MOTIONS[name]()
