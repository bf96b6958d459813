"""`scripts/bench cloud-speed`: speed of point clouds within a bound, by the length of the recording.

    jumping jacks, two lengths ─encode, decode, one thread─► seconds ─► frames a second, and constant seconds

A recording needs its body model and first pose once, so a frame of a short recording takes longer. Times are processor
times.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from mocodec import api
from mocodec.codecs.bodycast import Bodycast
from mocodec.pointcloud import PointClouds
from mocodec.testing import sequences

from ..machine import machine_description, measured_on
from ..markdown import table
from ..progress import progress
from ..results import read_json, rounded, write_json
from . import makehuman
from .points import D1_PER_BOUND, RATE


@dataclass(frozen=True)
class Case:
    """Recordings of one kind, in two lengths."""

    label: str
    points: int
    frames: tuple[int, int]
    coloured: bool
    bound_m: float | None
    """None: body surfaces with residual 25."""


BOUND_M = 0.002 / D1_PER_BOUND[2.0]
"""Gives a D1 of 2 mm for 10,000 points."""
CASES = (
    Case("10,000 points", 10_000, (60, 240), False, BOUND_M),
    Case("10,000 points, colours", 10_000, (60, 240), True, BOUND_M),
    Case("150,000 points, colours", 150_000, (4, 12), True, BOUND_M),
    Case("10,000 points, colours, residual 25", 10_000, (60, 240), True, None),
)


def measure(case: Case, frames: int) -> dict[str, Any]:
    """Seconds and bytes of one recording, with a first pose found without a skeleton."""
    performance = sequences.jumping_jacks(makehuman.find(), frames, RATE)
    clouds = sequences.record(performance, case.points, seed=1)
    if not case.coloured:
        clouds = replace(clouds, colours=None)
    codec = Bodycast(residual=25) if case.bound_m is None else Bodycast(max_error=case.bound_m)
    started = time.process_time()
    blob = api.encode(clouds, codec, threads=1)
    encoded = time.process_time()
    api.decode(blob, PointClouds, threads=1)
    return {
        "frames": frames, "bytes": len(blob), "encode_s": encoded - started, "decode_s": time.process_time() - encoded,
    }  # fmt: skip


def frames_a_second(short: dict[str, Any], long: dict[str, Any], way: str) -> list[str]:
    """Table cells: frames a second of the short and the long recording and of further frames; constant seconds."""
    further_s = (long[way] - short[way]) / (long["frames"] - short["frames"])
    once_s = max(0.0, short[way] - short["frames"] * further_s)
    return [
        f"{short['frames'] / short[way]:.3g}",
        f"{long['frames'] / long[way]:.3g}",
        f"{1 / max(further_s, 1e-9):.3g}",
        f"{once_s:.1f} s",
    ]


def page(results: dict[str, Any]) -> str:
    """The page with the table of docs/performance.md."""
    head = ["clouds", "frames", "bytes a frame"]
    for way in ("encode", "decode"):
        head += [f"{way}: short", "long", "a further frame", "once"]
    rows = [
        [
            case["label"],
            f"{short['frames']}, {long['frames']}",
            f"{short['bytes'] / short['frames']:,.0f}, {long['bytes'] / long['frames']:,.0f}",
            *frames_a_second(short, long, "encode_s"),
            *frames_a_second(short, long, "decode_s"),
        ]
        for case in results["cases"]
        for short, long in [case["recordings"]]
    ]
    note = (
        "Frames a second on one thread, of a short and of a longer recording, and of each further frame; *once*: what "
        f"a recording takes besides. Within {1000 * BOUND_M:.3g} mm, but for the last row. Jumping jacks at {RATE:g} "
        f"frames/s ({results['actor']}), first pose not given. {measured_on(results['machine'])} "
        f"Load by other work: {results['load']:.0f}. Made by `scripts/bench cloud-speed`."
    )
    return f"{table(head, rows)}\n\n{note}\n"


def write_tables(folder: Path) -> Path:
    """Write cloud_speed.md from the stored results; return its path."""
    (folder / "cloud_speed.md").write_text(page(read_json(folder / "cloud_speed.json")))
    return folder / "cloud_speed.md"


@click.command("cloud-speed")
@click.option("-o", "--output", default="docs/results", show_default=True, type=click.Path(path_type=Path))
@click.option("--frames", type=click.IntRange(2), help="Limit of the frames of a recording, for a quick look.")
def command(output: Path, frames: int | None) -> None:
    """Time encoding and decoding of point clouds by the length of the recording; write cloud_speed.json and .md."""
    output.mkdir(parents=True, exist_ok=True)
    cases = list[dict[str, Any]]()
    load = os.getloadavg()[0]
    with progress(2 * len(CASES)) as advance:
        for case in CASES:
            recordings = list[dict[str, Any]]()
            for length in case.frames:
                recordings.append(measure(case, min(length, frames or length)))
                advance(f"{case.label}, {length} frames")
            cases.append({"label": case.label, "recordings": recordings})
    results = {"cases": cases, "actor": makehuman.find().name, "load": load, "machine": machine_description()}
    write_json(output / "cloud_speed.json", rounded(results))
    click.echo(write_tables(output))
