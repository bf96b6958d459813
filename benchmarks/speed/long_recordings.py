"""`scripts/bench long`: recordings too long for memory, encoded in blocks and whole.

    recordings of one skeleton, repeated ─generator─► encode_blocks ─► processor time, peak memory, bytes
                                         └─all frames in memory─► encode ─► the same measures

Each case runs in its own process, for a separate peak of resident memory.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

import mocodec as mc

from ..machine import machine_description, measured_on
from ..markdown import table
from ..results import read_json, rounded, write_json
from .recordings import DATA

RESULTS, PAGE = Path("docs/results/long.json"), Path("docs/results/long.md")
SOURCES = "cmu/asfamc/*/*.amc"
SOURCE_FRAMES, BLOCK_FRAMES, RATE = 60_000, 4096, 120
MAX_ERROR_M = 0.005
CASES = ((0.5, "blocks"), (0.5, "at once"), (1.0, "blocks"), (10.0, "blocks"))
"""Hours, and kind of encoding."""
MEGABYTE = 1e6


def joined_recordings() -> mc.Motion:
    """Concatenated positions of recordings of the same joints, with the bones of the first."""
    parts: list[mc.Motion] = []
    for path in sorted(DATA.glob(SOURCES)):
        motion = mc.read(path, mc.Motion)
        if not parts or motion.names == parts[0].names:
            parts.append(motion)
        if sum(map(len, parts)) >= SOURCE_FRAMES:
            break
    if not parts:
        raise mc.BadInput(f"no recordings {DATA / SOURCES}; name a folder of recordings with MOCODEC_DATA")
    positions = np.concatenate([m.positions for m in parts])[:SOURCE_FRAMES]
    return replace(parts[0], positions=positions, rotations=None, extras={})


def blocks(source: mc.Motion, frames: int) -> Iterator[mc.Motion]:
    """Yields `frames` frames: the source, repeated."""
    at = 0
    while at < frames:
        start = at % (len(source) - BLOCK_FRAMES)
        block = source[start : start + min(BLOCK_FRAMES, frames - at)]
        at += len(block)
        yield block


def measure_here(source: Path, hours: float, how: str) -> dict[str, Any]:
    """Measures one case in this process."""
    with np.load(source) as arrays:
        skeleton = mc.Skeleton(tuple(arrays["names"].tolist()), tuple(arrays["parents"].tolist()), arrays["offsets"])
        motion = mc.Motion(arrays["positions"], RATE, skeleton.names, "y", skeleton)
    frames = round(hours * 3600 * RATE)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.mocz"
        if how == "blocks":
            begin = time.process_time()
            written = mc.encode_blocks(blocks(motion, frames), path, frames=frames, max_error=MAX_ERROR_M)
            largest = written.max_error
        else:
            whole = replace(motion, positions=np.concatenate([b.positions for b in blocks(motion, frames)]))
            begin = time.process_time()
            path.write_bytes(mc.encode(whole, max_error=MAX_ERROR_M))
            largest = MAX_ERROR_M
        seconds, size = time.process_time() - begin, path.stat().st_size
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {
        "hours": hours,
        "how": how,
        "frames": frames,
        "seconds": seconds,
        "before_bytes": before,
        "peak_bytes": peak,
        "file_bytes": size,
        "max_error": largest,
    }


def measure(source: Path, hours: float, how: str) -> dict[str, Any]:
    """Measures one case in a new process."""
    command = [sys.executable, "-m", __name__, str(source), str(hours), how]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def page(results: dict[str, Any]) -> str:
    """The table of docs/performance.md."""
    rows = [
        [
            f"{c['hours']:g} h",
            c["how"],
            f"{c['seconds']:,.0f} s",
            f"{c['frames'] / c['seconds']:,.0f}",
            f"{c['peak_bytes'] / MEGABYTE:,.0f} MB",
            f"{c['before_bytes'] / MEGABYTE:,.0f} MB",
            f"{c['file_bytes']:,}",
            f"{1000 * c['max_error']:.2f} mm",
        ]
        for c in results["cases"]
    ]
    head = [
        "31 joints at 120 Hz",
        "encoded",
        "processor time",
        "frames/s",
        "peak memory",
        "before",
        "bytes",
        "largest error",
    ]
    return "\n\n".join(
        [
            table(head, rows),
            "Blocks include decoding and measuring every chunk. *Before*: memory of the process with the source of "
            f"{SOURCE_FRAMES:,} frames, before encoding. {measured_on(results['machine'])} Load by other work: "
            f"{results['load']:.0f}. Made by `scripts/bench long`.",
        ]
    )


@click.command("long")
@click.option("--table-only", is_flag=True, help="Write the table from the stored results.")
@click.option("--hours", type=float, help="Only recordings of at most this length.")
def command(table_only: bool, hours: float | None) -> None:
    """Encode long recordings in blocks and whole; write docs/results/long.json and long.md."""
    if not table_only:
        motion = joined_recordings()
        assert motion.skeleton is not None
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "source.npz"
            np.savez(
                source, positions=motion.positions, names=np.array(motion.names),
                parents=np.array(motion.skeleton.parents), offsets=motion.skeleton.offsets,
            )  # fmt: skip
            cases: list[dict[str, Any]] = []
            for case in CASES:
                if hours is None or case[0] <= hours:
                    cases.append(measure(source, *case))
                    click.echo(f"{case[0]:g} h, {case[1]}: {cases[-1]['seconds']:.0f} s")
        write_json(RESULTS, rounded({"cases": cases, "load": os.getloadavg()[0], "machine": machine_description()}))
    PAGE.write_text(page(read_json(RESULTS)) + "\n")
    click.echo(f"wrote {RESULTS} and {PAGE}")


if __name__ == "__main__":
    print(json.dumps(measure_here(Path(sys.argv[1]), float(sys.argv[2]), sys.argv[3])))
