"""Bytes of shorter chunks: `scripts/bench chunk-lengths` → docs/results/chunk_lengths.json.

    recordings ──► windows of 3, 5 and 10 s, and whole ──► tempo with chunks of 1, 2 and 4 s ──► bytes of each

A damaged byte costs at least one chunk, since a damaged chunk loses all its frames. Bytes are those of the whole file
without extras.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from mocodec import api, formats
from mocodec.motion import Motion

from . import datasets, results
from .machine import machine_description

RESULTS = Path("docs/results/chunk_lengths.json")
FILES = (
    "cmu/asfamc/16/16_03.amc", "cmu/asfamc/118/118_20.amc", "cmu/asfamc/131/131_04.amc", "cmu/asfamc/49/49_20.amc",
    "cmu/c3d/85_02.c3d", "field-c3d/Vicon.c3d", "field-c3d/Qualisys.c3d", "field-c3d/Movement_trial.c3d",
    "field-trc/Gait.trc", "cmu/c3d/85_12.c3d", "cmu/bvh/salsa_09.bvh",
)  # fmt: skip
LENGTHS_S = (3.0, 5.0, 10.0)
WHOLE_AT_LEAST_S = 12.0
CHUNKS_S = (1.0, 2.0, 4.0)
TARGETS: tuple[dict[str, Any], ...] = ({"max_error": 0.005}, {"max_error": 0.001}, {"mean_error": 0.003})


def windows(motion: Motion) -> dict[str, Motion]:
    """The clips to measure: the middle of the recording, at each length up to its own; all of a long recording."""
    bare = replace(motion, extras={}, rotations=None)
    clips: dict[str, Motion] = {}
    for seconds in LENGTHS_S:
        frames = round(seconds * motion.rate)
        if frames <= len(motion):
            first = (len(motion) - frames) // 2
            clips[f"{seconds:g} s"] = bare[first : first + frames]
    if motion.seconds >= WHOLE_AT_LEAST_S:
        clips["longer"] = bare
    elif motion.seconds < LENGTHS_S[0]:
        clips["shorter"] = bare
    return clips


def measure(root: Path) -> list[dict[str, Any]]:
    """One record for each clip and target: bytes with each chunk length. Prints a line for each."""
    records: list[dict[str, Any]] = []
    for name in FILES:
        for length, clip in windows(api.read(root / name, Motion)).items():
            for target in TARGETS:
                sizes = {f"{s:g}": len(api.encode(clip, "tempo", chunk_seconds=s, **target)) for s in CHUNKS_S}
                records.append({"file": name, "clip": length, "seconds": clip.seconds, **target, "bytes": sizes})
                click.echo(f"{name} {length} {target}: {sizes}")
    return records


def table(records: list[dict[str, Any]]) -> list[str]:
    """A Markdown table: extra bytes of chunks of 2 and 1 s over 4 s, means over clips of each length."""
    lines = ["| clip | clips × targets | chunks of 2 s | chunks of 1 s |", "|---|---|---|---|"]
    for clip in dict.fromkeys(record["clip"] for record in sorted(records, key=lambda r: r["seconds"])):
        sizes = [record["bytes"] for record in records if record["clip"] == clip]
        more = (f"{100 * (sum(n[s] / n['4'] for n in sizes) / len(sizes) - 1):+.1f} %" for s in ("2", "1"))
        lines.append(f"| {clip} | {len(sizes)} | {' | '.join(more)} |")
    return lines


@click.command("chunk-lengths")
@click.option("--data", type=click.Path(path_type=Path), default=datasets.SHARED, help="Folder of the recordings.")
@click.option("--tables", is_flag=True, help="Only write the table from the stored results.")
def command(data: Path, tables: bool) -> None:
    """Measure the bytes of chunks of 1 and 2 s against 4 s; write docs/results/chunk_lengths.json and .md."""
    if not tables:
        records = results.rounded(measure(data))
        results.write_json(RESULTS, {"machine": machine_description(), "clips": records})
    text = "\n".join(table(results.read_json(RESULTS)["clips"])) + "\n"
    formats.replace_whole(RESULTS.with_suffix(".md"), text.encode())
    click.echo(text, nl=False)
