"""How closely bodycast follows a body over the whole grid: clips × rates × noise × share kept × views.

    mocodec eval cloud-grid [--quick] [--frames 60] [-o docs/results]

    clip, rate, views ──record once──► clean points ──► noise, share kept ──► tracker, first pose given ──► a condition

One condition is a line of cloud_grid.json: joint errors in centimetres, frames whose worst joint is off by more than
10 cm and the longest run of them, frames a second of processor time from raw points to a pose. A run that was stopped
goes on where it was; --quick varies one thing at a time. Writes cloud_grid.md beside it.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ... import formats
from ...pointcloud import PointClouds
from .. import datasets, runner
from . import actors, sequences, tracking

RATES, NOISES_CM, KEPT, VIEWS = (15, 30), (0.0, 0.5, 1.0, 2.0), (100, 25, 5, 1), (0, 3, 1)
POINTS = 10_000


class Condition(NamedTuple):
    """clip; frames a second; noise on each coordinate, cm; percent of 10,000 points; cameras, 0 for points all over."""

    clip: str
    rate: int = 15
    noise_cm: float = 0.0
    kept: int = 100
    views: int = 0

    @property
    def name(self) -> str:
        return f"{self.clip}, {self.rate} fps, {self.noise_cm:g} cm, {self.kept} %, {self.views or 'all'} views"


@dataclass
class Result:
    """What came out of one condition; lengths in centimetres."""

    clip: str
    rate: int
    noise_cm: float
    kept: int
    views: int
    frames: int
    mean_cm: float
    max_cm: float
    lost_frames: int
    longest_loss: int
    fps: float


def conditions(quick: bool = False) -> list[Condition]:
    """The whole grid, clip by clip; or with `quick` what differs from the ordinary condition in one thing, all clips in
    each and the mildest first: so a run that is stopped has something of every clip."""
    every = [
        Condition(clip, rate, noise, kept, views)
        for clip in tracking.STARTS
        for rate in RATES
        for views in VIEWS
        for noise in NOISES_CM
        for kept in KEPT
    ]
    if not quick:
        return every
    ordinary = Condition("")
    differs = {c: [a != b for a, b in zip(c[1:], ordinary[1:], strict=True)] for c in every}
    few = [c for c in every if sum(differs[c]) < 2]
    steps = {
        c: (VIEWS.index(c.views), RATES.index(c.rate), NOISES_CM.index(c.noise_cm), KEPT.index(c.kept)) for c in few
    }
    return sorted(few, key=lambda c: (sum(steps[c]), *steps[c]))


def run(wanted: Sequence[Condition], data: Path, frames: int, known: Sequence[Result]) -> Iterator[Result]:
    """The results of conditions, those that are known as they are; none of clips whose recordings are not there."""
    done = {Condition(r.clip, r.rate, r.noise_cm, r.kept, r.views): r for r in known if r.frames == frames}
    actor = actors.find()
    shot, clouds, act = ("", 0, -1), PointClouds([], 1.0), None
    for condition in wanted:
        if condition in done:
            yield done[condition]
            continue
        if (now := (condition.clip, condition.rate, condition.views)) != shot:
            shot, act = now, tracking.perform(actor, data, condition.clip, frames, condition.rate)
            clouds = sequences.record(act, POINTS, views=condition.views, seed=1) if act else clouds
        if act is not None:
            found = tracking.measured(act, thinned(clouds, condition))
            yield Result(*condition, frames=frames, **found)


def thinned(clouds: PointClouds, condition: Condition) -> PointClouds:
    """The recording with a share of its points removed at random, and noise."""
    assert clouds.colours is not None
    positions, colours = list[Any](), list[Any]()
    for frame, (points, shades) in enumerate(zip(clouds.positions, clouds.colours, strict=True)):
        rng = np.random.default_rng([zlib.crc32(condition.name.encode()), frame])
        some = rng.permutation(len(points))[: round(len(points) * condition.kept / 100)]
        positions.append(points[some] + condition.noise_cm / 100 * rng.normal(size=(len(some), 3)))
        colours.append(shades[some])
    return replace(clouds, positions=positions, colours=colours)


def load(path: Path) -> list[Result]:
    """Results of an earlier run; none where there are none."""
    return [Result(**row) for row in json.loads(path.read_text())["results"]] if path.is_file() else []


def write(folder: Path, results: Sequence[Result]) -> list[Path]:
    """DIR/cloud_grid.json and DIR/cloud_grid.md."""
    content = {
        "machine": runner.machine(),
        "command": "mocodec eval cloud-grid",
        "results": [asdict(r) for r in results],
    }
    lines = json.dumps(content, indent=None).replace('{"clip"', '\n{"clip"')
    paths = [folder / "cloud_grid.json", folder / "cloud_grid.md"]
    formats.replace_whole(paths[0], (lines + "\n").encode())
    formats.replace_whole(paths[1], markdown(results).encode())
    return paths


def measure(
    folder: Path, quick: bool, frames: int, again: bool, data: Path = datasets.SHARED,
    told: Callable[[str], None] = lambda _: None,
) -> list[Path]:  # fmt: skip
    """Everything that is not in the folder yet."""
    path = folder / "cloud_grid.json"
    known = [] if again else load(path)
    wanted, fresh = conditions(quick), list[Result]()
    for result in run(wanted, data, frames, known):
        fresh.append(result)
        told(Condition(result.clip, result.rate, result.noise_cm, result.kept, result.views).name)
        if len(fresh) % 8 == 0:
            write(folder, merged(known, fresh))
    return write(folder, merged(known, fresh))


def merged(known: Sequence[Result], fresh: Sequence[Result]) -> list[Result]:
    """Both, in the grid's order; of one condition the fresh one."""
    by = {Condition(r.clip, r.rate, r.noise_cm, r.kept, r.views): r for r in (*known, *fresh)}
    return [by[c] for c in conditions() if c in by]


