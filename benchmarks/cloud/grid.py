"""Tracking errors of bodycast, over a grid of clips, frame rates, noise, shares of points and views.

    clip, rate, views ──record once──► clean points ──► noise, share kept ──► tracker with the first pose ──► one result

A result has the joint errors in centimetres, the number of lost frames (worst joint off by more than 10 cm) and their
longest run, and frames per second of processor time from raw points to a pose. An interrupted run continues where it
stopped.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from mocodec import formats
from mocodec.pointcloud import PointClouds
from mocodec.testing import sequences
from mocodec.typing import Bytes, Floats

from .. import datasets
from .. import markdown as md
from ..machine import machine_description
from ..progress import progress
from ..results import read_json
from . import makehuman, tracking

RATES, NOISES_CM, KEPT, VIEWS = (15, 30), (0.0, 0.5, 1.0, 2.0), (100, 25, 5, 1), (0, 3, 1)
POINTS = 10_000


class Condition(NamedTuple):
    """Clip; frames a second; noise on each coordinate, cm; percent of points kept; cameras (0: whole surface)."""

    clip: str
    rate: int = 15
    noise_cm: float = 0.0
    kept: int = 100
    views: int = 0

    @property
    def name(self) -> str:
        return f"{self.clip}, {self.rate} fps, {self.noise_cm:g} cm, {self.kept} %, {self.views or 'all'} views"


@dataclass
class GridResult:
    """Tracking results under one condition; lengths in centimetres."""

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
    """The whole grid, clip by clip. quick: only conditions that differ from the default in at most one parameter.

    quick orders conditions from mild to hard, all clips in each step, so that an interrupted run covers all clips.
    """
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
    default = Condition("")
    differs = {c: [a != b for a, b in zip(c[1:], default[1:], strict=True)] for c in every}
    single = [c for c in every if sum(differs[c]) < 2]
    steps = {
        c: (VIEWS.index(c.views), RATES.index(c.rate), NOISES_CM.index(c.noise_cm), KEPT.index(c.kept)) for c in single
    }
    return sorted(single, key=lambda c: (sum(steps[c]), *steps[c]))


def run(wanted: Sequence[Condition], data: Path, frames: int, known: Sequence[GridResult]) -> Iterator[GridResult]:
    """Results of these conditions. Conditions in `known` are not measured again; clips without a file are skipped."""
    done = {condition_of(r): r for r in known if r.frames == frames}
    actor = makehuman.find()
    recorded: tuple[str, int, int] | None = None
    act: sequences.Performance | None = None
    clouds = PointClouds([], 1.0)
    for condition in wanted:
        if condition in done:
            yield done[condition]
            continue
        if (key := (condition.clip, condition.rate, condition.views)) != recorded:
            recorded, act = key, tracking.perform(actor, data, condition.clip, frames, condition.rate)
            clouds = sequences.record(act, POINTS, views=condition.views, seed=1) if act else clouds
        if act is not None:
            yield GridResult(*condition, frames=frames, **tracking.track(act, thinned(clouds, condition)))


def condition_of(result: GridResult) -> Condition:
    """The condition of a result."""
    return Condition(result.clip, result.rate, result.noise_cm, result.kept, result.views)


def thinned(clouds: PointClouds, condition: Condition) -> PointClouds:
    """The recording with a random share of its points and with noise, as in the condition; views do not change."""
    assert clouds.colours is not None
    positions, colours = list[Floats](), list[Bytes]()
    for frame, (points, point_colours) in enumerate(zip(clouds.positions, clouds.colours, strict=True)):
        rng = np.random.default_rng([zlib.crc32(condition.name.encode()), frame])
        chosen = rng.permutation(len(points))[: round(len(points) * condition.kept / 100)]
        positions.append(points[chosen] + condition.noise_cm / 100 * rng.normal(size=(len(chosen), 3)))
        colours.append(point_colours[chosen])
    return replace(clouds, positions=positions, colours=colours)


def load(path: Path) -> list[GridResult]:
    """Results of an earlier run; empty if there is no file."""
    return [GridResult(**row) for row in (read_json(path) or {"results": []})["results"]]


def write(folder: Path, results: Sequence[GridResult]) -> list[Path]:
    """Write cloud_grid.json, one line per result, and cloud_grid.md; return the paths."""
    content = {
        "machine": machine_description(),
        "command": "scripts/bench cloud-grid",
        "results": [asdict(r) for r in results],
    }
    lines = json.dumps(content, indent=None).replace('{"clip"', '\n{"clip"')
    formats.replace_whole(folder / "cloud_grid.json", (lines + "\n").encode())
    return [folder / "cloud_grid.json", write_tables(folder)]


def write_tables(folder: Path) -> Path:
    """Write cloud_grid.md from cloud_grid.json; return its path."""
    path = folder / "cloud_grid.md"
    formats.replace_whole(path, markdown(load(folder / "cloud_grid.json")).encode())
    return path


def measure(
    folder: Path, quick: bool, frames: int, again: bool, data: Path = datasets.SHARED,
    report: Callable[[str], None] = lambda _: None,
) -> list[Path]:  # fmt: skip
    """Measure the conditions that have no result in the folder yet (all, if `again`); return the written paths."""
    known = [] if again else load(folder / "cloud_grid.json")
    fresh = list[GridResult]()
    for result in run(conditions(quick), data, frames, known):
        fresh.append(result)
        report(condition_of(result).name)
        if len(fresh) % 8 == 0:
            write(folder, merged(known, fresh))
    return write(folder, merged(known, fresh))


def merged(known: Sequence[GridResult], fresh: Sequence[GridResult]) -> list[GridResult]:
    """Known and fresh results in the grid's order. A fresh result replaces a known one of the same condition."""
    results = {condition_of(r): r for r in (*known, *fresh)}
    return [results[c] for c in conditions() if c in results]


