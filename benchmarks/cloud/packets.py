"""`scripts/bench cloud-stream`: packets with all points of a frame within a bound, against a file with the same bound.

jumping jacks ─frame by frame─► packets ─► points         bytes a frame, frames a second
          └─────whole─────────► file
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec import api
from mocodec.codecs.bodycast import Bodycast
from mocodec.codecs.bodycast.streaming import Receiver, Sender
from mocodec.testing import sequences

from ..machine import machine_description, measured_on
from ..markdown import table
from ..progress import progress
from ..results import read_json, rounded, write_json
from . import makehuman
from .points import RATE
from .speed import BOUND_M

FRAMES = 60
CASES = {"10,000 points": False, "10,000 points, colours": True}
"""Whether the points of each case have colours."""


def measure(coloured: bool, frames: int) -> dict[str, Any]:
    """Bytes and processor seconds of a stream and of a file. The first frame, which finds the body, is separate."""
    clouds = sequences.record(sequences.jumping_jacks(makehuman.find(), frames, RATE), 10_000, seed=1)
    if not coloured:
        clouds = replace(clouds, colours=None)
    sender, receiver = Sender(max_error=BOUND_M), Receiver()
    sizes, pushed, received = list[int](), list[float](), list[float]()
    for points, colours in zip(clouds.positions, clouds.colours or [None] * frames, strict=True):
        started = time.process_time()
        packets = sender.push(points, colours)
        coded = time.process_time()
        for packet in packets:
            receiver.push(packet)
        pushed.append(coded - started)
        received.append(time.process_time() - coded)
        sizes.append(len(packets[-1]))
    return {
        "frames": frames, "model_bytes": len(sender.model), "packet_bytes": float(np.mean(sizes)),
        "file_bytes": len(api.encode(clouds, Bodycast(max_error=BOUND_M))) / frames,
        "first_s": pushed[0], "push_s": float(np.median(pushed[1:])), "receive_s": float(np.median(received[1:])),
    }  # fmt: skip


def page(results: dict[str, Any]) -> str:
    """The page with the table of docs/howto/streaming.md."""
    head = ["frames of", "model", "a packet", "a frame of a file", "first frame", "`Sender.push`", "`Receiver.push`"]
    rows = [
        [
            label,
            f"{case['model_bytes']:,} bytes",
            f"{case['packet_bytes']:,.0f} bytes",
            f"{case['file_bytes']:,.0f} bytes",
            f"{case['first_s']:.1f} s",
            f"{1000 * case['push_s']:.0f} ms",
            f"{1000 * case['receive_s']:.0f} ms",
        ]
        for label, case in results["cases"].items()
    ]
    frames = next(iter(results["cases"].values()))["frames"]
    note = (
        f"Within {1000 * BOUND_M:.3g} mm, each frame decoded and measured; the first frame finds the body without a "
        f"skeleton; medians of the others, one thread. {frames} frames of jumping jacks at {RATE:g} frames/s "
        f"({results['actor']}). {measured_on(results['machine'])} Load by other work: {results['load']:.0f}. Made by "
        "`scripts/bench cloud-stream`."
    )
    return f"{table(head, rows)}\n\n{note}\n"


def write_tables(folder: Path) -> Path:
    """Write cloud_stream.md from the stored results; return its path."""
    (folder / "cloud_stream.md").write_text(page(read_json(folder / "cloud_stream.json")))
    return folder / "cloud_stream.md"


@click.command("cloud-stream")
@click.option("-o", "--output", default="docs/results", show_default=True, type=click.Path(path_type=Path))
@click.option("--frames", default=FRAMES, show_default=True, type=click.IntRange(2))
def command(output: Path, frames: int) -> None:
    """Stream point clouds within a bound, frame by frame; write cloud_stream.json and .md."""
    output.mkdir(parents=True, exist_ok=True)
    cases, load = dict[str, Any](), os.getloadavg()[0]
    with progress(len(CASES)) as advance:
        for label, coloured in CASES.items():
            cases[label] = measure(coloured, frames)
            advance(label)
    results = {"cases": cases, "actor": makehuman.find().name, "load": load, "machine": machine_description()}
    write_json(output / "cloud_stream.json", rounded(results))
    click.echo(write_tables(output))
