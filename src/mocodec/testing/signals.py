"""Signals of every kind that labs have and some that they do not, by name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def noise(samples: int, size: float, seed: int = 0) -> NDArray[np.float64]:
    """White noise (samples,) of this standard deviation."""
    return np.random.default_rng(seed).normal(0, size, samples)


def slow(samples: int, size: float) -> NDArray[np.float64]:
    """A sine (samples,) of this amplitude."""
    return size * np.sin(np.arange(samples) / 37.0)


def plate(samples: int = 700) -> NDArray[np.generic]:
    """Four sensors as counts behind floats, and two forces that are sums of them, off while nobody stands there."""
    load = np.maximum(0, slow(samples, 900.0))
    sensors = [np.rint(load * share + noise(samples, 2.5, seed)) for seed, share in enumerate((0.9, 1.1, 0.7, 1.3))]
    volts = [(counts * np.float32(0.000305)).astype(np.float32) for counts in sensors]
    force = sensors[0] * 0.1373 + sensors[1] * 0.1291 + sensors[2] * 0.1402 + sensors[3] * 0.1337
    moment = sensors[0] * 3.913 - sensors[1] * 3.871
    on = load > 20
    return np.stack([*volts, np.where(on, force, -0.0), np.where(on, moment, -0.0)], axis=1).astype(np.float32)


def odd_floats(samples: int = 300) -> NDArray[np.generic]:
    """Floats among which are NaN, infinities, −0 and the smallest and largest."""
    values = noise(samples, 1.0).astype(np.float32)
    values[:7] = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-42, -3e38]
    return values[:, None]


def filtered_counts(samples: int = 600) -> NDArray[np.generic]:
    """Counts of 0.0763, an average subtracted in floats."""
    counts = np.rint(slow(samples, 90) + noise(samples, 30))
    scaled = (counts * 0.07629627).astype(np.float32)
    return (scaled.astype(np.float64) + 1e-7 * np.sign(noise(samples, 1))).astype(np.float32)[:, None]


def cases() -> dict[str, NDArray[np.generic]]:
    """Arrays (samples, …) by name: sensors and forces, counts, floats of all sizes, gaps, constants, one sample."""
    return {
        "plate": plate(),
        "counts": np.rint(slow(500, 2000)[:, None] + noise(1500, 3).reshape(500, 3)).astype(np.int16),
        "large counts": (np.rint(noise(400, 9))[:, None] * 1_000_000).astype(np.int64),
        "unsigned": np.rint(np.abs(noise(400, 9)))[:, None].astype(np.uint16),
        "big-endian": np.rint(slow(300, 50)).astype(">i4"),
        "flags": np.arange(600).reshape(300, 2) % 7 > 3,
        "floats": noise(900, 1.0).reshape(300, 3),
        "small floats": noise(300, 1e-3).astype(np.float16),
        "odd floats": odd_floats(),
        "all odd": np.array([np.nan, np.inf, -0.0] * 40, np.float32),
        "filtered": filtered_counts(),
        "copies": noise(600, 1.0).astype(np.float32).reshape(300, 2)[:, [0, 1, 0, 1, 1]],
        "few values": np.random.default_rng(3).choice(noise(9, 1e3, 2).astype(np.float32), (400, 2)),
        "twice each": np.repeat(noise(300, 1).astype(np.float32), 2)[:, None],
        "steps": np.repeat([5, -3, 900], 100).astype(np.int32),
        "constant": np.full((50, 3), 2.5, np.float32),
        "one sample": np.array([[1.5, -2.5]], np.float32),
        "three axes": np.rint(slow(360, 100)).astype(np.int16).reshape(60, 3, 2),
        "large steps": np.array([0, (1 << 29) - 1, 5 - (1 << 29)] * 50, np.int32),
    }
