"""Bytes of markers, and of model outputs (angles, forces, moments, powers) as positions or beside the markers.

C3D ─► mocodec of an older checkout: all points are positions, within the bound ─► bytes
    └► mocodec: markers within the bound ─► bytes
                └ model outputs beside them, exactly or within 0.1 % of their range ─► bytes
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from mocodec import api
from mocodec.container.writer import extras_bytes
from mocodec.motion import Motion
from mocodec.packing import with_signal_error

BOUND_M = 0.002
SIGNAL_ERROR = "0.1%"
FILES = ("59993_Frame_Static", "Movement_trial", "RoboStatic", "Sample_Static", "Static_trial")


def measure(root: Path, before: Path | None, stored: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One record for each file. before: a checkout that stores model outputs as positions; stored: records with its
    bytes, used without a checkout."""
    paths = [root / "field-c3d" / f"{name}.c3d" for name in FILES]
    script = [sys.executable, str(Path(__file__).with_name("bare.py")), str(BOUND_M), *map(str, paths)]
    older: dict[str, dict[str, int]] = {record["file"]: record["all_points"] for record in stored}
    if before is not None:
        environment = {**os.environ, "PYTHONPATH": str(before / "src")}
        result = subprocess.run(script, env=environment, check=True, capture_output=True)
        older = {Path(path).name: size for path, size in json.loads(result.stdout).items()}
    records: list[dict[str, Any]] = []
    for path in paths:
        motion = api.read(path, Motion)
        outputs = replace(motion, extras={"model_outputs": motion.extras["model_outputs"]})
        markers = len(api.encode(replace(motion, extras={}), max_error=BOUND_M))
        record = {
            "file": path.name,
            "all_points": older[path.name],
            "markers": {"points": motion.points, "bytes": markers},
            "outputs": {
                "points": len(motion.extras["model_outputs"]["columns"]),
                "bytes": extras_bytes(outputs),
                "bounded_bytes": extras_bytes(with_signal_error(outputs, SIGNAL_ERROR)),
            },
        }
        records.append(record)
        print(json.dumps(record), file=sys.stderr, flush=True)
    return records


def rows(records: list[dict[str, Any]]) -> list[list[str]]:
    """Table rows: file; points and bytes before; of markers; difference; of outputs."""
    table: list[list[str]] = []
    for record in records:
        every, markers, outputs = (record[key] for key in ("all_points", "markers", "outputs"))
        change = 100 * (markers["bytes"] / every["bytes"] - 1)
        cells = [f"{part[key]:,}" for part in (every, markers) for key in ("points", "bytes")]
        beside = [f"{outputs[key]:,}" for key in ("points", "bytes", "bounded_bytes")]
        table.append([record["file"], *cells, f"{change:+.0f} %", *beside])
    return table