def markdown(results: Sequence[Result]) -> str:
    """The condition that is to be met clip by clip; then everything by clip, rate, noise, share kept and views."""
    lines = [
        "# Following a body over the grid", "",
        f"Made by `mocodec eval cloud-grid`: {len(results)} conditions of {results[0].frames if results else 0} "
        f"frames, {POINTS:,} points before any are removed, first pose given. Lost: frames whose worst joint is off "
        "by more than 10 cm. Frames a second are of processor time, from raw points to a pose.", "",
        "## 15 and 30 frames/s, points all over, at most half a centimetre of noise, all or a quarter kept", "",
        "| clip | rate | mean cm | max cm | lost frames | longest run | frames/s |", "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for clip in dict.fromkeys(r.clip for r in results):
        for rate in RATES:
            some = [
                r
                for r in results
                if (r.clip, r.rate, r.views) == (clip, rate, 0) and r.noise_cm <= 0.5 and r.kept >= 25
            ]
            if some:
                lines.append(f"| {clip} | {rate} | {' | '.join(cells(some))} |")
    groups: dict[str, Callable[[Result], str]] = {
        "clip": lambda r: r.clip, "rate": lambda r: f"{r.rate} frames/s", "noise": lambda r: f"{r.noise_cm:g} cm",
        "kept": lambda r: f"{r.kept} %", "views": lambda r: f"{r.views or 'all'}",
    }  # fmt: skip
    for what, key in groups.items():
        lines += [
            "",
            f"## By {what}",
            "",
            f"| {what} | conditions | mean cm | max cm | lost frames | longest run | frames/s |",
        ]
        lines += ["|---|---|---|---|---|---|---|"]
        for value in dict.fromkeys(map(key, results)):
            some = [r for r in results if key(r) == value]
            lines.append(f"| {value} | {len(some)} | {' | '.join(cells(some))} |")
    return "\n".join(lines) + "\n"


def cells(some: Sequence[Result]) -> list[str]:
    """Mean of means, largest maximum, lost frames of all, longest run, mean frames a second."""
    lost, frames = sum(r.lost_frames for r in some), sum(r.frames - 1 for r in some)
    return [
        f"{np.mean([r.mean_cm for r in some]):.2f}", f"{max(r.max_cm for r in some):.1f}", f"{lost} of {frames:,}",
        str(max(r.longest_loss for r in some)), f"{np.mean([r.fps for r in some]):.0f}",
    ]  # fmt: skip
