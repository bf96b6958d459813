"""Compression ratios of long sequences of point clouds, measured on whole files, not extrapolated.

1,000 frames without a residual and 300 with one, as complete .mocz files with the first pose given; processor time of
encoding and decoding.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec import api
from mocodec.metrics import point_clouds
from mocodec.pointcloud import PointClouds
from mocodec.testing import sequences

from .. import datasets
from ..machine import machine_description
from ..progress import progress
from ..results import write_json
from . import makehuman, tracking
from .runner import once_bytes

POINTS, RATE = 10_000, 15.0
RUNS = (
    ("jumping jacks", "bodycast", 0, 1000), ("jumping jacks", "bodycast", 25, 300),
    ("jumping jacks", "bodycast", 100, 300), ("02_05", "bodycast", 0, 300), ("02_05", "bodycast", 25, 300),
    ("jumping jacks", "lien2006", 0, 300), ("jumping jacks", "lien2006", 25, 300),
)  # fmt: skip
"""Clip, codec, residual in percent, most frames (clips may be shorter)."""


@dataclass
class LongRun:
    """One coded sequence. bytes: the whole file; once_bytes: bytes that do not grow with the number of frames;
    quality, floor: measures of `point_clouds.compare`, for the decoded and for a second perfect sample.
    """

    clip: str
    codec: str
    residual: int
    frames: int
    points: int
    raw_bytes: int
    bytes: int
    once_bytes: int
    ratio: float
    ratio_without_once: float
    bytes_a_frame: float
    encode_fps: float
    decode_fps: float
    quality: dict[str, float]
    floor: dict[str, float]


def measure(
    folder: Path, quick: bool, data: Path = datasets.SHARED, report: Callable[[str], None] = lambda _: None
) -> Path:
    """Write cloud_long.json with all runs (quick: over a tenth of the frames) and return its path."""
    actor, results = makehuman.find(), list[LongRun]()
    recorded: dict[str, tuple[sequences.Performance, PointClouds]] = {}
    for clip, codec, residual, frames in RUNS:
        most = max(frames for name, _, _, frames in RUNS if name == clip) // (10 if quick else 1)
        if clip not in recorded:
            act = tracking.perform(actor, data, clip, most, RATE)
            if act is None:
                continue
            recorded[clip] = act, sequences.record(act, POINTS, seed=1)
        act, clouds = recorded[clip]
        count = min(len(clouds), frames // (10 if quick else 1))
        results.append(code(act, clouds[:count], clip, codec, residual))
        report(f"{clip}, {codec} {residual} %, {count} frames")
        runs = [asdict(r) for r in results]
        content = {"machine": machine_description(), "command": "scripts/bench cloud-long", "runs": runs}
        write_json(folder / "cloud_long.json", content)
    return folder / "cloud_long.json"


def code(act: sequences.Performance, clouds: PointClouds, clip: str, codec: str, residual: int) -> LongRun:
    """Encode and decode one recording; measure ten of its frames, and a second sample of the surface in them."""
    options: dict[str, Any] = {"residual": residual, "skeleton": act.skeleton()[:1]}
    started = time.process_time()
    blob = api.encode(clouds, codec, **options)
    encoded = time.process_time()
    decoded = api.decode(blob)
    done = time.process_time()
    assert isinstance(decoded, PointClouds)
    once = once_bytes(blob)
    frames = np.unique(np.linspace(1, len(clouds) - 1, 10).round().astype(int)).tolist()
    second_sample = sequences.record(replace(act, turns=act.turns[frames], root=act.root[frames]), POINTS, seed=2)
    colours = clouds.colours or []
    measured = replace(clouds, positions=[clouds.positions[f] for f in frames], colours=[colours[f] for f in frames])
    moving = (len(blob) - once) / len(clouds)
    raw = clouds.raw_bytes / len(clouds)
    return LongRun(
        clip, codec, residual, len(clouds), POINTS, clouds.raw_bytes, len(blob), once,
        round(clouds.raw_bytes / len(blob), 1), round(raw / moving, 1), round(moving, 1),
        round(len(clouds) / (encoded - started), 1), round(len(clouds) / max(done - encoded, 1e-9), 1),
        to_five_decimals(point_clouds.compare(clouds, decoded, frames)),
        to_five_decimals(point_clouds.compare(measured, second_sample, range(len(frames)))),
    )  # fmt: skip


def to_five_decimals(values: dict[str, float]) -> dict[str, float]:
    """Rounded values."""
    return {key: round(value, 5) for key, value in values.items()}


@click.command("cloud-long")
@click.option("-o", "--output", required=True, type=click.Path(file_okay=False, path_type=Path), help="Result folder.")
@click.option("--data", default=datasets.SHARED, show_default=True, type=click.Path(path_type=Path), help="Recordings.")
@click.option("--quick", is_flag=True, help="A tenth of the frames.")
def command(output: Path, data: Path, quick: bool) -> None:
    """Code 1,000 frames of 10,000 points without a residual and 300 frames with one: about ten minutes.

    Writes cloud_long.json; `cloud-summary` shows it.
    """
    output.mkdir(parents=True, exist_ok=True)
    with progress(len(RUNS)) as advance:
        click.echo(measure(output, quick, data, advance))
