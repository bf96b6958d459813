"""Strange motions and targets, each from a number: what no recording of a person has, and files have all the same.

motion(number) ─► a walk, noise, a constant …, changed by one to three of CHANGES
target(number, codec, motion) ─► settings with a hard bound, a mean error, a ratio, a size, or none
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

from mocodec import codecs
from mocodec.motion import Motion, Skeleton
from mocodec.testing import synthetic
from mocodec.typing import Floats

CODECS = ("tempo", "hou2014", "liu2006", "lossless")
RATES = (0.001, 0.5, 24.0, 29.97, 60.0, 120.0, 1000.0, 1e6)
Random = np.random.Generator


def motion(number: int) -> Motion:
    """The motion of this number: at most 60 frames of 12 points, one in twenty up to 700 frames of 41."""
    random = np.random.default_rng([number, 1])
    large = random.random() < 0.05
    frames = int(random.integers(1, 700 if large else 61))
    points = int(random.integers(1, 42 if large else 13))
    joints = random.random() < 0.2
    walk = synthetic.joints(frames, seed=number % 50) if joints else synthetic.markers(frames, seed=number % 50)
    chosen = np.sort(random.permutation(walk.points)[:points])
    positions = (
        walk.positions[:, chosen]
        if random.random() < 0.6
        else BASES[random.integers(len(BASES))](random, frames, points)
    )
    positions = np.array(positions, np.float64)
    for _ in range(int(random.integers(1, 4))):
        CHANGES[random.integers(len(CHANGES))](positions, random)
    positions = np.nan_to_num(positions, nan=np.nan, posinf=1e308, neginf=-1e308)
    if np.isnan(positions).all():
        positions[0, 0] = 0.0
    skeleton = _skeleton(random, positions.shape[1]) if random.random() < 0.25 else None
    names = (
        tuple(walk.names[c] for c in chosen[: positions.shape[1]]) if random.random() < 0.5 and skeleton is None else ()
    )
    names = names if len(names) == positions.shape[1] else ()
    rate = RATES[random.integers(len(RATES))] if random.random() < 0.5 else 120.0
    names = skeleton.names if skeleton is not None else names
    return Motion(positions, rate, names, "xyz"[random.integers(3)], skeleton, source={"unit_m": 0.001})


def target(number: int, codec: str, of: Motion) -> dict[str, Any]:
    """Settings of a target that the codec has, from easy to impossible."""
    random = np.random.default_rng([number, 2])
    known = {f.name for f in fields(codecs.codec_class(codec))}
    names = [name for name in ("max_error", "max_error", "mean_error", "mean_error", "ratio", "size") if name in known]
    if not names or random.random() < 0.05:
        return {}
    name = names[random.integers(len(names))]
    usual = float(np.nanmedian(np.abs(of.positions)))
    scale = usual if random.random() < 0.5 and 0 < usual < 1e300 else 1.0
    error = scale * 10.0 ** random.uniform(-5, 0)
    values = {"max_error": error, "mean_error": error, "ratio": 10.0 ** random.uniform(0, 3)}
    values["size"] = int(10 ** random.uniform(1.5, 5))
    return {name: values[name]}


def _skeleton(random: Random, points: int) -> Skeleton:
    """A random tree, some of whose bones have no length."""
    parents = tuple(-1 if i == 0 else int(random.integers(i)) for i in range(points))
    offsets = random.normal(size=(points, 3)) * (random.random((points, 1)) < 0.7) * 10.0 ** random.integers(-3, 2)
    return Skeleton(tuple(f"J{i}" for i in range(points)), parents, offsets)


BASES: tuple[Callable[[Random, int, int], Floats], ...] = (
    lambda random, frames, points: random.normal(size=(frames, points, 3)),
    lambda random, frames, points: np.cumsum(random.normal(size=(frames, points, 3)), axis=0),
    lambda random, frames, points: np.zeros((frames, points, 3)),
    lambda random, frames, points: np.ones((frames, points, 3)) * random.normal(size=3),
    lambda random, frames, points: np.repeat(random.normal(size=(1, points, 3)), frames, axis=0),
    lambda random, frames, points: random.integers(-3, 4, (frames, points, 3)) / 4.0,
)
"""What a strange motion may begin as, beside a walk."""


def _samples(p: Floats, random: Random, most: float) -> tuple[Any, Any]:
    """Frames and points of a random share of the samples."""
    frames, points = np.nonzero(random.random(p.shape[:2]) < most * random.random())
    return frames, points


def _run(p: Floats, random: Random) -> slice:
    a, b = np.sort(random.integers(0, len(p) + 1, 2))
    return slice(int(a), int(b))


def _spikes(p: Floats, random: Random) -> None:
    at = _samples(p, random, 0.1)
    p[at] += random.normal(size=(len(at[0]), 3)) * 10.0 ** random.integers(-2, 4)


def _jump(p: Floats, random: Random) -> None:
    p[_run(p, random)] += random.normal(size=3) * 10.0 ** random.integers(-2, 4)


def _gaps(p: Floats, random: Random) -> None:
    p[_samples(p, random, 1.0)] = np.nan


def _gap_runs(p: Floats, random: Random) -> None:
    for point in range(p.shape[1]):
        if random.random() < 0.5:
            p[_run(p, random), point] = np.nan


def _park(p: Floats, random: Random) -> None:
    where = [np.zeros(3), np.full(3, 3.2767), random.normal(size=3), np.full(3, -9999.99), np.full(3, 1e30)]
    at = where[random.integers(len(where))]
    for point in range(p.shape[1]):
        if random.random() < 0.6:
            p[_run(p, random), point] = at


def _freeze(p: Floats, random: Random) -> None:
    for point in range(p.shape[1]):
        run = _run(p, random)
        if random.random() < 0.6 and run.start < run.stop:
            p[run, point] = p[run.start, point]


def _scale(p: Floats, random: Random) -> None:
    with np.errstate(all="ignore"):
        p *= 10.0 ** random.integers(-12, 13)


def _extreme(p: Floats, random: Random) -> None:
    with np.errstate(all="ignore"):
        p *= 10.0 ** random.choice([-320, -300, -150, 100, 200, 300])


def _far(p: Floats, random: Random) -> None:
    p += random.normal(size=3) * 10.0 ** random.integers(0, 12)


def _one_extreme(p: Floats, random: Random) -> None:
    p[random.integers(len(p)), random.integers(p.shape[1])] = random.choice([1e9, 1e15, 1e39, 1e200, 5e-324, -1e308])


def _duplicate(p: Floats, random: Random) -> None:
    p[:, random.integers(p.shape[1])] = p[:, random.integers(p.shape[1])]


def _repeat(p: Floats, random: Random) -> None:
    p[:] = p[np.arange(len(p)) // int(random.integers(2, 9)) * 1 % len(p)]


def _coarse(p: Floats, random: Random) -> None:
    step = 10.0 ** random.integers(-5, 1)
    p[:] = np.rint(p / step) * step


def _noise(p: Floats, random: Random) -> None:
    p += random.normal(size=p.shape) * 10.0 ** random.integers(-9, 1)


def _flat(p: Floats, random: Random) -> None:
    p[..., random.integers(3)] = random.choice([0.0, -0.0, 1.0])


def _step_at_chunk(p: Floats, random: Random) -> None:
    edge = int(random.choice([1, 2, len(p) // 2, len(p) - 1]))
    p[edge : edge + 1] += 0.1 * 10.0 ** random.integers(-1, 3)


CHANGES = (
    _spikes, _jump, _gaps, _gap_runs, _park, _freeze, _scale, _extreme, _far, _one_extreme, _duplicate, _repeat,
    _coarse, _noise, _flat, _step_at_chunk,
)  # fmt: skip
"""What makes a motion strange; each changes positions (frames, points, 3) in place."""
