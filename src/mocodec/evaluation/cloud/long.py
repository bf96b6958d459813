"""Long sequences in fact: what is sent once, spread over as many frames as there are.

    mocodec eval cloud-long [--quick] [-o docs/results]

1,000 frames with no residual and 300 with one, whole .mocz files, every byte counted; times of the processor for the
whole of encoding and decoding, the first pose given. Writes cloud_long.json.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ... import api, formats
from ...pointcloud import PointClouds
from .. import datasets, runner
from . import actors, measures, sequences, tracking

POINTS, RATE = 10_000, 15.0
RUNS = (
    ("jumping jacks", "bodycast", 0, 1000), ("jumping jacks", "bodycast", 25, 300),
    ("jumping jacks", "bodycast", 100, 300), ("02_05", "bodycast", 0, 300), ("02_05", "bodycast", 25, 300),
    ("jumping jacks", "lien2006", 0, 300), ("jumping jacks", "lien2006", 25, 300),
)  # fmt: skip
"""Clip, codec, residual in percent, frames; a clip that is shorter has its own length."""


@dataclass
class Run:
    """What came out of one run; bytes of the whole file and of what is sent once; measures of `measures.compare`."""

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
    folder: Path, quick: bool, data: Path = datasets.SHARED, told: Callable[[str], None] = lambda _: None
) -> Path:
    """All runs, or with `quick` the same over a tenth of the frames; DIR/cloud_long.json."""
    actor, results = actors.find(), list[Run]()
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
        results.append(measured(act, clouds[:count], clip, codec, residual))
        told(f"{clip}, {codec} {residual} %, {count} frames")
        content = {
            "machine": runner.machine(), "command": "mocodec eval cloud-long", "runs": [asdict(r) for r in results],
        }  # fmt: skip
        formats.replace_whole(folder / "cloud_long.json", (json.dumps(content, indent=1) + "\n").encode())
    return folder / "cloud_long.json"


def measured(act: sequences.Performance, clouds: PointClouds, clip: str, codec: str, residual: int) -> Run:
    """One run; its floor is what other samples of the same surface score."""
    options: dict[str, Any] = {"residual": residual, "skeleton": act.skeleton()[:1]}
    started = time.process_time()
    blob = api.encode(clouds, codec, **options)
    encoded = time.process_time()
    decoded = api.decode(blob)
    done = time.process_time()
    assert isinstance(decoded, PointClouds)
    with api.open(blob) as f:
        once = len(blob) - sum(len(chunk.payload) for chunk in f.encoded.chunks)
    at = np.unique(np.linspace(1, len(clouds) - 1, 10).round().astype(int)).tolist()
    some = replace(act, turns=act.turns[at], root=act.root[at])
    again = sequences.record(some, POINTS, seed=2)
    seen = replace(clouds, positions=[clouds.positions[f] for f in at], colours=[(clouds.colours or [])[f] for f in at])
    moving = (len(blob) - once) / len(clouds)
    raw = clouds.raw_bytes / len(clouds)
    return Run(
        clip, codec, residual, len(clouds), POINTS, clouds.raw_bytes, len(blob), once,
        round(clouds.raw_bytes / len(blob), 1), round(raw / moving, 1), round(moving, 1),
        round(len(clouds) / (encoded - started), 1), round(len(clouds) / max(done - encoded, 1e-9), 1),
        rounded(measures.compare(clouds, decoded, at)), rounded(measures.compare(seen, again, range(len(at)))),
    )  # fmt: skip


def rounded(values: dict[str, float]) -> dict[str, float]:
    return {key: round(value, 5) for key, value in values.items()}