def markdown(results: Sequence[GridResult]) -> str:
    """A table of the mild conditions by clip and rate, then all conditions by each parameter."""
    columns = ["mean cm", "max cm", "lost frames", "longest run", "frames/s"]
    frames = results[0].frames if results else 0
    parts = [
        "# Tracking a body over the grid",
        f"Made by `scripts/bench cloud-grid`: {len(results)} conditions of {frames} frames. A frame has {POINTS:,} "
        "points before a share of them is removed; the tracker gets the first pose. Lost frames: the worst joint is "
        "off by more than 10 cm. Frames/s count processor time, from raw points to a pose.",
        "## 15 and 30 frames/s, points of the whole surface, noise of at most 0.5 cm, all or a quarter of the points",
    ]
    rows = list[list[str]]()
    for clip in dict.fromkeys(r.clip for r in results):
        for rate in RATES:
            mild = [r for r in results if (r.clip, r.rate) == (clip, rate) and is_mild(r)]
            if mild:
                rows.append([clip, str(rate), *cells(mild)])
    parts.append(md.table(["clip", "rate", *columns], rows))
    groups: dict[str, Callable[[GridResult], str]] = {
        "clip": lambda r: r.clip, "rate": lambda r: f"{r.rate} frames/s", "noise": lambda r: f"{r.noise_cm:g} cm",
        "kept": lambda r: f"{r.kept} %", "views": lambda r: f"{r.views or 'all'}",
    }  # fmt: skip
    for parameter, key in groups.items():
        by_value = {value: [r for r in results if key(r) == value] for value in dict.fromkeys(map(key, results))}
        rows = [[value, str(len(group)), *cells(group)] for value, group in by_value.items()]
        parts += [f"## By {parameter}", md.table([parameter, "conditions", *columns], rows)]
    return "\n\n".join(parts) + "\n"


def is_mild(result: GridResult) -> bool:
    """Whether a condition is mild: the whole surface, at most 0.5 cm of noise, at least a quarter of the points."""
    return result.views == 0 and result.noise_cm <= 0.5 and result.kept >= 25


def cells(results: Sequence[GridResult]) -> list[str]:
    """Table cells: mean error, largest error, lost frames, their longest run, mean frames a second."""
    lost, frames = sum(r.lost_frames for r in results), sum(r.frames - 1 for r in results)
    return [
        f"{np.mean([r.mean_cm for r in results]):.2f}", f"{max(r.max_cm for r in results):.1f}",
        f"{lost} of {frames:,}",
        str(max(r.longest_loss for r in results)), f"{np.mean([r.fps for r in results]):.0f}",
    ]  # fmt: skip


@click.command("cloud-grid")
@click.option("-o", "--output", required=True, type=click.Path(file_okay=False, path_type=Path), help="Result folder.")
@click.option("--data", default=datasets.SHARED, show_default=True, type=click.Path(path_type=Path), help="Recordings.")
@click.option("--frames", default=60, show_default=True, type=click.IntRange(2), help="Frames of every clip.")
@click.option("--quick", is_flag=True, help="Vary one parameter at a time: an eighth of the grid.")
@click.option("--again", is_flag=True, help="Also measure conditions with a result in the folder.")
def command(output: Path, data: Path, frames: int, quick: bool, again: bool) -> None:
    """Track a body through eight clips at two frame rates, with noise, fewer points and fewer views.

    An interrupted run continues where it stopped. All 768 conditions take about half an hour on one core. Writes
    cloud_grid.json and cloud_grid.md.
    """
    output.mkdir(parents=True, exist_ok=True)
    with progress(len(conditions(quick))) as advance:
        paths = measure(output, quick, frames, again, data, advance)
    for path in paths:
        click.echo(path)
