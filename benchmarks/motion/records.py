"""Records of the motion benchmark: one coder at one target on one recording."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mocodec import formats

from ..results import rounded

OURS = ("tempo", "hou2014", "liu2006", "lossless")
MEAN, HARD = "mean_error", "max_error"
TARGETS = ((MEAN, 0.001), (MEAN, 0.003), (MEAN, 0.01), (HARD, 0.001), (HARD, 0.003), (HARD, 0.01))
LOSSLESS = ("lossless", 0.0)


@dataclass
class Record:
    """The result of one coder at one target on one recording. Errors in metres, times in seconds.

    content: hash of the positions; figure: a stick figure with the mean error of each joint, or empty; problem: reason
    for no result.
    """

    codec: str
    ours: bool
    settings: dict[str, Any]
    target: str
    target_m: float
    file: str
    content: str
    frames: int
    points: int
    rate: float
    bytes: int = 0
    bytes_by_part: dict[str, int] = field(default_factory=dict)
    ratio: float = 0.0
    mean_error_m: float = 0.0
    p99_error_m: float = 0.0
    max_error_m: float = 0.0
    d_percent: float = 0.0
    rms_m: float = 0.0
    gaps_equal: bool = True
    encode_s: float = 0.0
    decode_s: float = 0.0
    encode_fps: float = 0.0
    decode_fps: float = 0.0
    peak_memory_mb: float = 0.0
    version: str = ""
    problem: str = ""
    figure: dict[str, Any] = field(default_factory=dict)


def save(path: Path, records: Sequence[Record]) -> None:
    """Write records as a JSON list, one line each, so that a changed result is one changed line."""
    ordered = sorted(records, key=lambda r: (r.file, not r.ours, r.codec, r.target, r.target_m))
    lines = [json.dumps(rounded(asdict(record)), ensure_ascii=False) for record in ordered]
    formats.replace_whole(path, ("[\n" + ",\n".join(lines) + "\n]\n").encode())


def load(path: Path) -> list[Record]:
    """The records of a JSON file; empty without a file."""
    if not path.is_file():
        return []
    return [Record(**record) for record in json.loads(path.read_text())]
